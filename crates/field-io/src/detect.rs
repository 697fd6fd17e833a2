//! Detects the kind of a light field.

use std::path::{Path, PathBuf};

use lumistack_core::Task;

use crate::geometry::GeometryFlags;
use crate::picture::{extension, has_picture_extension};
use crate::source::Source;
use crate::{FieldError, array, cameras, folder, hci, quilt};

/// Opens a light field without reading its pictures: headers, sizes and indices are checked.
pub(crate) fn detect(path: &Path, flags: &GeometryFlags, task: Task<'_>) -> Result<Source, FieldError> {
    if lumistack_files::is_folder(path).map_err(FieldError::io(path, "read"))? {
        return detect_folder(path, flags, task);
    }
    if path.file_name().is_some_and(|name| name == folder::INDEX) {
        return folder::source(path.parent().unwrap_or(Path::new(".")));
    }
    if extension(path).as_deref() == Some("npy") {
        return array::source(path, task);
    }
    if has_picture_extension(path) {
        return quilt::source(path, flags);
    }
    let found = path.extension().map_or("a file without extension".into(), |e| format!(".{}", e.to_string_lossy()));
    Err(FieldError::malformed(
        path,
        "kind of file",
        "a light field: .npy, lightfield.json or a picture of tiles",
        found,
    ))
}

fn detect_folder(path: &Path, flags: &GeometryFlags, task: Task<'_>) -> Result<Source, FieldError> {
    for candidate in [path.to_path_buf(), path.join("target")] {
        if lumistack_files::is_file(&candidate.join(folder::INDEX)) {
            return folder::source(&candidate);
        }
    }
    if let Some(source) = hci::source(path, task)? {
        return Ok(source);
    }
    if let Some(source) = cameras::source(path, task)? {
        return Ok(source);
    }
    let pictures = cameras::pictures(path)?;
    let arrays = arrays(path)?;
    let quilts: Vec<&PathBuf> = pictures.iter().filter(|file| quilt::layout_of(file).is_some()).collect();
    match (&arrays[..], &quilts[..], &pictures[..]) {
        ([array], _, _) => array::source(array, task),
        ([], [quilt], _) => quilt::source(quilt, flags),
        ([], [], [picture]) => quilt::source(picture, flags),
        _ => {
            let expected = "a light field: lightfield.json, pictures named NAME_RR_CC_Y_X, RR_CC or input_Cam000, a quilt, or one .npy";
            let found = match (pictures.len(), arrays.len()) {
                (0, 0) => "neither pictures nor arrays".into(),
                (pictures, 0) => format!("several quilts, or pictures with other names (pictures: {pictures})"),
                (pictures, arrays) => {
                    format!("several files (arrays: {arrays}, pictures: {pictures}); give the path of one of them")
                }
            };
            Err(FieldError::malformed(path, "content of the folder", expected, found))
        }
    }
}

fn arrays(folder: &Path) -> Result<Vec<PathBuf>, FieldError> {
    let mut files = lumistack_files::list(folder).map_err(FieldError::io(folder, "list the folder"))?;
    files.retain(|file| extension(file).as_deref() == Some("npy"));
    Ok(files)
}
