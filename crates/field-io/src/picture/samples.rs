//! A decoded picture.

/// Largest number of pixels of a picture. A header with more is refused before memory is allocated.
pub(crate) const PIXEL_LIMIT: usize = 1 << 28;

/// One decoded picture, in the file's precision.
#[derive(Clone, Debug)]
pub struct Picture {
    pub(super) cols: usize,
    pub(super) rows: usize,
    pub(super) samples: Samples,
}

/// Values of a picture, `[row][col][rgb]`.
#[derive(Clone, Debug)]
pub(super) enum Samples {
    /// sRGB code values 0..255.
    Srgb8(Vec<u8>),
    /// sRGB code values 0..65535.
    Srgb16(Vec<u16>),
    /// Linear light.
    Linear(Vec<f32>),
}
