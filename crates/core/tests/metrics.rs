//! Compares SSIM and FLIP with the reference tools, scikit-image and flip-evaluator. Their values
//! are recorded in `tests/metrics_reference.json`. If a Python has the tools, they run too.

use std::path::Path;
use std::process::Command;

use lumistack_core::colour::srgb_decode;
use lumistack_core::metrics::{Flip, MetricMap, ssim};
use serde_json::Value;

/// Tolerances of the mean SSIM, of the mean FLIP and of FLIP at single pixels.
const SSIM: f64 = 1e-5;
const FLIP_MEAN: f64 = 1e-4;
const FLIP_PIXEL: f64 = 1e-3;
/// Tolerance between the recorded values and the values of the reference tools on any machine: the
/// precision of the recorded digits.
const SAME_FIGURE: f64 = 1e-5;

#[test]
fn ssim_and_flip_are_those_of_the_reference_tools() {
    for case in cases(include_str!("../../../tests/metrics_reference.json")) {
        check(&case, None);
    }
}

#[test]
fn the_reference_tools_give_the_figures_that_are_written_down() {
    let Some(python) = lumistack_testkit::skip::python_with("skimage, flip_evaluator") else { return };
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/metrics_reference.py");
    let output = Command::new(python).arg(script).arg(folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let written = cases(include_str!("../../../tests/metrics_reference.json"));
    let found = cases(std::str::from_utf8(&output.stdout).unwrap());
    assert_eq!(written.len(), found.len());
    for (i, (written, found)) in written.iter().zip(&found).enumerate() {
        for key in ["ssim", "flip"] {
            let (written, found) = (number(&written[key]), number(&found[key]));
            assert!((written - found).abs() < SAME_FIGURE, "{key} is {found}, written down is {written}");
        }
        let map = std::fs::read(folder.path().join(format!("flip_{i}.f32"))).unwrap();
        let map = map.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        check(found, Some(map));
    }
}

/// Compares one pair of pictures; `map` is the reference tool's FLIP map of the whole picture, if
/// the tool runs.
fn check(case: &Value, map: Option<Vec<f32>>) {
    let name = case["name"].as_str().unwrap();
    let shape = [0, 1].map(|axis| case["shape"][axis].as_u64().unwrap() as usize);
    let [reference, test] = [("reference", 0), ("test", 1)].map(|(key, i)| {
        let codes = picture(case[key].as_str().unwrap(), shape);
        let sum: u64 = codes.iter().map(|code| u64::from(*code)).sum();
        assert_eq!(Some(sum), case["code_sums"][i].as_u64(), "{name}: the {key} is another picture");
        codes.into_iter().map(|code| srgb_decode(f32::from(code) / 255.0)).collect::<Vec<f32>>()
    });
    let similarity = ssim(&reference, &test, shape).mean().value();
    assert!((similarity - number(&case["ssim"])).abs() < SSIM, "{name}: SSIM {similarity}, {}", case["ssim"]);
    let flip: MetricMap = Flip::new(number(&case["pixels_per_degree"])).compare(&reference, &test, shape);
    let mean = flip.mean().value();
    assert!((mean - number(&case["flip"])).abs() < FLIP_MEAN, "{name}: FLIP {mean}, {}", case["flip"]);
    let samples = case["flip_at"].as_array().unwrap().iter().map(|pair| (number(&pair[0]) as usize, number(&pair[1])));
    let whole = map.iter().flatten().enumerate().map(|(i, value)| (i, f64::from(*value)));
    for (i, expected) in samples.chain(whole) {
        let found = f64::from(flip.values[i]);
        assert!((found - expected).abs() < FLIP_PIXEL, "{name}: FLIP {found} at {i}, {expected}");
    }
}

/// Computes a picture by a formula of `tests/metrics_reference.py`.
fn picture(formula: &str, [rows, cols]: [usize; 2]) -> Vec<u8> {
    let (kind, number) = formula.split_once(':').unwrap();
    let n: u32 = number.parse().unwrap();
    let at = |r: u32, c: u32, k: u32| match kind {
        "flat" => n,
        "noise" => noise(n, r, c, k),
        "smooth" => smooth(n, r, c, k),
        "grainy" => (7 * smooth(n, r, c, k) + noise(n + 100, r, c, k)) / 8,
        "shifted" => smooth(1, r, c + n, k),
        "checks" => 255 * ((r / n + c / n) % 2),
        _ => panic!("unknown picture {formula}"),
    };
    let pixels = (0..rows as u32).flat_map(|r| (0..cols as u32).map(move |c| (r, c)));
    pixels.flat_map(|(r, c)| [0, 1, 2].map(|k| at(r, c, k) as u8)).collect()
}

fn noise(seed: u32, r: u32, c: u32, k: u32) -> u32 {
    let parts = [(r, 0x9E37_79B1), (c, 0x85EB_CA77), (k, 0xC2B2_AE3D), (seed, 0x27D4_EB2Fu32)];
    let mut h = parts.iter().fold(0u32, |sum, (value, factor)| sum.wrapping_add(value.wrapping_mul(*factor)));
    h ^= h >> 15;
    h = h.wrapping_mul(0x2C1B_3C6D);
    h ^= h >> 12;
    h = h.wrapping_mul(0x297A_2D39);
    h ^= h >> 15;
    h >> 24
}

fn smooth(seed: u32, r: u32, c: u32, k: u32) -> u32 {
    let (fr, fc) = (r % 8, c % 8);
    let corner = |dr: u32, dc: u32| noise(seed, r / 8 + dr, c / 8 + dc, k);
    let top = (8 - fc) * corner(0, 0) + fc * corner(0, 1);
    let bottom = (8 - fc) * corner(1, 0) + fc * corner(1, 1);
    ((8 - fr) * top + fr * bottom) / 64
}

fn cases(text: &str) -> Vec<Value> {
    serde_json::from_str(text).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}
