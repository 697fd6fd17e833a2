//! The C interface between the host and its plugins: `repr(C)` types only, no dependencies.
//!
//! Compiled-in plugins and loaded plugins share this interface. A plugin has one [`Descriptor`]. A
//! library exports a function named [`ENTRY_PREFIX`] + id for each of its plugins, and the host
//! receives the descriptor from this function.
//!
//! ```text
//! host                                   plugin
//!  │  open(HostServices, params, display) ─▶ │   JSON in, a handle out
//!  │  submit(Time, Data) ──────────────────▶ │   any thread; fetches lent Planes one by one
//!  │ ◀── file_open / append / commit ─────── │   files are written only through the host
//!  │  run() ───────────────────────────────▶ │   presenters only, on the main thread
//!  │  finish() ────────────────────────────▶ │   no more data
//!  │  close() ─────────────────────────────▶ │   frees the handle, finished or not
//! ```
//!
//! This is the life of an output. While `run` runs, `submit` and `command` are still called.
//!
//! An importer, source or node has a single function, which passes its result to a sink:
//!
//! ```text
//!  │  import(HostServices, params, file, Assets, ByteSink) ─▶ │   a glTF document
//!  │  make(HostServices, params, display, Time, FieldSink) ─▶ │   a light field
//!  │  make(HostServices, params, display, Time, Data, StackSink) ─▶ │   a layer stack
//! ```
//!
//! Rules for both sides:
//! * Every struct that may grow begins with its size in bytes; [`Descriptor`] begins with the
//!   version numbers, then its size. A side that reads such a struct of the other side reads at
//!   most that size. A caller that requests a filled struct sets its `size` first.
//! * Text is UTF-8, never null-terminated. JSON may gain keys; readers ignore unknown keys.
//! * Lent data are valid until the call returns, unless their documentation says otherwise. No side
//!   frees the other's memory: the call's [`ErrorSink`] copies error texts, and planes have a
//!   release function.
//! * No unwinding crosses the interface: each side catches its panics.
//!
//! # Versions
//!
//! The version is [`ABI_MAJOR`].[`ABI_MINOR`]. Both sides must have the same major version. All
//! versions 1.x keep these promises:
//! * A plugin of version 1.a works unchanged in every program of version 1.b with b ≥ a. No member,
//!   function or constant of version 1.0 moves, disappears or changes its type or meaning.
//! * Additions raise the minor version: members at the ends of structs, constants, and keys of JSON
//!   texts. A reader accepts every struct that has all members of version 1.0, and regards missing
//!   later members as null or zero.
//! * An older program of version 1.a, with a < b, also loads a plugin of version 1.b. Before the
//!   plugin uses a member that was added after version 1.0, it reads the struct's `size`. The
//!   plugin refuses only work that needs a service that the program lacks.

// the example of README.md is a test
#![cfg_attr(doctest, doc = include_str!("../README.md"))]
#![cfg_attr(not(test), no_std)]

mod data;
mod descriptor;
mod host;
mod makers;

pub use data::{Data, Plane, Time, View, dtype, view};
pub use descriptor::{Descriptor, Entry, OutputVtable, kind, port};
pub use host::{HostServices, level};
pub use makers::{Assets, ByteSink, FieldSink, ImporterVtable, NodeVtable, SourceVtable, StackSink};

use core::ffi::c_void;

/// Major version of the interface, which must be the same in the program and in the plugin. The
/// section *Versions* of this crate's documentation lists the promises of versions 1.x.
pub const ABI_MAJOR: u32 = 1;

/// Minor version of the interface. Additions raise it: members at the ends of structs, constants,
/// and keys of JSON.
pub const ABI_MINOR: u32 = 0;

/// Prefix of a plugin's entry symbol; the plugin's id follows the prefix. See [`Entry`].
pub const ENTRY_PREFIX: &str = "lumistack_plugin_entry_";

/// Lent UTF-8 text.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Str {
    /// First byte; not read when `len` is 0.
    pub ptr: *const u8,
    /// Number of bytes.
    pub len: usize,
}

impl Str {
    /// Lends a text.
    pub const fn new(text: &str) -> Self {
        Self { ptr: text.as_ptr(), len: text.len() }
    }
}

/// Lent bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Bytes {
    /// First byte; not read when `len` is 0.
    pub ptr: *const u8,
    /// Number of bytes.
    pub len: usize,
}

impl Bytes {
    /// Lends bytes.
    pub const fn new(bytes: &[u8]) -> Self {
        Self { ptr: bytes.as_ptr(), len: bytes.len() }
    }
}

/// Outcome of a call.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status(pub i32);

impl Status {
    /// Done.
    pub const OK: Self = Self(0);
    /// The call failed; the error text states why.
    pub const FAILED: Self = Self(1);
    /// The call stopped because the host cancelled. This does not state whether the input is valid.
    pub const CANCELLED: Self = Self(2);
    /// The callee does not support the parameters or data; the error text names them.
    pub const REFUSED: Self = Self(3);
    /// The callee panicked; the error text is the panic's message.
    pub const PANICKED: Self = Self(4);
}

