//! Presentations by `lumistack show`: the preview in a window, flat pictures, test patterns on
//! every output, and calibration from photographs of the patterns.

#![cfg(feature = "panels")]

use std::path::Path;

use lumistack_core::seed::Stream;
use lumistack_display::{Display, Flip, LayerStack, Panel, Sampling, Transfer};
use lumistack_testkit::camera::Camera;

use crate::common::session::{Picture, SWAY, Session, wait_for};
use crate::common::show::Show;
use crate::common::{self, poke, session};

/// Makes a run whose layers contain smooth pictures. A test compares views of the run, and a
/// developer can look at the views.
fn write_waves(folder: &Path) -> Display {
    let mut display = Display::uniform([96, 60], 2.0, [3, 3], [24.0, 16.0], &[-20.0, 0.0, 20.0], 2);
    display.brightness = 0.5;
    let mut stack = LayerStack::filled(&display, 0.0);
    for (n, layer) in stack.layers.iter_mut().enumerate() {
        let [frames, rows, cols, _] = layer.shape();
        for (frame, row, col) in
            (0..frames).flat_map(|f| (0..rows).flat_map(move |r| (0..cols).map(move |c| (f, r, c))))
        {
            let (x, y) = (col as f32 / cols as f32 - 0.5, row as f32 / rows as f32 - 0.5);
            // draw rings on every layer, with a colour and a position for each layer, so that
            // parallax is visible
            let distance = (x - 0.1 * n as f32 + 0.1).hypot(0.6 * y) - 0.02 * frame as f32;
            for (channel, value) in layer.block_mut([frame, row, col]).iter_mut().enumerate() {
                let dims = channel == n;
                *value = if dims { 0.55 + 0.45 * (40.0 * distance).cos() } else { 1.0 };
            }
        }
    }
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join("display.toml"), display.to_toml()).unwrap();
    lumistack_field_io::write_stack(&folder.join("layers"), &display, &stack).unwrap();
    display
}

/// Saves a screenshot if `LUMISTACK_TEST_PICTURES` names a folder.
fn keep(picture: &Picture, name: &str) {
    if let Ok(folder) = std::env::var("LUMISTACK_TEST_PICTURES") {
        picture.save(&Path::new(&folder).join(format!("{name}.png")));
    }
}

/// Returns true if a window shows the picture that `lumistack simulate` writes for an angle. The
/// window enlarges each pixel by a whole factor. A rounding difference of one code is allowed.
fn shows_simulation(window: &Picture, run: &Path, from: [f64; 2]) -> bool {
    let file = run.join("simulated.png");
    let view = format!("{:.6},{:.6}", from[0], from[1]);
    common::succeed(common::lumistack().arg("simulate").arg(run).args(["--view", &view, "-o"]).arg(&file));
    let wanted = image::open(&file).unwrap().to_rgb8();
    let (cols, rows) = (wanted.width() as usize, wanted.height() as usize);
    let scale = (window.size[0] / cols).min(window.size[1] / rows);
    let corner = [(window.size[0] - scale * cols) / 2, (window.size[1] - scale * rows) / 2];
    (0..window.size[1]).all(|y| {
        (0..window.size[0]).all(|x| {
            let found = &window.rgb[3 * (y * window.size[0] + x)..][..3];
            let place = (x.wrapping_sub(corner[0]) / scale, y.wrapping_sub(corner[1]) / scale);
            match x >= corner[0] && y >= corner[1] && place.0 < cols && place.1 < rows {
                true => {
                    let pixel = wanted.get_pixel(place.0 as u32, place.1 as u32).0;
                    found.iter().zip(pixel).all(|(a, b)| a.abs_diff(b) <= 1)
                }
                false => found == [0, 0, 0],
            }
        })
    })
}

