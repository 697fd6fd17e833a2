use std::sync::Arc; use std::time::Instant; use std::path::*;
use lumistack_core::*; use lumistack_display::*; use lumistack_pathtracer::*; use lumistack_scene::Window;
struct Folder(PathBuf);
impl lumistack_gltf::AssetResolver for Folder { fn read(&self, uri: &str) -> Result<Vec<u8>, String> { std::fs::read(self.0.join(uri)).map_err(|e| e.to_string()) } }
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let (w, c) = (Collector::default(), Cancel::default()); let task = Task::quiet(&w, &c);
    let path = Path::new(&a[1]);
    let scene = Arc::new(lumistack_gltf::load("x", &std::fs::read(path).unwrap(), &Folder(path.parent().unwrap().into()), task).unwrap());
    let geometry = FieldGeometry { rows: 131, cols: 210, pitch_mm: 473.76/210.0, grid: ViewGrid::single(Projection::Oblique, [0.05, 0.02]) };
    let window = Window::from_camera(&scene.cameras[0], scene.bounds(), geometry.size_mm()).unwrap();
    let r = Renderer::new(scene, task).unwrap();
    let base = Settings::default();
    let reference = r.render_view(&window, &geometry, [0,0], &Settings { samples: 4096, seed: 77, ..base }, task).unwrap();
    let im = r.render_view(&window, &geometry, [0,0], &Settings { samples: 64, ..base }, task).unwrap();
    let codes: Vec<u8> = im.data().iter().zip(reference.data()).map(|(a, b)| ((a.min(1.0) - b.min(1.0)).abs() * 2500.0).min(255.0) as u8).collect();
    image::RgbImage::from_raw(210, 131, codes).unwrap().save("/tmp/err.png").unwrap();
    let codes: Vec<u8> = reference.data().iter().map(|&v| colour::srgb_code(v)).collect();
    image::RgbImage::from_raw(210, 131, codes).unwrap().save("/tmp/ref.png").unwrap();
    if a.len() > 2 { return; }
    for samples in [16, 64] { for start in [0,1,2,3,5] {
        let t = Instant::now();
        let n = 4;
        let mut mse = 0.0; let mut robust = 0.0;
        for seed in 0..n {
            let im = r.render_view(&window, &geometry, [0,0], &Settings { samples, seed, roulette_start: start, ..base }, task).unwrap();
            mse += metrics::SquaredError::between(im.data(), reference.data()).mse() / n as f64;
            // display-referred error
            let f = |v: &f32| v.min(1.0);
            let x: Vec<f32> = im.data().iter().map(f).collect(); let y: Vec<f32> = reference.data().iter().map(f).collect();
            robust += metrics::SquaredError::between(&x, &y).mse() / n as f64;
        }
        let t = t.elapsed().as_secs_f64() / n as f64;
        println!("spp {samples} rr {start}: mse {mse:.3e} clipped {robust:.3e} psnr {:.1} time {t:.3} eff {:.3e} clipped eff {:.3e}  {:.2} Ms/s", -10.0*robust.log10(), mse*t, robust*t, samples as f64*131.0*210.0/t*1e-6);
    }}
}
