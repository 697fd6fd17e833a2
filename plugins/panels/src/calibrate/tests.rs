use image::Luma;
use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::Transfer;
use lumistack_testkit::camera::Camera;

use super::*;
use crate::{Pattern, Place, Shows};

const OUTPUT: [usize; 2] = [840, 525];
const EYE: [f64; 3] = [12.0, -8.0, 2000.0];
/// Largest allowed error of the homographies, panel pixels.
const ERROR_PX: f64 = 0.1;
/// Largest allowed error of the homography of a panel that is already calibrated, panel pixels. It
/// is larger than [`ERROR_PX`], since lines of rotated crosses are staircases of panel pixels.
const ASKEW_PX: f64 = 0.2;

fn display() -> Display {
    let mut display = Display::uniform([420, 262], 1.1, [3, 3], [10.0, 10.0], &[-40.0, 0.0, 40.0], 1);
    for layer in &mut display.layers {
        (layer.panel_pitch_mm, layer.transfer) = (Some(0.55), Transfer::Linear);
    }
    display
}

/// Returns a photograph of a layer whose panel is misplaced: the homography `moved` maps a panel
/// point's nominal position to its real position.
fn photograph(
    camera: &Camera,
    display: &Display,
    layer: usize,
    moved: &Homography,
    noise: f64,
    seed: u64,
) -> GrayImage {
    let only = Some(Shows::Layer(layer));
    let codes = Pattern::Crosshairs.codes(display, Shows::Layer(layer), OUTPUT, only, EYE).unwrap();
    let back = moved.inverse();
    let pitch = Place::new(display, Shows::Layer(layer), OUTPUT).pitch_mm;
    let light = |mm: [f64; 2]| {
        let q = back.apply(mm);
        let col = (q[0] / pitch + (OUTPUT[0] as f64 - 1.0) / 2.0).round();
        let row = ((OUTPUT[1] as f64 - 1.0) / 2.0 - q[1] / pitch).round();
        let inside = col >= 0.0 && row >= 0.0 && col < OUTPUT[0] as f64 && row < OUTPUT[1] as f64;
        if inside { f64::from(codes[4 * (row as usize * OUTPUT[0] + col as usize)]) } else { 0.0 }
    };
    let mut random = Stream::new(seed);
    camera.photograph(display.layers[layer].d_mm, &light, noise, &mut || random.next_f32())
}

fn camera(turn: [f64; 3], bend: [f64; 2]) -> Camera {
    Camera { eye_mm: EYE, turn, focal_px: 3700.0, bend, size: [1200, 800] }
}

fn turned(degrees: f64, shift: [f64; 2], tilt: [f64; 2]) -> Homography {
    let (sin, cos) = degrees.to_radians().sin_cos();
    Homography([[cos, -sin, shift[0]], [sin, cos, shift[1]], [tilt[0], tilt[1], 1.0]])
}

#[test]
fn photographs_with_a_bent_lens_and_noise_say_where_panels_are() {
    let display = display();
    let camera = camera([0.012, -0.009, 0.015], [-0.11, 0.02]);
    let truths = [(0, turned(0.6, [2.3, -1.1], [3e-6, -2e-6])), (2, turned(-0.35, [-0.8, 1.7], [-2e-6, 4e-6]))];
    let reference = photograph(&camera, &display, 1, &Homography::IDENTITY, 4.0, 1);
    let photographs: Vec<GrayImage> = truths
        .iter()
        .map(|(layer, moved)| photograph(&camera, &display, *layer, moved, 4.0, 2 + *layer as u64))
        .collect();
    if let Ok(folder) = std::env::var("LUMISTACK_TEST_PICTURES") {
        reference.save(format!("{folder}/photograph_1.png")).unwrap();
        photographs[0].save(format!("{folder}/photograph_0.png")).unwrap();
    }
    let others: Vec<_> = truths.iter().zip(&photographs).map(|((layer, _), photo)| (*layer, photo)).collect();
    let (lens, found) = calibrate(&display, EYE, (1, &reference), &others).unwrap();
    println!("lens: {:?}", lens.distortion);
    let counts = pattern::crosses(&display);
    for ((_, truth), found) in truths.iter().zip(&found) {
        assert_eq!(found.crosses, (2 * counts[0] + 1) * (2 * counts[1] + 1));
        let mut worst: f64 = 0.0;
        for (i, j) in (-10..=10).flat_map(|i| (-10..=10).map(move |j| (f64::from(i), f64::from(j)))) {
            // Compare the homographies at the points of a grid over the whole panel, corners
            // included.
            let q = [i / 10.0 * 0.5 * 840.0 * 0.55, j / 10.0 * 0.5 * 525.0 * 0.55];
            let (a, b) = (truth.apply(q), found.homography.apply(q));
            worst = worst.max((a[0] - b[0]).hypot(a[1] - b[1]) / 0.55);
        }
        println!(
            "layer {}: {worst:.4} panel pixels at worst, crosses within {:.4} mm, moved {:.2} mm",
            found.layer, found.rms_mm, found.moved_mm
        );
        assert!(worst <= ERROR_PX, "layer {}: {worst} panel pixels", found.layer);
        assert!(found.moved_mm > 1.0);
    }
}

#[test]
fn a_calibrated_panel_is_found_where_it_is_and_stays() {
    // The display already has the right calibration, with which the array is drawn. So the
    // correction must be zero.
    let mut display = display();
    let truth = turned(0.5, [1.5, 0.7], [0.0, 0.0]);
    display.layers[0].panel.get_or_insert_default().homography = Some(truth.0);
    let camera = camera([0.0; 3], [0.0; 2]);
    let reference = photograph(&camera, &display, 1, &Homography::IDENTITY, 2.0, 1);
    let photograph = photograph(&camera, &display, 0, &truth, 2.0, 2);
    let (_, found) = calibrate(&display, EYE, (1, &reference), &[(0, &photograph)]).unwrap();
    assert!(found[0].moved_mm < ERROR_PX * 0.55, "{:?}", found[0]);
    for corner in [[-231.0, 144.0], [231.0, -144.0], [0.0, 0.0]] {
        let (a, b) = (truth.apply(corner), found[0].homography.apply(corner));
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < ASKEW_PX * 0.55, "{a:?} {b:?}");
    }
}

#[test]
fn photographs_of_something_else_are_refused() {
    let display = display();
    let empty = GrayImage::from_pixel(300, 200, Luma([128]));
    let error = calibrate(&display, EYE, (1, &empty), &[]).unwrap_err().to_string();
    assert!(error.starts_with("photograph of layer 1: expected the array of crosses"), "{error}");
    let mut random = Stream::new(1);
    let noise = GrayImage::from_fn(300, 200, |_, _| Luma([(random.next_u64() & 255) as u8]));
    assert!(calibrate(&display, EYE, (1, &noise), &[]).is_err());
}
