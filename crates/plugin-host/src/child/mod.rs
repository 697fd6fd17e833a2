//! Plugins in libraries run in a child process, so that nothing they do can end the program.
//!
//! ```text
//! program                                             child: one per open output, and per scene, field or stack
//!  │ Functions::open(HostServices, ...)                 │
//!  ├── Call(open, texts) ─────────────────────────────▶ │ the library's `open`, with a HostServices that asks
//!  │ ◀────────────── Request(file_append) + bytes ───── │
//!  │   the program's own file_append                    │
//!  ├── Answer ────────────────────────────────────────▶ │
//!  │ ◀──────────────────────────────── Done(status) ─── │
//! ```
//!
//! Both ends stand at the C boundary: the host's code above it and the plugin's below are the same as without a child,
//! and so are the bytes. Planes cross one at a time, when the plugin fetches them, as bytes in the pipe. Memory that
//! both processes map would save one copy, but a child that shortens the file under it ends the program by a bus error.
//!
//! [`outside`] passes the plugin's functions on, [`session`] holds the child that runs them, and [`requests`] does what it asks for; [`inside`] is the
//! child's end.

mod inside;
mod launch;
mod outside;
mod protocol;
mod requests;
mod session;

use std::ffi::c_void;

use lumistack_plugin::abi::{ErrorSink, Str};

pub use inside::plugin_child;
pub use launch::{Launcher, Limits};
pub(crate) use outside::probe;

/// Copies an error text to a sink.
///
/// # Safety
/// `error` is null or a valid sink.
unsafe fn tell(error: *const ErrorSink, text: &str) {
    // SAFETY: the caller's promise; the sink's function takes its own context and copies the text.
    if let Some(sink) = unsafe { error.as_ref() }
        && !text.is_empty()
    {
        // SAFETY: as above.
        unsafe { (sink.write)(sink.context, Str::new(text)) };
    }
}

/// An error sink that keeps the text.
fn keeping(text: &mut String) -> ErrorSink {
    ErrorSink { size: size_of::<ErrorSink>(), context: (&raw mut *text).cast(), write: keep }
}

unsafe extern "C" fn keep(context: *mut c_void, text: Str) {
    // SAFETY: the callee lends the text for this call.
    let bytes = unsafe { lent(text.ptr, text.len) }.unwrap_or_default();
    // SAFETY: `context` is the string of `keeping`, whose owner waits for the callee.
    unsafe { *context.cast::<String>() = String::from_utf8_lossy(bytes).into_owned() };
}

/// Bytes lent by the other side of the C boundary; `None` for a length that no array has.
///
/// # Safety
/// `ptr` points to `len` readable bytes (or `len` is 0) for as long as the result is used.
unsafe fn lent<'a>(ptr: *const u8, len: usize) -> Option<&'a [u8]> {
    if len == 0 {
        return Some(&[]);
    }
    if ptr.is_null() || isize::try_from(len).is_err() {
        return None;
    }
    // SAFETY: the caller's promise; no array is longer than was checked.
    Some(unsafe { std::slice::from_raw_parts(ptr, len) })
}
