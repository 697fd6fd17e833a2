//! Prefetches of memory that will soon be read. A prefetch may have no effect, and any address is
//! allowed.

/// Requests that a cache line be loaded into all caches.
#[inline(always)]
pub fn prefetch<T>(from: *const T) {
    // SAFETY: a prefetch may name any address, and every x86-64 has the instruction
    #[cfg(target_arch = "x86_64")]
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(from.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = from;
}

/// Requests that a cache line be loaded into the second-level cache and larger caches, but not into
/// the first-level cache.
#[inline(always)]
pub fn prefetch_far<T>(from: *const T) {
    // SAFETY: a prefetch may name any address, and every x86-64 has the instruction
    #[cfg(target_arch = "x86_64")]
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T1>(from.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = from;
}
