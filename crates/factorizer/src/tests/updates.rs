//! The update against the oracle, and what theory promises about it.

use lumistack_core::Cancel;
use lumistack_display::score;

use super::oracle::Oracle;
use super::problems::{Kind, random};
use crate::lanes::InstructionSet;
use crate::multiplicative::MultiplicativeRun;
use crate::{Run, random_start};

/// Largest difference of a mask value after one full update in f32 and in f64.
const MASK_TOLERANCE: f64 = 1e-5;
/// How much the objective may rise by rounding in f32: relative, and per ray and channel where it is nearly 0.
const RISE_RELATIVE: f64 = 1e-6;
const RISE_PER_VALUE: f64 = 1e-13;
/// Relative difference of the objective in f32 arithmetic and in f64, and per ray and channel where it is nearly 0.
const OBJECTIVE_TOLERANCE: f64 = 1e-5;
const OBJECTIVE_PER_VALUE: f64 = 1e-12;
/// Difference of PSNR values that are computed from the same patterns by two ways, dB.
const PSNR_TOLERANCE: f64 = 1e-3;
const SEEDS: [u64; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

/// Every kernel that this machine can run: instruction sets, with and without the fast path.
fn kernels() -> Vec<(InstructionSet, bool)> {
    InstructionSet::available().into_iter().flat_map(|set| [(set, false), (set, true)]).collect()
}

#[test]
fn one_update_agrees_with_the_oracle_on_every_kind_of_problem() {
    for kind in Kind::ALL {
        let mut worst: f64 = 0.0;
        for seed in SEEDS {
            let owned = random(kind, seed);
            let problem = owned.problem();
            let start = random_start(&owned.display, seed);
            let mut oracle = Oracle::new(&problem, &start);
            (0..oracle.factors.len()).for_each(|n| oracle.update(n));
            for (set, fast) in kernels() {
                let mut run = MultiplicativeRun::new(&problem, start.clone()).unwrap().with_kernel(set, fast);
                run.step(&Cancel::default()).unwrap();
                let distance = oracle.distance(&run.download());
                worst = worst.max(distance);
                assert!(distance <= MASK_TOLERANCE, "{kind:?} {seed} {set:?} fast {fast}: {distance}");
            }
        }
        println!("{kind:?}: {worst:.1e}");
    }
}

#[test]
fn plain_problems_take_the_fast_path_and_mixed_ones_do_not() {
    let fast = |kind, seed| {
        let owned = random(kind, seed);
        MultiplicativeRun::new(&owned.problem(), random_start(&owned.display, 0)).unwrap().is_shifted()
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
fn the_objective_never_rises_in_any_layer_step() {
    for kind in Kind::ALL {
        for seed in SEEDS {
            let owned = random(kind, seed);
            let problem = owned.problem();
            let start = random_start(&owned.display, seed);
            let mut oracle = Oracle::new(&problem, &start);
            let mut run = MultiplicativeRun::new(&problem, start).unwrap();
            let slack = RISE_PER_VALUE * 3.0 * oracle.ray_count() as f64;
            let first = oracle.objective();
            let mut before = first;
            for step in 0..6 {
                for n in 0..run.factor_count() {
                    run.update_factor(n);
                    oracle.upload(&run.download());
                    let after = oracle.objective();
                    assert!(
                        after <= before * (1.0 + RISE_RELATIVE) + slack,
                        "{kind:?} {seed}, step {step}, factor {n}: {before} to {after}"
                    );
                    before = after;
                }
            }
            assert!(before < first || oracle.ray_count() == 0, "{kind:?} {seed}: nothing gained");
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
            let oracle = Oracle::new(&problem, &start);
            for (set, fast) in kernels() {
                let mut run = MultiplicativeRun::new(&problem, start.clone()).unwrap().with_kernel(set, fast);
                assert_eq!(run.rays(), oracle.ray_count() as u64, "{kind:?} {seed}");
                let (found, expected) = (run.objective(), oracle.objective());
                let slack = OBJECTIVE_PER_VALUE * 3.0 * oracle.ray_count() as f64;
                assert!((found.value - expected).abs() <= OBJECTIVE_TOLERANCE * expected + slack, "{kind:?} {seed}");
                let psnr = score(&owned.display, &run.download(), &owned.target, &owned.weights).psnr_view();
                let same = (found.psnr_view - psnr).abs() < PSNR_TOLERANCE || found.psnr_view.is_nan() && psnr.is_nan();
                assert!(same, "{kind:?} {seed}: {} and {psnr}", found.psnr_view);
            }
        }
    }
}
