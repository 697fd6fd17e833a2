//! Folders of light fields and patterns: their notes, stale views, and folders of other data.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use lumistack_display::{Display as Description, StackIndex};
use lumistack_field_io::view_file_name;
use lumistack_pipeline::PipelineError;
use pyo3::prelude::*;
use serde_json::{Map, Value};

use crate::error::{exception, setting};

/// Key of the display in the notes (`info`) of a light-field folder.
pub(crate) const DISPLAY: &str = "display";
/// Index of a light-field folder.
const INDEX: &str = "lightfield.json";
/// Suffixes that save() refuses for a new folder, since users would expect a file.
const FILES: [&str; 16] =
    ["npz", "exr", "png", "jpg", "jpeg", "tif", "tiff", "hdr", "json", "toml", "h5", "hdf5", "pt", "mat", "zip", "pkl"];

/// Content of a folder.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Holds {
    /// A light field.
    Views,
    /// Patterns.
    Patterns,
}

/// Returns the display and the other notes of a light-field folder, or of the folder `target` in a
/// run's folder. Light fields of other formats have no notes.
pub(crate) fn notes(path: &Path) -> (Option<Arc<Description>>, Map<String, Value>) {
    let is_index = path.file_name().is_some_and(|name| name == INDEX);
    let places =
        if is_index { vec![path.to_path_buf()] } else { vec![path.join(INDEX), path.join("target").join(INDEX)] };
    let Some(mut index) = places.iter().find_map(|place| read(place)) else { return (None, Map::new()) };
    let Some(Value::Object(mut info)) = index.remove("info") else { return (None, Map::new()) };
    // If the note `display` is not a valid display, it stays a note.
    let display = info.get(DISPLAY).and_then(|display| serde_json::from_value::<Description>(display.clone()).ok());
    let display = display.filter(|display| display.check().is_ok());
    if display.is_some() {
        info.remove(DISPLAY);
    }
    (display.map(Arc::new), info)
}

/// Returns the files of the views in a light-field folder.
pub(crate) fn views(folder: &Path) -> Vec<String> {
    let index = read(&folder.join(INDEX)).unwrap_or_default();
    let views = index.get("views").and_then(Value::as_array).into_iter().flatten();
    views.filter_map(|view| view["file"].as_str().map(String::from)).collect()
}

/// Removes the files of an earlier light field in this folder that the new one has not replaced.
/// Only files with names that save() gives are removed.
pub(crate) fn remove_stale(folder: &Path, old: &[String], views: [usize; 2]) -> Result<(), PipelineError> {
    let new: Vec<String> =
        (0..views[0]).flat_map(|row| (0..views[1]).map(move |col| view_file_name(views, [row, col]))).collect();
    let is_number = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    let is_ours = |file: &str| {
        let numbers = file.strip_prefix("view_").and_then(|rest| rest.strip_suffix(".exr"));
        numbers.and_then(|numbers| numbers.split_once('_')).is_some_and(|(row, col)| is_number(row) && is_number(col))
    };
    old.iter().filter(|file| is_ours(file) && !new.contains(file)).try_for_each(|file| {
        let path = folder.join(file);
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != ErrorKind::NotFound => Err(PipelineError::write(&path)(source)),
            _ => Ok(()),
        }
    })
}

/// Checks that save() may write this content into a folder. The name of a new folder must not have
/// the suffix of a file. An existing folder must not contain the other kind of content ([`Holds`]),
/// nor files of other programs with names that save() writes.
///
/// # Errors
/// SettingError for the suffix of a file, FileError for an existing folder with such content or
/// files.
pub(crate) fn check_free(py: Python<'_>, folder: &Path, holds: Holds) -> PyResult<()> {
    let suffix = folder.extension().map(|suffix| suffix.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if FILES.contains(&&*suffix) && !folder.exists() {
        let array = if holds == Holds::Views { ", or the name of a file that ends in .npy" } else { "" };
        let message = format!("{}: expected the name of a folder{array}, found the suffix .{suffix}", folder.display());
        return Err(setting(py, message));
    }
    let (others, what, found) = match holds {
        Holds::Views => {
            (vec![StackIndex::FILE.into(), format!("layers/{}", StackIndex::FILE)], "a light field", "patterns")
        }
        Holds::Patterns => (vec![INDEX.into()], "patterns", "a light field"),
    };
    if let Some(other) = others.iter().find(|other| folder.join(other).is_file()) {
        let message = format!(
            "{}: expected a free folder for {what}, found {found} ({other}); give another folder",
            folder.display()
        );
        return Err(exception(py, "FileError", &message));
    }
    // A folder that save() has completed contains an index. Without an index, these names belong to
    // another program or to a stopped save().
    let (index, names) = match holds {
        Holds::Views => (INDEX.to_owned(), vec!["view_00_00.exr", "view_000_000.exr"]),
        Holds::Patterns => (format!("layers/{}", StackIndex::FILE), vec!["display.toml", "layers"]),
    };
    let foreign = |name: &&str| !folder.join(&index).is_file() && is_full(&folder.join(name));
    if let Some(name) = names.into_iter().find(foreign) {
        let message = format!(
            "{}: expected a free folder for {what}, found `{name}` of another program, or of a save that was stopped; remove it, or give another folder",
            folder.display()
        );
        return Err(exception(py, "FileError", &message));
    }
    Ok(())
}

/// Returns true for a file, and for a folder that is not empty.
fn is_full(path: &Path) -> bool {
    path.is_file() || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some())
}

fn read(index: &Path) -> Option<Map<String, Value>> {
    serde_json::from_slice(&std::fs::read(index).ok()?).ok()
}
