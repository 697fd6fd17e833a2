//! Single pictures as linear RGB: OpenEXR (linear), PNG, JPEG, WebP (sRGB-encoded), Radiance HDR
//! (linear).
//!
//! Alpha is composited over black, since a light field has no background.

mod encoded;
mod openexr;
mod samples;

use std::path::Path;
use std::sync::OnceLock;

use lumistack_core::colour;

use crate::FieldError;

pub use samples::Picture;
use samples::Samples;

pub use openexr::{MultiView, Precision, exr_bytes, write_exr, write_exr_channels, write_exr_noted};

impl Picture {
    /// Reads a picture. The extension `.exr` selects OpenEXR. Other formats are recognized by their
    /// first bytes, or else by the extension.
    ///
    /// # Errors
    /// If the format is unknown, or the file is damaged, truncated or too large.
    pub fn read(path: &Path) -> Result<Self, FieldError> {
        if is_exr(path) { openexr::read(path) } else { encoded::read(path) }
    }

    /// Reads an OpenEXR picture, and the text that [`write_exr_noted`] stored in its header. `None`
    /// if the header has no text.
    ///
    /// # Errors
    /// If the file is not an OpenEXR picture, or is damaged, truncated or too large.
    pub fn read_noted(path: &Path) -> Result<(Self, Option<String>), FieldError> {
        openexr::read_noted(path)
    }

    /// Reads [columns, rows] from the file's header.
    ///
    /// # Errors
    /// If the header is unreadable or unsupported, or declares too many pixels. For OpenEXR also if
    /// the file is too short for its pixels.
    pub fn size_of(path: &Path) -> Result<[usize; 2], FieldError> {
        if is_exr(path) { openexr::size(path) } else { encoded::size(path) }
    }

    /// Returns an upper bound of the memory that [`Self::read`] takes, in bytes, including the
    /// result.
    ///
    /// # Errors
    /// The errors of [`Self::size_of`].
    pub(crate) fn bytes_of(path: &Path) -> Result<u64, FieldError> {
        if is_exr(path) { openexr::bytes(path) } else { encoded::bytes(path) }
    }

    /// Returns [columns, rows].
    pub fn size(&self) -> [usize; 2] {
        [self.cols, self.rows]
    }

    /// Returns true if the picture has sRGB code values, which are clipped at white. Returns false
    /// if it has linear values: radiance, or decoded values that an alpha below 1 has darkened.
    pub fn is_encoded(&self) -> bool {
        !matches!(self.samples, Samples::Linear(_))
    }

    /// Returns all pixels, `[row][col][rgb]`, linear.
    pub fn into_linear(self) -> Vec<f32> {
        match self.samples {
            Samples::Linear(data) => data,
            _ => self.linear_part([0, 0], [self.cols, self.rows]),
        }
    }

    /// Returns the pixels of a rectangle, `[row][col][rgb]`, linear. `corner` is [column, row] of
    /// its top left pixel, and `size` is its [columns, rows].
    ///
    /// # Panics
    /// If the rectangle extends past the picture.
    pub fn linear_part(&self, corner: [usize; 2], size: [usize; 2]) -> Vec<f32> {
        assert!(corner[0] + size[0] <= self.cols && corner[1] + size[1] <= self.rows, "the part lies in the picture");
        let mut part = Vec::with_capacity(3 * size[0] * size[1]);
        for row in corner[1]..corner[1] + size[1] {
            let start = 3 * (row * self.cols + corner[0]);
            let range = start..start + 3 * size[0];
            match &self.samples {
                Samples::Srgb8(data) => part.extend(data[range].iter().map(|&code| linear_table8()[usize::from(code)])),
                Samples::Srgb16(data) => {
                    part.extend(data[range].iter().map(|&code| linear_table16()[usize::from(code)]));
                }
                Samples::Linear(data) => part.extend_from_slice(&data[range]),
            }
        }
        part
    }
}

/// Returns true if the extension belongs to a supported picture format.
pub(crate) fn has_picture_extension(path: &Path) -> bool {
    extension(path).is_some_and(|e| matches!(e.as_str(), "png" | "jpg" | "jpeg" | "webp" | "hdr" | "exr"))
}

pub(crate) fn extension(path: &Path) -> Option<String> {
    path.extension()?.to_str().map(str::to_ascii_lowercase)
}

fn is_exr(path: &Path) -> bool {
    extension(path).as_deref() == Some("exr")
}

fn linear_table8() -> &'static [f32] {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    TABLE.get_or_init(|| (0..=255u8).map(|code| colour::srgb_decode(f32::from(code) / 255.0)).collect())
}

fn linear_table16() -> &'static [f32] {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    TABLE.get_or_init(|| (0..=u16::MAX).map(|code| colour::srgb_decode(f32::from(code) / 65535.0)).collect())
}
