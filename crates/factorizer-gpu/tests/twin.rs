//! Compares the results of a device with the results of the processor. Any adapter may be the
//! device, also a software adapter. Without an adapter the tests are skipped.

use std::sync::{Mutex, OnceLock};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Formation, LayerStack, RayMap, Simulator};
use lumistack_factorizer::device::{Begin, Executor, Factor, Rule, Updater};
use lumistack_factorizer::{
    FactorizeError, Problem, Processor, Run, Settings, Solver, factorize, factorize_on, random_start, solver, start_on,
};
use lumistack_factorizer_gpu::Device;

#[path = "../../factorizer/tests/factorizer/problems.rs"]
#[allow(dead_code, reason = "the solvers' own problems; not every part is needed here")]
mod problems;

use problems::{Kind, Owned, display, random};

/// Largest allowed difference of a mask value.
const PATTERN_TOLERANCE: f32 = 1e-4;
/// Largest allowed difference of the emission of a ray.
const EMISSION_TOLERANCE: f32 = 1e-5;
/// Largest allowed relative difference of the objective.
const OBJECTIVE_TOLERANCE: f64 = 1e-4;
/// Largest allowed difference of an objective near 0, divided by the number of rays and channels.
const OBJECTIVE_PER_VALUE: f64 = 1e-11;
/// Largest relative difference of an objective whose terms are summed in another order.
const SUM_TOLERANCE: f64 = 1e-5;
/// A value is compared between device and processor only if its influence on the emission is at
/// least this. Rounding decides a value with less influence.
const DETERMINED: f32 = 0.1;
/// Number of iterations whose updates are compared one by one.
const COMPARED_ITERATIONS: usize = 4;
/// Number of iterations of a whole run.
const ITERATIONS: usize = 10;
/// Seed of the random problems. Both tests that compare updates use it, so that they share compiled
/// shaders.
const SEED: u64 = 4;
/// The processor's own difference is the difference of emission between runs whose starts and
/// targets differ by rounding. The device's emission may differ from the processor's by this
/// multiple of the own difference.
const OWN_ROUNDING: f32 = 4.0;
/// Number of runs of the processor by which its own difference is measured.
const NUDGES: u32 = 4;
/// Largest number of runs that may need the tolerance [`OWN_ROUNDING`].
const MOST_LED_ELSEWHERE: usize = 8;

/// Returns the device of the tests. It is the adapter that `LUMISTACK_GPU` names, otherwise a
/// graphics processor, otherwise any adapter.
fn device() -> Option<Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let open = || {
        let named = std::env::var("LUMISTACK_GPU").ok();
        let first = Device::open(named.as_deref()).or_else(|_| Device::open(Some("")));
        first.map_err(|error| lumistack_testkit::skip::skipped(&error.to_string())).ok()
    };
    DEVICE.get_or_init(open).clone()
}

/// Returns true if the device and the solver accept a problem.
fn takes(owned: &Owned, name: &str) -> bool {
    let fits = name != "multiplicative" || owned.display.formation != Formation::Polarization;
    fits && owned.display.layers.iter().all(|layer| layer.response().is_none())
}

fn run(solver: &dyn Solver, problem: &Problem, start: &LayerStack, updates: usize) -> (LayerStack, f64) {
    let mut run = solver.start(problem, start.clone()).unwrap();
    (0..updates).for_each(|_| run.step(&Cancel::default()).unwrap());
    (run.download(), run.objective().value)
}

fn tensors(stack: &LayerStack) -> impl Iterator<Item = &[f32]> {
    stack.layers.iter().map(|layer| layer.data()).chain(stack.emission.iter().map(|emission| emission.data()))
}

/// Returns the emission along all rays.
fn emissions(owned: &Owned, stack: &LayerStack) -> Vec<f32> {
    let (geometry, simulator) = (owned.target.geometry(), Simulator::new(&owned.display, stack));
    let map = RayMap::new(&owned.display, geometry);
    geometry.grid.iter().flat_map(|view| simulator.view(&map, geometry, view).radiance.data().to_vec()).collect()
}

fn largest<'a>(a: impl IntoIterator<Item = &'a f32>, b: impl IntoIterator<Item = &'a f32>) -> f32 {
    a.into_iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Returns the influence of one value: the largest change of a ray's emission, divided by the
