//! Numbers of report.json other than PSNR, compared with the display crate or with closed forms.
//!
//! Limits are simulated for the central view and the corners. Tests that compare a limit with the
//! score have two by two views, so all views of these tests are simulated.

use lumistack_core::metrics::{Flip, ssim};
use lumistack_display::{Display, LayerStack, LightField, RayMap, Simulator, ViewGrid, Weights, quantize, score};
use serde_json::{Value, json};

use super::{SAME_DB, built, display, json_psnr, noisy_field, noisy_stack, plain};
use crate::{Iteration, ReportInput};

/// Tolerance of means over f32 pictures.
const SAME: f64 = 1e-6;

/// Returns a display of two layers, with the lines `extra` in the table of each layer.
fn two_layers(views: [usize; 2], resolution: [usize; 2], extra: &str) -> Display {
    let [cols, rows] = resolution;
    let mut text = format!(
        "name = \"two\"\nframes = 2\nbrightness = 0.2\n[field]\nresolution = [{cols}, {rows}]\npitch_mm = 1.0\nviews = {views:?}\nfov_deg = [20.0, 20.0]\n"
    );
    for d_mm in [-3.0, 3.0] {
        text += &format!("[[layers]]\nd_mm = {d_mm:?}\nresolution = [{cols}, {rows}]\npitch_mm = 1.0\n{extra}\n");
    }
    Display::from_toml(&text).unwrap()
}

