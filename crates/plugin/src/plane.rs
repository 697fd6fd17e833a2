//! Planes of values that the other side of the interface lends.

use std::borrow::Cow;
use std::marker::PhantomData;

use lumistack_plugin_abi::{Plane, dtype};

use crate::PluginError;

/// A borrowed plane `[row][col][channel]` of `f32`. The plane is released when this value is
/// dropped.
#[derive(Debug)]
pub struct PlaneView<'a> {
    plane: Plane,
    _lent: PhantomData<&'a [f32]>,
}

impl PlaneView<'_> {
    /// Checks a plane that the other side filled in. If the check fails, releases the plane.
    ///
    /// # Errors
    /// If the plane does not have three axes of `f32`, or its pointer is null although it has
    /// elements.
    ///
    /// # Safety
    /// The plane's pointer, shape, strides and type describe memory that stays readable and
    /// unchanged for the lifetime, or until `release` is called. All its elements lie within
    /// `isize::MAX` bytes of the first.
    pub unsafe fn new(plane: Plane) -> Result<Self, PluginError> {
        let view = Self { plane, _lent: PhantomData };
        if plane.dtype != dtype::F32 || plane.ndim != 3 {
            let (dtype, ndim) = (plane.dtype, plane.ndim);
            return Err(PluginError::Failed(format!(
                "expected a plane with 3 axes and the data type {} (f32), found a plane with {ndim} axes and the data type {dtype}",
                dtype::F32
            )));
        }
        if plane.data.is_null() && view.count() > 0 {
            return Err(PluginError::Failed("expected a pointer to the values of a plane, found null".into()));
        }
        Ok(view)
    }

    /// Returns the number of rows; row 0 is the top.
    pub fn rows(&self) -> usize {
        self.plane.shape[0]
    }

    /// Returns the number of columns.
    pub fn cols(&self) -> usize {
        self.plane.shape[1]
    }

    /// Returns the number of channels: 3 for colours (red, green, blue), 1 for weights.
    pub fn channels(&self) -> usize {
        self.plane.shape[2]
    }

    /// Returns one value, for planes of any strides.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn get(&self, row: usize, col: usize, channel: usize) -> f32 {
        assert!(
            row < self.rows() && col < self.cols() && channel < self.channels(),
            "expected an index inside a plane of shape {:?}, found [{row}][{col}][{channel}]",
            &self.plane.shape[..3]
        );
        let [r, c, k, _] = self.plane.strides;
        let offset = row as isize * r + col as isize * c + channel as isize * k;
        // SAFETY: the index is in range, so `offset` leads to an element (guaranteed to `new`). The
        // element may be unaligned.
        unsafe { self.plane.data.cast::<u8>().offset(offset).cast::<f32>().read_unaligned() }
    }

    /// Returns all values as one slice `[row][col][channel]`. Returns `None` if there are no
    /// values, or if they are not contiguous and aligned in memory.
    pub fn as_slice(&self) -> Option<&[f32]> {
        let element = size_of::<f32>() as isize;
        let [rows, cols, channels, _] = self.plane.shape;
        let dense = [(cols * channels) as isize * element, channels as isize * element, element];
        let ordered = (0..3).all(|axis| self.plane.shape[axis] <= 1 || self.plane.strides[axis] == dense[axis]);
        let data = self.plane.data.cast::<f32>();
        if !ordered || !data.is_aligned() || self.count() == 0 {
            return None;
        }
        // SAFETY: `data` is aligned, and the strides state that the elements are contiguous
        // (guaranteed to `new`).
        Some(unsafe { std::slice::from_raw_parts(data, rows * cols * channels) })
    }

    /// Iterates over the rows from top to bottom, each `[col][channel]`.
    pub fn iter_rows(&self) -> impl Iterator<Item = Vec<f32>> {
        (0..self.rows()).map(|row| {
            let width = self.cols() * self.channels();
            match self.as_slice() {
                Some(values) => values[row * width..(row + 1) * width].to_vec(),
                None => (0..width).map(|i| self.get(row, i / self.channels(), i % self.channels())).collect(),
            }
        })
    }

    /// Copies all values `[row][col][channel]`.
    pub fn to_vec(&self) -> Vec<f32> {
        self.values().into_owned()
    }

    /// Returns all values `[row][col][channel]`. They are copied only if they are not contiguous
    /// and aligned in memory.
    pub fn values(&self) -> Cow<'_, [f32]> {
        self.as_slice().map_or_else(|| self.iter_rows().flatten().collect(), Cow::Borrowed)
    }

    fn count(&self) -> usize {
        self.plane.shape[..3].iter().product()
    }
}