/// Receives the error text of one call. The caller provides the sink, so no memory changes its
/// owner, and calls from several threads do not mix their texts.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct ErrorSink {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to `write`.
    pub context: *mut c_void,
    /// Copies `text`, which replaces an earlier text.
    pub write: unsafe extern "C" fn(context: *mut c_void, text: Str),
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::mem::{align_of, offset_of, size_of};

    /// The layout of these structs in every 64-bit C compiler. Any change except new members at the
    /// end needs a new major version.
    #[test]
    #[cfg(target_pointer_width = "64")]
    fn layouts_are_what_a_c_header_would_say() {
        assert_eq!((size_of::<Str>(), offset_of!(Str, len)), (16, 8));
        assert_eq!((size_of::<Bytes>(), offset_of!(Bytes, len)), (16, 8));
        assert_eq!((size_of::<Status>(), align_of::<Status>()), (4, 4));
        assert_eq!((offset_of!(ErrorSink, context), offset_of!(ErrorSink, write), size_of::<ErrorSink>()), (8, 16, 24));

        let descriptor = [
            offset_of!(Descriptor, abi_major),
            offset_of!(Descriptor, abi_minor),
            offset_of!(Descriptor, size),
            offset_of!(Descriptor, kind),
            offset_of!(Descriptor, ports),
            offset_of!(Descriptor, id),
            offset_of!(Descriptor, version),
            offset_of!(Descriptor, doc),
            offset_of!(Descriptor, schema_json),
            offset_of!(Descriptor, vtable),
            size_of::<Descriptor>(),
        ];
        assert_eq!(descriptor, [0, 4, 8, 16, 20, 24, 40, 56, 72, 88, 96]);

        let vtable = [
            offset_of!(OutputVtable, open),
            offset_of!(OutputVtable, submit),
            offset_of!(OutputVtable, run),
            offset_of!(OutputVtable, finish),
            offset_of!(OutputVtable, close),
            offset_of!(OutputVtable, command),
            size_of::<OutputVtable>(),
        ];
        assert_eq!(vtable, [8, 16, 24, 32, 40, 48, 56]);

        let host = [
            offset_of!(HostServices, context),
            offset_of!(HostServices, log),
            offset_of!(HostServices, progress_begin),
            offset_of!(HostServices, progress_advance),
            offset_of!(HostServices, progress_end),
            offset_of!(HostServices, is_cancelled),
            offset_of!(HostServices, file_open),
            offset_of!(HostServices, file_append),
            offset_of!(HostServices, file_commit),
            offset_of!(HostServices, file_abort),
            offset_of!(HostServices, simulate),
            offset_of!(HostServices, tell),
            offset_of!(HostServices, port),
            size_of::<HostServices>(),
        ];
        assert_eq!(host, [8, 16, 24, 32, 40, 48, 56, 64, 72, 80, 88, 96, 104, 112]);

        let data = [
            offset_of!(Data, port),
            offset_of!(Data, context),
            offset_of!(Data, description_json),
            offset_of!(Data, layer_plane),
            offset_of!(Data, emission_plane),
            offset_of!(Data, view_plane),
            offset_of!(Data, weight_plane),
            size_of::<Data>(),
        ];
        assert_eq!(data, [8, 16, 24, 40, 48, 56, 64, 72]);

        let plane = [
            offset_of!(Plane, data),
            offset_of!(Plane, dtype),
            offset_of!(Plane, ndim),
            offset_of!(Plane, shape),
            offset_of!(Plane, strides),
            offset_of!(Plane, owner),
            offset_of!(Plane, release),
            size_of::<Plane>(),
        ];
        assert_eq!(plane, [8, 16, 20, 24, 56, 88, 96, 104]);

        assert_eq!((offset_of!(ByteSink, context), offset_of!(ByteSink, write), size_of::<ByteSink>()), (8, 16, 24));
        assert_eq!((offset_of!(Assets, context), offset_of!(Assets, read), size_of::<Assets>()), (8, 16, 24));
        let importer = [offset_of!(ImporterVtable, extensions), offset_of!(ImporterVtable, import)];
        assert_eq!((importer, size_of::<ImporterVtable>()), ([8, 24], 32));
        let field =
            [offset_of!(FieldSink, context), offset_of!(FieldSink, geometry), offset_of!(FieldSink, view_plane)];
        assert_eq!((field, size_of::<FieldSink>()), ([8, 16, 24], 32));
        let stack = [
            offset_of!(StackSink, context),
            offset_of!(StackSink, brightness),
            offset_of!(StackSink, layer_plane),
            offset_of!(StackSink, emission_plane),
            offset_of!(StackSink, step),
            offset_of!(StackSink, solution),
        ];
        assert_eq!((stack, size_of::<StackSink>()), ([8, 16, 24, 32, 40, 48], 56));
        assert_eq!((offset_of!(SourceVtable, make), size_of::<SourceVtable>()), (8, 16));
        assert_eq!((offset_of!(NodeVtable, make), size_of::<NodeVtable>()), (8, 16));

        assert_eq!((offset_of!(Time, index), offset_of!(Time, seconds), size_of::<Time>()), (8, 16, 24));
        assert_eq!((offset_of!(View, kind), offset_of!(View, value), size_of::<View>()), (8, 16, 40));
    }

    #[test]
    fn every_struct_starts_with_its_size_or_its_version() {
        assert_eq!(offset_of!(Descriptor, abi_major), 0);
        let sizes = [
            offset_of!(ErrorSink, size),
            offset_of!(OutputVtable, size),
            offset_of!(HostServices, size),
            offset_of!(Data, size),
            offset_of!(Plane, size),
            offset_of!(Time, size),
            offset_of!(View, size),
            offset_of!(ByteSink, size),
            offset_of!(Assets, size),
            offset_of!(ImporterVtable, size),
            offset_of!(FieldSink, size),
            offset_of!(SourceVtable, size),
            offset_of!(StackSink, size),
            offset_of!(NodeVtable, size),
        ];
        assert_eq!(sizes, [0; 14]);
    }

    #[test]
    fn ports_are_distinct_bits() {
        let ports = [port::SCENE, port::LIGHT_FIELD, port::LAYER_STACK, port::FILE];
        assert!(ports.iter().all(|bit| bit.count_ones() == 1));
        assert_eq!(ports.iter().fold(0, |set, bit| set | bit).count_ones(), 4);
    }
}
