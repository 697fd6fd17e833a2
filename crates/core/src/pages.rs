//! Large pages for large arrays. With small pages, random reads also wait for address translation,
//! and new memory takes longer to map.

use std::mem::MaybeUninit;

/// Size of a large page on most machines, bytes. Arrays smaller than two large pages are left
/// alone.
const LARGE_PAGE: usize = 2 << 20;

/// Requests large pages from the system; it gives them on Linux alone, if some are free. Call it
/// for untouched memory, such as the spare capacity of a new [`Vec`] or a large `vec![0; n]`: the
/// system assigns pages at the first write.
pub fn prefer_large_pages<T>(memory: &[T]) {
    if size_of_val(memory) >= 2 * LARGE_PAGE {
        advise(memory.as_ptr() as usize, size_of_val(memory));
    }
}

/// Copies a large array into large pages if the system has them. Returns other arrays unchanged.
pub fn in_large_pages<T: Copy>(values: Vec<T>) -> Vec<T> {
    if cfg!(not(target_os = "linux")) || size_of_val(values.as_slice()) < 2 * LARGE_PAGE {
        return values;
    }
    let mut moved = Vec::with_capacity(values.len());
    prefer_large_pages::<MaybeUninit<T>>(moved.spare_capacity_mut());
    moved.extend_from_slice(&values);
    moved
}

#[cfg(target_os = "linux")]
fn advise(address: usize, length: usize) {
    use std::ffi::{c_int, c_void};
    unsafe extern "C" {
        fn madvise(address: *mut c_void, length: usize, advice: c_int) -> c_int;
    }
    const MADV_HUGEPAGE: c_int = 14;
    let start = address.next_multiple_of(LARGE_PAGE);
    let end = (address + length) / LARGE_PAGE * LARGE_PAGE;
    if start < end {
        // SAFETY: the range lies within memory that the caller has borrowed, and the advice changes
        // no values. A refusal of the advice changes nothing.
        unsafe { madvise(start as *mut c_void, end - start, MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise(_address: usize, _length: usize) {}

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
