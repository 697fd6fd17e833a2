//! Memory of large arrays: pages of a large size, and arrays in files, of which only a few pages
//! are in memory at any time.
//!
//! With small pages, random reads are slower, since more of them wait for the translation of
//! addresses. New memory also takes longer to map.

use std::io;
use std::mem::MaybeUninit;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Size of a large page on most machines, bytes. No large pages are requested for arrays smaller
/// than two large pages.
const LARGE_PAGE: usize = 2 << 20;

/// Requests large pages from the system, which gives them only on Linux, if some are free. Call
/// this function for untouched memory, such as the spare capacity of a new [`Vec`] or a large
/// `vec![0; n]`. The system assigns pages at the first write.
pub fn prefer_large_pages<T>(memory: &[T]) {
    if size_of_val(memory) >= 2 * LARGE_PAGE {
        advise(memory.as_ptr() as usize, size_of_val(memory));
    }
}

/// Copies a large array into memory for which it requests large pages. Returns a small array
/// unchanged, and on systems other than Linux any array.
pub fn in_large_pages<T: Copy>(values: Vec<T>) -> Vec<T> {
    if cfg!(not(target_os = "linux")) || size_of_val(values.as_slice()) < 2 * LARGE_PAGE {
        return values;
    }
    let mut moved = Vec::with_capacity(values.len());
    prefer_large_pages::<MaybeUninit<T>>(moved.spare_capacity_mut());
    moved.extend_from_slice(&values);
    moved
}

/// Limits how much of a mapped file is in memory.
///
/// Callers announce the bytes that they use next. Once more than `limit` bytes have been announced,
/// all pages are released, and the count begins anew. The system keeps released pages in its cache
/// if it has room, and maps them again at their next use.
///
/// So the pages in memory take at most the limit, plus the bytes that all threads use together. For
/// each byte that is read, the system maps up to [`NEIGHBOURS`](Self::NEIGHBOURS) bytes around it.
/// Systems other than Linux decide themselves which pages are in memory.
#[derive(Debug)]
pub struct Window {
    start: usize,
    length: usize,
    limit: usize,
    announced: AtomicUsize,
}

impl Window {
    /// Number of bytes that the system may map together with a byte that is read.
    pub const NEIGHBOURS: usize = 64 << 10;

    /// Limits a mapping to `limit` bytes.
    ///
    /// # Safety
    /// `memory` is a whole mapping of a file, and all writes to it go to the file. Released pages
    /// then have the same values when they are mapped again. The mapping exists as long as the
    /// window.
    pub unsafe fn new(memory: &[u8], limit: usize) -> Self {
        Self { start: memory.as_ptr() as usize, length: memory.len(), limit, announced: AtomicUsize::new(0) }
    }

    /// Announces that the caller uses this number of bytes next. Releases all pages once the limit
    /// is exceeded.
    #[inline]
    pub fn announce(&self, bytes: usize) {
        if self.announced.fetch_add(bytes, Ordering::Relaxed) + bytes > self.limit {
            self.announced.store(bytes, Ordering::Relaxed);
            release(self.start, self.length);
        }
    }
}

/// Creates arrays that may exceed memory, such as arrays in files. The function receives a number
/// of bytes, and returns an array in which all bytes are zero.
pub type Storage = Arc<dyn Fn(usize) -> io::Result<Pages> + Send + Sync>;

/// Bytes in a file, of which few are in memory at any time.
pub struct Pages {
    mapped: Box<dyn MappedBytes>,
    window: Window,
}

/// A mapping that can be read and written.
pub trait MappedBytes: AsRef<[u8]> + AsMut<[u8]> + Send + Sync {}

impl<T: AsRef<[u8]> + AsMut<[u8]> + Send + Sync> MappedBytes for T {}

impl Pages {
    /// Takes a mapping of which about `limit` bytes may be in memory.
    ///
    /// # Safety
    /// The conditions of [`Window::new`] hold for `mapped`. The mapping begins at a page.
    pub unsafe fn new(mapped: Box<dyn MappedBytes>, limit: usize) -> Self {
        // SAFETY: the caller guarantees the conditions; the box does not move the mapping
        let window = unsafe { Window::new((*mapped).as_ref(), limit) };
        Self { mapped, window }
    }
}

/// Types whose values are bytes without gaps, and for which all bytes are valid.
///
/// # Safety
/// The type has no padding, no invalid bit patterns, and an alignment of at most a page.
pub unsafe trait Plain: Copy + Default + Send + Sync {}

