//! Cached files that the last finished run used. Every finished run removes the views of other
//! settings, which it did not use.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::code;
use super::files::write_json;
use super::key::KeyBuilder;
use super::left_overs::{entries, is_folder, remove_all};
use crate::error::PipelineError;

/// File with the list of used files, in the folder `cache`.
pub(crate) const USED: &str = "used.json";
/// Folder of the results of tiles, in the folder `cache`. A finished run does not need these
/// results.
pub(crate) const TILES: &str = "tiles";
/// Names of light fields, and `zone` for the pictures of the zone score. For each name, the cache
/// has folders with names `NAME-KEY`.
const FIELDS: [&str; 4] = ["target", "held-out", "outside", "zone"];
/// The cached views, light fields and rows that a finished run used.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct Used {
    /// Fingerprint of the code that makes views. A version with other code cannot use the views.
    code: String,
    /// Names of the folders of views.
    views: BTreeSet<String>,
    /// Names of the light fields of a sweep.
    pub(crate) fields: BTreeSet<String>,
    /// Names of the files with the rows of a sweep.
    pub(crate) designs: BTreeSet<String>,
}

fn code_of_views() -> String {
    KeyBuilder::new("used", code::VIEWS).finish()
}

/// Records which cached views the run in `dir` used. Removes all other cached views, and the
/// results of tiles.
///
/// # Errors
/// If the list cannot be written.
pub(crate) fn keep_only_views(dir: &Path, used: &[PathBuf]) -> Result<(), PipelineError> {
    let cache = dir.join("cache");
    let views = used.iter().filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned())).collect();
    let used = Used { code: code_of_views(), views, ..Used::default() };
    if !used.views.is_empty() || cache.join(USED).exists() {
        write_json(&cache.join(USED), &used)?;
    }
    remove_all(&unused_views(&cache, &used));
    remove_tiles(dir);
    Ok(())
}

/// Removes the results of tiles, which no later work in `dir` uses.
pub(crate) fn remove_tiles(dir: &Path) {
    remove_all(&[dir.join("cache").join(TILES)]);
}

/// Records which light fields (by their numbers) and which files of rows the sweep in `dir` used.
/// Removes all other light fields. Rows are small, so all of them stay for sweeps over more values.
///
/// # Errors
/// If the list cannot be written.
pub(crate) fn keep_only_fields(
    dir: &Path,
    fields: impl Iterator<Item = usize>,
    designs: BTreeSet<String>,
) -> Result<(), PipelineError> {
    let fields = fields.map(|number| number.to_string()).collect();
    let used = Used { code: code_of_views(), fields, designs, ..Used::default() };
    write_json(&dir.join("cache").join(USED), &used)?;
    remove_all(&unused_in(&dir.join("fields"), &used.fields));
    Ok(())
}

/// Returns the folders of cached views. A run has them in `cache/views`, and the command `render`
/// in `cache`.
pub(crate) fn all_views(cache: &Path) -> Vec<(String, PathBuf)> {
    let is_field =
        |name: &str| name.rsplit_once('-').is_some_and(|(field, key)| FIELDS.contains(&field) && key.len() == 16);
    let both = [cache.join("views"), cache.to_owned()];
    both.iter().flat_map(|folder| entries(folder)).filter(|(name, path)| is_field(name) && is_folder(path)).collect()
}

pub(crate) fn unused_views(cache: &Path, used: &Used) -> Vec<PathBuf> {
    let views = all_views(cache).into_iter();
    views.filter(|(name, _)| used.code != code_of_views() || !used.views.contains(name)).map(|(_, path)| path).collect()
}

pub(crate) fn unused_in(folder: &Path, used: &BTreeSet<String>) -> Vec<PathBuf> {
    entries(folder).into_iter().filter(|(name, _)| !used.contains(name)).map(|(_, path)| path).collect()
}
