//! The paper's single panel behind a lens array, from the scene to the panels.
//!
//! A scene becomes patterns of a backlight and a layer, and these become the pictures of two
//! panels. The test then traces rays through layer and lenses to the rear panel. This tracing does
//! not use the display model.

use lumistack_display::{Backlight, Display, LensletBacklight, Projection};
use lumistack_plugin_panels::{Picture, Shows};

use crate::common::{lumistack, number, report, root, succeed};

/// Largest difference between the PSNR of the traced rays and the PSNR in the report, dB.
const DECIBELS: f64 = 0.5;
/// Half the width of the pupil, as a fraction of the width of a view's angular bin.
const PUPIL: f64 = 0.3;
/// On each axis of the pupil, rays go to `2 * PUPIL_STEPS + 1` points.
const PUPIL_STEPS: i32 = 3;
/// One ray out of this number is traced. Different rays are traced for different views.
const EVERY: usize = 21;

/// The picture of a panel as light: red, green and blue of every pixel, row by row.
struct Panel {
    light: Vec<[f64; 3]>,
    size: [usize; 2],
    pitch_mm: f64,
}

impl Panel {
    /// Decodes codes in the order in which they are sent: red, green, blue and a fourth byte.
    fn new(codes: &[u8], size: [usize; 2], pitch_mm: f64) -> Self {
        // the transfer function of IEC 61966-2-1, which the display file declares
        let decoded = |code: u8| {
            let code = f64::from(code) / 255.0;
            if code <= 0.040_45 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) }
        };
        let light = codes.chunks_exact(4).map(|pixel| [0, 1, 2].map(|c| decoded(pixel[c]))).collect();
        Self { light, size, pitch_mm }
    }

    fn light(&self, at_mm: [f64; 2]) -> Option<[f64; 3]> {
        let col = (at_mm[0] / self.pitch_mm + self.size[0] as f64 / 2.0).floor();
        let row = (self.size[1] as f64 / 2.0 - at_mm[1] / self.pitch_mm).floor();
        let inside = col >= 0.0 && row >= 0.0 && col < self.size[0] as f64 && row < self.size[1] as f64;
        inside.then(|| self.light[row as usize * self.size[0] + col as usize])
    }
}

/// Returns the point on the rear panel from which a ray comes. The ray leaves the lens array at the
/// point `place_mm` with the slope `slope`. `None` if `place_mm` is not on the array.
///
/// The ray is followed backwards from the lens plane: through a thin lens of focal length
/// `focal_mm`, and to the focal plane of the lens.
fn behind(lenses: &LensletBacklight, focal_mm: f64, place_mm: [f64; 2], slope: [f64; 2]) -> Option<[f64; 2]> {
    let mut on_panel = [0.0; 2];
    for axis in 0..2 {
        let count = lenses.lenslets[axis] as f64;
        let lens = (place_mm[axis] / lenses.pitch_mm + count / 2.0).floor();
        if lens < 0.0 || lens >= count {
            return None;
        }
        let centre = (lens + 0.5 - count / 2.0) * lenses.pitch_mm;
        let height = place_mm[axis] - centre;
        // A thin lens of focal length f changes the slope of a ray at height h by −h/f. So before
        // the ray passes the lens, its slope is larger by h/f.
        let before = slope[axis] + height / focal_mm;
        on_panel[axis] = place_mm[axis] - before * focal_mm;
    }
    Some(on_panel)
}

#[test]
fn rays_through_lenses_and_layer_see_the_target() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let job = folder.path().join("job.toml");
    let scene = root().join("scenes/letters/letters.gltf");
    // this test does not need the zone score, so the job switches it off
    let text = format!(
        "scene = {scene:?}\noutputs = []\n[display]\npreset = \"paper-directional\"\nresolution = [56, 35]\nframes = 2\n\
         [render]\nsamples = 3\n[factorize]\niterations = 8\n[report]\nzone_directions = 0\n"
    );
    std::fs::write(&job, text).unwrap();
    succeed(lumistack().arg("run").arg(&job).arg("-o").arg(&run));
    let display = Display::from_toml(&std::fs::read_to_string(run.join("display.toml")).unwrap()).unwrap();
    let stack = lumistack_field_io::read_stack(&run.join("layers")).unwrap();
    let (field, _) = lumistack_field_io::read_field_folder(&run.join("target")).unwrap();
    let Backlight::Lenslets(lenses) = &display.backlight else { panic!("directional") };
    let rear = &display.layers[0];
    let (size, pitch_mm) = (rear.panel_resolution.unwrap(), rear.panel_pitch_mm.unwrap());
    // the lenses have a field of view of 48 degrees
    let focal_mm = 0.5 * lenses.pitch_mm / 24f64.to_radians().tan();
    let panels: Vec<[Panel; 2]> = (0..display.frames)
        .map(|frame| {
            [Shows::Backlight, Shows::Layer(0)].map(|shows| {
                let codes = Picture::new(&display, shows, size).codes(&stack, frame, None);
                Panel::new(&codes, size, pitch_mm)
            })
        })
        .collect();
    let geometry = field.geometry();
    assert_eq!(geometry.grid.projection, Projection::Oblique);
    let bin = geometry.grid.bin_width();
    let pupil: Vec<[f64; 2]> = (-PUPIL_STEPS..=PUPIL_STEPS)
        .flat_map(|y| (-PUPIL_STEPS..=PUPIL_STEPS).map(move |x| [x, y]))
        .map(|at| [0, 1].map(|axis| f64::from(at[axis]) / f64::from(PUPIL_STEPS) * PUPIL * bin[axis]))
        .collect();
    let (mut sum, mut count) = (0.0, 0.0);
    let [views_y, views_x] = geometry.grid.views();
    for (view_y, view_x) in (0..views_y).flat_map(|y| (0..views_x).map(move |x| (y, x))) {
        let slope = [geometry.grid.slope_x[view_x], geometry.grid.slope_y[view_y]];
        let target = field.view([view_y, view_x]);
        for (row, col) in (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| (row, col))) {
            if (row * geometry.cols + col + view_y + 2 * view_x) % EVERY != 0 {
                continue;
            }
            let on_plane = [geometry.x_mm(col), geometry.y_mm(row)];
            let mut seen = [0.0; 3];
            let mut missed = false;
            for offset in &pupil {
                let slope = [0, 1].map(|axis| slope[axis] + offset[axis]);
                let at = |d_mm: f64| [0, 1].map(|axis| on_plane[axis] + d_mm * slope[axis]);
                let Some(source) = behind(lenses, focal_mm, at(lenses.d_mm), slope) else {
                    missed = true;
                    break;
                };
                for [backlight, layer] in &panels {
                    let (Some(emitted), Some(passed)) = (backlight.light(source), layer.light(at(rear.d_mm))) else {
                        missed = true;
                        break;
                    };
                    (0..3).for_each(|c| seen[c] += emitted[c] * passed[c]);
                }
            }
            if missed {
                continue;
            }
            for c in 0..3 {
                let mean = seen[c] / (pupil.len() * panels.len()) as f64;
                let wanted = f64::from(target[3 * (row * geometry.cols + col) + c]);
                sum += (mean / stack.brightness - wanted).powi(2);
                count += 1.0;
            }
        }
    }
    let psnr = -10.0 * (sum / count).log10();
    let reported = number(&report(&run), "psnr_view");
    println!("traced through the lenses {psnr:.2} dB, reported {reported:.2} dB");
    assert!((psnr - reported).abs() <= DECIBELS, "traced {psnr:.2} dB, reported {reported:.2} dB");
}