/// change of the value.
fn influence(owned: &Owned, stack: &LayerStack, tensor: usize, index: usize) -> f32 {
    let mut moved = stack.clone();
    let layers = moved.layers.iter_mut().map(|layer| layer.data_mut());
    let mut parts = layers.chain(moved.emission.iter_mut().map(|emission| emission.data_mut()));
    let value = &mut parts.nth(tensor).unwrap()[index];
    *value = if *value > 0.5 { *value - 0.25 } else { *value + 0.25 };
    drop(parts);
    4.0 * largest(&emissions(owned, stack), &emissions(owned, &moved))
}

/// Changes values by a rounding, up or down at random. If all values changed by one common factor,
/// the first exact step would undo the change, and later steps would show nothing.
fn nudge(values: &mut [f32], state: &mut u32) {
    for value in values {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let up = *state >> 31 == 1;
        *value *= if up && *value < 1.0 { 1.0 + f32::EPSILON } else { 1.0 - f32::EPSILON };
    }
}

/// Returns the patterns and objectives of runs on the processor whose starts and targets differ
/// only by rounding.
fn own_runs(kind: Kind, name: &str, start: &LayerStack) -> Vec<(LayerStack, f64)> {
    let own_run = |number: u32| {
        let (mut state, mut owned, mut start) = (number, random(kind, SEED), start.clone());
        let layers = start.layers.iter_mut().map(|layer| layer.data_mut());
        for tensor in layers.chain(start.emission.iter_mut().map(|emission| emission.data_mut())) {
            nudge(tensor, &mut state);
        }
        for view in owned.target.geometry().grid.clone().iter() {
            nudge(owned.target.view_mut(view), &mut state);
        }
        run(solver(name).unwrap(), &owned.problem(), &start, ITERATIONS)
    };
    (1..=NUDGES).map(own_run).collect()
}

/// An executor that records the input of a run and starts none.
struct Catch(Mutex<Option<Begin>>);

impl Executor for Catch {
    fn begin(&self, begin: Begin) -> Result<Box<dyn Updater>, FactorizeError> {
        *self.0.lock().unwrap() = Some(begin);
        Err(FactorizeError::Device { device: "none".into(), why: "nothing begins here".into() })
    }
}

/// Returns the input of a solver's run.
fn begin_of(name: &str, problem: &Problem, start: LayerStack) -> Begin {
    let catch = Catch(Mutex::default());
    assert!(start_on(&catch, name, problem, start).is_err());
    catch.0.into_inner().unwrap().unwrap()
}

/// Returns true if `a` and `b` are equal within the tolerance. Both are parts of a sum of `values`
/// terms, and the tolerance is relative to that whole sum, `sum`.
fn are_near(a: f64, b: f64, sum: f64, values: usize) -> bool {
    (a - b).abs() <= OBJECTIVE_TOLERANCE * sum + OBJECTIVE_PER_VALUE * values as f64
}

