//! The solver of a live display, on the device of its job.

use std::sync::Arc;

use lumistack_core::Task;
use lumistack_display::Weights;
use lumistack_live::{Solved, Solver, Target};

use crate::error::{PipelineError, factorize_error};
use crate::job::Job;
use crate::stage::device::SolverDevice;
use crate::stage::factorize::solver_settings;

/// Solves light fields one after another, each from the patterns of the previous one.
///
/// If the device of `auto` fails, the processor solves from then on.
pub struct LiveSolver {
    solver: Solver,
    device: String,
    site: SolverDevice,
}

impl LiveSolver {
    /// Opens the device of a job.
    ///
    /// # Errors
    /// If the solver, the start or the device does not exist.
    pub fn new(job: &Job) -> Result<Self, PipelineError> {
        let solver = Solver::new(solver_settings(&job.factorize, job.seed)?);
        let device = job.factorize.device.clone();
        Ok(Self { solver, site: SolverDevice::of(&device)?, device })
    }

    /// Uses the settings and the device of a job from the next step on.
    ///
    /// # Errors
    /// As [`new`](Self::new). Settings and device then stay as they are.
    pub fn follow(&mut self, job: &Job) -> Result<(), PipelineError> {
        let settings = solver_settings(&job.factorize, job.seed)?;
        let device = &job.factorize.device;
        // The search for adapters takes longer than a step, so `auto` makes it once. A device with
        // a name is open already, except after a failure.
        if device != "auto" || self.device != "auto" {
            self.site = SolverDevice::of(device)?;
            self.device.clone_from(device);
        }
        self.solver.set(settings);
        Ok(())
    }

    /// Makes `updates` towards a target. The patterns become the start of the next step.
    ///
    /// # Errors
    /// If target, weights and settings do not fit each other, if a device that the job names fails,
    /// or when cancelled. The next start then stays the same.
    pub fn step(
        &mut self,
        target: &Arc<Target>,
        weights: &Weights,
        updates: u32,
        task: Task<'_>,
    ) -> Result<Solved, PipelineError> {
        let Self { solver, site, .. } = self;
        site.run(task, |site| solver.step(site.executor(), target, weights, updates, task).map_err(factorize_error))
    }
}
