//! Dense row-major `f32` tensors whose axes carry names.
//!
//! Error messages and file headers contain the names (`view_y`, `row`, `rgb`, ...), so that a
//! swapped axis is visible immediately.

use std::sync::Arc;

use thiserror::Error;

use crate::pages::{Storage, Window};

/// Dense row-major tensor of order `N`; the last axis is contiguous. The tensor owns its values, or
/// another owner has [lent](Tensor::lent) them.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor<const N: usize> {
    axes: [&'static str; N],
    shape: [usize; N],
    data: Values,
}

/// A shared owner of values that tensors use without a copy, such as an array of Python.
pub type Lender = Arc<dyn Lend>;

/// The owner of lent values.
pub trait Lend: Send + Sync {
    /// Returns all values, row-major.
    fn values(&self) -> &[f32];

    /// Returns the window that limits the bytes in memory, if the values are in a file.
    fn window(&self) -> Option<&Window> {
        None
    }

    /// Returns the storage in which callers create arrays of similar size, if the values themselves
    /// are in a file.
    fn storage(&self) -> Option<&Storage> {
        None
    }
}

impl<T: AsRef<[f32]> + Send + Sync> Lend for T {
    fn values(&self) -> &[f32] {
        self.as_ref()
    }
}

#[derive(Clone)]
enum Values {
    Own(Vec<f32>),
    Lent(Lender),
}

impl Values {
    #[inline]
    fn as_slice(&self) -> &[f32] {
        match self {
            Self::Own(values) => values,
            Self::Lent(lender) => lender.values(),
        }
    }
}

impl std::fmt::Debug for Values {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.as_slice().fmt(f)
    }
}

impl PartialEq for Values {
    fn eq(&self, other: &Self) -> bool {
        self.as_slice() == other.as_slice()
    }
}

/// The error of data whose length or shape does not fit the axes.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("axes {axes} of shape {expected} need {count} values, found {found}")]
pub struct ShapeError {
    axes: String,
    expected: String,
    count: String,
    found: usize,
}