// SAFETY: a number has no padding, and all its bit patterns are valid
unsafe impl Plain for u16 {}
// SAFETY: a number has no padding, and all its bit patterns are valid
unsafe impl Plain for f32 {}
// SAFETY: an array has no gaps between its values, and the values are plain
unsafe impl<T: Plain, const N: usize> Plain for [T; N] where [T; N]: Default {}

/// A large array, in memory or in a file.
pub enum Array<T> {
    /// The values are in memory.
    Held(Vec<T>),
    /// The values are in a file, of which only pages in use are in memory.
    Paged(Pages),
}

impl<T: Plain> Array<T> {
    /// Makes `count` zeros in the storage, or in memory if there is no storage.
    ///
    /// # Errors
    /// If the storage cannot create the array, for example because it is full.
    pub fn zeros(count: usize, storage: Option<&Storage>) -> io::Result<Self> {
        let Some(storage) = storage else {
            let values = vec![T::default(); count];
            prefer_large_pages(&values);
            return Ok(Self::Held(values));
        };
        storage(count * size_of::<T>()).map(Self::Paged)
    }

    /// Returns all values. If the values are in a file, also returns the file's window, to which
    /// callers announce the bytes that they use next.
    #[inline(always)]
    pub fn all(&self) -> (&[T], Option<&Window>) {
        match self {
            Self::Held(values) => (values, None),
            // SAFETY: pages begin at a multiple of the alignment, and all bytes are valid
            Self::Paged(pages) => (unsafe { (*pages.mapped).as_ref().align_to().1 }, Some(&pages.window)),
        }
    }

    /// Returns the same as [`all`](Self::all), with writable values.
    pub fn all_mut(&mut self) -> (&mut [T], Option<&Window>) {
        match self {
            Self::Held(values) => (values, None),
            // SAFETY: as in `all`
            Self::Paged(pages) => (unsafe { (*pages.mapped).as_mut().align_to_mut().1 }, Some(&pages.window)),
        }
    }

    /// Returns the values of a range. Announces their bytes to the window if they are in a file.
    #[inline(always)]
    pub fn part(&self, range: std::ops::Range<usize>) -> &[T] {
        let (values, window) = self.all();
        if let Some(window) = window {
            window.announce(range.len() * size_of::<T>());
        }
        &values[range]
    }
}

impl<T> std::fmt::Debug for Array<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Held(values) => write!(f, "Held({} values)", values.len()),
            Self::Paged(pages) => write!(f, "Paged({} bytes)", (*pages.mapped).as_ref().len()),
        }
    }
}

fn advise(address: usize, length: usize) {
    let start = address.next_multiple_of(LARGE_PAGE);
    let end = (address + length) / LARGE_PAGE * LARGE_PAGE;
    if start < end {
        const MADV_HUGEPAGE: i32 = 14;
        // SAFETY: the range lies within memory that the caller has borrowed, and the advice changes
        // no values
        unsafe { madvise(start, end - start, MADV_HUGEPAGE) };
    }
}

/// Releases all pages of a shared mapping of a file. The file keeps their values.
fn release(start: usize, length: usize) {
    const MADV_DONTNEED: i32 = 4;
    // SAFETY: the caller of `Window::new` has promised a shared mapping
    unsafe { madvise(start, length, MADV_DONTNEED) };
}

/// Gives the system advice about pages. A refusal changes nothing.
///
/// # Safety
/// The advice is harmless for this memory.
#[cfg(target_os = "linux")]
unsafe fn madvise(start: usize, length: usize, advice: i32) {
    use std::ffi::{c_int, c_void};
    unsafe extern "C" {
        fn madvise(address: *mut c_void, length: usize, advice: c_int) -> c_int;
    }
    // SAFETY: the caller guarantees that the advice is harmless
    unsafe { madvise(start as *mut c_void, length, advice) };
}

#[cfg(not(target_os = "linux"))]
unsafe fn madvise(_start: usize, _length: usize, _advice: i32) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stay_what_they_are() {
        for count in [0, 1000, 3_000_000] {
            let values: Vec<u64> = (0..count).map(|i| i * i).collect();
            assert_eq!(in_large_pages(values.clone()), values);
            let zeros = vec![0u64; count as usize];
            prefer_large_pages(&zeros);
            assert!(zeros.iter().all(|&zero| zero == 0));
        }
    }
}
