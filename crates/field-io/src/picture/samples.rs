//! A decoded picture.

/// Pixel limit of one picture; a header with more is refused before memory is allocated.
pub(crate) const PIXEL_LIMIT: usize = 1 << 28;

/// One decoded picture, in the file's precision.
#[derive(Clone, Debug)]
pub struct Picture {
    pub(super) cols: usize,
    pub(super) rows: usize,
    pub(super) samples: Samples,
}

/// `[row][col][rgb]`.
#[derive(Clone, Debug)]
pub(super) enum Samples {
    /// sRGB code values.
    Srgb8(Vec<u8>),
    /// sRGB code values.
    Srgb16(Vec<u16>),
    /// Linear light.
    Linear(Vec<f32>),
}
