//! Services of the host for plugins.

use core::ffi::c_void;

use crate::{Bytes, Data, ErrorSink, Plane, Status, Str, View};

/// Levels of [`HostServices::log`].
pub mod level {
    /// An operation failed, and the plugin continues without its result.
    pub const ERROR: u32 = 1;
    /// A problem that the user should know.
    pub const WARN: u32 = 2;
    /// Information for the user.
    pub const INFO: u32 = 3;
    /// Information for the plugin's developer.
    pub const DEBUG: u32 = 4;
}

/// Functions of the host, which any thread may call. An output may call them from `open` until
/// `close` returns; other plugins may call them until `import` or `make` returns.
///
/// The functions are passed as a table because every library has its own statics (loggers,
/// allocators, thread pools), and cannot reach those of the host.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct HostServices {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to every function.
    pub context: *const c_void,
    /// Reports a message; `level` is one of [`level`].
    pub log: unsafe extern "C" fn(context: *const c_void, level: u32, message: Str),
    /// Starts a stage of `total` steps; `unit` names them, such as "files".
    pub progress_begin: unsafe extern "C" fn(context: *const c_void, stage: Str, total: u64, unit: Str),
    /// Reports finished steps. `note` is a short value to show next to the progress bar, or empty.
    pub progress_advance: unsafe extern "C" fn(context: *const c_void, steps: u64, note: Str),
    /// Ends the stage.
    pub progress_end: unsafe extern "C" fn(context: *const c_void),
    /// Returns nonzero once the user cancelled. A plugin calls this function often during long
    /// work. After a nonzero result the plugin returns [`Status::CANCELLED`].
    pub is_cancelled: unsafe extern "C" fn(context: *const c_void) -> u8,
    /// Creates a file, and stores its handle in `*file`. `path` is relative to the output's folder,
    /// with `/` between names and no `..`.
    pub file_open:
        unsafe extern "C" fn(context: *const c_void, path: Str, file: *mut u64, error: *const ErrorSink) -> Status,
    /// Appends bytes to an open file.
    pub file_append:
        unsafe extern "C" fn(context: *const c_void, file: u64, bytes: Bytes, error: *const ErrorSink) -> Status,
    /// Completes the file and closes the handle. The file appears in the output's folder once the
    /// output has finished.
    pub file_commit: unsafe extern "C" fn(context: *const c_void, file: u64, error: *const ErrorSink) -> Status,
    /// Drops the file and closes the handle. Nothing of the file remains.
    pub file_abort: unsafe extern "C" fn(context: *const c_void, file: u64, error: *const ErrorSink) -> Status,
    /// Computes the seen picture of a submitted layer stack from one viewpoint.
    ///
    /// The result is emitted linear radiance `[row][col][rgb]`, not divided by the stack's
    /// brightness. Each value is the mean over the area of a pixel of the target. `data` is the
    /// argument of `submit`. The plugin releases the plane.
    pub simulate: unsafe extern "C" fn(
        context: *const c_void,
        data: *const Data,
        view: *const View,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Sends an event of a presenter to the program that runs the presentation. The plugin defines
    /// the form of the JSON.
    pub tell: unsafe extern "C" fn(context: *const c_void, event_json: Str),
    /// Port whose data the output will receive, a bit of [`port`](crate::port); 0 if the host does
    /// not know the port.
    pub port: u32,
}
