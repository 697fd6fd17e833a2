//! Arrays that may be larger than memory: their values stay in the file, and the system keeps the
//! pages in memory that are read.

use std::fs::File;
use std::sync::Arc;

use lumistack_core::Lender;
use memmap2::Mmap;

/// Smallest size of an array that stays in its file, bytes.
pub(crate) const FROM: u64 = 1 << 30;

/// `float32` values in a mapped file.
struct Mapped {
    file: Mmap,
    first: usize,
    count: usize,
}

impl AsRef<[f32]> for Mapped {
    fn as_ref(&self) -> &[f32] {
        // SAFETY: all bytes are valid numbers. A map begins at a page, and `lend` checked the
        // alignment of the first value.
        unsafe { self.file[self.first..][..4 * self.count].align_to::<f32>().1 }
    }
}

/// Maps `count` little-endian `float32` values of a file, from byte `first` on.
///
/// `None` if this machine cannot use the bytes of the file directly, or the file is too short.
pub(crate) fn lend(file: &File, first: u64, count: usize) -> Option<Lender> {
    if !(cfg!(target_endian = "little") && cfg!(target_pointer_width = "64") && first.is_multiple_of(4)) {
        return None;
    }
    // SAFETY: files of results are replaced, never changed in place
    let file = unsafe { Mmap::map(file) }.ok()?;
    (file.len() as u64 >= first + 4 * count as u64)
        .then(|| Arc::new(Mapped { file, first: first as usize, count }) as Lender)
}
