//! Tests the plugin `two_layer_nmf`: compares an iteration with the rule for matrices, and the
//! scores for different numbers of frames.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Display, LayerStack, RayMap, Weights, score};
use lumistack_plugin_baselines::two_layer_nmf::PLUGIN;
use lumistack_plugin_testkit::{conformance, made_by, random_field};

/// Tolerance of f32 arithmetic in one iteration.
const ROUNDING: f64 = 2e-3;

fn display(frames: usize) -> Display {
    let display = Display::uniform([12, 3], 1.0, [3, 1], [20.0, 20.0], &[-6.0, 6.0], frames);
    Display { brightness: 0.4, ..display }
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
}

/// The rule for matrices in f64, applied to the plugin's masks after one iteration, gives the
/// plugin's masks after two iterations. The rule updates F first, then G.
#[test]
fn an_update_is_the_rule_of_the_matrix() {
    let display = display(2);
    let field = random_field(&display).unwrap();
    let first = made_by(&PLUGIN, r#"{"iterations": 1}"#, &display, &field).unwrap();
    let second = made_by(&PLUGIN, r#"{"iterations": 2}"#, &display, &field).unwrap();
    let map = RayMap::new(&display, field.geometry());
    let (channel, rows, cols) = (1, 3, 12);
    // List the known entries of the matrix as (rear pixel, front pixel, target).
    let mut rays = Vec::new();
    for (view, row, col) in (0..3).flat_map(|v| (0..rows).flat_map(move |r| (0..cols).map(move |c| (v, r, c)))) {
        let [rear, front] = [0, 1].map(|n| map.layers[n].x.of_view(view)[col]);
        if !rear.is_missed() && !front.is_missed() {
            let wanted = 0.4 * f64::from(field.radiance().get([0, view, row, col, channel]));
            rays.push((row * cols + rear.first as usize, row * cols + front.first as usize, wanted));
        }
    }
    let values = |stack: &LayerStack, n: usize| -> Vec<Vec<f64>> {
        let value = |m, j| f64::from(stack.layers[n].get([m, j / cols, j % cols, channel]));
        (0..2).map(|m| (0..rows * cols).map(|j| value(m, j)).collect()).collect()
    };
    let mut factors = [values(&first, 0), values(&first, 1)];
    for n in 0..2 {
        let (mut above, mut below) = (vec![vec![0.0; rows * cols]; 2], vec![vec![0.0; rows * cols]; 2]);
        for &(rear, front, wanted) in &rays {
            let shown: f64 = (0..2).map(|m| factors[0][m][rear] * factors[1][m][front]).sum::<f64>() / 2.0;
            let (own, other) = if n == 0 { (rear, front) } else { (front, rear) };
            for m in 0..2 {
                above[m][own] += wanted * factors[1 - n][m][other];
                below[m][own] += shown * factors[1 - n][m][other];
            }
        }
        for (m, j) in (0..2).flat_map(|m| (0..rows * cols).map(move |j| (m, j))) {
            if below[m][j] > 0.0 {
                factors[n][m][j] = (factors[n][m][j] * above[m][j] / below[m][j]).clamp(0.0, 1.0);
            }
        }
    }
    for n in 0..2 {
        let found = values(&second, n);
        for (m, j) in (0..2).flat_map(|m| (0..rows * cols).map(move |j| (m, j))) {
            let (found, expected) = (found[m][j], factors[n][m][j]);
            assert!((found - expected).abs() < ROUNDING, "layer {n}, frame {m}, pixel {j}: {found}, not {expected}");
        }
    }
}

#[test]
fn frames_raise_the_quality() {
    let psnr = |frames: usize| {
        let display = display(frames);
        let field = random_field(&display).unwrap();
        let stack = made_by(&PLUGIN, r#"{"iterations": 200}"#, &display, &field).unwrap();
        score(&display, &stack, &field, &Weights::Uniform).psnr_view()
    };
    let [one, three, six] = [1, 3, 6].map(psnr);
    assert!(three > one + 1.0 && six > three + 1.0, "{one} {three} {six}");
}

#[test]
fn other_displays_are_refused() {
    let mut display = display(1);
    let field = random_field(&display).unwrap();
    display.layers.pop();
    let error = made_by(&PLUGIN, "{}", &display, &field).unwrap_err();
    assert!(matches!(&error, PluginError::Refused(text) if text.contains("expected two layers, found 1")), "{error:?}");
}
