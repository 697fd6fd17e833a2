//! Opens a light field of any kind.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, LightField};

use crate::FieldError;
use crate::assemble::{LeftOut, assemble, plan};
use crate::detect::detect;
use crate::geometry::{GeometryDefaults, GeometryFlags};
use crate::prefilter::Footprint;

/// Reads a light field of any kind.
///
/// The path is a folder with `lightfield.json`, the folder of a run, or a `.npy` file with or
/// without a `.json` of the same name. It may also be a quilt, a picture of tiles, or a folder of
/// pictures. Such pictures are named as in the Stanford archive, as in the HCI benchmark, or
/// `RR_CC.png`.
///
/// # Errors
/// If the path is of another kind, a file is damaged, views differ in size, values are not finite,
/// or the geometry is incomplete.
pub fn open(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    task: Task<'_>,
) -> Result<LightField, FieldError> {
    open_for(path, flags, defaults, None, 0, task).map(|(field, _)| field)
}

/// Reads a light field as [`open`] does, for a display. With [`GeometryFlags::prefilter`] every
/// kept view is averaged with its neighbours over the display's footprint. Also returns up to
/// `most_left_out` views between the kept ones.
///
/// # Errors
/// The errors of [`open`], and if a prefilter is requested without a footprint.
pub fn open_for(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    footprint: Option<Footprint<'_>>,
    most_left_out: usize,
    task: Task<'_>,
) -> Result<(LightField, Vec<LeftOut>), FieldError> {
    let mut source = detect(path, flags, task)?;
    source.mirror(flags.mirror);
    assemble(&mut source, flags, defaults, footprint, most_left_out, task)
}

/// The geometry of the light field that [`open`] would return, without reading all pictures.
///
/// # Errors
/// The errors of [`open`], except those of pixel values.
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
