//! The device against the processor. Any adapter will do, software too; without one the tests are skipped.

use std::sync::OnceLock;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Formation, LayerStack, RayMap, Simulator};
use lumistack_factorizer::{
    FactorizeError, Problem, Run, Settings, Solver, factorize, factorize_on, random_start, solver,
};
use lumistack_factorizer_gpu::Device;

#[path = "../../factorizer/src/tests/problems.rs"]
#[allow(dead_code, reason = "the solvers' own problems; not every part is needed here")]
mod problems;

use problems::{Kind, Owned, display, random};

/// Largest difference of a pattern's value after ten updates.
const PATTERN_TOLERANCE: f32 = 1e-4;
/// Largest difference of the emission after ten updates.
const EMISSION_TOLERANCE: f32 = 1e-5;
/// Relative difference of the objective, and per ray and channel where it is nearly 0.
const OBJECTIVE_TOLERANCE: f64 = 1e-4;
const OBJECTIVE_PER_VALUE: f64 = 1e-11;
/// Change of the emission by a change of a value, from which on the value counts as determined.
const DETERMINED: f32 = 0.1;
const UPDATES: usize = 10;
/// By how much more than the processor from itself, where start and target are moved by a rounding,
/// the device may differ.
const OWN_ROUNDING: f32 = 4.0;
/// Problems by which the processor's own differences are measured.
const NUDGES: u32 = 4;

/// The adapter of the tests: `LUMISTACK_GPU`, or a graphics processor, or whatever there is.
fn device() -> Option<Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let open = || {
        let named = std::env::var("LUMISTACK_GPU").ok();
        let first = Device::open(named.as_deref()).or_else(|_| Device::open(Some("")));
        first.map_err(|error| lumistack_testkit::skip::skipped(&error.to_string())).ok()
    };
    DEVICE.get_or_init(open).clone()
}

/// Whether the device takes a display.
fn takes(owned: &Owned) -> bool {
    owned.display.layers.iter().all(|layer| layer.response().is_none())
}

fn run(solver: &dyn Solver, problem: &Problem, start: &LayerStack, updates: usize) -> (LayerStack, f64) {
    let mut run = solver.start(problem, start.clone()).unwrap();
    (0..updates).for_each(|_| run.step(&Cancel::default()).unwrap());
    (run.download(), run.objective().value)
}

fn tensors(stack: &LayerStack) -> impl Iterator<Item = &[f32]> {
    stack.layers.iter().map(|layer| layer.data()).chain(stack.emission.iter().map(|emission| emission.data()))
}

/// The emission along all rays.
fn emissions(owned: &Owned, stack: &LayerStack) -> Vec<f32> {
    let (geometry, simulator) = (owned.target.geometry(), Simulator::new(&owned.display, stack));
    let map = RayMap::new(&owned.display, geometry);
    geometry.grid.iter().flat_map(|view| simulator.view(&map, geometry, view).radiance.data().to_vec()).collect()
}

fn largest<'a>(a: impl IntoIterator<Item = &'a f32>, b: impl IntoIterator<Item = &'a f32>) -> f32 {
    a.into_iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// By how much the emission of any ray changes at most with each value, in the order of the stack's tensors: found by moving it.
fn influence(owned: &Owned, stack: &LayerStack, tensor: usize, index: usize) -> f32 {
    let mut moved = stack.clone();
    let layers = moved.layers.iter_mut().map(|layer| layer.data_mut());
    let mut parts = layers.chain(moved.emission.iter_mut().map(|emission| emission.data_mut()));
    let value = &mut parts.nth(tensor).unwrap()[index];
    *value = if *value > 0.5 { *value - 0.25 } else { *value + 0.25 };
    drop(parts);
    4.0 * largest(&emissions(owned, stack), &emissions(owned, &moved))
}

/// Moves values by a rounding, up or down at random. One factor for all values would be undone by
/// the first exact step, and would say nothing about later ones.
fn nudge(values: &mut [f32], state: &mut u32) {
    for value in values {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let up = *state >> 31 == 1;
        *value *= if up && *value < 1.0 { 1.0 + f32::EPSILON } else { 1.0 - f32::EPSILON };
    }
}

