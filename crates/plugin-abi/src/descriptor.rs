//! A plugin's descriptor, and the functions of an output.

use core::ffi::c_void;

use crate::{Data, ErrorSink, HostServices, Status, Str, Time};

/// Values of [`Descriptor::kind`].
pub mod kind {
    /// Makes scenes from files; see [`ImporterVtable`](crate::ImporterVtable).
    pub const IMPORTER: u32 = 1;
    /// Makes light fields; see [`SourceVtable`](crate::SourceVtable).
    pub const SOURCE: u32 = 2;
    /// Turns light fields into layer stacks; see [`NodeVtable`](crate::NodeVtable).
    pub const NODE: u32 = 3;
    /// Writes or presents light fields and patterns; see [`OutputVtable`](super::OutputVtable).
    pub const OUTPUT: u32 = 4;
}

/// Bits of [`Descriptor::ports`]: the kinds of data that plugins exchange.
pub mod port {
    /// A validated scene.
    pub const SCENE: u32 = 1;
    /// Linear radiance of many views.
    pub const LIGHT_FIELD: u32 = 1 << 1;
    /// The patterns of a tensor display.
    pub const LAYER_STACK: u32 = 1 << 2;
    /// A file, which an importer reads.
    pub const FILE: u32 = 1 << 3;
}

/// The function that a plugin exports as [`ENTRY_PREFIX`](crate::ENTRY_PREFIX) + id.
///
/// The result is valid as long as the process lives, since libraries are never unloaded. The result
/// is null if the plugin cannot describe itself.
pub type Entry = unsafe extern "C" fn() -> *const Descriptor;

/// Description of a plugin. All texts live as long as the process.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Descriptor {
    /// [`ABI_MAJOR`](crate::ABI_MAJOR) of the plugin's build.
    pub abi_major: u32,
    /// [`ABI_MINOR`](crate::ABI_MINOR) of the plugin's build.
    pub abi_minor: u32,
    /// Size of this struct in bytes.
    pub size: usize,
    /// One of [`kind`]; it selects the type of `vtable`.
    pub kind: u32,
    /// Accepted input ports, bits of [`port`]: [`FILE`](port::FILE) for importers, none for
    /// sources, [`LIGHT_FIELD`](port::LIGHT_FIELD) for nodes. An output accepts
    /// [`LIGHT_FIELD`](port::LIGHT_FIELD), [`LAYER_STACK`](port::LAYER_STACK) or both.
    pub ports: u32,
    /// Name in job files and on the command line: lower-case letters, digits and underscores. The
    /// first character is a letter.
    pub id: Str,
    /// Version of the plugin, `major.minor.patch`.
    pub version: Str,
    /// Description for users; lists show its first sentence.
    pub doc: Str,
    /// Parameters: `{"params": [{"name", "kind", "default", "min", "max", "options", "unit",
    /// "help"}, ...]}`.
    pub schema_json: Str,
    /// Functions of the plugin's kind; see [`kind`].
    pub vtable: *const c_void,
}

// SAFETY: a descriptor and all that it points to are immutable and live as long as the process.
unsafe impl Send for Descriptor {}
// SAFETY: as above.
unsafe impl Sync for Descriptor {}

/// Functions of an output plugin. All but `run` and `command` are required.
///
/// `error` receives the text of a status other than [`Status::OK`]; it may be null if the caller
/// does not need the text.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct OutputVtable {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Starts an output. `params_json` is an object with any of the schema's parameters.
    /// `display_json` is the display file as JSON. `host` is valid until `close` returns.
    ///
    /// On success `*instance` is a handle for the other functions. After a failure `*instance` is
    /// unchanged, and `close` is not called.
    pub open: Option<
        unsafe extern "C" fn(
            host: *const HostServices,
            params_json: Str,
            display_json: Str,
            instance: *mut *mut c_void,
            error: *const ErrorSink,
        ) -> Status,
    >,
    /// Takes one time step of the sequence. Any thread may call this function; several threads may
    /// call it in parallel.
    pub submit: Option<
        unsafe extern "C" fn(
            instance: *mut c_void,
            time: *const Time,
            data: *const Data,
            error: *const ErrorSink,
        ) -> Status,
    >,
    /// For presenters only, else null. Runs on the main thread until the user closes the
    /// presentation or the host cancels. Meanwhile every `submit` replaces the presented patterns.
    pub run: Option<unsafe extern "C" fn(instance: *mut c_void, error: *const ErrorSink) -> Status>,
    /// Completes the output: no more data follow. Called at most once, after every `submit` has
    /// returned.
    pub finish: Option<unsafe extern "C" fn(instance: *mut c_void, error: *const ErrorSink) -> Status>,
    /// Frees the handle. Called exactly once, as the last function, in any state. Without an
    /// earlier `finish` the output is discarded.
    pub close: Option<unsafe extern "C" fn(instance: *mut c_void)>,
    /// For presenters with commands, else null. Executes a command while `run` runs. Any thread may
    /// call this function. The plugin defines the form of `command_json`.
    pub command:
        Option<unsafe extern "C" fn(instance: *mut c_void, command_json: Str, error: *const ErrorSink) -> Status>,
}
