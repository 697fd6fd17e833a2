//! Rows of the target, as they are kept.

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
    /// Some columns.
    #[inline(always)]
    pub(crate) fn part(self, cols: Range<usize>) -> Self {
        let part = PAD + cols.start..PAD + cols.end;
        match self {
            Self::Half(row) => Self::Half(&row[part]),
            Self::Float(row) => Self::Float(&row[part]),
        }
    }
}

/// The first of three pixels next to each other, and the share of each in a mean.
pub(crate) type Cover = (usize, [f32; 3]);

/// A row that is written.
pub(crate) enum RowMut<'a> {
    Half(&'a mut [u16]),
    Float(&'a mut [f32]),
}
