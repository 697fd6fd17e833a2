use std::time::Duration;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, LayerStack, RayMap, Simulator, ViewGrid, Weights};
use lumistack_factorizer::{Processor, Settings};

use super::fields::{Content, display, target};
use crate::{Boxes, SIGMA_MM, Solver, Target, Tracker, head_of_packet};

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Returns a tracker that has received positions of a head 50 times a second. The head moves at 200
/// mm/s.
fn walking(until_ms: u64) -> Tracker {
    let mut tracker = Tracker::default();
    for at in (0..=until_ms).step_by(20) {
        tracker.see(&[[0.2 * at as f64, 0.0, 600.0]], ms(at)).unwrap();
    }
    tracker
}

#[test]
fn heads_are_looked_for_where_they_will_be() {
    let tracker = walking(1000);
    let boxes = tracker.boxes(ms(1010), ms(90));
    assert!((boxes.heads_mm[0][0] - 220.0).abs() < 1.0, "{boxes:?}");
    assert_eq!((boxes.heads_mm[0][1], boxes.heads_mm[0][2], boxes.zone), (0.0, 600.0, 0.0));
    // a velocity is extrapolated only for a short time
    let late = tracker.boxes(ms(1900), ms(0));
    assert!((late.heads_mm[0][0] - 250.0).abs() < 1.0, "{late:?}");
}

#[test]
fn without_a_tracker_the_zone_fades_back_in() {
    let tracker = walking(1000);
    let zone = |at| tracker.boxes(ms(at), ms(0)).zone;
    assert_eq!([1000, 2000, 2250, 2500, 3000, 9000].map(zone), [0.0, 0.0, 0.25, 0.5, 1.0, 1.0]);
    assert_eq!(Tracker::default().boxes(ms(5), ms(0)), Boxes { heads_mm: Vec::new(), zone: 1.0 });
    let geometry = display().geometry().unwrap();
    let weights = |at| tracker.boxes(ms(at), ms(0)).weights(&geometry, &Weights::Uniform, SIGMA_MM).unwrap();
    assert_eq!(weights(3000), Weights::Uniform);
    // when the tracker is silent, the weight of rays far from the head grows
    let far = [2000, 2500].map(|at| weights(at).at([1, 0], 25, 0));
    assert!(far[0] < 0.01 && (0.45..0.55).contains(&far[1]), "{far:?}");
    // a viewer who comes back is followed immediately
    let mut back = tracker.clone();
    back.see(&[[0.0, 0.0, 500.0]], ms(4000)).unwrap();
    assert_eq!(back.boxes(ms(4000), ms(100)), Boxes { heads_mm: vec![[0.0, 0.0, 500.0]], zone: 0.0 });
}

#[test]
fn somebody_else_has_no_velocity_of_who_was_there_before() {
    let mut tracker = walking(1000);
    tracker.see(&[[-400.0, 0.0, 600.0]], ms(1020)).unwrap();
    assert_eq!(tracker.boxes(ms(1020), ms(200)).heads_mm, [[-400.0, 0.0, 600.0]]);
    // After an empty list there is no viewer, so the whole zone has the weight 1.
    tracker.see(&[], ms(1040)).unwrap();
    assert_eq!(tracker.boxes(ms(1040), ms(0)).zone, 1.0);
}