/// Runs of the processor from starts and to targets that differ by rounding alone. A value that no
/// light reaches but through pixels near 0 is decided by rounding, and decides later values.
fn own_runs(kind: Kind, seed: u64, name: &str, start: &LayerStack, updates: usize) -> Vec<LayerStack> {
    let mut runs = Vec::new();
    for number in 1..=NUDGES {
        let (mut state, mut owned, mut start) = (number, random(kind, seed), start.clone());
        let layers = start.layers.iter_mut().map(|layer| layer.data_mut());
        for tensor in layers.chain(start.emission.iter_mut().map(|emission| emission.data_mut())) {
            nudge(tensor, &mut state);
        }
        for view in owned.target.geometry().grid.clone().iter() {
            nudge(owned.target.view_mut(view), &mut state);
        }
        runs.push(run(solver(name).unwrap(), &owned.problem(), &start, updates).0);
    }
    runs
}

#[test]
fn updates_equal_the_processors() {
    let Some(device) = device() else { return };
    let (mut count, mut wrong) = (0, Vec::new());
    for kind in Kind::ALL {
        for seed in [4] {
            let owned = random(kind, seed);
            if !takes(&owned) {
                continue;
            }
            let start = random_start(&owned.display, seed);
            for (name, early) in [("multiplicative", UPDATES), ("block-exact", 1), ("extrapolated", 2)] {
                if name == "multiplicative" && owned.display.formation == Formation::Polarization {
                    continue;
                }
                let what = format!("{kind:?} {seed} {name}");
                let (on_device, here) = (device.solver(name).unwrap(), solver(name).unwrap());
                // later, frames that add up to the same emission differ by where rounding leads: restarts, ends of converged runs
                let [(expected, _), (found, _)] =
                    [here, &on_device].map(|solver: &dyn Solver| run(solver, &owned.problem(), &start, early));
                for (tensor, (a, b)) in tensors(&expected).zip(tensors(&found)).enumerate() {
                    let far = a.iter().zip(b).enumerate().filter(|(_, (a, b))| (*a - *b).abs() > PATTERN_TOLERANCE);
                    // a value that next to no light reaches is not determined either
                    let mut lit = far.filter(|(index, _)| influence(&owned, &expected, tensor, *index) >= DETERMINED);
                    if let Some((index, (a, b))) = lit.next() {
                        let own = own_runs(kind, seed, name, &start, early);
                        let own = own.iter().map(|own| (tensors(own).nth(tensor).unwrap()[index] - a).abs());
                        let own = own.fold(0.0, f32::max);
                        println!("{what}: value {index} of {tensor}: {a} and {b}, own {own:.1e}");
                        if (a - b).abs() <= OWN_ROUNDING * own {
                            continue;
                        }
                        wrong.push(format!("{what}: value {index} of {tensor}: {a} and {b}"));
                    }
                }
                let [(expected, objective), (found, value)] =
                    [here, &on_device].map(|solver: &dyn Solver| run(solver, &owned.problem(), &start, UPDATES));
                let (expected, found) = (emissions(&owned, &expected), emissions(&owned, &found));
                let emitted = largest(&expected, &found);
                println!("{what}: emission {emitted:.1e}, objective {objective:.6e} and {value:.6e}");
                if emitted.is_nan() || emitted > EMISSION_TOLERANCE {
                    let own = own_runs(kind, seed, name, &start, UPDATES);
                    let own = own.iter().map(|own| largest(&expected, &emissions(&owned, own))).fold(0.0, f32::max);
                    println!("{what}: emission differs by {emitted:.1e}, the processor's own by {own:.1e}");
                    if emitted.is_nan() || emitted > OWN_ROUNDING * own {
                        wrong.push(format!("{what}: emission differs by {emitted}, the processor's own by {own}"));
                    }
                }
                let slack = OBJECTIVE_PER_VALUE * found.len() as f64;
                if (value - objective).abs() > OBJECTIVE_TOLERANCE * objective + slack {
                    wrong.push(format!("{what}: objectives {objective} and {value}"));
                }
                count += 1;
            }
        }
    }
    assert!(wrong.is_empty(), "of {count}:\n{}", wrong.join("\n"));
    assert!(count > 60, "{count}");
}

#[test]
fn bands_change_nothing() {
    let Some(device) = device() else { return };
    for kind in [Kind::Plain, Kind::Bilinear, Kind::RayWeights, Kind::LensletsRepeat, Kind::Polarization] {
        let owned = random(kind, 2);
        let start = random_start(&owned.display, 2);
        let whole = run(&device.solver("extrapolated").unwrap(), &owned.problem(), &start, 3);
        let mut banded = 0;
        for bytes in [16 << 10, 8 << 10, 4 << 10, 2 << 10] {
            let cut = device.with_binding_bytes(bytes).unwrap();
            match cut.solver("extrapolated").unwrap().start(&owned.problem(), start.clone()) {
                // as small as it gets
                Err(error) => assert!(error.to_string().contains("too little memory"), "{error}"),
                Ok(_) => {
                    let parts = run(&cut.solver("extrapolated").unwrap(), &owned.problem(), &start, 3);
                    assert_eq!(parts.0, whole.0, "{kind:?}, {bytes} bytes");
                    banded += 1;
                }
            }
        }
        assert!(banded > 0, "{kind:?}");
    }
}