impl<const N: usize> Tensor<N> {
    /// Makes a tensor filled with one value.
    ///
    /// # Panics
    /// If the number of elements overflows `usize`; check untrusted shapes with
    /// [`Tensor::from_vec`] or [`element_count`](Self::element_count) first.
    pub fn filled(axes: [&'static str; N], shape: [usize; N], value: f32) -> Self {
        let count = Self::element_count(shape).expect("tensor size fits in memory");
        Self { axes, shape, data: Values::Own(vec![value; count]) }
    }

    /// Makes a tensor of zeros.
    pub fn zeros(axes: [&'static str; N], shape: [usize; N]) -> Self {
        Self::filled(axes, shape, 0.0)
    }

    /// Takes ownership of row-major data.
    ///
    /// # Errors
    /// If `data.len()` is not the product of `shape`.
    pub fn from_vec(axes: [&'static str; N], shape: [usize; N], data: Vec<f32>) -> Result<Self, ShapeError> {
        Self::with_values(axes, shape, Values::Own(data))
    }

    /// Uses row-major data where it is, without a copy. The first write to the tensor copies the
    /// data.
    ///
    /// # Errors
    /// If the number of values is not the product of `shape`.
    pub fn lent(axes: [&'static str; N], shape: [usize; N], lender: Lender) -> Result<Self, ShapeError> {
        Self::with_values(axes, shape, Values::Lent(lender))
    }

    fn with_values(axes: [&'static str; N], shape: [usize; N], data: Values) -> Result<Self, ShapeError> {
        let found = data.as_slice().len();
        if Self::element_count(shape) == Some(found) {
            Ok(Self { axes, shape, data })
        } else {
            Err(ShapeError {
                axes: format!("[{}]", axes.join("][")),
                expected: format!("{shape:?}"),
                count: Self::element_count(shape).map_or("too many".into(), |n| n.to_string()),
                found,
            })
        }
    }

    /// Returns the number of elements of a shape; `None` if the number overflows.
    pub fn element_count(shape: [usize; N]) -> Option<usize> {
        shape.iter().try_fold(1usize, |product, &n| product.checked_mul(n))
    }

    /// Returns the names of the axes, outermost first.
    pub fn axes(&self) -> [&'static str; N] {
        self.axes
    }

    /// Returns the lengths of the axes, outermost first.
    pub fn shape(&self) -> [usize; N] {
        self.shape
    }

    /// Returns all values, row-major.
    #[inline]
    pub fn data(&self) -> &[f32] {
        self.data.as_slice()
    }

    /// Returns the values of a range, row-major. If the values are in a file, only parts of the
    /// file are in memory. So callers read a large tensor in parts.
    #[inline]
    pub fn part(&self, range: std::ops::Range<usize>) -> &[f32] {
        if let Some(window) = self.lender().and_then(|lender| lender.window()) {
            window.announce(size_of_val(&self.data()[range.clone()]));
        }
        &self.data()[range]
    }

    /// Returns the storage in which callers create arrays of similar size, if the values themselves
    /// are in a file.
    pub fn storage(&self) -> Option<&Storage> {
        self.lender()?.storage()
    }

    #[inline]
    fn lender(&self) -> Option<&Lender> {
        match &self.data {
            Values::Own(_) => None,
            Values::Lent(lender) => Some(lender),
        }
    }

    /// Returns all values, row-major, writable.
    pub fn data_mut(&mut self) -> &mut [f32] {
        if let Values::Lent(lender) = &self.data {
            self.data = Values::Own(lender.values().to_vec());
        }
        match &mut self.data {
            Values::Own(values) => values,
            Values::Lent(_) => unreachable!("lent values have just been copied"),
        }
    }

    /// Returns the values; lent ones are copied.
    pub fn into_data(self) -> Vec<f32> {
        match self.data {
            Values::Own(values) => values,
            Values::Lent(lender) => lender.values().to_vec(),
        }
    }

    /// Returns the offset of an element in [`data`](Self::data).
    #[inline]
    pub fn offset(&self, index: [usize; N]) -> usize {
        let mut offset = 0;
        for axis in 0..N {
            debug_assert!(index[axis] < self.shape[axis], "{} {index:?} of {:?}", self.axes[axis], self.shape);
            offset = offset * self.shape[axis] + index[axis];
        }
        offset
    }

    /// Returns one value.
    #[inline]
    pub fn get(&self, index: [usize; N]) -> f32 {
        self.data()[self.offset(index)]
    }

    /// Returns one value, writable.
    #[inline]
    pub fn at_mut(&mut self, index: [usize; N]) -> &mut f32 {
        let offset = self.offset(index);
        &mut self.data_mut()[offset]
    }

    /// Returns the contiguous block under the first `K` indices: `tensor.block([m, n])` of a tensor
    /// of order 5 is a slice that holds the last three axes.
    pub fn block<const K: usize>(&self, outer: [usize; K]) -> &[f32] {
        self.part(self.block_range(outer))
    }

    /// Returns the same as [`block`](Self::block), with writable values.
    pub fn block_mut<const K: usize>(&mut self, outer: [usize; K]) -> &mut [f32] {
        let range = self.block_range(outer);
        &mut self.data_mut()[range]
    }

    fn block_range<const K: usize>(&self, outer: [usize; K]) -> std::ops::Range<usize> {
        const { assert!(K <= N) }
        let inner: usize = self.shape[K..].iter().product();
        let mut index = 0;
        for axis in 0..K {
            assert!(outer[axis] < self.shape[axis], "{} {} of {}", self.axes[axis], outer[axis], self.shape[axis]);
            index = index * self.shape[axis] + outer[axis];
        }
        index * inner..(index + 1) * inner
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_row_major() {
        let t = Tensor::from_vec(["row", "col", "rgb"], [2, 2, 3], (0..12).map(|i| i as f32).collect()).unwrap();
        assert_eq!(t.block([1, 0]), &[6.0, 7.0, 8.0]);
        assert_eq!(t.block([1]).len(), 6);
        assert_eq!(t.get([0, 1, 2]), 5.0);
    }

    #[test]
    fn lent_values_are_copied_before_they_are_written() {
        let lender: Lender = Arc::new(vec![1.0, 2.0, 3.0, 4.0]);
        let mut t = Tensor::lent(["row", "col"], [2, 2], lender.clone()).unwrap();
        assert_eq!(t.data().as_ptr(), lender.values().as_ptr());
        assert_eq!((t.get([1, 0]), t.block([1])), (3.0, &[3.0, 4.0][..]));
        assert_eq!(t, Tensor::from_vec(["row", "col"], [2, 2], vec![1.0, 2.0, 3.0, 4.0]).unwrap());
        *t.at_mut([0, 0]) = 9.0;
        assert_eq!((t.get([0, 0]), lender.values()[0]), (9.0, 1.0));
        assert!(Tensor::lent(["row", "col"], [2, 3], lender.clone()).is_err());
        assert_eq!(Tensor::lent(["row"], [4], lender).unwrap().into_data(), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn a_wrong_length_names_the_axes() {
        let error = Tensor::from_vec(["row", "col"], [2, 3], vec![0.0; 5]).unwrap_err();
        assert_eq!(error.to_string(), "axes [row][col] of shape [2, 3] need 6 values, found 5");
        assert!(Tensor::from_vec(["row", "col"], [usize::MAX, 3], vec![0.0; 5]).is_err());
    }
}
