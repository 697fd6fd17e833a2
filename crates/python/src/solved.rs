//! History and solution of factorized patterns.

use lumistack_factorizer::{Factorization, Iteration};

/// History and solution as plain values, for pickles.
pub(crate) type SolvedParts = (Solution, Vec<Step>);
/// Solver, start, number of coarser levels, KKT residual, and PSNRs of layers of few bits.
type Solution = (String, String, u32, f64, Option<[f64; 3]>);
/// Number of iterations, objective, PSNR and seconds.
type Step = (u32, f64, f64, f64);

/// Settings and history of the factorization that made a stack.
pub(crate) struct Solved {
    pub(crate) solution: lumistack_report::Solution,
    pub(crate) steps: Vec<lumistack_report::Iteration>,
}

impl Solved {
    /// Returns settings and history of a factorization. `seconds` are the times of the evaluations
    /// of the objective, measured from the start of the solve.
    pub(crate) fn of(made: &Factorization, seconds: &[f64], warm: bool) -> Self {
        let settings = &made.settings;
        let start = if warm { "warm" } else { settings.start.unwrap_or_default().name() };
        let step = |(step, &seconds): (&Iteration, &f64)| lumistack_report::Iteration {
            iteration: step.iteration,
            objective: step.objective,
            psnr_view: step.psnr_view,
            seconds,
        };
        Self {
            solution: lumistack_report::Solution {
                solver: settings.solver.clone(),
                start: start.into(),
                coarse_levels: if warm { 0 } else { settings.coarse_levels.unwrap_or(0) },
                kkt_residual: made.kkt_residual,
                levels: made.levels.map(|loss| [loss.continuous, loss.rounded, loss.reoptimized]),
            },
            steps: made.history.iter().zip(seconds).map(step).collect(),
        }
    }

    /// Returns the values of the history and the solution.
    pub(crate) fn parts(&self) -> SolvedParts {
        let of = &self.solution;
        let solution = (of.solver.clone(), of.start.clone(), of.coarse_levels, of.kkt_residual, of.levels);
        let step = |step: &lumistack_report::Iteration| (step.iteration, step.objective, step.psnr_view, step.seconds);
        (solution, self.steps.iter().map(step).collect())
    }

    /// Returns history and solution from their values.
    pub(crate) fn from_parts((solution, steps): SolvedParts) -> Self {
        let (solver, start, coarse_levels, kkt_residual, levels) = solution;
        let solution = lumistack_report::Solution { solver, start, coarse_levels, kkt_residual, levels };
        let step = |(iteration, objective, psnr_view, seconds)| lumistack_report::Iteration {
            iteration,
            objective,
            psnr_view,
            seconds,
        };
        Self { solution, steps: steps.into_iter().map(step).collect() }
    }
}
