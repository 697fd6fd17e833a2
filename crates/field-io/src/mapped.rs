//! Arrays that may be larger than memory. The values of such an array stay in its file, and the
//! system loads a page of the file into memory when the page is read.

#[cfg(target_pointer_width = "64")]
use std::sync::Arc;

use lumistack_core::Lender;
use lumistack_files::File;
#[cfg(target_pointer_width = "64")]
use memmap2::Mmap;

/// Smallest size in bytes of an array that stays in its file; smaller arrays are read.
pub(crate) const FROM: u64 = 1 << 30;

/// `float32` values in a mapped file.
#[cfg(target_pointer_width = "64")]
struct Mapped {
    file: Mmap,
    first: usize,
    count: usize,
}

#[cfg(target_pointer_width = "64")]
impl AsRef<[f32]> for Mapped {
    fn as_ref(&self) -> &[f32] {
        // SAFETY: all bytes are valid numbers. A map begins at a page, and `lend` checked the
        // alignment of the first value.
        unsafe { self.file[self.first..][..4 * self.count].align_to::<f32>().1 }
    }
}

/// Maps `count` little-endian `float32` values of a file, from byte `first` on.
///
/// `None` if this machine cannot use the bytes in place, the file cannot be mapped, or the file is
/// too short.
#[cfg(target_pointer_width = "64")]
pub(crate) fn lend(file: &File, first: u64, count: usize) -> Option<Lender> {
    if !(cfg!(target_endian = "little") && first.is_multiple_of(4)) {
        return None;
    }
    // SAFETY: `atomic` replaces files of results and never changes them in place. A file that is
    // replaced or removed keeps its content while it is mapped, under another name on Windows.
    let file = unsafe { Mmap::map(file) }.ok()?;
    (file.len() as u64 >= first + 4 * count as u64)
        .then(|| Arc::new(Mapped { file, first: first as usize, count }) as Lender)
}

/// Returns `None`, since on 32 bits there are too few addresses for an array that exceeds memory.
#[cfg(not(target_pointer_width = "64"))]
pub(crate) fn lend(_file: &File, _first: u64, _count: usize) -> Option<Lender> {
    None
}
