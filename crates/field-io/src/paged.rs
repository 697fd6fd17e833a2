//! Light fields larger than memory, in an unnamed file of which few pages are in memory. On Windows
//! the file has a name, no other program can open it, and the system removes it when it is closed.
//!
//! Views are written one by one. The finished light field is read like an array in memory. Arrays
//! of similar size that are computed from it can be stored in the same folder
//! ([`Tensor::storage`]).

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_core::pages::{Pages, Storage, Window};
use lumistack_core::{Lend, Tensor};
use lumistack_display::{FieldGeometry, LightField};
use memmap2::{Mmap, MmapMut};

use crate::FieldError;

/// Number of values that are converted to bytes together.
const PART: usize = 1 << 14;

/// A light field that is written view by view, into memory or into a file.
pub enum FieldWriter {
    /// The views are in memory.
    Held {
        /// Geometry of the light field.
        geometry: FieldGeometry,
        /// The views that have been written so far.
        values: Vec<f32>,
    },
    /// The views are in a file.
    Paged(Paged),
}

impl FieldWriter {
    /// Begins a light field. `place` is the folder for its file, and the number of the file's bytes
    /// that may be in memory. Without `place` the light field is kept in memory.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn begin(geometry: FieldGeometry, place: Option<(&Path, usize)>) -> Result<Self, FieldError> {
        match place {
            Some((folder, limit)) => Paged::begin(geometry, folder, limit).map(Self::Paged),
            None => {
                let count = LightField::shape_of(&geometry).iter().product();
                Ok(Self::Held { geometry, values: Vec::with_capacity(count) })
            }
        }
    }

    /// Returns the geometry of the light field.
    pub fn geometry(&self) -> &FieldGeometry {
        match self {
            Self::Held { geometry, .. } | Self::Paged(Paged { geometry, .. }) => geometry,
        }
    }

    /// Writes the next view in the order of the grid, `[row][col][rgb]`.
    ///
    /// # Errors
    /// If the disk is full.
    pub fn write(&mut self, view: &[f32]) -> Result<(), FieldError> {
        match self {
            Self::Held { values, .. } => values.extend_from_slice(view),
            Self::Paged(paged) => paged.write(view)?,
        }
        Ok(())
    }

    /// Returns the light field, once all views are written. Errors name a light field in memory by
    /// `path`, and a light field in a file by the file's folder.
    ///
    /// # Errors
    /// The errors of [`Paged::finish`].
    pub fn finish(self, path: &Path) -> Result<LightField, FieldError> {
        let (geometry, values) = match self {
            Self::Paged(paged) => return paged.finish(),
            Self::Held { geometry, values } => (geometry, values),
        };
        let shape = LightField::shape_of(&geometry);
        let radiance = Tensor::from_vec(LightField::AXES, shape, values)
            .map_err(|error| FieldError::malformed(path, "size", format!("{shape:?}"), error.to_string()))?;
        LightField::new(geometry, radiance).map_err(FieldError::geometry(path))
    }
}

/// A light field that is written view by view to a file.
pub struct Paged {
    geometry: FieldGeometry,
    file: BufWriter<File>,
    /// Folder on whose disk the file is.
    folder: PathBuf,
    /// Largest number of bytes of the file that may be in memory.
    limit: usize,
    bytes: Vec<u8>,
}

impl Paged {
    /// Creates the file on the disk of a folder. `limit` is the largest number of bytes of the
    /// finished light field that may be in memory. The same limit applies to each array that is
    /// stored in the same folder.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn begin(geometry: FieldGeometry, folder: &Path, limit: usize) -> Result<Self, FieldError> {
        let file = tempfile::tempfile_in(folder).map_err(FieldError::io(folder, "write"))?;
        let bytes = Vec::with_capacity(4 * PART);
        Ok(Self { geometry, file: BufWriter::new(file), folder: folder.to_owned(), limit, bytes })
    }

    /// Writes the next view in the order of the grid, `[row][col][rgb]`.
    ///
    /// # Errors
    /// If the disk is full.
    pub fn write(&mut self, view: &[f32]) -> Result<(), FieldError> {
        for part in view.chunks(PART) {
            self.bytes.clear();
            self.bytes.extend(part.iter().flat_map(|value| value.to_ne_bytes()));
            self.file.write_all(&self.bytes).map_err(FieldError::io(&self.folder, "write"))?;
        }
        Ok(())
    }

    /// Returns the light field, once all views are written.
    ///
    /// # Errors
    /// If the disk is full, the file cannot be mapped, or views are missing.
    pub fn finish(self) -> Result<LightField, FieldError> {
        let Self { geometry, file, folder, limit, .. } = self;
        let failed = |error| FieldError::io(&folder, "write")(error);
        let file = file.into_inner().map_err(|error| failed(error.into_error()))?;
        // SAFETY: no other process can open the file, so none writes it
        let map = unsafe { Mmap::map(&file) }.map_err(failed)?;
        // SAFETY: the shared mapping covers the whole file, and lives as long as the window
        let window = unsafe { Window::new(&map, limit) };
        let values = Mapped { map, window, storage: storage(&folder, limit) };
        let radiance = Tensor::lent(LightField::AXES, LightField::shape_of(&geometry), Arc::new(values));
        let radiance =
            radiance.map_err(|error| FieldError::malformed(&folder, "light field", "all views", error.to_string()))?;
        LightField::new(geometry, radiance).map_err(FieldError::geometry(&folder))
    }
}

