//! A cloud of splats gives the same picture from every file format.
//!
//! The case for USD needs `LUMISTACK_PYTHON` to name a Python with usd-core, and is skipped without
//! it.

use std::path::Path;
use std::sync::Arc;

use glam::{DVec3, Quat, Vec3};
use lumistack_core::{Cancel, Cancelled, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pipeline::{ImporterJob, LightJob, PoseJob, Registry, load_scene};
use lumistack_scene::{Cloud, Scene, Window};
use lumistack_splats::read::read_spz;
use lumistack_splats::{Renderer, SplatView, Wanted, glb, write};

use crate::usd::has_usd;

/// Minimum PSNR of the pictures from a file against the pictures from the `.glb` file, dB.
const LEAST_PSNR: f64 = 50.0;

/// Returns a bumpy ball of flat splats, whose colours change with the direction. An `.spz` file can
/// represent all of its values.
fn ball() -> Cloud {
    let mut cloud = Cloud { degree: 2, ..Cloud::default() };
    for i in 0..1200 {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / 1200.0;
        let (sin, cos) = (2.399_963 * i as f32).sin_cos();
        let normal = Vec3::new((1.0 - y * y).sqrt() * cos, y, (1.0 - y * y).sqrt() * sin);
        cloud.positions.push((1.0 + 0.1 * (5.0 * sin).sin() + 0.3 * normal.y) * normal);
        cloud.rotations.push(Quat::from_rotation_arc(Vec3::Z, normal));
        cloud.scales.push(Vec3::new(0.09, 0.05, 0.01));
        cloud.opacities.push(0.5 + 0.4 * normal.x.abs());
        cloud.harmonics.extend([1.5 * normal.y, normal.x, -normal.z]);
        cloud.harmonics.extend((0..24).map(|k| 0.3 * ((k * i) as f32).sin()));
    }
    read_spz(&write::spz(&cloud).unwrap(), 1 << 30).unwrap().cloud
}

/// Returns the cloud in the axes of training programs, with y down and z away from the viewer. For
/// this, the cloud is rotated by half a turn about x.
fn as_trained(cloud: &Cloud) -> Cloud {
    let mut turned = cloud.clone();
    let turn = Quat::from_xyzw(1.0, 0.0, 0.0, 0.0);
    turned.positions.iter_mut().for_each(|at| *at = turn * *at);
    turned.rotations.iter_mut().for_each(|rotation| *rotation = turn * *rotation);
    // Harmonics whose power of y and z together is odd change sign. These are orders −1 and 0 of
    // degree 1, and orders −2 and 1 of degree 2.
    for splat in turned.harmonics.chunks_exact_mut(27) {
        for k in [1, 2, 4, 7] {
            splat[3 * k..3 * k + 3].iter_mut().for_each(|value| *value = -*value);
        }
    }
    turned
}

/// Returns a USD stage that contains the cloud.
fn usda(cloud: &Cloud) -> String {
    let tuples = |rows: &mut dyn Iterator<Item = Vec<f32>>| -> String {
        let texts = rows.map(|row| format!("({})", row.iter().map(f32::to_string).collect::<Vec<_>>().join(", ")));
        texts.collect::<Vec<_>>().join(", ")
    };
    let positions = tuples(&mut cloud.positions.iter().map(|at| at.to_array().to_vec()));
    let orientations = tuples(&mut cloud.rotations.iter().map(|q| vec![q.w, q.x, q.y, q.z]));
    let scales = tuples(&mut cloud.scales.iter().map(|scale| scale.to_array().to_vec()));
    let harmonics = tuples(&mut cloud.harmonics.chunks(3).map(<[f32]>::to_vec));
    let opacities: Vec<String> = cloud.opacities.iter().map(f32::to_string).collect();
    format!(
        "#usda 1.0\n(\n upAxis = \"Y\"\n)\ndef ParticleField3DGaussianSplat \"ball\"\n{{\n point3f[] positions = [{positions}]\n \
         quatf[] orientations = [{orientations}]\n float3[] scales = [{scales}]\n float[] opacities = [{}]\n \
         uniform int radiance:sphericalHarmonicsDegree = {}\n float3[] radiance:sphericalHarmonicsCoefficients = [{harmonics}]\n}}\n",
        opacities.join(", "),
        cloud.degree
    )
}

fn loaded(path: &Path) -> Arc<Scene> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let registry = Registry::built_in().unwrap();
    let (pose, importer, light) = (PoseJob::default(), ImporterJob::default(), LightJob::default());
    let task = Task::quiet(&warnings, &cancel);
    let loaded = load_scene(path, &pose, &importer, &registry, &light, None, task).unwrap();
    assert!(warnings.take().is_empty());
    loaded.scene
}

/// Renders views of a scene from the side, `[view][row][col][r, g, b, T]` with the transmittance T.
fn pictures(scene: &Arc<Scene>) -> Vec<f32> {
    let grid = ViewGrid::uniform(Projection::Perspective { distance_mm: 500.0 }, [2, 2], [20.0, 20.0]).unwrap();
    let geometry = FieldGeometry { rows: 60, cols: 80, pitch_mm: 3.0, grid };
    let forward = DVec3::new(-0.4, -0.3, -1.0);
    let window = Window::given(DVec3::ZERO, forward, DVec3::Y, 4.0, geometry.size_mm()).unwrap();
    let slopes: Vec<[f64; 2]> =
        geometry.grid.iter().map(|[y, x]| [geometry.grid.slope_x[x], geometry.grid.slope_y[y]]).collect();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let mut all = Vec::new();
    let none = |_: usize| Ok::<_, Cancelled>(None);
    let done = |_: usize, view: SplatView| {
        all.extend_from_slice(view.light.data());
        Ok(())
    };
    let renderer = Renderer::new(scene.clone()).unwrap();
    let task = Task::quiet(&warnings, &cancel);
    renderer.render(&window, &geometry, &slopes, &none, Wanted::Light, task, done).unwrap();
    all
}

#[test]
fn one_cloud_gives_the_same_picture_from_every_file() {
    let folder = tempfile::tempdir().unwrap();
    let (upright, trained) = (ball(), as_trained(&ball()));
    let put = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    put("a.glb", &glb(&upright, [0.0, 0.0, 0.0, 1.0], 1.0).unwrap());
    put("a.ply", &write::ply(&trained));
    put("a.spz", &write::spz(&upright).unwrap());
    write::sog(&trained).unwrap().iter().for_each(|(name, bytes)| put(name, bytes));
    put("a.usda", usda(&upright).as_bytes());
    let of = |name: &str| pictures(&loaded(&folder.path().join(name)));
    let original = of("a.glb");
    assert!(original.chunks_exact(4).filter(|pixel| pixel[3] < 0.5).count() > 3000, "the ball is seen");
    let mut files = vec!["a.ply", "a.spz", "meta.json"];
    if has_usd() {
        files.push("a.usda");
    }
    for name in files {
        let squares: f64 = original.iter().zip(of(name)).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        let quality = -10.0 * (squares / original.len() as f64).log10();
        assert!(quality >= LEAST_PSNR, "{name}: {quality} dB");
    }
}
