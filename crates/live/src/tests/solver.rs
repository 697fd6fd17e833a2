use std::sync::Arc;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::Weights;
use lumistack_factorizer::{Problem, Processor, Settings, factorize};

use super::fields::{CONTENTS, Content, target, wide};
use crate::{Rays, Solver, Start, Target};

/// Number of iterations per time step, as on a slow machine.
const WARM: u32 = 5;
/// Number of iterations of a solve from a fresh start.
const FROM_SCRATCH: u32 = 30;

fn from_scratch(target: &Target, weights: &Weights, iterations: u32) -> f64 {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let problem = Problem { display: &target.display, target: &target.field, weights };
    let settings = Settings { iterations, report_every: u32::MAX, ..Settings::default() };
    let done = factorize(&problem, &settings, None, Task::quiet(&warnings, &cancel), &mut |_| {}).unwrap();
    done.history.last().unwrap().psnr_view
}

/// Solves several time steps, in each of which the content has moved by `step_px`. Returns three
/// values of the last time step: the PSNR after [`WARM`] iterations, the start, and the target.
fn chain(content: Content, step_px: f64) -> (f64, Start, Arc<Target>) {
    let (warnings, cancel, display) = (Collector::default(), Cancel::default(), wide());
    let task = Task::quiet(&warnings, &cancel);
    let mut solver = Solver::new(Settings::default());
    let target_at = |time: u32| target(&display, content, f64::from(time) * step_px, u64::from(time));
    solver.step(&Processor, &target_at(0), &Rays::Views(Weights::Uniform), FROM_SCRATCH, task).unwrap();
    let mut last = None;
    for time in 1..=3 {
        let now = target_at(time);
        let solved = solver.step(&Processor, &now, &Rays::Views(Weights::Uniform), WARM, task).unwrap();
        last = Some((solved.psnr_view, solved.start, now));
    }
    last.unwrap()
}

#[test]
fn a_few_warm_updates_follow_content_that_moves() {
    let mut behind = Vec::new();
    for content in CONTENTS {
        for (step_px, loss_db) in [(2.0, 1.0), (10.0, 2.0)] {
            let (warm, start, target) = chain(content, step_px);
            let scratch = from_scratch(&target, &Weights::Uniform, FROM_SCRATCH);
            let text = format!("{content:?}, {step_px} px: {warm:.2} dB from {start:?}, {scratch:.2} dB from scratch");
            println!("{text}");
            if warm < scratch - loss_db || start == Start::Fresh {
                behind.push(text);
            }
        }
    }
    assert!(behind.is_empty(), "{behind:#?}");
}