#[test]
fn the_preview_window_shows_the_view_that_the_pointer_selects() {
    let Some(session) = Session::xorg(&[("DUMMY0", [1200, 800], [0, 0])]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let display = write_waves(folder.path());
    let mut show = Show::start(&session, folder.path(), &["--preview", "--from", "3,-2"]);
    show.event("started");
    // along each axis the window has eight pixels for every pixel of the display
    let size = [768, 480];
    let window = || Some(session.import()?.part([0, 0], size));
    let first =
        wait_for("the first view", || window().filter(|shot| shows_simulation(shot, folder.path(), [3.0, -2.0])));
    keep(&first, "preview_first");
    let mut poke = poke::Poke::new(session.x_display());
    let mut seen = vec![first];
    for (i, at) in [[384, 240], [40, 240], [728, 240], [384, 30], [600, 450]].into_iter().enumerate() {
        // move the pointer twice: if the pointer is already at a position, a move to this position
        // causes no event
        poke.point([at[0] - 1, at[1]]);
        poke.point(at);
        // an edge of the window stands for 1.2 times half the field of view
        let share = [2.0 * f64::from(at[0]) / 768.0 - 1.0, 1.0 - 2.0 * f64::from(at[1]) / 480.0];
        let from = [0, 1].map(|axis| 1.2 * share[axis] * 0.5 * display.field.fov_deg[axis]);
        let shot = wait_for(&format!("the view from {from:?}"), || {
            window().filter(|shot| shows_simulation(shot, folder.path(), from))
        });
        keep(&shot, &format!("preview_{i}"));
        assert!(!seen.contains(&shot), "the picture does not follow the pointer");
        seen.push(shot);
    }
    let report = show.quit();
    assert!(report["swaps"].as_u64().unwrap() >= 6, "{report}");
}

#[test]
fn a_flat_picture_has_all_pixels_of_its_panel() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut display = Display::uniform([320, 180], 0.5, [3, 3], [10.0, 10.0], &[-10.0, 0.0, 10.0], 1);
    for layer in &mut display.layers {
        layer.transfer = Transfer::Linear;
    }
    display.layers[2].panel_pitch_mm = Some(0.25);
    display.layers[2].panel = Some(Panel { flip: Flip::Horizontal, ..Panel::default() });
    std::fs::write(folder.path().join("display.toml"), display.to_toml()).unwrap();
    // The third panel and the picture have 640 × 360 pixels, and a pixel of the panel's mask covers
    // 2 × 2 of the panel's pixels. The panel is mirrored and has linear codes.
    let mut random = Stream::new(5);
    let picture = image::RgbImage::from_fn(640, 360, |x, y| {
        let ring = (f64::from(x) - 320.0).hypot(f64::from(y) - 180.0) < 120.0;
        let noise = (random.next_u64() & 63) as u8;
        image::Rgb(if ring { [255 - noise, 40 + noise, noise] } else { [(x / 3) as u8, (y / 2) as u8, 90 + noise] })
    });
    let file = folder.path().join("flat.png");
    picture.save(&file).unwrap();
    let options = ["--full-resolution-2d", file.to_str().unwrap(), "--layer", "2"];
    let mut show = Show::start(&session, &folder.path().join("display.toml"), &options);
    show.event("started");
    // converts an sRGB code of the picture to the linear code of the panel
    let code = |code: u8| {
        let value = f64::from(code) / 255.0;
        let light = if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) };
        (light * 255.0).round() as u8
    };
    let mut rgb = Vec::new();
    for (y, x) in (0..360).flat_map(|y| (0..640).map(move |x| (y, x))) {
        rgb.extend(picture.get_pixel(639 - x, y).0.map(code));
    }
    let wanted = Picture { size: [640, 360], rgb };
    let shot = wait_for("the picture", || session.grim("HEADLESS-3").filter(|shown| *shown == wanted));
    keep(&shot, "flat_2");
    // All other panels are clear inside of their masks, which are 320 × 180 pixels in the middle,
    // and dark outside of the masks.
    for (name, [cols, rows], _) in &SWAY[..2] {
        let mut rgb = Vec::new();
        for (y, x) in (0..*rows).flat_map(|y| (0..*cols).map(move |x| (y, x))) {
            let inside = (2 * x + 1).abs_diff(*cols) < 320 && (2 * y + 1).abs_diff(*rows) < 180;
            rgb.extend([if inside { 255 } else { 0 }; 3]);
        }
        let clear = Picture { size: [*cols, *rows], rgb };
        wait_for(&format!("{name} clear"), || session.grim(name).filter(|shown| *shown == clear));
    }
    show.quit();
}

#[test]
fn masks_for_other_panels_cause_a_warning_and_fit_scales_them() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let folder = tempfile::tempdir().unwrap();
    let display = Display::uniform([40, 30], 4.0, [3, 3], [10.0, 10.0], &[-10.0, 0.0, 10.0], 1);
    std::fs::write(folder.path().join("display.toml"), display.to_toml()).unwrap();
    lumistack_field_io::write_stack(&folder.path().join("layers"), &display, &LayerStack::filled(&display, 1.0))
        .unwrap();
    // With `--fit` a mask pixel covers 8 × 8 panel pixels, since the mask then fills the smallest
    // panel.
    for (options, mask) in [(&["--hold", "0"][..], [40, 30]), (&["--hold", "0", "--fit"], [320, 240])] {
        let mut show = Show::start(&session, folder.path(), options);
        let warning = show.event("warning");
        let text = warning["message"].as_str().unwrap();
        match mask {
            [40, _] => assert!(
                text.starts_with("layer 0 covers 40 × 30 pixels, and output HEADLESS-1 has 320 × 240"),
                "{text}"
            ),
            _ => assert!(
                text.starts_with("fit: the masks are scaled as if the pixels of all panels had a pitch of 0.5000 mm"),
                "{text}"
            ),
        }
        for (name, [cols, rows], _) in SWAY {
            let mut rgb = Vec::new();
            for (y, x) in (0..rows).flat_map(|y| (0..cols).map(move |x| (y, x))) {
                let inside = (2 * x + 1).abs_diff(cols) < mask[0] && (2 * y + 1).abs_diff(rows) < mask[1];
                rgb.extend([if inside { 255 } else { 0 }; 3]);
            }
            let wanted = Picture { size: [cols, rows], rgb };
            wait_for(&format!("{mask:?} on {name}"), || session.grim(name).filter(|shown| *shown == wanted));
        }
        show.quit();
    }
}

