//! Rows of the target in their stored form.

use std::ops::Range;

use crate::factor::PAD;

/// One row of L.
#[derive(Clone, Copy)]
pub enum Row<'a> {
    /// Half floats.
    Half(&'a [u16]),
    /// Floats.
    Float(&'a [f32]),
}

impl<'a> Row<'a> {
    /// Returns a range of columns of a padded row.
    #[inline(always)]
    pub(crate) fn part(self, cols: Range<usize>) -> Self {
        let part = PAD + cols.start..PAD + cols.end;
        match self {
            Self::Half(row) => Self::Half(&row[part]),
            Self::Float(row) => Self::Float(&row[part]),
        }
    }
}

/// A coarse pixel as a mean over three neighbouring fine pixels: the index of the first fine pixel,
/// and the share of each fine pixel.
pub(crate) type Cover = (usize, [f32; 3]);

/// A row to be written.
pub(crate) enum RowMut<'a> {
    Half(&'a mut [u16]),
    Float(&'a mut [f32]),
}