/// Compares single updates of the device and the processor. Each update starts from the processor's
/// patterns after the previous update, so that rounding does not accumulate.
#[test]
fn one_update_equals_the_processors() {
    let Some(device) = device() else { return };
    let (mut count, mut worst, mut wrong) = (0, 0.0f32, Vec::new());
    for kind in Kind::ALL {
        let owned = random(kind, SEED);
        for (name, rule) in [("multiplicative", Rule::Multiplicative), ("block-exact", Rule::Block { sweeps: 4 })] {
            if !takes(&owned, name) {
                continue;
            }
            let Begin { plan, display, ranges, mut factors, tries_local } =
                begin_of(name, &owned.problem(), random_start(&owned.display, SEED));
            let begun = |executor: &dyn Executor, factors: &[Factor]| {
                let (plan, display, ranges) = (plan.clone(), display.clone(), ranges.clone());
                executor.begin(Begin { plan, display, ranges, factors: factors.to_vec(), tries_local }).unwrap()
            };
            let each = factors.len();
            for (round, n) in (0..COMPARED_ITERATIONS * each).map(|at| (at / each, at % each)) {
                let what = format!("{kind:?} {name}, round {round}, factor {n}");
                // in every second round the block-exact rule extrapolates, and every rule takes the
                // curvature at the current point where L̃ is not linear
                let odd = round % 2 == 1;
                let extrapolation = (odd && name == "block-exact").then_some(0.35);
                let local = odd && !plan.is_bounded(n);
                let mut both = [begun(&Processor, &factors), begun(&device, &factors)];
                let [expected, found] = both.each_mut().map(|state| {
                    state.apply(n, rule, extrapolation, local);
                    let (update, errors) = (state.outcome(), state.errors());
                    let read = state.download();
                    state.swap_latest();
                    let stepped = state.download();
                    state.apply(n, Rule::KktResidual, None, false);
                    let seen = if plan.sees_all_rays(n) { update.error } else { 0.0 };
                    let probed = state.outcome().gain;
                    // pair each result with the sum of which it is a part
                    let sums = [(errors.weighted, errors.weighted), (errors.plain, errors.plain), (seen, seen)];
                    let parts = [(update.gain, update.error), (probed, errors.weighted.max(probed))];
                    (sums.into_iter().chain(parts).collect::<Vec<_>>(), [read, stepped])
                });
                let rays = emissions(&owned, &expected.1[0]).len();
                for ((a, sum), (b, _)) in expected.0.iter().zip(&found.0) {
                    if !are_near(*a, *b, *sum, rays) {
                        wrong.push(format!("{what}: sums {:?} and {:?}", expected.0, found.0));
                    }
                }
                for (expected, found) in expected.1.iter().zip(&found.1) {
                    let emitted = largest(&emissions(&owned, expected), &emissions(&owned, found));
                    worst = worst.max(emitted);
                    if emitted.is_nan() || emitted > EMISSION_TOLERANCE {
                        wrong.push(format!("{what}: emission differs by {emitted}"));
                    }
                    for (tensor, (a, b)) in tensors(expected).zip(tensors(found)).enumerate() {
                        let mut far =
                            a.iter().zip(b).enumerate().filter(|(_, (a, b))| (*a - *b).abs() > PATTERN_TOLERANCE);
                        // a value with little influence is not compared, since rounding decides it
                        let lit = far.find(|(index, _)| influence(&owned, expected, tensor, *index) >= DETERMINED);
                        if let Some((index, (a, b))) = lit {
                            wrong.push(format!("{what}: value {index} of {tensor}: {a} and {b}"));
                        }
                    }
                }
                let [here, _] = both;
                factors = here.into_factors().unwrap();
                count += 1;
            }
        }
    }
    println!("{count} updates, emissions within {worst:.1e}");
    assert!(wrong.is_empty(), "{} in {count}:\n{}", wrong.len(), wrong.join("\n"));
    assert!(count > 400, "{count}");
}