/// Columns and rows of the panels that are photographed.
const PANEL: [usize; 2] = [840, 525];
const PITCH_MM: f64 = 0.55;
/// Largest error of positions after calibration, panel pixels.
const ERROR_PX: f64 = 0.1;
const EYE: [f64; 3] = [12.0, -8.0, 2000.0];

/// The true pose of a panel, which the calibration must find: its rotation, and its shift in the
/// plane of its layer in millimetres.
#[derive(Clone, Copy)]
struct Standing {
    turn_rad: f64,
    shift_mm: [f64; 2],
}

impl Standing {
    /// Returns the pixel (column, row) at a point of the layer in millimetres.
    fn pixel(&self, mm: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.turn_rad.sin_cos();
        let [x, y] = [0, 1].map(|axis| mm[axis] - self.shift_mm[axis]);
        let [x, y] = [cos * x + sin * y, cos * y - sin * x];
        [x / PITCH_MM + (PANEL[0] as f64 - 1.0) / 2.0, (PANEL[1] as f64 - 1.0) / 2.0 - y / PITCH_MM]
    }

    /// Returns the point of the layer, in millimetres, at a pixel.
    fn mm(&self, pixel: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.turn_rad.sin_cos();
        let x = (pixel[0] - (PANEL[0] as f64 - 1.0) / 2.0) * PITCH_MM;
        let y = ((PANEL[1] as f64 - 1.0) / 2.0 - pixel[1]) * PITCH_MM;
        [cos * x - sin * y + self.shift_mm[0], sin * x + cos * y + self.shift_mm[1]]
    }
}

const OUTPUTS: [session::Screen; 3] = [
    ("HEADLESS-1", PANEL, [0, 0]),
    ("HEADLESS-2", PANEL, [PANEL[0] as i32, 0]),
    ("HEADLESS-3", PANEL, [2 * PANEL[0] as i32, 0]),
];

