//! Solves of the page on a device. Their patterns equal the processor's patterns up to rounding,
//! and the processor continues when the device fails. Without an adapter the tests are skipped.

use lumistack_display::LayerStack;
use lumistack_factorizer_gpu::Device;
use lumistack_web_solver::{Settings, Stage, Work};

/// Largest allowed difference of a mask value.
const TOLERANCE: f32 = 1e-4;

fn device() -> Option<Device> {
    Device::open(Some("")).map_err(|error| lumistack_testkit::skip::skipped(&error.to_string())).ok()
}

fn work(folder: &std::path::Path, device: Option<&Device>, iterations: u32) -> Work {
    let path = folder.join("stripes_qs4x2a1.5.png");
    image::RgbImage::from_fn(4 * 48, 2 * 32, |x, y| {
        let view = x / 48 + 4 * (1 - y / 32);
        let near = (x % 48 + view) % 15 < 5 && y % 32 > 10;
        image::Rgb([if near { 220 } else { 30 }, if (x + 30 - view) % 10 < 5 { 180 } else { 60 }, 90])
    })
    .save(&path)
    .unwrap();
    let settings = Settings::from_json(&format!(r#"{{"cols": 48, "frames": 2, "iterations": {iterations}}}"#)).unwrap();
    let mut work = Work::of_field(path.to_str().unwrap(), settings).unwrap();
    if let Some(device) = device {
        work.solve_on(Box::new(device.clone()));
    }
    work
}

fn finish(mut work: Work) -> (LayerStack, Work) {
    while work.stage() != Stage::Done {
        work.advance().unwrap();
        assert!((0.0..=1.0).contains(&work.share()), "{}", work.share());
    }
    (work.stack().unwrap().clone(), work)
}

/// Returns the warnings about changes to the processor.
fn changes(work: &Work) -> Vec<String> {
    work.warnings().into_iter().filter(|warning| warning.contains("processor")).collect()
}

fn apart(a: &LayerStack, b: &LayerStack) -> f32 {
    let pairs = a.layers.iter().zip(&b.layers).flat_map(|(a, b)| a.data().iter().zip(b.data()));
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn patterns_of_the_device_are_those_of_the_processor() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    // Compare after one iteration, since rounding errors of pattern values that hardly affect the
    // emission grow with every iteration.
    let (on_processor, _) = finish(work(folder.path(), None, 1));
    let (on_device, work) = finish(work(folder.path(), Some(&device), 1));
    assert!(work.is_on_device());
    assert!(changes(&work).is_empty());
    let difference = apart(&on_device, &on_processor);
    assert!(difference > 0.0 && difference <= TOLERANCE, "{difference}");
}

#[test]
fn the_processor_continues_a_solve_whose_device_fails() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (expected, _) = finish(work(folder.path(), None, 6));
    // the device is lost after some patterns were shown
    let mut lost = work(folder.path(), Some(&device), 6);
    while lost.shown() < 2 {
        lost.advance().unwrap();
    }
    device.lose();
    let (found, lost) = finish(lost);
    assert!(!lost.is_on_device());
    let warnings = changes(&lost);
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].contains("lost") && warnings[0].ends_with("; the processor solves instead"), "{warnings:?}");
    assert_eq!(found, expected);
    // the device's limits are too small from the beginning
    let small = self::device().unwrap().with_binding_bytes(16).unwrap();
    let (found, refused) = finish(work(folder.path(), Some(&small), 6));
    assert!(!refused.is_on_device());
    let warnings = changes(&refused);
    assert!(warnings.len() == 1 && warnings[0].contains("largest storage buffer"), "{warnings:?}");
    assert_eq!(found, expected);
}
