//! Light fields that are larger than memory, in an unnamed file whose pages the system reads on
//! demand.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_core::Tensor;
use lumistack_display::{FieldGeometry, LightField};
use memmap2::Mmap;

use crate::error::PipelineError;

/// Number of values that are converted to bytes at a time.
const PART: usize = 1 << 14;

/// A light field that is written view by view to a file.
pub(crate) struct Paged {
    geometry: FieldGeometry,
    file: BufWriter<File>,
    /// Folder of the file, for messages.
    folder: PathBuf,
    bytes: Vec<u8>,
}

impl Paged {
    /// Creates the file on the disk of a folder.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub(crate) fn begin(geometry: FieldGeometry, folder: &Path) -> Result<Self, PipelineError> {
        let file = tempfile::tempfile_in(folder).map_err(PipelineError::write(folder))?;
        Ok(Self {
            geometry,
            file: BufWriter::new(file),
            folder: folder.to_owned(),
            bytes: Vec::with_capacity(4 * PART),
        })
    }

    /// Writes the next view in the order of the grid, `[row][col][rgb]`.
    ///
    /// # Errors
    /// If the disk is full.
    pub(crate) fn write(&mut self, view: &[f32]) -> Result<(), PipelineError> {
        for part in view.chunks(PART) {
            self.bytes.clear();
            self.bytes.extend(part.iter().flat_map(|value| value.to_ne_bytes()));
            self.file.write_all(&self.bytes).map_err(PipelineError::write(&self.folder))?;
        }
        Ok(())
    }

    /// Returns the light field, after all views are written.
    ///
    /// # Errors
    /// If the disk is full, or the file cannot be mapped.
    pub(crate) fn finish(self) -> Result<LightField, PipelineError> {
        let Self { geometry, file, folder, .. } = self;
        let file = file.into_inner().map_err(|error| PipelineError::write(&folder)(error.into_error()))?;
        // SAFETY: the file has no name, so no other process writes it
        let values = Mapped(unsafe { Mmap::map(&file) }.map_err(PipelineError::write(&folder))?);
        let [views_y, views_x] = geometry.grid.views();
        let shape = [views_y, views_x, geometry.rows, geometry.cols, 3];
        let radiance = Tensor::lent(LightField::AXES, shape, Arc::new(values));
        let radiance = radiance
            .map_err(|error| PipelineError::value(&folder, "light field", "all of its views", error.to_string()))?;
        Ok(LightField::new(geometry, radiance)?)
    }
}

/// Values in a mapped file.
struct Mapped(Mmap);

impl AsRef<[f32]> for Mapped {
    fn as_ref(&self) -> &[f32] {
        // SAFETY: a map begins at a page, and all bit patterns are valid numbers
        unsafe { self.0.align_to::<f32>().1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_display::{Projection, ViewGrid};

    #[test]
    fn views_are_found_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let grid = ViewGrid::uniform(Projection::Oblique, [3, 2], [20.0, 20.0]).unwrap();
        let geometry = FieldGeometry { rows: 70, cols: 90, pitch_mm: 1.0, grid };
        let mut paged = Paged::begin(geometry.clone(), folder.path()).unwrap();
        let value = |view: [usize; 2], i: usize| (i + 7919 * view[0] + 104_729 * view[1]) as f32;
        for view in geometry.grid.iter() {
            let picture: Vec<f32> = (0..70 * 90 * 3).map(|i| value(view, i)).collect();
            paged.write(&picture).unwrap();
        }
        let field = paged.finish().unwrap();
        for view in geometry.grid.iter() {
            assert!(field.view(view).iter().enumerate().all(|(i, found)| *found == value(view, i)), "{view:?}");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the file has no name");
        let unfinished = Paged::begin(geometry, folder.path()).unwrap();
        assert!(unfinished.finish().is_err(), "no views");
    }
}