impl Drop for PlaneView<'_> {
    fn drop(&mut self) {
        if let Some(release) = self.plane.release {
            // SAFETY: `release` is called once, with the plane's own owner.
            unsafe { release(self.plane.owner) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::c_void;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn plane(data: *const u8, shape: [usize; 3], strides: [isize; 3]) -> Plane {
        Plane {
            data: data.cast(),
            ndim: 3,
            shape: [shape[0], shape[1], shape[2], 1],
            strides: [strides[0], strides[1], strides[2], 0],
            ..Plane::empty()
        }
    }

    #[test]
    fn strides_are_honoured() {
        // a plane of 2 × 2 × 3 values, stored channel by channel with the bottom row first: value =
        // 100·row + 10·col + channel
        let value = |row: usize, col: usize, k: usize| (100 * row + 10 * col + k) as f32;
        let mut stored = [0.0f32; 12];
        for (row, col, k) in (0..12).map(|i| (i / 6, i / 3 % 2, i % 3)) {
            stored[k * 4 + (1 - row) * 2 + col] = value(row, col, k);
        }
        let first = stored[2..].as_ptr().cast::<u8>();
        // SAFETY: shape and strides describe `stored`.
        let view = unsafe { PlaneView::new(plane(first, [2, 2, 3], [-8, 4, 16])) }.unwrap();
        assert!(view.as_slice().is_none());
        assert_eq!(view.get(1, 0, 2), 102.0);
        let expected: Vec<f32> = (0..12).map(|i| value(i / 6, i / 3 % 2, i % 3)).collect();
        assert_eq!(view.to_vec(), expected);
        assert!(matches!(view.values(), Cow::Owned(_)));
        // SAFETY: as above, dense.
        let dense = unsafe { PlaneView::new(plane(expected.as_ptr().cast(), [2, 2, 3], [24, 12, 4])) }.unwrap();
        assert_eq!(dense.as_slice(), Some(expected.as_slice()));
        assert_eq!(dense.iter_rows().nth(1).unwrap(), expected[6..]);
    }

    #[test]
    fn unaligned_planes_can_be_read() {
        let bytes: Vec<u8> =
            std::iter::once(0).chain([1.5f32, -2.0, 3.0].iter().flat_map(|v| v.to_ne_bytes())).collect();
        // SAFETY: three floats start at the second byte.
        let view = unsafe { PlaneView::new(plane(bytes[1..].as_ptr(), [1, 1, 3], [12, 12, 4])) }.unwrap();
        assert_eq!(view.to_vec(), [1.5, -2.0, 3.0]);
    }

    #[test]
    fn planes_of_another_kind_are_refused_and_given_back() {
        static RELEASED: AtomicUsize = AtomicUsize::new(0);
        unsafe extern "C" fn release(_: *mut c_void) {
            RELEASED.fetch_add(1, Ordering::SeqCst);
        }
        let value = 1.0f32;
        let good = plane((&raw const value).cast(), [1, 1, 1], [4, 4, 4]);
        for bad in [Plane { dtype: 77, ..good }, Plane { ndim: 2, ..good }, Plane { data: std::ptr::null(), ..good }] {
            // SAFETY: none of these is read.
            assert!(unsafe { PlaneView::new(Plane { release: Some(release), ..bad }) }.is_err());
        }
        // SAFETY: describes `value`.
        drop(unsafe { PlaneView::new(Plane { release: Some(release), ..good }) }.unwrap());
        assert_eq!(RELEASED.load(Ordering::SeqCst), 4);
    }
}
