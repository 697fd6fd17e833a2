//! A decoded picture.

/// Most pixels of one picture; a header that claims more is refused before memory is taken.
pub(crate) const PIXEL_LIMIT: usize = 1 << 28;

/// One decoded picture, as compact as its file had it.
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
