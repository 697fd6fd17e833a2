//! Large pages for large arrays: a ray jumps all over the tree, and with small pages it also waits for their addresses.

/// Arrays below this are left alone: the size of a large page on most machines.
const LARGE_PAGE: usize = 2 << 20;

/// The same values in memory for which the system was asked to use large pages, where it can be asked (Linux) and the array is large.
pub(crate) fn in_large_pages<T: Copy>(values: Vec<T>) -> Vec<T> {
    if cfg!(not(target_os = "linux")) || size_of_val(values.as_slice()) < 2 * LARGE_PAGE {
        return values;
    }
    let mut moved = Vec::with_capacity(values.len());
    // before the memory is touched for the first time, which is when pages are made
    advise(&moved);
    moved.extend_from_slice(&values);
    moved
}

#[cfg(target_os = "linux")]
fn advise<T>(empty: &Vec<T>) {
    use std::ffi::{c_int, c_void};
    unsafe extern "C" {
        fn madvise(address: *mut c_void, length: usize, advice: c_int) -> c_int;
    }
    const MADV_HUGEPAGE: c_int = 14;
    let start = (empty.as_ptr() as usize).next_multiple_of(LARGE_PAGE);
    let end = (empty.as_ptr() as usize + empty.capacity() * size_of::<T>()) / LARGE_PAGE * LARGE_PAGE;
    if start < end {
        // SAFETY: the range lies in memory that this array owns, and the advice changes no values. A refusal changes nothing.
        unsafe { madvise(start as *mut c_void, end - start, MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise<T>(_empty: &Vec<T>) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stay_what_they_are() {
        for count in [0, 1000, 3_000_000] {
            let values: Vec<u64> = (0..count).map(|i| i * i).collect();
            assert_eq!(in_large_pages(values.clone()), values);
        }
    }
}
