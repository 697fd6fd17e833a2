//! The solver of a live display, on the device of its job.

use std::sync::Arc;

use lumistack_core::Task;
use lumistack_live::{Rays, Solved, Solver, Target};

use crate::error::{PipelineError, factorize_error};
use crate::job::Job;
use crate::stage::device::SolverDevice;
use crate::stage::factorize::solver_settings;

/// Solves light fields one after another, each from the patterns of the previous one.
///
/// With the device `auto`, if a graphics processor fails, the processor solves from then on.
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
    /// The errors of [`new`](Self::new). After an error, settings and device are the same as
    /// before.
    pub fn follow(&mut self, job: &Job) -> Result<(), PipelineError> {
        let settings = solver_settings(&job.factorize, job.seed)?;
        let device = &job.factorize.device;
        // The search for graphics processors takes longer than a step, so `auto` searches only
        // once. If the job names a device, `SolverDevice::of` returns the open device immediately.
        // It opens a device only if the name is new or the device has failed.
        if device != "auto" || self.device != "auto" {
            self.site = SolverDevice::of(device)?;
            self.device.clone_from(device);
        }
        self.solver.set(settings);
        Ok(())
    }

    /// Makes `updates` iterations of the solver towards a target, along `rays`. The resulting
    /// patterns are the start of the next step.
    ///
    /// # Errors
    /// If target, rays and settings do not match, if a device that the job names fails, or when
    /// cancelled. After an error the next step starts from the same patterns as this step.
    pub fn step(
        &mut self,
        target: &Arc<Target>,
        rays: &Rays,
        updates: u32,
        task: Task<'_>,
    ) -> Result<Solved, PipelineError> {
        let Self { solver, site, .. } = self;
        site.run(task, |site| solver.step(site.executor(), target, rays, updates, task).map_err(factorize_error))
    }
}
