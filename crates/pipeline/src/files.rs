//! Files of a run folder: written whole or not at all, older reports removed.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{PipelineError, field_error};
use crate::job::Job;

/// Writes `job.toml` so that it can be run from where it lies.
pub(crate) fn write_job(job: &Job, dir: &Path) -> Result<(), PipelineError> {
    let mut job = job.clone();
    for path in job.paths_mut() {
        if let Ok(absolute) = std::path::absolute(&*path) {
            *path = absolute;
        }
    }
    write(&dir.join("job.toml"), job.to_toml().as_bytes())
}

/// Removes the reports of older patterns.
pub(crate) fn remove_reports(dir: &Path) -> Result<(), PipelineError> {
    for name in ["report.html", "report.json"] {
        let path = dir.join(name);
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(PipelineError::Write { path, source });
            }
            _ => {}
        }
    }
    Ok(())
}

/// Writes `report.json`, then `report.html`.
pub(crate) fn write_report(dir: &Path, html: &str, json: &serde_json::Value) -> Result<(), PipelineError> {
    write(&dir.join("report.json"), &serde_json::to_vec_pretty(json).expect("reports serialize"))?;
    write(&dir.join("report.html"), html.as_bytes())
}

pub(crate) fn check_folder(path: &Path) -> Result<(), PipelineError> {
    if path.is_file() { Err(PipelineError::NotAFolder { path: path.to_owned() }) } else { Ok(()) }
}

/// What was kept between runs; `None` where there is nothing, or something else.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&std::fs::read(path).ok()?).ok()
}

/// Keeps a value for the next run.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), PipelineError> {
    write(path, &serde_json::to_vec(value).expect("what is kept between runs serializes"))
}

pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), PipelineError> {
    lumistack_field_io::atomic::write_bytes(path, bytes).map_err(field_error)
}