fn limit<'a>(report: &'a Value, name: &str) -> &'a Value {
    let limits = report["limits"].as_array().unwrap();
    limits.iter().find(|limit| limit["name"] == name).unwrap_or_else(|| panic!("no limit {name} in {limits:?}"))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn ssim_and_flip_take_rays_that_do_not_count_from_the_target() {
    let display = display(3, 2, [3, 3], [40, 32], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let report = built(&ReportInput { pixels_per_degree: 40.0, ..plain(&display, &stack, &target) }).unwrap().json;
    let (mut sums, mut counted) = ([0.0; 2], [0.0; 2]);
    let mut dropped = 0;
    for view in target.geometry().grid.iter() {
        let map = RayMap::new(&display, target.geometry());
        let emitted = Simulator::new(&display, &stack).view(&map, target.geometry(), view);
        let mut shown = target.view(view).to_vec();
        for (i, valid) in emitted.valid.iter().enumerate() {
            for c in 0..3 {
                if *valid {
                    shown[3 * i + c] = (f64::from(emitted.radiance.data()[3 * i + c]) / 0.2) as f32;
                }
            }
            dropped += usize::from(!valid);
        }
        let maps =
            [ssim(target.view(view), &shown, [32, 40]), Flip::new(40.0).compare(target.view(view), &shown, [32, 40])];
        for (m, (map, key)) in maps.iter().zip(["ssim", "flip"]).enumerate() {
            let (mut sum, mut count) = (0.0, 0.0);
            for row in map.margin..32 - map.margin {
                for col in map.margin..40 - map.margin {
                    if emitted.valid[row * 40 + col] {
                        sum += f64::from(map.values[row * 40 + col]);
                        count += 1.0;
                    }
                }
            }
            let found = number(&report["views"][key][view[0]][view[1]]);
            assert!((found - sum / count).abs() < SAME, "{key} of {view:?}: {found}, expected {}", sum / count);
            (sums[m], counted[m]) = (sums[m] + sum, counted[m] + count);
        }
    }
    assert!(dropped > 0, "the test needs rays that do not count");
    assert!((number(&report["ssim"]) - sums[0] / counted[0]).abs() < SAME);
    assert!((number(&report["flip"]) - sums[1] / counted[1]).abs() < SAME);
    assert_eq!(report["pixels_per_degree"], 40.0);
}

#[test]
fn outside_views_are_scored_or_shown() {
    let display = display(3, 2, [3, 3], [24, 20], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let shown = built(&plain(&display, &stack, &target)).unwrap();
    assert!(shown.json["outside"].is_null() && shown.outside_psnr_view.is_none());
    assert!(shown.html.contains("Simulated: View outside the zone"));
    let outside = noisy_field(&display, target.geometry().grid.outside(1));
    let report = built(&ReportInput { outside: Some(&outside), ..plain(&display, &stack, &target) }).unwrap();
    let expected = score(&display, &stack, &outside, &Weights::Uniform).psnr_view();
    assert!((json_psnr(&report.json["outside"]["overall_psnr_view"]) - expected).abs() < SAME_DB);
    assert_eq!(report.outside_psnr_view, Some(expected));
    assert_eq!(report.json["outside"]["ssim"][0].as_array().map(Vec::len), Some(2));
    assert!(report.html.contains("Difference") && report.html.contains("Views outside the zone"));
}

#[test]
fn brightness_is_relative_to_the_backlight() {
    // The two layers have a peak of 0.5 and values of 0.4, and the target is ½. So L̃ is 0.16, and
    // `open` is 0.25.
    let display = two_layers([1, 1], [12, 8], "peak = 0.5");
    let mut target = LightField::black(display.geometry().unwrap()).unwrap();
    target.radiance_mut().data_mut().fill(0.5);
    let stack = LayerStack::filled(&display, 0.4);
    let report = built(&plain(&display, &stack, &target)).unwrap();
    let light = &report.json["light"];
    for (key, expected) in [("emitted", 0.16), ("wanted", 0.5), ("open", 0.25)] {
        assert!((number(&light[key]) - expected).abs() < SAME, "{key}: {light}");
    }
    let text = light["text"].as_str().unwrap();
    assert!(
        text.contains("16.0 % of its backlight") && text.contains("transmit 25.0 %") && text.contains("0.5 · 0.5"),
        "{text}"
    );
    assert!(report.html.contains("transmit 25.0 %"));
    // Two emissive layers add up to 1. Two rotations of 0.5 give 90°, which transmits all light.
    for (formation, open) in [("additive", 1.0), ("polarization", 1.0)] {
        let text = display.to_toml().replacen("\"attenuating\"", &format!("\"{formation}\""), 1);
        let display = Display::from_toml(&text).unwrap();
        let report = built(&plain(&display, &LayerStack::filled(&display, 0.1), &target)).unwrap().json;
        assert!((number(&report["light"]["open"]) - open).abs() < SAME, "{formation}: {}", report["light"]);
    }
}

#[test]
fn a_white_that_cannot_be_reached_is_said() {
    let display = Display { brightness: 0.5, ..two_layers([1, 1], [4, 4], "peak = 0.5") };
    let mut target = LightField::black(display.geometry().unwrap()).unwrap();
    target.radiance_mut().data_mut().fill(1.0);
    let report = built(&plain(&display, &LayerStack::filled(&display, 0.5), &target)).unwrap().json;
    let text = report["light"]["text"].as_str().unwrap();
    assert!(text.contains("cannot be shown: the brightest white of this display has 25.0 %"), "{text}");
}

#[test]
fn the_limit_of_rounding_agrees_with_the_score() {
    let coarse = two_layers([2, 2], [24, 20], "bits = 3\ntransfer = \"linear\"");
    let (stack, target) = (noisy_stack(&coarse), noisy_field(&coarse, None));
    let base = score(&coarse, &stack, &target, &Weights::Uniform).psnr_view();
    let mut rounded = stack.clone();
    for layer in &mut rounded.layers {
        layer.data_mut().iter_mut().for_each(|value| *value = (*value * 7.0).round() / 7.0);
    }
    let worse = base - score(&coarse, &rounded, &target, &Weights::Uniform).psnr_view();
    let report = built(&plain(&coarse, &stack, &target)).unwrap().json;
    let found = limit(&report, "Bits");
    assert!((number(&found["figures"]["loss_db"]) - worse).abs() < 1e-4, "{found}, expected {worse}");
    assert_eq!(found["figures"]["bits"], json!([3, 3]));
    let report = built(&plain(&coarse, &rounded, &target)).unwrap().json;
    assert!(
        limit(&report, "Bits")["text"]
            .as_str()
            .unwrap()
            .contains("already contain only the values of the layers' 3 bits")
    );
    // A display that declares no bits is assumed to have 8 bits.
    let plain_display = two_layers([2, 2], [24, 20], "");
    let levels: Vec<f32> = (0..256).map(|code| lumistack_core::colour::srgb_decode(code as f32 / 255.0)).collect();
    let mut rounded = stack.clone();
    for layer in &mut rounded.layers {
        layer.data_mut().iter_mut().for_each(|value| *value = quantize(*value, &levels));
    }
    let worse = base - score(&plain_display, &rounded, &target, &Weights::Uniform).psnr_view();
    let report = built(&plain(&plain_display, &stack, &target)).unwrap().json;
    let found = limit(&report, "Bits");
    assert!((number(&found["figures"]["loss_db"]) - worse).abs() < 1e-4, "{found}, expected {worse}");
    assert_eq!(found["figures"]["given"], false);
}

#[test]
fn ends_of_the_range_are_counted_and_the_limit_of_black_agrees_with_the_score() {
    let display = two_layers([2, 2], [24, 20], "black_level = 0.1\npeak = 0.8");
    let target = noisy_field(&display, None);
    let mut stack = noisy_stack(&display);
    for layer in &mut stack.layers {
        layer.data_mut().iter_mut().for_each(|value| *value = (*value * 1.4 - 0.2).clamp(0.08, 0.8));
    }
    let report = built(&plain(&display, &stack, &target)).unwrap().json;
    let share = |layer: usize, at: f32| {
        let data = stack.layers[layer].data();
        data.iter().filter(|value| (**value - at).abs() < 1e-3 * 0.72).count() as f64 / data.len() as f64
    };
    let (bright, contrast) = (limit(&report, "Brightness"), limit(&report, "Contrast"));
    for layer in 0..2 {
        assert!((number(&bright["figures"]["share_at_brightest"][layer]) - share(layer, 0.8)).abs() < 1e-9, "{bright}");
        assert!((number(&contrast["figures"]["share_at_darkest"][layer]) - share(layer, 0.08)).abs() < 1e-9);
        assert!(share(layer, 0.8) > 0.1 && share(layer, 0.08) > 0.1);
    }
    let psnr = |stack: &LayerStack| score(&display, stack, &target, &Weights::Uniform).psnr_view();
    let changed = |change: &dyn Fn(f32) -> f32| {
        let mut changed = stack.clone();
        changed.layers.iter_mut().for_each(|layer| layer.data_mut().iter_mut().for_each(|v| *v = change(*v)));
        psnr(&changed)
    };
    let black = changed(&|v| if v < 0.0801 { 0.0 } else { v }) - psnr(&stack);
    assert!((number(&contrast["figures"]["black_gain_db"]) - black).abs() < 0.02, "{contrast}, expected {black}");
    let brighter = changed(&|v| if v > 0.7999 { v * 1.01f32.sqrt() } else { v });
    let less = 1.0 - 10f64.powf((psnr(&stack) - brighter) / 10.0);
    assert!(
        (number(&bright["figures"]["less_error_for_1_percent"]) - less.max(0.0)).abs() < 1e-3,
        "{bright}, expected {less}"
    );
}

#[test]
fn a_flattened_tone_curve_is_measured() {
    // The stack shows every target value L as 0.1 + 0.7·L.
    let display = display(1, 1, [3, 3], [16, 12], "");
    let mut target = noisy_field(&display, None);
    let mut stack = LayerStack::filled(&display, 0.0);
    let picture: Vec<f32> = target.view([0, 0]).to_vec();
    for view in target.geometry().grid.iter() {
        target.view_mut(view).copy_from_slice(&picture);
    }
    // On z = 0, every view reads the same pixels of the picture.
    let display =
        Display { layers: vec![lumistack_display::Layer { d_mm: 0.0, ..display.layers[0].clone() }], ..display };
    stack.layers[0].data_mut().iter_mut().zip(&picture).for_each(|(value, l)| *value = 0.2 * (0.1 + 0.7 * l));
    let report = built(&plain(&display, &stack, &target)).unwrap().json;
    let figures = &limit(&report, "Contrast")["figures"];
    assert!(
        (number(&figures["offset"]) - 0.1).abs() < 1e-4 && (number(&figures["slope"]) - 0.7).abs() < 1e-4,
        "{figures}"
    );
    assert!(number(&figures["share_of_error"]) > 0.999_99);
    // One layer with one frame has as many values as one of the nine views has rays.
    let ratio = number(&limit(&report, "Frames")["figures"]["ratio"]);
    assert!((ratio - 1.0 / 9.0).abs() < 1e-9, "{ratio}");
}

#[test]
fn the_limit_of_a_still_picture_agrees_with_the_score() {
    let display = display(2, 3, [2, 2], [24, 20], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let mut still = stack.clone();
    for layer in &mut still.layers {
        let size = layer.data().len() / 3;
        for i in 0..size {
            let mean = (0..3).map(|m| layer.data()[m * size + i]).sum::<f32>() / 3.0;
            (0..3).for_each(|m| layer.data_mut()[m * size + i] = mean);
        }
    }
    let psnr = |stack: &LayerStack| score(&display, stack, &target, &Weights::Uniform).psnr_view();
    let report = built(&plain(&display, &stack, &target)).unwrap().json;
    let found = number(&limit(&report, "Frames")["figures"]["still_loss_db"]);
    assert!((found - (psnr(&stack) - psnr(&still))).abs() < 1e-4, "{found}");
}

#[test]
fn blur_and_crosstalk_are_compared_with_a_display_without() {
    let display =
        two_layers([2, 2], [24, 20], "blur_px = 0.7\ncrosstalk = [[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]]");
    let ideal = two_layers([2, 2], [24, 20], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let psnr = |display: &Display| score(display, &stack, &target, &Weights::Uniform).psnr_view();
    let report = built(&plain(&display, &stack, &target)).unwrap().json;
    let found = number(&limit(&report, "Blur and crosstalk")["figures"]["gain_db"]);
    assert!((found - (psnr(&ideal) - psnr(&display))).abs() < 1e-4, "{found}");
    let report = built(&plain(&ideal, &stack, &target)).unwrap().json;
    assert!(report["limits"].as_array().unwrap().iter().all(|limit| limit["name"] != "Blur and crosstalk"));
}

/// Returns a light field of two planes with a fine texture. One is at `z_mm`, in the left half of
/// the picture; the other is on z = 0, in the right half.
fn stepped_field(display: &Display, z_mm: f64) -> LightField {
    let mut field = LightField::black(display.geometry().unwrap()).unwrap();
    let geometry = field.geometry().clone();
    let texture = |x: f64, row: usize| {
        let noise = |i: i64| lumistack_core::seed::Stream::new((31 * row as i64 + i + 10_000) as u64).next_f32();
        let (place, t) = (x.floor(), x.rem_euclid(1.0) as f32);
        0.2 + 0.6 * (noise(place as i64) * (1.0 - t) + noise(place as i64 + 1) * t)
    };
    for view in geometry.grid.iter() {
        for (i, pixel) in field.view_mut(view).chunks_exact_mut(3).enumerate() {
            let x = geometry.x_mm(i % geometry.cols);
            let z = if x < 0.0 { z_mm } else { 0.0 };
            pixel.fill(texture(x + z * geometry.grid.slope_x[view[1]], i / geometry.cols / 2));
        }
    }
    field
}

#[test]
fn error_behind_the_layers_is_found_there() {
    // The layer on z = 0 contains the central view, so the display is exact for content on z = 0
    // and wrong behind it.
    let text = "name = \"one\"\nframes = 1\nbrightness = 1.0\n[field]\nresolution = [160, 40]\npitch_mm = 1.0\nviews = [3, 1]\nfov_deg = [20.0, 20.0]\n[[layers]]\nd_mm = 0.0\nresolution = [160, 40]\npitch_mm = 1.0\n";
    let display = Display::from_toml(text).unwrap();
    let target = stepped_field(&display, -40.0);
    let mut stack = LayerStack::filled(&display, 0.0);
    stack.layers[0].data_mut().copy_from_slice(target.view([0, 1]));
    let report = built(&plain(&display, &stack, &target)).unwrap().json;
    let depth = limit(&report, "Depth");
    let share = |key: &str| number(&depth["figures"][key]);
    assert!((share("share_of_rays_outer") - 0.5).abs() < 0.06, "{depth}");
    assert!(share("share_of_error_outer") > 0.95, "{depth}");
    assert!(number(&depth["decibels"]) > 10.0, "{depth}");
    let limits = report["limits"].as_array().unwrap();
    let gains: Vec<f64> = limits[..limits.len() - 1].iter().map(|limit| json_psnr(&limit["decibels"])).collect();
    assert!(gains.is_sorted_by(|a, b| a >= b), "the largest comes first: {gains:?}");
    let outer = limit(&report, "Outer views");
    assert_eq!(
        (&outer["decibels"], &outer["figures"]["psnr_centre"]),
        (&json!("Infinity"), &Value::Null),
        "an exact view"
    );
}

#[test]
fn both_of_two_views_are_outer_views() {
    let text = "name = \"one\"\nframes = 1\nbrightness = 1.0\n[field]\nresolution = [160, 40]\npitch_mm = 1.0\nviews = [2, 1]\nfov_deg = [20.0, 20.0]\n[[layers]]\nd_mm = 0.0\nresolution = [160, 40]\npitch_mm = 1.0\n";
    let display = Display::from_toml(text).unwrap();
    let target = stepped_field(&display, -40.0);
    let mut stack = LayerStack::filled(&display, 0.0);
    // The left view is exact, so all error is in the right view.
    stack.layers[0].data_mut().copy_from_slice(target.view([0, 0]));
    let report = built(&plain(&display, &stack, &target)).unwrap().json;
    let depth = limit(&report, "Depth");
    assert!(number(&depth["figures"]["share_of_error_outer"]) > 0.9, "{depth}");
}

#[test]
fn the_second_half_of_the_iterations_is_weighed() {
    let display = display(2, 2, [3, 3], [12, 8], "");
    let (stack, target) = (noisy_stack(&display), noisy_field(&display, None));
    let it = |iteration: u32, psnr_view: f64| Iteration {
        iteration,
        objective: 1.0,
        psnr_view,
        seconds: 0.25 * f64::from(iteration),
    };
    let history = [it(1, 20.0), it(2, 22.0), it(4, 25.0), it(8, 26.5), it(10, 26.75)];
    let report = built(&ReportInput { convergence: &history, ..plain(&display, &stack, &target) }).unwrap();
    let found = limit(&report.json, "Iterations");
    assert_eq!(number(&found["decibels"]), 1.75, "against iteration 4, the last up to the fifth");
    let reached = report.json["reached"].as_array().unwrap();
    let lines: Vec<_> = reached.iter().map(|line| (number(&line["seconds"]), number(&line["psnr_view"]))).collect();
    assert_eq!(lines, [(0.5, 22.0), (1.0, 25.0), (2.0, 26.5), (2.5, 26.75)]);
    assert!(report.html.contains("class=\"reached\"") && report.html.contains("2.5 s"));
}

#[test]
fn one_view_and_perfect_displays_have_few_limits() {
    let display = display(1, 1, [1, 1], [6, 4], "");
    let target = LightField::black(display.geometry().unwrap()).unwrap();
    let report = built(&plain(&display, &LayerStack::filled(&display, 0.0), &target)).unwrap().json;
    let names: Vec<_> = report["limits"].as_array().unwrap().iter().map(|limit| limit["name"].clone()).collect();
    assert_eq!(names, ["Frames"]);
    assert!(ViewGrid::single(lumistack_display::Projection::Oblique, [0.0; 2]).outside(1).is_none());
}
