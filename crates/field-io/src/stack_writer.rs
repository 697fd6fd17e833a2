//! Writes a stack region by region, so that the whole stack is never in memory.

use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use lumistack_core::bytes::append;
use lumistack_display::{Display, LayerStack, Region, StackIndex};
use tempfile::NamedTempFile;

use crate::index::write_json;
use crate::{FieldError, atomic, npy};

/// A stack that is being written. Its files appear when [`finish`](Self::finish) is called. A
/// writer that is dropped without this call leaves no files.
#[derive(Debug)]
pub struct StackWriter {
    folder: PathBuf,
    index: StackIndex,
    /// The arrays of the layers from rear to front, then the array of the backlight if there is
    /// one.
    arrays: Vec<Array>,
}

/// An array `[plane...][row][col][rgb]` that is being written.
#[derive(Debug)]
struct Array {
    path: PathBuf,
    file: NamedTempFile,
    /// Number of bytes of the file in front of the array's values.
    header: u64,
    rows: usize,
    cols: usize,
}

impl StackWriter {
    /// Begins a display's stack in a folder, which is created if missing. Pixels that are never
    /// written are 0.
    ///
    /// # Errors
    /// If the folder or a file cannot be created.
    pub fn begin(folder: &Path, display: &Display) -> Result<Self, FieldError> {
        let index = StackIndex::of_display(display);
        atomic::create_folder(folder)?;
        let mut arrays = Vec::new();
        for (n, entry) in index.layers.iter().enumerate() {
            arrays.push(Array::begin(folder.join(&entry.file), &LayerStack::layer_shape(display, n))?);
        }
        if let Some(shape) = LayerStack::emission_shape(display) {
            arrays.push(Array::begin(folder.join(StackIndex::EMISSION), &shape)?);
        }
        Ok(Self { folder: folder.to_owned(), index, arrays })
    }

    /// Writes one region of each layer, and of the lenslets if there are any. `part` has the
    /// values. `regions` has one region for each array of `part`: the layers from rear to front,
    /// then the lenslets.
    ///
    /// # Errors
    /// If the disk is full or fails.
    pub fn write(&mut self, regions: &[Region], part: &LayerStack) -> Result<(), FieldError> {
        let layers = part.layers.iter().map(|layer| layer.data());
        let values = layers.chain(part.emission.iter().map(|emission| emission.data()));
        for ((array, region), values) in self.arrays.iter_mut().zip(regions).zip(values) {
            array.write(region, values).map_err(FieldError::io(&array.path, "write"))?;
        }
        Ok(())
    }

    /// Publishes the files, the index last.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn finish(self) -> Result<(), FieldError> {
        atomic::remove(&self.folder.join(StackIndex::FILE))?;
        for array in self.arrays {
            atomic::publish(array.file, &array.path).map_err(FieldError::io(&array.path, "write"))?;
        }
        if self.index.backlight.is_none() {
            atomic::remove(&self.folder.join(StackIndex::EMISSION))?;
        }
        write_json(&self.folder.join(StackIndex::FILE), &self.index)
    }
}

impl Array {
    fn begin(path: PathBuf, shape: &[usize]) -> Result<Self, FieldError> {
        let begin = || {
            let mut file = atomic::temporary_beside(path.parent().unwrap_or(Path::new(".")))?;
            // the lock marks the file as in use; see `atomic::is_abandoned`
            let _ = file.as_file().try_lock();
            npy::write_header(file.as_file_mut(), shape)?;
            let header = file.as_file_mut().stream_position()?;
            let values: usize = shape.iter().product();
            file.as_file().set_len(header + 4 * values as u64)?;
            Ok((file, header))
        };
        let (file, header) = begin().map_err(FieldError::io(&path, "write"))?;
        let [.., rows, cols, _] = *shape else { unreachable!("patterns have rows and columns") };
        Ok(Self { path, file, header, rows, cols })
    }

    fn write(&mut self, region: &Region, values: &[f32]) -> std::io::Result<()> {
        let [rows, cols] = region.size();
        if region.is_empty() {
            return Ok(());
        }
        let mut bytes = Vec::with_capacity(12 * cols);
        for (number, line) in values.chunks_exact(3 * cols).enumerate() {
            let (plane, row) = (number / rows, number % rows + region.rows.start);
            let pixel = (plane * self.rows + row) * self.cols + region.cols.start;
            bytes.clear();
            append(&mut bytes, line);
            let file = self.file.as_file_mut();
            file.seek(SeekFrom::Start(self.header + 12 * pixel as u64))?;
            file.write_all(&bytes)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DISPLAY: &str = r#"
        schema = "lumistack/display"
        version = 1
        name = "small"
        frames = 2
        [field]
        resolution = [18, 11]
        pitch_mm = 1.0
        views = [3, 3]
        fov_deg = [20.0, 20.0]
        [[layers]]
        d_mm = -2.0
        resolution = [18, 11]
        pitch_mm = 1.0
        [[layers]]
        d_mm = 3.0
        resolution = [30, 17]
        pitch_mm = 0.6
        [backlight]
        kind = "lenslets"
        d_mm = -6.0
        lenslets = [6, 4]
        pitch_mm = 3.0
        fov_deg = [20.0, 20.0]
        views = [3, 3]
    "#;

    #[test]
    fn parts_make_the_files_of_the_whole() {
        let display = Display::from_toml(DISPLAY).unwrap();
        let mut stack = LayerStack::filled(&display, 0.0);
        let parts = stack.layers.iter_mut().map(|layer| layer.data_mut());
        for values in parts.chain(stack.emission.iter_mut().map(|emission| emission.data_mut())) {
            values.iter_mut().enumerate().for_each(|(i, value)| *value = (i % 997) as f32 / 997.0);
        }
        let folder = tempfile::tempdir().unwrap();
        let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
        crate::write_stack(&whole, &display, &stack).unwrap();
        let geometry = display.geometry().unwrap();
        let tiling = lumistack_display::Tiling::new(&display, &geometry, [3, 2]);
        let mut writer = StackWriter::begin(&parts, &display).unwrap();
        for number in (0..tiling.count()).rev() {
            let own: Vec<Region> = tiling.tile(number).parts.into_iter().map(|part| part.own).collect();
            writer.write(&own, &stack.cut(&own)).unwrap();
        }
        assert!(!parts.join("stack.json").exists(), "the index appears only when the stack is finished");
        writer.finish().unwrap();
        let files = |folder: &Path| {
            let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
            files.sort();
            files
                .iter()
                .map(|path| (path.file_name().unwrap().to_owned(), std::fs::read(path).unwrap()))
                .collect::<Vec<_>>()
        };
        assert!(files(&whole) == files(&parts) && files(&whole).len() > 2);
        drop(StackWriter::begin(&folder.path().join("dropped"), &display).unwrap());
        assert!(files(&folder.path().join("dropped")).is_empty());
    }
}
