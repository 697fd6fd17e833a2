//! Plugins that make something: importers (scenes), sources (light fields) and nodes (layer stacks). Each is one function that runs to its end
//! and hands what it made to a sink, piece by piece; the host checks all of it.

use core::ffi::c_void;

use crate::{Bytes, Data, ErrorSink, HostServices, Plane, Status, Str, Time};

/// Takes bytes, in order.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct ByteSink {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to `write`.
    pub context: *mut c_void,
    /// Copies the bytes behind those of earlier calls.
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
    /// Reads a whole file; `path` is relative to the folder of the imported file, with `/` between its parts.
    pub read: unsafe extern "C" fn(
        context: *const c_void,
        path: Str,
        bytes: *const ByteSink,
        error: *const ErrorSink,
    ) -> Status,
}

/// Functions of an importer: a file of some format becomes a glTF 2.0 document.
///
/// glTF is the form in which a scene crosses the boundary: JSON and planes of numbers, public, with a validator on the host's side.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct ImporterVtable {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Extensions of the files that it takes: lower case, without the dot, separated by spaces.
    pub extensions: Str,
    /// Reads the file `file` (a name to be read through `assets`) and writes a whole `.glb` or `.gltf` to `scene`. Files that the document
    /// refers to are read beside the imported file. `host` offers messages, progress and cancellation, and no files.
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

// SAFETY: a table of functions and all that it points to are immutable and live as long as the process.
unsafe impl Send for ImporterVtable {}
// SAFETY: as above.
unsafe impl Sync for ImporterVtable {}

/// Takes a light field.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct FieldSink {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to every function.
    pub context: *mut c_void,
    /// Pixels and views, as the geometry in [`Data::description_json`]; once, before the first view.
    pub geometry: unsafe extern "C" fn(context: *mut c_void, geometry_json: Str, error: *const ErrorSink) -> Status,
    /// Copies the linear radiance `[row][col][rgb]` of one view: finite and not below 0. Every view is given exactly once, in any order.
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
    /// Makes the light field of one time; the display's own geometry is what is wanted, another is taken as it is. `host` as for importers.
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

/// Takes a layer stack of the display that the node was given. Functions may not be called from several threads at once.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct StackSink {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Passed to every function.
    pub context: *mut c_void,
    /// Brightness β, above 0 and at most 1: the patterns are to emit β times the target. Without this call the display's.
    pub brightness: unsafe extern "C" fn(context: *mut c_void, brightness: f64, error: *const ErrorSink) -> Status,
    /// Copies the values `[row][col][rgb]` of one layer (0 = rearmost) and frame, linear, 0..1. Every one is given exactly once.
    pub layer_plane: unsafe extern "C" fn(
        context: *mut c_void,
        layer: usize,
        frame: usize,
        plane: *const Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Copies the emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a directional backlight, linear, 0..1. Every one is
    /// given exactly once.
    pub emission_plane: unsafe extern "C" fn(
        context: *mut c_void,
        frame: usize,
        bin_y: usize,
        bin_x: usize,
        plane: *const Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Reports how far an iterative method is: its objective after `iteration` iterations (0: at the start), which the method makes small, and the PSNR of
    /// what is shown against the target, dB; NaN where it is not known. Optional, in order. Since version 0.3.
    pub step: unsafe extern "C" fn(
        context: *mut c_void,
        iteration: u32,
        objective: f64,
        psnr_view_db: f64,
        error: *const ErrorSink,
    ) -> Status,
    /// Reports how an iterative method came to the patterns: `{"solver", "start", "coarse_levels": levels of half the resolution before the first iteration,
    /// "unsettled": root mean square of the change of the emission that a further exact step would make, "levels": [continuous, rounded, re-optimized] PSNR
    /// in dB for panels of few bits, or null}`. Optional, once. Since version 0.3.
    pub solution: unsafe extern "C" fn(context: *mut c_void, solution_json: Str, error: *const ErrorSink) -> Status,
}

/// Functions of a node, which makes the layer stack of a display from a light field.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct NodeVtable {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Makes the patterns of one time; `data` is a light field of the display's own geometry, with what else its description names. `host` as for importers.
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
