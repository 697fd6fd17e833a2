//! What a plugin offers: its descriptor and the functions of its kind.

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
    /// Takes what the graph makes and puts it somewhere; see [`OutputVtable`](super::OutputVtable).
    pub const OUTPUT: u32 = 4;
}

/// Bits of [`Descriptor::ports`]: the types of the graph's edges.
pub mod port {
    /// A validated scene.
    pub const SCENE: u32 = 1;
    /// Linear radiance of many views.
    pub const LIGHT_FIELD: u32 = 1 << 1;
    /// The patterns of a tensor display.
    pub const LAYER_STACK: u32 = 1 << 2;
    /// A file that another part wrote.
    pub const FILE: u32 = 1 << 3;
}

/// The function that a plugin exports as [`ENTRY_PREFIX`](crate::ENTRY_PREFIX) + id. Its result is valid for as long as the process
/// lives (libraries are never unloaded), or null when the plugin cannot describe itself.
pub type Entry = unsafe extern "C" fn() -> *const Descriptor;

/// What a plugin is and what it takes. All texts live as long as the process.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Descriptor {
    /// [`ABI_MAJOR`](crate::ABI_MAJOR) of the plugin's build.
    pub abi_major: u32,
    /// [`ABI_MINOR`](crate::ABI_MINOR) of the plugin's build.
    pub abi_minor: u32,
    /// Size of this struct in bytes.
    pub size: usize,
    /// One of [`kind`]; says what `vtable` points to.
    pub kind: u32,
    /// Accepted input ports, bits of [`port`]: [`FILE`](port::FILE) for importers, none for sources, [`LIGHT_FIELD`](port::LIGHT_FIELD) for nodes.
    pub ports: u32,
    /// Name in job files and on the command line: lower-case letters, digits and underscores, a letter first.
    pub id: Str,
    /// Version of the plugin, `major.minor.patch`.
    pub version: Str,
    /// What it does, for people; the first sentence stands in lists.
    pub doc: Str,
    /// Parameters: `{"params": [{"name", "kind", "default", "min", "max", "options", "unit", "help"}, ...]}`.
    pub schema_json: Str,
    /// Functions of its kind; see [`kind`].
    pub vtable: *const c_void,
}

// SAFETY: a descriptor and all that it points to are immutable and live as long as the process.
unsafe impl Send for Descriptor {}
// SAFETY: as above.
unsafe impl Sync for Descriptor {}

/// Functions of an output plugin. All but `run` and `command` must be there. `error` is where the text of a status other than
/// [`Status::OK`] goes; it may be null when the caller does not want it.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct OutputVtable {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Starts an output. `params_json` is an object that holds any of the schema's parameters; `display_json` the display file as
    /// JSON. `host` is valid until `close` returns. On success `*instance` is a handle for the other functions; otherwise it is
    /// left alone and `close` is not called.
    pub open: Option<
        unsafe extern "C" fn(
            host: *const HostServices,
            params_json: Str,
            display_json: Str,
            instance: *mut *mut c_void,
            error: *const ErrorSink,
        ) -> Status,
    >,
    /// Takes one time of the sequence. Called from any thread, also from several at once.
    pub submit: Option<
        unsafe extern "C" fn(
            instance: *mut c_void,
            time: *const Time,
            data: *const Data,
            error: *const ErrorSink,
        ) -> Status,
    >,
    /// Presenters only, else null: runs on the main thread until the user closes the presentation or the host cancels. Meanwhile
    /// every `submit` replaces what is presented: only the newest state counts.
    pub run: Option<unsafe extern "C" fn(instance: *mut c_void, error: *const ErrorSink) -> Status>,
    /// No more data will come. Called at most once, after every `submit` has returned.
    pub finish: Option<unsafe extern "C" fn(instance: *mut c_void, error: *const ErrorSink) -> Status>,
    /// Frees the handle. Called exactly once, last, from whatever state: without `finish` the output is abandoned.
    pub close: Option<unsafe extern "C" fn(instance: *mut c_void)>,
    /// Presenters that take commands, else null: obeys a command while `run` runs; from any thread. `command_json` is of the plugin's own form.
    /// Since version 0.4.
    pub command:
        Option<unsafe extern "C" fn(instance: *mut c_void, command_json: Str, error: *const ErrorSink) -> Status>,
}
