//! Writes the last state of a live display as a run folder.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_live::State;
use lumistack_plugin_host::Registry;
use serde_json::Map;

use crate::error::{PipelineError, field_error};
use crate::job::Job;
use crate::steps::{ReportOn, write_report_on};
use crate::store::files::remove_reports;
use crate::store::folder;
use crate::store::lock::FolderLock;
use crate::store::names::Work;
use crate::store::settings::{write_display, write_job};

/// A run folder that a live display has locked until the value is dropped.
pub struct LiveFolder {
    dir: PathBuf,
    _owned: FolderLock,
}

impl LiveFolder {
    /// Locks a folder and prepares it for the run.
    ///
    /// # Errors
    /// If another run uses the folder, or the run would replace a file of another program or an
    /// input.
    pub fn lock(dir: &Path, job: &Job, registry: &Registry, task: Task<'_>) -> Result<Self, PipelineError> {
        let owned = folder::lock(dir, Work::Run, job, registry, task)?;
        Ok(Self { dir: dir.to_owned(), _owned: owned })
    }

    /// Returns the folder for results that can be made again.
    pub fn cache(&self) -> PathBuf {
        self.dir.join("cache")
    }

    /// Writes job, display, light field, patterns and report of the last state. Returns the path of
    /// the report.
    ///
    /// # Errors
    /// If a file cannot be written, or when cancelled.
    pub fn finish(&self, job: &Job, state: &State, task: Task<'_>) -> Result<PathBuf, PipelineError> {
        let (dir, target) = (&self.dir, &state.target);
        remove_reports(dir)?;
        // Results of an earlier run in this folder do not match these patterns.
        for name in ["held-out", "outside", "outputs"] {
            let path = dir.join(name);
            if path.is_dir() {
                std::fs::remove_dir_all(&path).map_err(PipelineError::write(&path))?;
            }
        }
        write_job(job, dir)?;
        write_display(&dir.join("display.toml"), &target.display)?;
        lumistack_field_io::write_field(&dir.join("target"), &target.field, &Map::new()).map_err(field_error)?;
        lumistack_field_io::write_stack(&dir.join("layers"), &target.display, &state.stack).map_err(field_error)?;
        // The report uses the solver's weights, which are large for rays to the viewers' eyes.
        let weights = state
            .boxes
            .weights(target.field.geometry(), &target.weights)
            .map_err(|error| PipelineError::Factorize(error.into()))?;
        let on = ReportOn {
            title: &job.name,
            display: &target.display,
            stack: &state.stack,
            target: &target.field,
            references: None,
            weights: &weights,
            // The solver started from patterns of other light fields, so it has no convergence
            // curve.
            solution: None,
            settings: &job.to_json(),
        };
        write_report_on(&on, dir, task)?;
        Ok(dir.join("report.html"))
    }
}