/// Tests the whole calibration. An output shows crosses, the test renders a photograph of them, and
/// the command corrects the display file. Then spots on the outputs must appear at their positions.
#[test]
fn photographs_correct_the_pose_of_panels() {
    let Some(session) = Session::sway(&OUTPUTS) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut display = Display::uniform([420, 262], 1.1, [3, 3], [10.0, 10.0], &[-40.0, 0.0, 40.0], 1);
    for layer in &mut display.layers {
        (layer.panel_pitch_mm, layer.transfer) = (Some(PITCH_MM), Transfer::Linear);
        // Interpolate between pixels. After a small rotation, the nearest pixel would shift an edge
        // by up to half a pixel.
        layer.panel = Some(Panel { resample: Sampling::Bilinear, ..Panel::default() });
    }
    // every layer has one spot, 12 mask pixels wide, in each of its nine parts
    let mut stack = LayerStack::filled(&display, 0.0);
    let spots: Vec<[usize; 2]> =
        [60, 210, 360].into_iter().flat_map(|col| [50, 131, 212].map(|row| [col, row])).collect();
    for layer in &mut stack.layers {
        for [col, row] in &spots {
            for (r, c) in (row - 6..row + 6).flat_map(|r| (col - 6..col + 6).map(move |c| (r, c))) {
                layer.block_mut([0, r, c]).fill(1.0);
            }
        }
    }
    let file = folder.path().join("display.toml");
    std::fs::write(&file, display.to_toml()).unwrap();
    lumistack_field_io::write_stack(&folder.path().join("layers"), &display, &stack).unwrap();

    let standing = [
        Standing { turn_rad: 0.010, shift_mm: [2.3, -1.1] },
        Standing { turn_rad: 0.0, shift_mm: [0.0, 0.0] },
        Standing { turn_rad: -0.006, shift_mm: [-0.8, 1.7] },
    ];
    let camera =
        Camera { eye_mm: EYE, turn: [0.012, -0.009, 0.015], focal_px: 3700.0, bend: [-0.11, 0.02], size: [1200, 800] };
    let photograph = |n: usize, round: usize| {
        let only = n.to_string();
        let options = ["--pattern", "crosshairs", "--only", &only, "--eye-mm", "12,-8,2000"];
        let mut show = Show::start(&session, &file, &options);
        show.event("swapped");
        // The panel shows dark crosses on a light background. The picture is complete when most of
        // it is light and two screenshots are equal.
        let name = OUTPUTS[n].0;
        let shot = wait_for("the crosses", || {
            let shot = session.grim(name)?;
            let light = shot.rgb.iter().filter(|code| **code > 200).count();
            (light > shot.rgb.len() / 2 && light < shot.rgb.len() && session.grim(name)? == shot).then_some(shot)
        });
        show.quit();
        let light = |mm: [f64; 2]| {
            let [col, row] = standing[n].pixel(mm).map(f64::round);
            let inside = col >= 0.0 && row >= 0.0 && col < PANEL[0] as f64 && row < PANEL[1] as f64;
            if inside { f64::from(shot.rgb[3 * (row as usize * PANEL[0] + col as usize)]) } else { 0.0 }
        };
        let mut random = Stream::new((10 * round + n) as u64);
        let picture = camera.photograph(display.layers[n].d_mm, &light, 4.0, &mut || random.next_f32());
        let path = folder.path().join(format!("photograph_{round}_{n}.png"));
        picture.save(&path).unwrap();
        if let Ok(kept) = std::env::var("LUMISTACK_TEST_PICTURES") {
            picture.save(Path::new(&kept).join(format!("photograph_{round}_{n}.png"))).unwrap();
        }
        format!("{n}={}", path.display())
    };
    let calibrate = |photographs: &[String], extra: &[&str]| -> Vec<serde_json::Value> {
        let mut command = common::lumistack();
        command.args(["--json", "display", "calibrate"]).arg(&file).args(["--eye-mm", "12,-8,2000"]);
        command.args(["--reference", &photographs[1], "--photo", &photographs[0], "--photo", &photographs[2]]);
        let text = common::succeed(command.args(extra));
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let first: Vec<String> = (0..3).map(|n| photograph(n, 1)).collect();
    let before = std::fs::read_to_string(&file).unwrap();
    calibrate(&first, &["--dry-run"]);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), before, "a dry run changes nothing");
    for found in calibrate(&first, &[]) {
        println!("{found}");
        assert!(found["moved_mm"].as_f64().unwrap() > 1.0, "{found}");
    }
    // a second calibration finds no remaining error of the panels' positions
    let second: Vec<String> = (0..3).map(|n| photograph(n, 2)).collect();
    for found in calibrate(&second, &["--dry-run"]) {
        println!("{found}");
        assert!(found["moved_mm"].as_f64().unwrap() < ERROR_PX * PITCH_MM, "{found}");
    }
    // now the outputs show the spots at the corrected positions; screenshots measure these
    // positions
    let mut show = Show::start(&session, folder.path(), &["--hold", "0"]);
    show.event("swapped");
    for (n, (name, ..)) in OUTPUTS.iter().enumerate() {
        let shot = wait_for("the spots", || {
            let shot = session.grim(name)?;
            // there are nine spots of 12² mask pixels, and a mask pixel has 2² panel pixels
            let light = shot.rgb.iter().map(|code| usize::from(*code)).sum::<usize>() / 255;
            (light.abs_diff(9 * 3 * 24 * 24) < 300).then_some(shot)
        });
        keep(&shot, &format!("spots_{n}"));
        let mut worst: f64 = 0.0;
        for [col, row] in &spots {
            // a spot is 12 pixels wide, so its middle is half a pixel to the left of the centre of
            // pixel [col, row], and half a pixel above this centre
            let wanted = [(*col as f64 - 0.5 - 209.5) * 1.1, (130.5 - (*row as f64 - 0.5)) * 1.1];
            let around = standing[n].pixel(wanted);
            let (mut sum, mut count) = ([0.0; 2], 0.0);
            for (y, x) in (-25..=25).flat_map(|y| (-25..=25).map(move |x| (y, x))) {
                let (x, y) = (around[0].round() as i32 + x, around[1].round() as i32 + y);
                let light = f64::from(shot.rgb[3 * (y as usize * PANEL[0] + x as usize)]);
                (sum, count) = ([sum[0] + light * f64::from(x), sum[1] + light * f64::from(y)], count + light);
            }
            let found = standing[n].mm(sum.map(|sum| sum / count));
            worst = worst.max((found[0] - wanted[0]).hypot(found[1] - wanted[1]) / PITCH_MM);
        }
        println!("layer {n}: spots within {worst:.3} panel pixels of their place");
        assert!(worst < ERROR_PX, "layer {n}: {worst} panel pixels");
    }
    show.quit();
}
