use std::sync::Arc;
use std::time::Duration;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{
    DirectionScore, Display, LayerStack, LightField, Projection, Sampling, Simulator, ViewGrid, Weights,
};
use lumistack_factorizer::{Processor, Settings};

use super::fields::{self, Content, display};
use crate::{Boxes, Eyes, Rays, SIGMA_MM, Solver, Target, Tracker, head_of_packet};

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Returns a tracker that has received positions of a head 50 times a second. The head moves at 200
/// mm/s.
fn walking(until_ms: u64) -> Tracker {
    let mut tracker = Tracker::default();
    for at in (0..=until_ms).step_by(20) {
        tracker.see(&[[0.2 * at as f64, 0.0, 600.0]], Eyes::Two, ms(at)).unwrap();
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
    assert_eq!(Tracker::default().boxes(ms(5), ms(0)), Boxes::default());
    let geometry = display().geometry().unwrap();
    let weights = |at| tracker.boxes(ms(at), ms(0)).weights(&geometry, &Weights::Uniform).unwrap();
    assert_eq!(weights(3000), Weights::Uniform);
    // when the tracker is silent, the weight of rays far from the head grows
    let far = [2000, 2500].map(|at| weights(at).at([1, 0], 25, 0));
    assert!(far[0] < 0.01 && (0.45..0.55).contains(&far[1]), "{far:?}");
    // a viewer who comes back is followed immediately
    let mut back = tracker.clone();
    back.see(&[[0.0, 0.0, 500.0]], Eyes::Picture, ms(4000)).unwrap();
    assert_eq!(
        back.boxes(ms(4000), ms(100)),
        Boxes { heads_mm: vec![[0.0, 0.0, 500.0]], eyes: Eyes::Picture, zone: 0.0 }
    );
}

#[test]
fn another_viewer_has_no_velocity_of_the_viewer_before() {
    let mut tracker = walking(1000);
    tracker.see(&[[-400.0, 0.0, 600.0]], Eyes::Two, ms(1020)).unwrap();
    assert_eq!(tracker.boxes(ms(1020), ms(200)).heads_mm, [[-400.0, 0.0, 600.0]]);
    // After an empty list there is no viewer, so the whole zone has the weight 1.
    tracker.see(&[], Eyes::Two, ms(1040)).unwrap();
    assert_eq!(tracker.boxes(ms(1040), ms(0)).zone, 1.0);
}

#[test]
fn positions_that_make_no_sense_are_refused() {
    let mut tracker = walking(100);
    for wrong in [[0.0, 0.0, 0.0], [f64::NAN, 0.0, 500.0], [0.0, f64::INFINITY, 500.0]] {
        let error = tracker.see(&[[0.0, 0.0, 500.0], wrong], Eyes::Two, ms(120)).unwrap_err().to_string();
        assert!(error.starts_with("viewer: expected three finite numbers"), "{error}");
    }
    assert_eq!(tracker.boxes(ms(100), ms(0)).heads_mm.len(), 1);
    let packet: Vec<u8> = [1.5f64, -2.0, 10.0, 30.0, 0.0, 0.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    assert_eq!(head_of_packet(&packet, [0.0, 0.0, 600.0]).unwrap(), [15.0, -20.0, 700.0]);
    assert!(head_of_packet(&packet[..47], [0.0; 3]).unwrap_err().to_string().contains("found 47 bytes"));
    let nan: Vec<u8> = [f64::NAN; 6].iter().flat_map(|value| value.to_le_bytes()).collect();
    assert!(head_of_packet(&nan, [0.0; 3]).unwrap_err().to_string().contains("finite"));
}

/// Distance of the viewers from the display, mm.
const DISTANCE_MM: f64 = 1500.0;

/// Returns the PSNR of the picture that an eye sees, against the content.
fn at_eye(stack: &LayerStack, target: &Target, content: Content, eye_mm: [f64; 3]) -> f64 {
    let [x, y, z] = eye_mm;
    let view = ViewGrid::single(Projection::Perspective { distance_mm: z }, [x / z, y / z]);
    let shown = Simulator::new(&target.display, stack).seen_from(&view);
    let wanted = fields::view(content, &target.field.geometry().with_grid(view.clone()));
    DirectionScore::new(&view, &shown, target.display.brightness, [&wanted, &wanted]).psnr()
}

/// Recorded positions of two heads, midway between the eyes, every 33 ms. The heads move around
/// two points at ±10°.
fn recorded() -> Vec<[[f64; 3]; 2]> {
    let lines = include_str!("heads.txt").lines().filter(|line| !line.starts_with('#'));
    let aside = DISTANCE_MM * 10f64.to_radians().tan();
    let heads = lines.map(|line| {
        let mm: Vec<f64> = line.split(' ').map(|number| number.parse().unwrap()).collect();
        [[mm[0] - aside, mm[1], mm[2] + DISTANCE_MM], [mm[3] + aside, mm[4], mm[5] + DISTANCE_MM]]
    });
    heads.collect()
}

/// Two viewers stand at ±10° in front of a display with a zone of ±16°, and their heads move as two
/// recorded heads did. The content is too deep for the whole zone. Patterns that follow the viewers
/// are solved with the default settings. Compared with patterns for the whole zone, they gain more
/// than 10 dB in 95 % of the pictures that the four eyes see. The eyes are between the views of the
/// target. The gain hardly depends on the heads' motion.
#[test]
fn two_viewers_who_move_get_what_the_whole_zone_cannot_have() {
    /// Number of reports of the tracker per state.
    const PER_STATE: usize = 2;
    /// Number of report intervals from the newest report that a state uses to the time at which the
    /// state is shown.
    const LATENCY: usize = 2;
    const REPORT_MS: u64 = 33;
    const UPDATES: u32 = 5;
    const WARM_UP: usize = 30;
    // solve patterns for the whole zone, with which the tracked patterns are compared
    let plain = Display::uniform([48, 30], 1.0, [25, 1], [32.0, 1.0], &[-20.0, 20.0], 6);
    let content = Content::Waves;
    let target = fields::target(&Display { brightness: 0.3, ..plain }, content, 0.0, 0);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let whole = Rays::Views(Weights::Uniform);
    let zone = Solver::new(Settings::default()).step(&Processor, &target, &whole, 60, task).unwrap().stack;
    let (mut tracker, mut solver) = (Tracker::default(), Solver::new(Settings::default()));
    let (mut tracked, mut gains) = (Vec::new(), Vec::new());
    let heads = recorded();
    // after every second report, solve for the predicted eyes, and score at the later real eyes
    for now in 0..heads.len() - LATENCY {
        let now_ms = ms(REPORT_MS * now as u64);
        tracker.see(&heads[now].map(|head| head.map(f64::round)), Eyes::Two, now_ms).unwrap();
        if now % PER_STATE != 0 {
            continue;
        }
        let boxes = tracker.boxes(now_ms, ms(REPORT_MS * LATENCY as u64));
        let rays = boxes.rays(&target, SIGMA_MM).unwrap();
        let solved = solver.step(&Processor, &target, &rays, UPDATES, task).unwrap();
        if now >= WARM_UP {
            let eyes =
                heads[now + LATENCY].into_iter().flat_map(|[x, y, z]| [-32.0, 32.0].map(|side| [x + side, y, z]));
            for eye_mm in eyes {
                let [seen, of_zone] = [&solved.stack, &zone].map(|stack| at_eye(stack, &target, content, eye_mm));
                tracked.push(seen);
                gains.push(seen - of_zone);
            }
        }
    }
    // compare the median and the 5th percentile
    for scores in [&mut tracked, &mut gains] {
        scores.sort_by(f64::total_cmp);
    }
    let [fifth, median] = [gains.len() / 20, gains.len() / 2].map(|at| [gains[at], tracked[at]]);
    println!(
        "gain: median {:.1} dB, 5th percentile {:.1} dB; PSNR {:.1} and {:.1} dB",
        median[0], fifth[0], median[1], fifth[1]
    );
    assert!(median[0] > 10.0 && fifth[0] > 10.0, "{median:?} {fifth:?}");
    assert!(fifth[0] > median[0] - 3.0, "{median:?} {fifth:?}");
}

/// Views at the eyes are mixtures of the views around each ray. So a light field that is linear in
/// the slope is reproduced exactly, in parallel projections and in perspective.
#[test]
fn eyes_see_mixtures_of_the_views_around_each_ray() {
    for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 700.0 }] {
        let plain = Display::uniform([20, 12], 2.0, [5, 4], [40.0, 30.0], &[-6.0, 6.0], 3);
        let geometry = plain.geometry().unwrap();
        let grid = ViewGrid { projection, ..geometry.grid.clone() };
        let mut field = LightField::black(geometry.with_grid(grid)).unwrap();
        let geometry = field.geometry().clone();
        let value = |at: [f64; 2], [sx, sy]: [f64; 2]| 0.5 + 0.2 * sx - 0.3 * sy + 0.001 * at[0] - 0.002 * at[1];
        for view in geometry.grid.iter() {
            let picture = field.view_mut(view);
            for (i, pixel) in picture.chunks_exact_mut(3).enumerate() {
                let at = [geometry.x_mm(i % geometry.cols), geometry.y_mm(i / geometry.cols)];
                pixel.fill(value(at, geometry.grid.slope_at(view, at)) as f32);
            }
        }
        let target = Target { display: Arc::new(plain), field, weights: Weights::Uniform, content: 0, passes: 1 };
        let mut tracker = Tracker::default();
        tracker.see(&[[-60.0, 40.0, 600.0], [50.0, -20.0, 600.0]], Eyes::Two, ms(0)).unwrap();
        let Rays::Eyes(eyes) = tracker.boxes(ms(0), ms(0)).rays(&target, 10.0).unwrap() else { panic!("no eyes") };
        let seen = eyes.field().geometry();
        assert_eq!((seen.grid.views(), eyes.display().sampling), ([2, 8], Sampling::Bilinear));
        // each eye of each viewer is midway between two views, in the viewer's row of views
        let columns = [-101.5, -81.5, -38.5, -18.5, 8.5, 28.5, 71.5, 91.5];
        for (view, slope) in seen.grid.slope_x.iter().enumerate() {
            assert!((slope * 600.0 - columns[view]).abs() < 1e-9, "{slope}");
        }
        let weights: Vec<f32> = seen.grid.iter().map(|view| eyes.weights().at(view, 20, 0)).collect();
        assert_eq!(weights, [1., 1., 1., 1., 0., 0., 0., 0., 0., 0., 0., 0., 1., 1., 1., 1.]);
        for view in seen.grid.iter() {
            if eyes.weights().at(view, 0, 0) == 0.0 {
                assert!(eyes.field().view(view).iter().all(|value| *value == 0.0), "{view:?} has no weight");
                continue;
            }
            for (i, pixel) in eyes.field().view(view).chunks_exact(3).enumerate() {
                let at = [seen.x_mm(i % seen.cols), seen.y_mm(i / seen.cols)];
                let wanted = value(at, seen.grid.slope_at(view, at));
                assert!(
                    (f64::from(pixel[0]) - wanted).abs() < 1e-6,
                    "{projection:?} {view:?} {at:?}: {pixel:?}, {wanted}"
                );
            }
        }
        // five viewers would need too many views
        let crowd: Vec<[f64; 3]> = (0..5).map(|i| [60.0 * f64::from(i), 0.0, 600.0]).collect();
        tracker.see(&crowd, Eyes::Two, ms(5)).unwrap();
        let of_crowd = tracker.boxes(ms(5), ms(0)).rays(&target, 10.0).unwrap();
        assert!(matches!(of_crowd, Rays::Views(Weights::PerRay(_))), "{of_crowd:?}");
        // Outside of the light field's views, an eye sees the outermost view. A viewer of a picture
        // has one eye, and the light field's projection.
        tracker.see(&[[6000.0, 0.0, 600.0]], Eyes::Picture, ms(10)).unwrap();
        let Rays::Eyes(far) = tracker.boxes(ms(10), ms(0)).rays(&target, 10.0).unwrap() else { panic!("no eyes") };
        assert_eq!((far.field().geometry().grid.views(), far.field().geometry().grid.projection), ([1, 2], projection));
        let [rightmost, seen] = [target.field.view([1, 4]), far.field().view([0, 0])].map(|view| view[3 * 5]);
        let below = target.field.view([2, 4])[3 * 5];
        assert!((seen - 0.5 * (rightmost + below)).abs() < 1e-6, "{seen} {rightmost} {below}");
    }
}
