//! Compares the update with the oracle, and checks the guarantees of the theory.

use lumistack_core::Cancel;
use lumistack_display::score;
use lumistack_simd::Backend;

use crate::oracle::Oracle;
use crate::problems::{Kind, random};
use lumistack_factorizer::device::Rule;
use lumistack_factorizer::device::Updater;
use lumistack_factorizer::internals::Engine;
use lumistack_factorizer::{FLOOR, random_start, solver};

/// Largest allowed difference of a mask value between an update in f32 and the oracle's update in
/// f64.
const MASK_TOLERANCE: f64 = 1e-5;
/// Tolerated relative rise of the objective by rounding in f32.
const RISE_RELATIVE: f64 = 1e-6;
/// Tolerated rise of an objective near 0, per ray and channel.
const RISE_PER_VALUE: f64 = 1e-13;
/// Relative tolerance of the objective that an update obtains from its own sums.
const ERROR_SEEN: f64 = 1e-5;
/// Tolerance of an objective near 0 that an update obtains from its own sums, per ray and channel.
const ERROR_SEEN_PER_VALUE: f64 = 1e-11;
/// Largest allowed KKT residual after many iterations, when the run has converged.
const SETTLED: f64 = 1e-4;
/// Largest allowed relative difference of the objective between f32 and f64.
const OBJECTIVE_TOLERANCE: f64 = 1e-5;
/// Largest allowed difference of an objective near 0 between f32 and f64, per ray and channel.
const OBJECTIVE_PER_VALUE: f64 = 1e-12;
/// Largest allowed difference of PSNR values computed from the same patterns in two ways, dB.
const PSNR_TOLERANCE: f64 = 1e-3;
/// A value is compared only if its influence on the emission is larger than this. Rounding decides
/// values with less influence.
const DETERMINED: f64 = 0.1;
/// Largest allowed difference between the emission of updates in f32 and the oracle's emission in
/// f64.
const SEEN_TOLERANCE: f64 = 1e-5;
const SEEDS: [u64; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

/// Returns every kernel that this machine can run: each instruction set, with and without the
/// kernels that the argument `fast` of [`Engine::use_kernel`] permits.
fn kernels() -> Vec<(Backend, bool)> {
    Backend::available().iter().flat_map(|backend| [(*backend, false), (*backend, true)]).collect()
}

/// The rules of the solvers. Each has the smallest value that its solver allows, and the number of
/// sweeps for the oracle.
const RULES: [(Rule, f32, Option<u32>); 2] =
    [(Rule::Multiplicative, FLOOR, None), (Rule::Block { sweeps: 4 }, 0.0, Some(4))];

/// Returns true if a rule applies to problems of a kind.
fn fits(rule: Rule, kind: Kind) -> bool {
    rule != Rule::Multiplicative || kind != Kind::Polarization
}

#[test]
fn one_update_agrees_with_the_oracle_on_every_kind_of_problem() {
    for (rule, floor, sweeps) in RULES {
        for kind in Kind::ALL.into_iter().filter(|kind| fits(rule, *kind)) {
            let mut worst: f64 = 0.0;
            for seed in SEEDS {
                let owned = random(kind, seed);
                let problem = owned.problem();
                let start = random_start(&owned.display, seed);
                let mut oracle = Oracle::new(&problem, &start, floor);
                // By the paper's rule the oracle's values do not depend on the kernel, so they are
                // computed once.
                let mut known: Vec<Vec<f64>> = Vec::new();
                for (set, fast) in kernels() {
                    oracle.upload(&start);
                    let mut engine = Engine::new(&problem, start.clone(), floor).unwrap();
                    engine.use_kernel(set, fast);
                    for n in 0..engine.plan().factor_count() {
                        let influence = if let Some(values) = known.get(n) {
                            oracle.factors[n].clone_from(values);
                            Vec::new()
                        } else {
                            oracle.update(n, sweeps)
                        };
                        if sweeps.is_none() && known.len() == n {
                            known.push(oracle.factors[n].clone());
                        }
                        engine.update(n, rule, None);
                        let stack = engine.download();
                        let what = format!("{rule:?} {kind:?} {seed} {set:?} fast {fast} factor {n}");
                        if sweeps.is_none() {
                            let distance = oracle.distance(n, &stack, |_| 1.0);
                            worst = worst.max(distance);
                            assert!(distance <= MASK_TOLERANCE, "{what}: {distance}");
                        } else {
                            // Rounding decides a value that almost no light reaches, so only
                            // determined values are compared.
                            let distance = oracle.distance(n, &stack, |i| f64::from(influence[i] > DETERMINED));
                            worst = worst.max(distance);
                            assert!(distance <= MASK_TOLERANCE, "{what}: {distance}");
                            let seen = oracle.distance(n, &stack, |i| influence[i]);
                            assert!(seen <= SEEN_TOLERANCE, "{what}: {seen} in the emission");
                            oracle.upload(&stack);
                        }
                    }
                }
            }
            println!("{rule:?} {kind:?}: {worst:.1e}");
        }
    }
}

#[test]
fn plain_problems_take_the_fast_path_and_mixed_ones_do_not() {
    let fast = |kind, seed| {
        let owned = random(kind, seed);
        let engine = Engine::new(&owned.problem(), random_start(&owned.display, 0), FLOOR).unwrap();
        (0..engine.plan().factor_count()).all(|n| engine.is_fast(n))
    };
    for kind in [Kind::Plain, Kind::EightLayers, Kind::ViewWeights, Kind::RayWeights, Kind::Wide] {
        assert!(SEEDS.iter().all(|seed| fast(kind, *seed)), "{kind:?}");
    }
    assert!(SEEDS.iter().filter(|seed| fast(Kind::Clear, **seed)).count() > 2);
    for kind in [Kind::MixedLayers, Kind::LensletsDark] {
        assert!(!SEEDS.iter().all(|seed| fast(kind, *seed)), "{kind:?}");
    }
}

#[test]
fn the_objective_never_rises_and_falls_by_what_the_step_says_at_least() {
    for (rule, floor, _) in RULES {
        for kind in Kind::ALL.into_iter().filter(|kind| fits(rule, *kind)) {
            for seed in SEEDS {
                let owned = random(kind, seed);
                let problem = owned.problem();
                let start = random_start(&owned.display, seed);
                let mut oracle = Oracle::new(&problem, &start, floor);
                let mut engine = Engine::new(&problem, start, floor).unwrap();
                // rounding may raise the objective by this much
                let slack = RISE_PER_VALUE * 3.0 * oracle.ray_count() as f64;
                let rounding = ERROR_SEEN_PER_VALUE * 3.0 * oracle.ray_count() as f64;
                let scale = engine.weight_scale();
                let first = oracle.objective();
                let mut before = first;
                for step in 0..6 {
                    for n in 0..engine.plan().factor_count() {
                        engine.update(n, rule, None);
                        let outcome = engine.outcome();
                        oracle.upload(&engine.download());
                        let after = oracle.objective();
                        // the objective must fall by at least the reported gain, and the reported
                        // error must be the objective before the step
                        let what = format!("{rule:?} {kind:?} {seed}, step {step}, factor {n}");
                        assert!(after <= before * (1.0 + RISE_RELATIVE) + slack, "{what}: {before} to {after}");
                        if engine.plan().sees_all_rays(n) {
                            let seen = outcome.error * scale;
                            assert!(
                                (seen - before).abs() <= ERROR_SEEN * before + rounding,
                                "{what}: {seen} of {before}"
                            );
                        }
                        let promised = before - outcome.gain * scale;
                        assert!(after <= promised + ERROR_SEEN * before + rounding, "{what}: {after} after {promised}");
                        before = after;
                    }
                }
                assert!(before < first || oracle.ray_count() == 0, "{rule:?} {kind:?} {seed}: nothing gained");
            }
        }
    }
}

#[test]
fn many_steps_end_where_the_first_order_conditions_hold() {
    for kind in [Kind::Plain, Kind::OneFrame, Kind::LensletsDark, Kind::RayWeights, Kind::Floors] {
        let owned = random(kind, 1);
        let problem = owned.problem();
        let start = random_start(&owned.display, 1);
        for name in ["block-exact", "extrapolated"] {
            let mut run = solver(name).unwrap().start(&problem, start.clone()).unwrap();
            let first = run.kkt_residual();
            (0..2000).for_each(|_| run.step(&Cancel::default()).unwrap());
            let last = run.kkt_residual();
            println!("{kind:?} {name}: {first:.1e} to {last:.1e}, objective {:.6e}", run.objective().value);
            assert!(last < 1e-3 * first && last < SETTLED, "{kind:?} {name}: {first} to {last}");
        }
    }
}

#[test]
fn the_objective_and_the_psnr_are_those_of_the_oracle_and_of_the_forward_model() {
    for kind in Kind::ALL {
        for seed in SEEDS {
            let owned = random(kind, seed);
            let problem = owned.problem();
            let start = random_start(&owned.display, seed);
            let oracle = Oracle::new(&problem, &start, FLOOR);
            for (set, fast) in kernels() {
                let mut engine = Engine::new(&problem, start.clone(), FLOOR).unwrap();
                engine.use_kernel(set, fast);
                assert_eq!(engine.plan().rays, oracle.ray_count() as u64, "{kind:?} {seed}");
                let (found, expected) = (engine.objective(), oracle.objective());
                let slack = OBJECTIVE_PER_VALUE * 3.0 * oracle.ray_count() as f64;
                assert!((found.value - expected).abs() <= OBJECTIVE_TOLERANCE * expected + slack, "{kind:?} {seed}");
                let psnr = score(&owned.display, &engine.download(), &owned.target, &owned.weights).psnr_view();
                let same = (found.psnr_view - psnr).abs() < PSNR_TOLERANCE || found.psnr_view.is_nan() && psnr.is_nan();
                assert!(same, "{kind:?} {seed}: {} and {psnr}", found.psnr_view);
            }
        }
    }
}

#[test]
fn the_objective_that_a_step_finds_on_its_way_is_that_of_its_end() {
    let mut found = 0;
    for kind in Kind::ALL {
        for seed in SEEDS {
            let owned = random(kind, seed);
            let start = random_start(&owned.display, seed);
            let mut run = solver("block-exact").unwrap().start(&owned.problem(), start).unwrap();
            for _ in 0..3 {
                run.step(&Cancel::default()).unwrap();
                let Some(known) = run.known_objective() else { continue };
                let evaluated = run.objective();
                let slack = ERROR_SEEN_PER_VALUE * 3.0 * run.rays() as f64;
                let difference = (known.value - evaluated.value).abs();
                assert!(difference <= ERROR_SEEN * evaluated.value + slack, "{kind:?} {seed}: {known:?} {evaluated:?}");
                found += 1;
            }
        }
    }
    assert!(found > 200, "{found}");
}

#[test]
fn steps_by_the_local_curvature_never_worsen_either() {
    for seed in SEEDS {
        let owned = random(Kind::Polarization, seed);
        let problem = owned.problem();
        let mut run = solver("block-exact").unwrap().start(&problem, random_start(&owned.display, seed)).unwrap();
        let first = run.objective().value;
        let mut before = first;
        for step in 0..30 {
            run.step(&Cancel::default()).unwrap();
            let after = run.objective().value;
            assert!(after <= before * (1.0 + RISE_RELATIVE), "{seed}, step {step}: {before} to {after}");
            before = after;
        }
        assert!(before < first || run.rays() == 0, "{seed}: nothing gained");
    }
}
