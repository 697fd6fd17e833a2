//! Opens a light field of any kind.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, LightField};

use crate::FieldError;
use crate::assemble::{LeftOut, Reading, assemble, plan};
use crate::detect::detect;
use crate::geometry::{GeometryDefaults, GeometryFlags};
use crate::picture::{Picture, has_picture_extension};

/// Reads a light field of any kind.
///
/// The path is a folder with `lightfield.json`, the folder of a run, or a `.npy` file with or
/// without a `.json` of the same name. It may also be a quilt, a picture of tiles, a folder with
/// one of these files, or a folder with a picture per view. The pictures of views are named as in
/// the Stanford archive, as in the HCI benchmark, or `RR_CC.png`.
///
/// # Errors
/// If the path is of another kind, a file is damaged, views differ in size, or the geometry is
/// incomplete. Also if values are not finite, or too large for half floats.
pub fn open(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    task: Task<'_>,
) -> Result<LightField, FieldError> {
    open_for(path, flags, defaults, Reading::default(), task).map(|(field, _)| field)
}

/// Does the same as [`open`], for a display. With [`GeometryFlags::prefilter`] every kept view is
/// averaged with its neighbours over the display's footprint. Also returns views between the kept
/// ones, at most [`Reading::most_left_out`].
///
/// # Errors
/// The errors of [`open`]. Also if a prefilter is requested without a footprint, or if the file of
/// a large light field cannot be written.
pub fn open_for(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    reading: Reading<'_>,
    task: Task<'_>,
) -> Result<(LightField, Vec<LeftOut>), FieldError> {
    let mut source = detect(path, flags, task)?;
    source.mirror(flags.mirror);
    assemble(&mut source, flags, defaults, reading, task)
}

/// Returns the geometry of the light field that [`open`] would return, without reading all
/// pictures.
///
/// # Errors
/// The errors of [`open`], except errors of pixel values.
pub fn geometry_of(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    task: Task<'_>,
) -> Result<FieldGeometry, FieldError> {
    let mut source = detect(path, flags, task)?;
    source.mirror(flags.mirror);
    plan(&mut source, flags, defaults, task).map(|plan| plan.geometry)
}

/// Returns an upper bound of the memory, in bytes, that a light field's decoded picture takes while
/// the views are read. The result is 0 unless the path is a picture, which then contains all views.
pub fn picture_bytes(path: &Path) -> u64 {
    let is_picture = path.is_file() && has_picture_extension(path);
    let bytes = is_picture.then(|| Picture::bytes_of(path).ok()).flatten();
    bytes.unwrap_or(0)
}