#[test]
fn positions_that_make_no_sense_are_refused() {
    let mut tracker = walking(100);
    for wrong in [[0.0, 0.0, 0.0], [f64::NAN, 0.0, 500.0], [0.0, f64::INFINITY, 500.0]] {
        let error = tracker.see(&[[0.0, 0.0, 500.0], wrong], ms(120)).unwrap_err().to_string();
        assert!(error.starts_with("viewer: expected three finite numbers"), "{error}");
    }
    assert_eq!(tracker.boxes(ms(100), ms(0)).heads_mm.len(), 1);
    let packet: Vec<u8> = [1.5f64, -2.0, 10.0, 30.0, 0.0, 0.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    assert_eq!(head_of_packet(&packet, [0.0, 0.0, 600.0]).unwrap(), [15.0, -20.0, 700.0]);
    assert!(head_of_packet(&packet[..47], [0.0; 3]).unwrap_err().to_string().contains("found 47 bytes"));
    let nan: Vec<u8> = [f64::NAN; 6].iter().flat_map(|value| value.to_le_bytes()).collect();
    assert!(head_of_packet(&nan, [0.0; 3]).unwrap_err().to_string().contains("finite"));
}

/// Returns the mean squared error of the picture that the display shows along a slope, against
/// the content.
fn seen_from(stack: &LayerStack, target: &Target, content: Content, slope: [f64; 2]) -> f64 {
    let geometry = target.field.geometry();
    let from = geometry.with_grid(ViewGrid::single(geometry.grid.projection, slope));
    let map = RayMap::new(&target.display, &from);
    let shown = Simulator::new(&target.display, stack).view(&map, &from, [0, 0]);
    let wanted = super::fields::view(content, &from);
    let (mut sum, mut count) = (0.0, 0);
    for (i, (shown, wanted)) in shown.radiance.data().iter().zip(wanted).enumerate() {
        // compare only pixels away from the border, since rays near the border miss layers
        let (row, col) = (i / 3 / from.cols, i / 3 % from.cols);
        if (8..from.rows - 8).contains(&row) && (8..from.cols - 8).contains(&col) {
            sum += (f64::from(*shown) / target.display.brightness - f64::from(wanted)).powi(2);
            count += 1;
        }
    }
    sum / f64::from(count)
}

/// Distance of the viewers from the display of [`deep`], mm.
const DISTANCE_MM: f64 = 1500.0;
/// Standard deviation σ of the viewers' weights. It is smaller than [`SIGMA_MM`], so that most
/// views of the zone have nearly no weight.
const NARROW_MM: f64 = 20.0;

/// Returns a target that is too deep for its display, with a row of views. The display has a zone
/// of ±16°.
fn deep(content: Content, views: usize) -> std::sync::Arc<Target> {
    /// Field of view for which the third view from either end of 13 views is at 10°, degrees.
    const FOV_DEG: f64 = 31.97;
    let plain = Display::uniform([80, 50], 1.0, [views, 1], [FOV_DEG, 1.0], &[-6.0, 6.0], 6);
    target(&Display { brightness: 0.3, ..plain }, content, 0.0, 0)
}

/// Two viewers stand at ±10°, in front of a display with a zone of ±16°. The content is too deep
/// for the display. If only rays near the viewers have a weight, the PSNR at ±10° is at least 10 dB
/// higher than with equal weights.
#[test]
fn two_viewers_get_what_the_whole_zone_cannot_have() {
    const UPDATES: u32 = 60;
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let (task, target) = (Task::quiet(&warnings, &cancel), deep(Content::Two, 13));
    let slope = 10f64.to_radians().tan();
    let mut tracker = Tracker::default();
    tracker.see(&[-1.0, 1.0].map(|side| [side * slope * DISTANCE_MM, 0.0, DISTANCE_MM]), ms(0)).unwrap();
    let boxes = tracker.boxes(ms(0), ms(0));
    let weights = boxes.weights(target.field.geometry(), &Weights::Uniform, NARROW_MM).unwrap();
    let [zone, tracked] = [Weights::Uniform, weights].map(|weights| {
        Solver::new(Settings::default()).step(&Processor, &target, &weights, UPDATES, task).unwrap().stack
    });
    let [zone, tracked] = [&zone, &tracked].map(|stack| {
        let errors = [-1.0, 1.0].map(|side| seen_from(stack, &target, Content::Two, [side * slope, 0.0]));
        -10.0 * (0.5 * (errors[0] + errors[1])).log10()
    });
    println!("at ±10°: {zone:.1} dB of the zone, {tracked:.1} dB tracked");
    assert!(tracked > zone + 10.0, "{zone} {tracked}");
}

/// A head sways in front of a display, by up to 6° to each side and at up to 300 mm/s. The patterns
/// follow it with five updates per report of the tracker, and are shown two reports later.
///
/// The worst twentieth of the pictures that the head sees is at most 3 dB below the median picture.
/// It is also better than the median picture of patterns for the whole zone.
#[test]
fn patterns_follow_a_head_that_sways() {
    const UPDATES: u32 = 5;
    const REPORT_MS: u64 = 33;
    const LATENCY_MS: u64 = 2 * REPORT_MS;
    const WARM_UP_MS: u64 = 1000;
    const END_MS: u64 = 7000;
    /// At the head, the views of the target are 36 mm apart. With 13 views, 72 mm apart, the worst
    /// twentieth is 9 dB below the median: between two views, no ray constrains the patterns.
    const VIEWS: usize = 25;
    // Two slow sways, and the error of a tracker that rounds to millimetres.
    let head = |at_ms: u64| {
        let at = at_ms as f64 / 1000.0;
        let sway = |size_mm: f64, hertz: f64, phase: f64| size_mm * (std::f64::consts::TAU * hertz * at + phase).sin();
        [sway(130.0, 0.21, 0.0) + sway(25.0, 0.8, 1.0), sway(10.0, 0.3, 2.0), DISTANCE_MM + sway(50.0, 0.13, 3.0)]
    };
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let (task, target) = (Task::quiet(&warnings, &cancel), deep(Content::Waves, VIEWS));
    let (mut tracker, mut solver) = (Tracker::default(), Solver::new(Settings::default()));
    let zone = Solver::new(Settings::default()).step(&Processor, &target, &Weights::Uniform, 60, task).unwrap().stack;
    let (mut tracked, mut untracked) = (Vec::new(), Vec::new());
    for now_ms in (0..END_MS).step_by(REPORT_MS as usize) {
        tracker.see(&[head(now_ms).map(f64::round)], ms(now_ms)).unwrap();
        let boxes = tracker.boxes(ms(now_ms), ms(LATENCY_MS));
        let weights = boxes.weights(target.field.geometry(), &Weights::Uniform, NARROW_MM).unwrap();
        let solved = solver.step(&Processor, &target, &weights, UPDATES, task).unwrap();
        if now_ms >= WARM_UP_MS {
            let [x, y, z] = head(now_ms + LATENCY_MS);
            let psnr = |stack: &LayerStack| -10.0 * seen_from(stack, &target, Content::Waves, [x / z, y / z]).log10();
            tracked.push(psnr(&solved.stack));
            untracked.push(psnr(&zone));
        }
    }
    for scores in [&mut tracked, &mut untracked] {
        scores.sort_by(f64::total_cmp);
    }
    let [fifth, median] = [tracked.len() / 20, tracked.len() / 2].map(|at| tracked[at]);
    let of_zone = untracked[untracked.len() / 2];
    println!("median {median:.1} dB, 5th percentile {fifth:.1} dB, for the zone {of_zone:.1} dB");
    assert!(fifth > median - 3.0, "{fifth} {median}");
    assert!(fifth > of_zone, "{fifth} {of_zone}");
}
