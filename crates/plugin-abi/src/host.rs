//! What the host offers to a plugin.

use core::ffi::c_void;

use crate::{Bytes, Data, ErrorSink, Plane, Status, Str, View};

/// Levels of [`HostServices::log`].
pub mod level {
    /// Something failed and the plugin goes on without it.
    pub const ERROR: u32 = 1;
    /// The user should know.
    pub const WARN: u32 = 2;
    /// The user may want to know.
    pub const INFO: u32 = 3;
    /// For whoever develops the plugin.
    pub const DEBUG: u32 = 4;
}

/// Functions of the host; every one may be called from any thread, from `open` until `close` returns. They come as a table because
/// statics (loggers, allocators, thread pools) are separate in every library.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct HostServices {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to every function.
    pub context: *const c_void,
    /// Reports a message; `level` is one of [`level`].
    pub log: unsafe extern "C" fn(context: *const c_void, level: u32, message: Str),
    /// A stage of `total` steps of kind `unit` ("files") starts.
    pub progress_begin: unsafe extern "C" fn(context: *const c_void, stage: Str, total: u64, unit: Str),
    /// Some steps are done; `note` is a short figure to show beside the bar, or empty.
    pub progress_advance: unsafe extern "C" fn(context: *const c_void, steps: u64, note: Str),
    /// The stage has ended.
    pub progress_end: unsafe extern "C" fn(context: *const c_void),
    /// Nonzero once the user asked to stop; long work asks often and then returns [`Status::CANCELLED`].
    pub is_cancelled: unsafe extern "C" fn(context: *const c_void) -> u8,
    /// Starts a file; `path` is relative to the output's folder, with `/` between its parts and no `..`. `*file` is its handle.
    pub file_open:
        unsafe extern "C" fn(context: *const c_void, path: Str, file: *mut u64, error: *const ErrorSink) -> Status,
    /// Adds bytes at the end of an open file.
    pub file_append:
        unsafe extern "C" fn(context: *const c_void, file: u64, bytes: Bytes, error: *const ErrorSink) -> Status,
    /// The file is whole. It appears in its place once the output has finished. The handle is gone.
    pub file_commit: unsafe extern "C" fn(context: *const c_void, file: u64, error: *const ErrorSink) -> Status,
    /// Drops the file; nothing of it remains. The handle is gone.
    pub file_abort: unsafe extern "C" fn(context: *const c_void, file: u64, error: *const ErrorSink) -> Status,
    /// The seen picture of a submitted layer stack from one place: emitted linear radiance
    /// `[row][col][rgb]`, the mean over the area of each of the target's pixels, not divided by the stack's brightness. `data` is what `submit` was given; the plane is the plugin's to
    /// release.
    pub simulate: unsafe extern "C" fn(
        context: *const c_void,
        data: *const Data,
        view: *const View,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Tells an event to the driver of a presenter, as JSON of the plugin's own form. Since version 0.4.
    pub tell: unsafe extern "C" fn(context: *const c_void, event_json: Str),
    /// The port whose data an output will be given, a bit of [`port`](crate::port); 0 where the host does not say. Since version 0.4.
    pub port: u32,
}
