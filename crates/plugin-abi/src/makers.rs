//! Plugins that make data: importers (scenes), sources (light fields) and nodes (layer stacks).
//!
//! Each plugin is one function that passes its result to a sink, piece by piece. The host checks
//! every piece. Two threads must never call functions of one sink at the same time.

use core::ffi::c_void;

use crate::{Bytes, Data, ErrorSink, HostServices, Plane, Status, Str, Time};

/// Receives a sequence of bytes, piece by piece.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct ByteSink {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to `write`.
    pub context: *mut c_void,
    /// Appends a copy of the bytes.
    pub write: unsafe extern "C" fn(context: *mut c_void, bytes: Bytes, error: *const ErrorSink) -> Status,
}

/// Files that an importer may read.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Assets {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to `read`.
    pub context: *const c_void,
    /// Reads a whole file. `path` is relative to the folder of the imported file, with `/` between
    /// names.
    pub read: unsafe extern "C" fn(
        context: *const c_void,
        path: Str,
        bytes: *const ByteSink,
        error: *const ErrorSink,
    ) -> Status,
}

/// Functions of an importer, which converts a file to a glTF 2.0 document.
///
/// A scene crosses the interface as glTF: a public format of JSON and arrays, which the host
/// validates.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct ImporterVtable {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Extensions of the files that the importer reads: lower case, without the dot, separated by
    /// spaces.
    pub extensions: Str,
    /// Reads the file `file`, a path for `read` of `assets`, and writes a whole `.glb` or `.gltf`
    /// to `scene`. The document may refer to files in the imported file's folder. `host` offers
    /// messages, progress and cancellation, but no files.
    pub import: Option<
        unsafe extern "C" fn(
            host: *const HostServices,
            params_json: Str,
            file: Str,
            assets: *const Assets,
            scene: *const ByteSink,
            error: *const ErrorSink,
        ) -> Status,
    >,
}

// SAFETY: a table of functions and all that it points to are immutable and live as long as the
// process.
unsafe impl Send for ImporterVtable {}
// SAFETY: as above.
unsafe impl Sync for ImporterVtable {}

/// Receives a light field.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FieldSink {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to every function.
    pub context: *mut c_void,
    /// Sets the light field's geometry, in the form of a geometry in [`Data::description_json`].
    /// Called once, before the first view.
    pub geometry: unsafe extern "C" fn(context: *mut c_void, geometry_json: Str, error: *const ErrorSink) -> Status,
    /// Copies the linear radiance `[row][col][rgb]` of one view, finite and at least 0. Called
    /// exactly once for every view, in any order.
    pub view_plane: unsafe extern "C" fn(
        context: *mut c_void,
        view_y: usize,
        view_x: usize,
        plane: *const Plane,
        error: *const ErrorSink,
    ) -> Status,
}

/// Functions of a source, which makes a light field.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct SourceVtable {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Makes the light field of one time step. It should have the display's geometry; the host
    /// accepts other geometries. `host` offers messages, progress and cancellation, but no files.
    pub make: Option<
        unsafe extern "C" fn(
            host: *const HostServices,
            params_json: Str,
            display_json: Str,
            time: *const Time,
            field: *const FieldSink,
            error: *const ErrorSink,
        ) -> Status,
    >,
}

/// Receives a layer stack for the node's display. Two threads must never call these functions at
/// the same time.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct StackSink {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to every function.
    pub context: *mut c_void,
    /// Sets the brightness β, above 0 and at most 1: the patterns emit β times the target. Without
    /// this call β is the brightness in the display file.
    pub brightness: unsafe extern "C" fn(context: *mut c_void, brightness: f64, error: *const ErrorSink) -> Status,
    /// Copies the values `[row][col][rgb]` of one layer (0 = rearmost) and frame, linear, 0..1.
    /// Called exactly once for each layer and frame.
    pub layer_plane: unsafe extern "C" fn(
        context: *mut c_void,
        layer: usize,
        frame: usize,
        plane: *const Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Copies the emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a
    /// directional backlight, linear, 0..1. Called exactly once for each bin and frame.
    pub emission_plane: unsafe extern "C" fn(
        context: *mut c_void,
        frame: usize,
        bin_y: usize,
        bin_x: usize,
        plane: *const Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Reports the progress of an iterative method; nodes may omit this call. `objective` is the
    /// value that the method minimizes, after `iteration` iterations. Iteration 0 is the start, and
    /// `iteration` must increase from call to call. `psnr_view_db` is the PSNR of the emitted light
    /// field against the target, dB; NaN if it is unknown.
    pub step: unsafe extern "C" fn(
        context: *mut c_void,
        iteration: u32,
        objective: f64,
        psnr_view_db: f64,
        error: *const ErrorSink,
    ) -> Status,
    /// Reports the result of an iterative method: `{"solver", "start", "coarse_levels",
    /// "kkt_residual", "levels"}`. Nodes may omit this call, and make it at most once.
    ///
    /// * `coarse_levels`: number of coarser resolutions, each half the next finer one, that were
    ///   solved first.
    /// * `kkt_residual`: an exact update of a single value of the patterns would change the emitted
    ///   light field. The residual is the root mean square of these changes, over all values that
    ///   may change.
    /// * `levels`: PSNR in dB of [continuous, rounded, re-optimized] patterns for panels of few
    ///   bits, or null.
    pub solution: unsafe extern "C" fn(context: *mut c_void, solution_json: Str, error: *const ErrorSink) -> Status,
}

/// Functions of a node, which makes the layer stack of a display from a light field.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct NodeVtable {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Makes the patterns of one time step. `data` is a light field of the display's geometry; its
    /// description has the further keys for nodes that [`Data::description_json`] lists. `host`
    /// offers messages, progress and cancellation, but no files.
    pub make: Option<
        unsafe extern "C" fn(
            host: *const HostServices,
            params_json: Str,
            display_json: Str,
            time: *const Time,
            data: *const Data,
            stack: *const StackSink,
            error: *const ErrorSink,
        ) -> Status,
    >,
}
