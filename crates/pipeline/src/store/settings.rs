//! `job.toml` and `display.toml` of a run folder. The first line of each file has a hash of all
//! other lines, which shows whether a user wrote or changed the file.

use std::ffi::OsStr;
use std::path::Path;

use lumistack_core::config;
use lumistack_display::Display;

use super::files::write;
use crate::error::PipelineError;
use crate::job::{DisplayJob, Job};

const SEAL: &str = "# Written by Lumistack; the next run into this folder replaces it. BLAKE3 of the rest: ";

/// Writes `job.toml` with absolute paths, so that it can be run from any folder.
pub(crate) fn write_job(job: &Job, dir: &Path) -> Result<(), PipelineError> {
    let mut job = job.clone();
    for path in job.paths_mut() {
        if let Ok(absolute) = std::path::absolute(&*path) {
            *path = absolute;
        }
    }
    // `sweep.displays` has files and presets as texts, so its paths are UTF-8.
    let folder = job.folder.clone();
    for name in job.sweep.iter_mut().flat_map(|sweep| &mut sweep.displays) {
        if let Some(file) = DisplayJob::by_name_or_path(&*name).file
            && let Ok(absolute) = std::path::absolute(folder.join(file))
            && let Some(text) = absolute.to_str()
        {
            *name = text.to_owned();
        }
    }
    write_sealed(&dir.join("job.toml"), &job.to_toml())
}

/// Writes `job.toml` or `display.toml` with the hash in the first line.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn write_sealed(path: &Path, text: &str) -> Result<(), PipelineError> {
    write(path, sealed(text).as_bytes())
}

/// Writes `display.toml` of a run. The file stays if it has the same display with a calibration,
/// and `display` has no calibration. A calibration takes work, and patterns do not depend on it.
///
/// # Errors
/// If the file cannot be written.
pub(crate) fn write_display(path: &Path, display: &Display) -> Result<(), PipelineError> {
    let there = std::fs::read_to_string(path).ok().and_then(|text| Display::from_toml(&text).ok());
    let nominal = display.without_panels();
    if *display == nominal && there.is_some_and(|there| there != nominal && there.without_panels() == nominal) {
        return Ok(());
    }
    write_sealed(path, &display.to_toml())
}

/// Renews the hash of a settings file whose text Lumistack changed from `before` to `after`, for
/// example by a calibration. If `before` has a valid hash, the result is `after` with a new hash;
/// otherwise the result is `after`.
pub fn with_new_seal(before: &str, after: &str) -> String {
    match (is_whole(before), after.strip_prefix(SEAL).and_then(|rest| rest.split_once('\n'))) {
        (Some(true), Some((_, rest))) => sealed(rest),
        _ => after.into(),
    }
}

fn sealed(text: &str) -> String {
    format!("{SEAL}{}\n{text}", blake3::hash(text.as_bytes()).to_hex())
}

/// Returns true if the hash in a text is valid; `None` if the text has no hash.
fn is_whole(text: &str) -> Option<bool> {
    let (hash, rest) = text.strip_prefix(SEAL)?.split_once('\n')?;
    Some(blake3::hash(rest.as_bytes()).to_hex().as_str() == hash.trim_end())
}

/// Returns true if the hash in a settings file is valid; `None` if the file is missing or has no
/// hash.
pub(crate) fn is_sealed(path: &Path) -> Option<bool> {
    is_whole(&std::fs::read_to_string(path).ok()?)
}

/// Returns true if a settings file is as Lumistack wrote it. A file of a version without hashes
/// must have every default and no comment. If the folder is known to be `ours`, files of older
/// versions with fewer keys are accepted too.
pub(crate) fn is_written_by_us(path: &Path, ours: bool) -> bool {
    if let Some(whole) = is_sealed(path) {
        return whole;
    }
    let Ok(text) = std::fs::read_to_string(path) else { return false };
    if path.file_name() == Some(OsStr::new("job.toml")) {
        let same = config::parse::<Job>(&text).is_ok_and(|job| job.to_toml() == text);
        let tables = ["[display]", "[window]", "[light]", "[render]", "[factorize]", "[report]"];
        let begins = text.starts_with("schema = \"lumistack/job\"\nversion = 1\nname = ");
        same || (ours && begins && !text.contains('#') && tables.iter().all(|table| text.contains(table)))
    } else {
        let same = Display::from_toml(&text).is_ok_and(|display| display.to_toml() == text);
        same || (ours && text.starts_with("name = ") && !text.contains('#') && text.contains("[[layers]]"))
    }
}
