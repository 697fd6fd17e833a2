//! What an output is given: planes of numbers, fetched one at a time.

use core::ffi::c_void;

use crate::{ErrorSink, Status, Str};

/// Values of [`Plane::dtype`].
pub mod dtype {
    /// IEEE 754 binary32, native byte order.
    pub const F32: u32 = 1;
}

/// Values of [`View::kind`].
pub mod view {
    /// A parallel projection: `value` = slope s_x, s_y, and 0.
    pub const SLOPE: u32 = 1;
    /// A pinhole: `value` = eye x, y, z in display space, millimetres, z > 0.
    pub const EYE: u32 = 2;
}

/// A lent array of 1 to 4 axes, outermost first.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// Size of this struct in bytes; the one who wants a plane sets it.
    pub size: usize,
    /// First element. Elements need not be aligned.
    pub data: *const c_void,
    /// One of [`dtype`].
    pub dtype: u32,
    /// Number of axes in use.
    pub ndim: u32,
    /// Length of every axis; 1 beyond `ndim`.
    pub shape: [usize; 4],
    /// Bytes from one element to the next along every axis; may be negative or 0.
    pub strides: [isize; 4],
    /// Passed to `release`.
    pub owner: *mut c_void,
    /// Gives the plane back. Null: it is valid until the `submit` that fetched it returns, and nothing needs to be done.
    pub release: Option<unsafe extern "C" fn(owner: *mut c_void)>,
}

impl Plane {
    /// A plane of nothing, for a callee to fill in.
    pub const fn empty() -> Self {
        Self {
            size: size_of::<Self>(),
            data: core::ptr::null(),
            dtype: dtype::F32,
            ndim: 0,
            shape: [1; 4],
            strides: [0; 4],
            owner: core::ptr::null_mut(),
            release: None,
        }
    }
}

/// Place in a sequence.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Time {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Number of the time in this output, from 0; a still has only 0.
    pub index: u64,
    /// Time in the scene, seconds.
    pub seconds: f64,
}

/// A place to look at the display from.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Size of this struct in bytes.
    pub size: usize,
    /// One of [`view`].
    pub kind: u32,
    /// Meaning by `kind`.
    pub value: [f64; 3],
}

/// One time's data, lent until `submit` returns. Functions that do not fit `port` return [`Status::REFUSED`]. May be read from
/// several threads.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Data {
    /// Size of this struct in bytes.
    pub size: usize,
    /// One bit of [`port`](crate::port): what this is.
    pub port: u32,
    /// Passed to every function.
    pub context: *const c_void,
    /// Shapes and geometry. A layer stack: `{"port": "layer_stack", "brightness", "frames", "layers": [[rows, cols], ...] (rearmost
    /// first), "emission": [bins_y, bins_x, lenslet_rows, lenslet_cols] or null, "target": geometry, "target_views": whether `view_plane` lends
    /// the target's views, "target_depth": depth}`. A light field: `{"port":
    /// "light_field", "geometry": geometry, "depth": depth}`, and for a node also `"seed"`, `"weights": {"per_view": [[...], ...]}` or `"per_ray"` (see `weight_plane`;
    /// left out where all rays count alike), and `"start": {"brightness"}` where there are patterns to begin from, of the display's own
    /// shape, which `layer_plane` and `emission_plane` lend. A depth, left out where nobody knows it: how deep the view [view rows / 2, view columns / 2]
    /// sees, `{"rows", "cols", "z_mm": [row by row, millimetres towards the viewer, null where nothing is met]}`; it may be coarser than the views. A geometry: `{"rows", "cols", "pitch_mm", "projection": "oblique" | "perspective",
    /// "distance_mm", "slope_x": [...], "slope_y": [...]}`.
    pub description_json: Str,
    /// Transmittance `[row][col][rgb]` of one layer (0 = rearmost) and frame, linear, 0..1.
    pub layer_plane: unsafe extern "C" fn(
        context: *const c_void,
        layer: usize,
        frame: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a directional backlight, linear, 0..1.
    pub emission_plane: unsafe extern "C" fn(
        context: *const c_void,
        frame: usize,
        bin_y: usize,
        bin_x: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Linear radiance `[row][col][rgb]` of one view of a light field, or of a layer stack's target where it has views.
    pub view_plane: unsafe extern "C" fn(
        context: *const c_void,
        view_y: usize,
        view_x: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Weights `[row][col][1]`, not below 0, of the rays of one view, where the description says `"per_ray"`. Since version 0.3.
    pub weight_plane: unsafe extern "C" fn(
        context: *const c_void,
        view_y: usize,
        view_x: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
}
