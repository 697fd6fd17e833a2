//! NumPy's archives: `.npz`, arrays of little-endian `float32` in an uncompressed ZIP file.
//!
//! An archive is written front to back, some values at a time. So writing needs no seeking, and
//! memory does not grow with the arrays. Equal values produce equal bytes.

use std::io::{self, Write};

use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::npy;

/// An array of this many bytes or more is written with ZIP's 64-bit sizes.
const LARGE: u64 = 1 << 31;

/// An archive in progress.
pub struct NpzWriter<W: Write> {
    zip: ZipWriter<StreamWriter<W>>,
    /// Number of values that the current array still lacks.
    missing: usize,
}

impl<W: Write> NpzWriter<W> {
    /// Begins an empty archive.
    pub fn new(writer: W) -> Self {
        Self { zip: ZipWriter::new_stream(writer), missing: 0 }
    }

    /// Begins an array; calls of [`values`](Self::values) write its values.
    ///
    /// # Errors
    /// If writing fails.
    ///
    /// # Panics
    /// If the previous array is incomplete.
    pub fn array(&mut self, name: &str, shape: &[usize]) -> io::Result<()> {
        self.check_complete();
        self.missing = shape.iter().product();
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .large_file(4 * self.missing as u64 >= LARGE);
        self.zip.start_file(npyz::npz::file_name_from_array_name(name), options).map_err(io::Error::from)?;
        npy::write_header(&mut self.zip, shape)
    }

    /// Writes the next values of the array, in row-major order.
    ///
    /// # Errors
    /// If writing fails.
    ///
    /// # Panics
    /// If there are more values than the array's shape has.
    pub fn values(&mut self, values: &[f32]) -> io::Result<()> {
        self.missing = self.missing.checked_sub(values.len()).expect("no more values than the shape has");
        npy::write_values(&mut self.zip, values)
    }

    /// Completes the archive.
    ///
    /// # Errors
    /// If writing fails.
    ///
    /// # Panics
    /// If the last array is incomplete.
    pub fn finish(self) -> io::Result<()> {
        self.check_complete();
        self.zip.finish().map(drop).map_err(io::Error::from)
    }

    fn check_complete(&self) {
        assert_eq!(self.missing, 0, "values fill the shape");
    }
}