/// Compares whole runs of the device and the processor.
///
/// Whole runs agree less well than single updates. Later updates depend on values that rounding has
/// decided, so a few runs end at other patterns. Runs on the processor alone also end at other
/// patterns if their starts differ by rounding.
#[test]
fn ten_updates_equal_the_processors() {
    let Some(device) = device() else { return };
    let (mut count, mut led_elsewhere, mut wrong) = (0, Vec::new(), Vec::new());
    for kind in Kind::ALL {
        let owned = random(kind, SEED);
        let start = random_start(&owned.display, SEED);
        for name in ["multiplicative", "block-exact", "extrapolated"].into_iter().filter(|name| takes(&owned, name)) {
            // run both from the same start, and compare the emissions
            let what = format!("{kind:?} {name}");
            let on_device = device.solver(name).unwrap();
            let [(expected, objective), (found, value)] = [solver(name).unwrap(), &on_device]
                .map(|solver: &dyn Solver| run(solver, &owned.problem(), &start, ITERATIONS));
            let (expected, found) = (emissions(&owned, &expected), emissions(&owned, &found));
            let emitted = largest(&expected, &found);
            // if they differ, the processor's own runs must differ by a similar amount
            let mut own_objective = 0.0;
            if emitted.is_nan() || emitted > EMISSION_TOLERANCE {
                let runs = own_runs(kind, name, &start);
                let own = runs.iter().map(|(own, _)| largest(&expected, &emissions(&owned, own))).fold(0.0, f32::max);
                own_objective = runs.iter().map(|(_, own)| (own - objective).abs()).fold(0.0, f64::max);
                let differs = format!("{what}: emission differs by {emitted:.1e}, the processor's own by {own:.1e}");
                let list = if emitted <= OWN_ROUNDING * own { &mut led_elsewhere } else { &mut wrong };
                list.push(differs);
            }
            let as_near_as_own = (value - objective).abs() <= f64::from(OWN_ROUNDING) * own_objective;
            if !are_near(objective, value, objective, found.len()) && !as_near_as_own {
                wrong.push(format!(
                    "{what}: objectives {objective} and {value}, the processor's own within {own_objective}"
                ));
            }
            count += 1;
        }
    }
    println!("{} of {count} led elsewhere:\n{}", led_elsewhere.len(), led_elsewhere.join("\n"));
    assert!(wrong.is_empty(), "of {count}:\n{}", wrong.join("\n"));
    assert!(count > 60, "{count}");
    assert!(led_elsewhere.len() <= MOST_LED_ELSEWHERE, "{}", led_elsewhere.len());
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
                // the device cannot divide this problem into smaller bands
                Err(error) => assert!(error.to_string().contains("largest storage buffer"), "{error}"),
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

/// Sums by subgroups and by workgroups differ in the order of their terms alone. The sums decide
/// when a solver restarts, so the emissions are compared too.
#[test]
fn subgroups_change_sums_by_rounding_alone() {
    let Some(device) = device() else { return };
    if !device.has_subgroups() {
        return lumistack_testkit::skip::skipped("the adapter has no subgroups");
    }
    let without = device.without_subgroups().unwrap();
    assert!(!without.has_subgroups());
    for kind in [Kind::Plain, Kind::Bilinear, Kind::RayWeights, Kind::LensletsRepeat, Kind::Polarization] {
        let owned = random(kind, 2);
        let start = random_start(&owned.display, 2);
        let [(a, by_subgroups), (b, by_workgroups)] =
            [&device, &without].map(|on| run(&on.solver("extrapolated").unwrap(), &owned.problem(), &start, 3));
        let emitted = largest(&emissions(&owned, &a), &emissions(&owned, &b));
        assert!(emitted <= EMISSION_TOLERANCE, "{kind:?}: {emitted}");
        let relative = (by_subgroups - by_workgroups).abs() / by_workgroups;
        assert!(relative <= SUM_TOLERANCE, "{kind:?}: {by_subgroups} and {by_workgroups}");
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
    // solve a coarser level first, with extrapolation, and end with few bits
    let expected = factorize(&owned.problem(), &settings, None, task, &mut |_| ()).unwrap();
    let found = factorize_on(&device, &owned.problem(), &settings, None, task, &mut |_| ()).unwrap();
    assert_eq!(found.settings, expected.settings);
    for (found, expected) in found.history.iter().zip(&expected.history) {
        assert!((found.psnr_view - expected.psnr_view).abs() < 0.05, "{found:?} {expected:?}");
    }
    let [a, b] = [found.levels, expected.levels].map(|levels| levels.unwrap().reoptimized);
    assert!((a - b).abs() < 0.2, "{a} and {b}");
    assert!(
        (found.kkt_residual - expected.kkt_residual).abs() < 0.2 * expected.kkt_residual,
        "{} {}",
        found.kkt_residual,
        expected.kkt_residual
    );
    // a second run gives the same patterns
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
    assert!(
        missing.contains("expected a graphics processor whose name contains `no such adapter`, found "),
        "{missing}"
    );
    let Some(device) = device() else { return };
    let mut owned = random(Kind::Plain, 3);
    owned.display.layers[0].blur_px = 0.5;
    let start = random_start(&owned.display, 3);
    let message = |device: &Device, owned: &Owned| {
        let begun = device.solver("auto").unwrap().start(&owned.problem(), start.clone());
        begun.err().unwrap().to_string()
    };
    let refused = message(&device, &owned);
    assert!(refused.ends_with("; solve on the processor with --device cpu"), "{refused}");
    owned.display.layers[0].blur_px = 0.0;
    let small = message(&device.with_binding_bytes(16).unwrap(), &owned);
    assert!(small.contains("largest storage buffer"), "{small}");
    // Lose a device that only this test uses, since all tests share `device`.
    let doomed = device.with_binding_bytes(u64::MAX).unwrap();
    let mut run: Box<dyn Run> = doomed.solver("auto").unwrap().start(&owned.problem(), start.clone()).unwrap();
    run.step(&Cancel::default()).unwrap();
    doomed.lose();
    let lost = run.step(&Cancel::default()).unwrap_err().to_string();
    assert!(lost.contains("lost"), "{lost}");
    run.download();
    assert!(run.check().is_err());
}
