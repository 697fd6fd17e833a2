//! `f32` storage that begins on a cache line, so that no aligned vector straddles two lines.

use std::mem::MaybeUninit;
use std::ops::{Deref, DerefMut};

use lumistack_core::pages::prefer_large_pages;

use crate::bands;

/// Values per cache line.
pub(crate) const LINE: usize = 16;

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct CacheLine([f32; LINE]);

/// Number of cache lines in one part of an initialization. The first access to a page is slow, so
/// the parts are distributed to all threads.
const PART: usize = 1 << 14;

/// A fixed number of values.
#[derive(Debug, Default)]
pub(crate) struct Aligned {
    lines: Vec<CacheLine>,
    len: usize,
}

impl Aligned {
    /// Allocates `len` values that all equal `value`.
    pub(crate) fn filled(value: f32, len: usize) -> Self {
        let lines = made(len.div_ceil(LINE), |_, lines| {
            lines.fill(MaybeUninit::new(CacheLine([value; LINE])));
        });
        Self { lines, len }
    }
}

impl Clone for Aligned {
    fn clone(&self) -> Self {
        let lines = made(self.lines.len(), |first, lines| {
            lines.iter_mut().zip(&self.lines[first..]).for_each(|(to, from)| *to = MaybeUninit::new(*from));
        });
        Self { lines, len: self.len }
    }
}

/// Allocates `count` cache lines and initializes them on all threads.
///
/// `make(first, part)` writes every line of `part`; `first` is the index of the part's first line.
fn made(count: usize, make: impl Fn(usize, &mut [MaybeUninit<CacheLine>]) + Sync + Send) -> Vec<CacheLine> {
    let mut lines = Vec::with_capacity(count);
    let spare = &mut lines.spare_capacity_mut()[..count];
    // large pages shorten an update by 7 % and the preparation by a third
    prefer_large_pages(spare);
    bands::for_each_chunk(spare, PART, || (), |(), index, part| make(index * PART, part));
    // SAFETY: every part was written, and together they are the first `count` lines
    unsafe { lines.set_len(count) };
    lines
}

impl Deref for Aligned {
    type Target = [f32];

    #[inline(always)]
    fn deref(&self) -> &[f32] {
        // SAFETY: cache lines are arrays of f32 without padding, and `len` is at most their number
        // of values
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as in `deref`
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}
