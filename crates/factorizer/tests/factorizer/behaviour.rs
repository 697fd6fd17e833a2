//! Tests small cases with exact solutions, degenerate input, errors, threads and cancellation.

use std::cell::Cell;
use std::sync::Arc;

use lumistack_core::{Cancel, Collector, Progress, Task, Tensor};
use lumistack_display::{LayerStack, Sampling, Weights};

use crate::problems::{Kind, Owned, display, random};
use lumistack_factorizer::device::Rule;
use lumistack_factorizer::device::Updater;
use lumistack_factorizer::internals::Engine;
use lumistack_factorizer::{ChannelRun, Factorization, FactorizeError, Settings, check_rays, factorize};

/// Tolerance for an exact solution in f32.
const EXACT: f32 = 1e-6;

fn solve(owned: &Owned, settings: &Settings, warm: Option<&LayerStack>) -> Result<Factorization, FactorizeError> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    factorize(&owned.problem(), settings, warm, Task::quiet(&warnings, &cancel), &mut |_| ())
}

fn iterations(iterations: u32) -> Settings {
    Settings { solver: "multiplicative".into(), iterations, ..Settings::default() }
}

#[test]
fn one_pixel_one_view_one_layer_reaches_the_target_and_not_a_fraction_of_it() {
    for frames in [1, 4] {
        let owned = Owned::constant(display([1, 1], [1, 1], &[0.0], frames), 0.6);
        let result = solve(&owned, &iterations(3), None).unwrap();
        let layer = &result.stack.layers[0];
        let mean = layer.data().chunks(3).map(|pixel| pixel[0]).sum::<f32>() / frames as f32;
        assert!((mean - 0.4 * 0.6).abs() < EXACT, "M = {frames}: {mean}");
        assert!(result.history[3].psnr_view > 120.0);
    }
}

#[test]
fn degenerate_input_gives_finite_patterns() {
    let flat = || display([9, 6], [3, 3], &[-5.0, 0.3, 5.0], 3);
    let mut huge_weights = Owned::constant(flat(), 0.5);
    huge_weights.weights = Weights::PerView(Tensor::filled(["view_y", "view_x"], [3, 3], f32::MAX));
    let mut tiny_weights = Owned::constant(flat(), 0.5);
    tiny_weights.weights = Weights::PerView(Tensor::filled(["view_y", "view_x"], [3, 3], 1e-40));
    let eight = display([9, 6], [3, 3], &[-8.0, -6.0, -4.0, -2.0, 0.3, 2.0, 4.0, 6.0], 3);
    for (what, owned) in [
        ("black", Owned::constant(flat(), 0.0)),
        ("white", Owned::constant(flat(), 1.0)),
        ("beyond white", Owned::constant(flat(), 1e30)),
        ("below black", Owned::constant(flat(), -1e-3)),
        ("one pixel", Owned::constant(display([1, 1], [3, 3], &[-50.0, 0.0, 50.0], 2), 0.5)),
        ("huge weights", huge_weights),
        ("tiny weights", tiny_weights),
        ("eight black layers", Owned::constant(eight, 0.0)),
    ] {
        let result = solve(&owned, &iterations(20), None).unwrap();
        result.stack.check(&owned.display).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert!(result.history.iter().all(|entry| entry.objective.is_finite()), "{what}");
    }
}

#[test]
fn no_counted_ray_is_an_error_and_no_figure() {
    let mut owned = random(Kind::Plain, 3);
    let views = owned.target.geometry().grid.views();
    owned.weights = Weights::PerView(Tensor::zeros(["view_y", "view_x"], views));
    let error = solve(&owned, &iterations(3), None).unwrap_err().to_string();
    let found = format!("0 everywhere (number of weights: {})", views[0] * views[1]);
    assert_eq!(error, format!("weights: expected at least one weight above 0, found {found}"));
    for sampling in [Sampling::Nearest, Sampling::Bilinear] {
        let mut beside = display([9, 6], [3, 3], &[-5.0, 0.3, 5.0], 3);
        beside.layers[1].offset_mm = [1000.0, 0.0];
        beside.sampling = sampling;
        let found = check_rays(&beside, &beside.geometry().unwrap());
        assert_eq!(found, Err(FactorizeError::NoRays), "found before the solve");
        let error = solve(&Owned::constant(beside, 0.5), &iterations(3), None).unwrap_err();
        assert_eq!(error, FactorizeError::NoRays, "a layer beside the field");
    }
    let hit = display([9, 6], [3, 3], &[-5.0, 0.3, 5.0], 3);
    assert_eq!(check_rays(&hit, &hit.geometry().unwrap()), Ok(()));
}