#[test]
fn a_whole_solve_is_as_good_as_the_processors() {
    let Some(device) = device() else { return };
    let mut display = display([100, 98], [3, 3], &[-5.3, 0.4, 5.1], 3);
    display.layers[1].bits = Some(2);
    let mut owned = Owned::constant(display, 0.0);
    let geometry = owned.target.geometry().clone();
    for view in geometry.grid.iter() {
        for (i, pixel) in owned.target.view_mut(view).chunks_exact_mut(3).enumerate() {
            let (col, row) = ((i % geometry.cols) as f32, (i / geometry.cols) as f32);
            pixel.fill(0.4 + 0.35 * (0.3 * col + view[1] as f32).sin() * (0.2 * row + view[0] as f32).cos());
        }
    }
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let settings = Settings { iterations: 8, ..Settings::default() };
    let task = Task::quiet(&warnings, &cancel);
    // from a coarser level, extrapolated, to levels of few bits
    let expected = factorize(&owned.problem(), &settings, None, task, &mut |_| ()).unwrap();
    let found = factorize_on(&device, &owned.problem(), &settings, None, task, &mut |_| ()).unwrap();
    assert_eq!(found.settings, expected.settings);
    for (found, expected) in found.history.iter().zip(&expected.history) {
        assert!((found.psnr_view - expected.psnr_view).abs() < 0.05, "{found:?} {expected:?}");
    }
    let [a, b] = [found.levels, expected.levels].map(|levels| levels.unwrap().reoptimized);
    assert!((a - b).abs() < 0.2, "{a} and {b}");
    assert!(
        (found.unsettled - expected.unsettled).abs() < 0.2 * expected.unsettled,
        "{} {}",
        found.unsettled,
        expected.unsettled
    );
    // the same once more
    let again = factorize_on(&device, &owned.problem(), &settings, None, task, &mut |_| ()).unwrap();
    assert_eq!(again.stack, found.stack);
}

#[test]
fn a_cancelled_step_leaves_the_patterns() {
    let Some(device) = device() else { return };
    let owned = random(Kind::Plain, 6);
    let start = random_start(&owned.display, 6);
    let mut run = device.solver("extrapolated").unwrap().start(&owned.problem(), start).unwrap();
    let (before, cancel) = (run.download(), Cancel::default());
    cancel.cancel();
    assert!(matches!(run.step(&cancel), Err(FactorizeError::Cancelled(_))));
    assert_eq!(run.download(), before);
    run.step(&Cancel::default()).unwrap();
    assert_ne!(run.download(), before);
}

#[test]
fn what_a_device_cannot_do_is_one_clear_message() {
    let missing = Device::open(Some("no such adapter")).err().unwrap().to_string();
    assert!(missing.contains("expected an adapter named like `no such adapter`, found "), "{missing}");
    let Some(device) = device() else { return };
    let mut owned = random(Kind::Plain, 3);
    owned.display.layers[0].blur_px = 0.5;
    let start = random_start(&owned.display, 3);
    let message = |device: &Device, owned: &Owned| {
        let begun = device.solver("auto").unwrap().start(&owned.problem(), start.clone());
        begun.err().unwrap().to_string()
    };
    let refused = message(&device, &owned);
    assert!(refused.ends_with("are solved on the processor"), "{refused}");
    owned.display.layers[0].blur_px = 0.0;
    let small = message(&device.with_binding_bytes(16).unwrap(), &owned);
    assert!(small.contains("too little memory"), "{small}");
    // another handle: the others go on
    let doomed = device.with_binding_bytes(u64::MAX).unwrap();
    let mut run: Box<dyn Run> = doomed.solver("auto").unwrap().start(&owned.problem(), start.clone()).unwrap();
    run.step(&Cancel::default()).unwrap();
    doomed.lose();
    let lost = run.step(&Cancel::default()).unwrap_err().to_string();
    assert!(lost.contains("lost"), "{lost}");
    run.download();
    assert!(run.check().is_err());
}
