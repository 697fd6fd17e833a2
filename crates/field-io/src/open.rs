//! A light field of any kind from a path.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, LightField};

use crate::FieldError;
use crate::assemble::{LeftOut, assemble, plan};
use crate::detect::detect;
use crate::geometry::{GeometryDefaults, GeometryFlags};
use crate::prefilter::Footprint;

/// Reads a light field of any kind:
///
/// * our folder (or a run's folder),
/// * `.npy` with or without a `.json` beside it,
/// * a folder of pictures as in the Stanford archive, the HCI benchmark or `RR_CC.png`,
/// * a quilt, a picture of tiles.
///
/// # Errors
/// If the path is none of these, a file is damaged, views differ in size, values are not finite, or
/// the geometry is incomplete.
pub fn open(
    path: &Path,
    flags: &GeometryFlags,
    defaults: &GeometryDefaults,
    task: Task<'_>,
) -> Result<LightField, FieldError> {
    open_for(path, flags, defaults, None, 0, task).map(|(field, _)| field)
}

/// As [`open`], for a display: with [`GeometryFlags::prefilter`] every view that is kept is
/// averaged with those around it over the display's footprint. Gives `most_left_out` views at most
/// of those between the kept ones, too.
///
/// # Errors
/// As [`open`], and when a prefilter is requested without a footprint.
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

/// The geometry that [`open`] would give a light field, without reading all of its pictures.
///
/// # Errors
/// As [`open`], as far as no values are needed.
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