#[test]
fn a_warm_start_continues_where_it_left() {
    let owned = random(Kind::Anything, 2);
    let whole = solve(&owned, &iterations(8), None).unwrap();
    let half = solve(&owned, &iterations(4), None).unwrap();
    let rest = solve(&owned, &iterations(4), Some(&half.stack)).unwrap();
    assert_eq!(rest.stack, whole.stack);
    assert_eq!(rest.history[4].objective, whole.history[8].objective);
}

#[test]
fn the_brightness_is_the_displays_and_equal_frames_are_reported() {
    let owned = random(Kind::Plain, 1);
    let mut warm = LayerStack::filled(&owned.display, 0.0);
    warm.brightness = 1.0;
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    for solver in ["multiplicative", "block-exact"] {
        let settings = Settings { solver: solver.into(), ..iterations(5) };
        let result = factorize(&owned.problem(), &settings, Some(&warm), task, &mut |_| ()).unwrap();
        assert_eq!(result.stack.brightness, owned.display.brightness);
        assert!(result.history[5].objective < result.history[0].objective, "zeros are lifted to the floor and grow");
        // only the multiplicative rule keeps equal frames equal
        let layer = &result.stack.layers[0];
        let frames: Vec<&[f32]> = (0..owned.display.frames).map(|frame| layer.block([frame])).collect();
        let are_equal = frames.iter().all(|frame| *frame == frames[0]);
        assert_eq!(are_equal, solver == "multiplicative", "{solver}");
        let said: Vec<_> =
            warnings.take().into_iter().filter(|said| said.message.contains("frames are equal")).collect();
        assert_eq!(said.len(), usize::from(are_equal), "{solver}: {said:?}");
    }
}

#[test]
fn results_are_the_same_bytes_on_any_number_of_threads() {
    for kind in [Kind::Wide, Kind::Anything, Kind::LensletsRepeat, Kind::Bilinear] {
        let owned = random(kind, 4);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| solve(&owned, &iterations(5), None).unwrap())
        };
        assert_eq!(on(1), on(5), "{kind:?}");
    }
}

#[test]
fn what_does_not_fit_is_named() {
    let message = |owned: &Owned, settings: &Settings, warm: Option<&LayerStack>| {
        solve(owned, settings, warm).unwrap_err().to_string()
    };
    let mut owned = Owned::constant(display([6, 4], [3, 2], &[0.0], 2), 0.5);
    let other = LayerStack::filled(&display([6, 5], [3, 2], &[0.0], 2), 0.5);
    let text = message(&owned, &iterations(1), Some(&other));
    assert_eq!(
        text,
        "starting patterns: shape [frame][row][col][rgb] of layer 0: expected [2, 4, 6, 3], found [2, 5, 6, 3]"
    );
    let unknown = Settings { solver: "fastest".into(), ..iterations(1) };
    assert_eq!(
        message(&owned, &unknown, None),
        "solver: expected one of auto, multiplicative, block-exact, extrapolated, found fastest"
    );
    owned.weights = Weights::PerView(Tensor::zeros(["view_y", "view_x"], [3, 3]));
    assert_eq!(message(&owned, &iterations(1), None), "weights: expected shape [2, 3], found [3, 3]");
    owned.weights = Weights::Uniform;
    *owned.target.radiance_mut().at_mut([1, 2, 3, 4, 1]) = f32::NAN;
    let text = message(&owned, &iterations(1), None);
    assert_eq!(text, "target, view [1, 2], row 3, column 4, green: expected a finite value, found NaN");
    *owned.target.radiance_mut().at_mut([1, 2, 3, 4, 1]) = 0.5;
    owned.display.brightness = 0.0;
    assert!(message(&owned, &iterations(1), None).starts_with("display: brightness: expected a number above 0"));
}

#[test]
fn cancelling_stops_the_run_and_ends_the_progress() {
    let owned = random(Kind::Plain, 6);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let progress = Steps::default();
    let task = Task { progress: &progress, ..Task::quiet(&warnings, &cancel) };
    let seen = Cell::new(0);
    let result = factorize(&owned.problem(), &iterations(10), None, task, &mut |entry| {
        seen.set(entry.iteration);
        if entry.iteration == 3 {
            cancel.cancel();
        }
    });
    assert_eq!(result.unwrap_err(), FactorizeError::Cancelled(lumistack_core::Cancelled));
    assert_eq!(seen.get(), 3);
    let steps = progress.0.lock().unwrap();
    assert_eq!(*steps, ["begin 10 iterations", "3 dB notes", "end"].map(String::from), "{steps:?}");
}