/// Returns a [`Storage`] that keeps each array in an unnamed temporary file in `folder`. At most
/// `limit` bytes of each array are in memory.
pub fn storage(folder: &Path, limit: usize) -> Storage {
    let folder = folder.to_owned();
    Arc::new(move |bytes| {
        let mut file = tempfile::tempfile_in(&folder)?;
        // Write zeros, so that a full disk is an error here. Without them, a later write into the
        // mapping would crash the program.
        io::copy(&mut io::repeat(0).take(bytes as u64), &mut file)?;
        // SAFETY: no other process can open the file, so none writes it
        let map = unsafe { MmapMut::map_mut(&file) }?;
        // SAFETY: the shared mapping covers the whole file
        Ok(unsafe { Pages::new(Box::new(map), limit) })
    })
}

/// Values in a mapped file.
struct Mapped {
    map: Mmap,
    window: Window,
    storage: Storage,
}

impl Lend for Mapped {
    fn values(&self) -> &[f32] {
        // SAFETY: a map begins at a page, and all bit patterns are valid numbers
        unsafe { self.map.align_to::<f32>().1 }
    }

    fn window(&self) -> Option<&Window> {
        Some(&self.window)
    }

    fn storage(&self) -> Option<&Storage> {
        Some(&self.storage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::pages::Array;
    use lumistack_display::{Projection, ViewGrid};

    #[test]
    fn views_are_found_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let grid = ViewGrid::uniform(Projection::Oblique, [3, 2], [20.0, 20.0]).unwrap();
        let geometry = FieldGeometry { rows: 70, cols: 90, pitch_mm: 1.0, grid };
        // the limit is smaller than one view, so pages are released between views
        let mut paged = Paged::begin(geometry.clone(), folder.path(), 1 << 14).unwrap();
        let value = |view: [usize; 2], i: usize| (i + 7919 * view[0] + 104_729 * view[1]) as f32;
        for view in geometry.grid.iter() {
            let picture: Vec<f32> = (0..70 * 90 * 3).map(|i| value(view, i)).collect();
            paged.write(&picture).unwrap();
        }
        let field = paged.finish().unwrap();
        for view in geometry.grid.iter() {
            assert!(field.view(view).iter().enumerate().all(|(i, found)| *found == value(view, i)), "{view:?}");
        }
        let count = || std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(count(), usize::from(cfg!(windows)), "the file has a name on Windows only");
        drop(field);
        assert_eq!(count(), 0, "the file is removed with the light field");
        let unfinished = Paged::begin(geometry, folder.path(), 1 << 14).unwrap();
        assert!(unfinished.finish().is_err(), "no views");
    }

    #[test]
    fn released_pages_keep_their_values() {
        let folder = tempfile::tempdir().unwrap();
        let (count, part) = (1 << 20, 1 << 12);
        let mut array = Array::<f32>::zeros(count, Some(&storage(folder.path(), 1 << 16))).unwrap();
        let (values, window) = array.all_mut();
        assert!(values.len() == count && values.iter().all(|value| *value == 0.0));
        for (number, values) in values.chunks_mut(part).enumerate() {
            window.unwrap().announce(size_of_val(values));
            values.fill(number as f32);
        }
        for number in 0..count / part {
            let values = array.part(number * part..(number + 1) * part);
            assert!(values.iter().all(|value| *value == number as f32), "part {number}");
        }
    }
}