#[test]
fn a_cancelled_step_leaves_the_lines_that_it_did_not_reach() {
    for kind in [Kind::Plain, Kind::Bilinear, Kind::LensletsDark, Kind::Additive] {
        let owned = random(kind, 6);
        for solver in ["multiplicative", "block-exact"] {
            let start = lumistack_factorizer::random_start(&owned.display, 6);
            let mut run = lumistack_factorizer::solver(solver).unwrap().start(&owned.problem(), start).unwrap();
            let (before, cancel) = (run.download(), Cancel::default());
            cancel.cancel();
            assert!(run.step(&cancel).is_err(), "{kind:?} {solver}");
            assert_eq!(run.download(), before, "{kind:?} {solver}");
            run.step(&Cancel::default()).unwrap();
            assert_ne!(run.download(), before, "{kind:?} {solver}");
        }
    }
}

#[test]
fn the_objective_is_reported_as_often_as_asked_and_at_the_end() {
    let owned = random(Kind::Plain, 6);
    let settings = Settings { report_every: 4, ..iterations(10) };
    let result = solve(&owned, &settings, None).unwrap();
    assert_eq!(result.history.iter().map(|entry| entry.iteration).collect::<Vec<_>>(), [0, 4, 8, 10]);
    let mut run =
        lumistack_factorizer::solver("multiplicative").unwrap().start(&owned.problem(), result.stack).unwrap();
    let objective = run.objective();
    assert_eq!(objective.value, result.history[3].objective);
}

/// Records the reports of progress.
#[derive(Default)]
struct Steps(std::sync::Mutex<Vec<String>>);

impl Progress for Steps {
    fn begin(&self, _stage: &str, total: u64, unit: &str) {
        self.0.lock().unwrap().push(format!("begin {total} {unit}"));
    }

    fn advance(&self, steps: u64, note: &str) {
        let mut list = self.0.lock().unwrap();
        assert!(steps == 1 && note.ends_with(" dB"), "{steps} {note}");
        let count = list.last().and_then(|last| last.strip_suffix(" dB notes")?.parse::<u32>().ok());
        match count {
            Some(count) => *list.last_mut().unwrap() = format!("{} dB notes", count + 1),
            None => list.push("1 dB notes".into()),
        }
    }

    fn end(&self) {
        self.0.lock().unwrap().push("end".into());
    }
}

#[test]
fn one_lent_channel_is_solved_like_a_channel_of_the_whole() {
    let mut owned = random(Kind::Wide, 2);
    let geometry = owned.target.geometry().clone();
    // The target has the half floats 0 and 0.25..1, alike in every channel.
    let halves: Vec<u16> = (0..owned.target.radiance().data().len() / 3)
        .map(|i| if i * 37 % 257 == 0 { 0 } else { 0x3c00 - (i * 37 % 257) as u16 * 8 })
        .collect();
    let pixels = owned.target.radiance_mut().data_mut().chunks_exact_mut(3);
    pixels.zip(&halves).for_each(|(pixel, &half)| pixel.fill(lumistack_simd::float_from_half(half)));
    let mut channel = ChannelRun::start(&owned.display, &geometry, Arc::new(halves.clone()), 3).unwrap();
    let mut stack = LayerStack::filled(&owned.display, 0.0);
    let fetch = |run: &ChannelRun, stack: &mut LayerStack| {
        for (n, layer) in stack.layers.iter_mut().enumerate() {
            let [frames, rows, cols, _] = layer.shape();
            for (frame, row) in (0..frames).flat_map(|frame| (0..rows).map(move |row| (frame, row))) {
                let values = run.row(n, frame, row);
                assert_eq!(values.len(), cols);
                let pixels = layer.block_mut([frame, row]).chunks_exact_mut(3);
                pixels.zip(values).for_each(|(pixel, &value)| pixel.fill(value));
            }
        }
    };
    fetch(&channel, &mut stack);
    let problem = owned.problem();
    let mut whole = Engine::new(&problem, stack.clone(), 0.0).unwrap();
    let first = channel.objective();
    assert!((first.psnr_view - whole.objective().psnr_view).abs() < 1e-9);
    for _ in 0..3 {
        channel.step(&Cancel::default()).unwrap();
        (0..whole.plan().factor_count()).for_each(|n| {
            whole.update(n, Rule::Block { sweeps: 2 }, None);
        });
    }
    fetch(&channel, &mut stack);
    assert_eq!(whole.download().layers, stack.layers);
    assert!(channel.objective().psnr_view > first.psnr_view + 3.0);
    let infinite = Arc::new(vec![0x7c00u16; halves.len()]);
    let error = ChannelRun::start(&owned.display, &geometry, infinite, 3).err().unwrap();
    assert!(error.to_string().contains("not finite"), "{error}");
}
