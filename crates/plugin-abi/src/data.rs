//! The data that an output or node receives: planes of numbers, fetched one by one.

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

/// A lent array of 1 to 4 axes, the outermost axis first.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// Size of this struct in bytes. The caller that requests a plane sets it.
    pub size: usize,
    /// First element. Elements need not be aligned.
    pub data: *const c_void,
    /// One of [`dtype`].
    pub dtype: u32,
    /// Number of axes in use.
    pub ndim: u32,
    /// Length of every axis; 1 for the axes past `ndim`.
    pub shape: [usize; 4],
    /// Bytes from one element to the next along every axis; may be negative or 0.
    pub strides: [isize; 4],
    /// Passed to `release`.
    pub owner: *mut c_void,
    /// Releases the plane. If null, the plane needs no release: it stays valid until the `submit`
    /// or `make` that fetched it returns.
    pub release: Option<unsafe extern "C" fn(owner: *mut c_void)>,
}

impl Plane {
    /// An empty plane, which a callee fills in.
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

/// Position of a time step in a sequence.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Time {
    /// Size of this struct in bytes.
    pub size: usize,
    /// Number of the time step. For outputs and nodes the first number is 0; a still has the number
    /// 0. For a source the job sets the first number.
    pub index: u64,
    /// Time in the scene, seconds.
    pub seconds: f64,
}

/// Direction or eye position from which the display is seen.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Size of this struct in bytes.
    pub size: usize,
    /// One of [`view`].
    pub kind: u32,
    /// Direction or eye position; its meaning depends on `kind`.
    pub value: [f64; 3],
}

/// Data of a time step, lent until `submit` or `make` returns. A function returns
/// [`Status::REFUSED`] if the data do not contain its plane. Several threads may call the functions
/// in parallel.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Data {
    /// Size of this struct in bytes.
    pub size: usize,
    /// One bit of [`port`](crate::port): the kind of the data.
    pub port: u32,
    /// Passed to every function.
    pub context: *const c_void,
    /// Shapes and geometry as JSON.
    ///
    /// * A layer stack: `{"port": "layer_stack", "brightness", "frames", "layers": [[rows, cols],
    ///   ...], "emission", "target": geometry, "target_views", "target_depth": depth}`. `layers`
    ///   begins with the rearmost layer. `emission` is null or `[bins_y, bins_x, lenslet_rows,
    ///   lenslet_cols]`. `target_views` is true if `view_plane` lends the target's views.
    /// * A light field: `{"port": "light_field", "geometry": geometry, "depth": depth}`.
    /// * A node's light field also has `"seed"`, `"weights"` and `"start"`. `weights` is
    ///   `{"per_view": [[...], ...]}` or `"per_ray"` (see `weight_plane`); without it all rays have
    ///   the same weight. `start` is `{"brightness"}` if there is a warm start. The warm start's
    ///   patterns have the display's shape; `layer_plane` and `emission_plane` lend them.
    /// * A depth: `{"rows", "cols", "z_mm": [...]}`, row by row, in millimetres towards the viewer,
    ///   null for a miss. It belongs to the view [view rows / 2, view columns / 2], and may be
    ///   coarser than the views. If the depth is unknown, the keys `depth` and `target_depth` are
    ///   left out.
    /// * A geometry: `{"rows", "cols", "pitch_mm", "projection": "oblique" | "perspective",
    ///   "distance_mm", "slope_x": [...], "slope_y": [...]}`.
    pub description_json: Str,
    /// Transmittance `[row][col][rgb]` of one layer (0 = rearmost) and frame, linear, 0..1.
    pub layer_plane: unsafe extern "C" fn(
        context: *const c_void,
        layer: usize,
        frame: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame of a directional
    /// backlight, linear, 0..1.
    pub emission_plane: unsafe extern "C" fn(
        context: *const c_void,
        frame: usize,
        bin_y: usize,
        bin_x: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Linear radiance `[row][col][rgb]` of one view: of a light field, or of a layer stack's
    /// target if `target_views` is true.
    pub view_plane: unsafe extern "C" fn(
        context: *const c_void,
        view_y: usize,
        view_x: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
    /// Weights `[row][col][1]`, at least 0, of the rays of one view, if `weights` of the
    /// description is `"per_ray"`.
    pub weight_plane: unsafe extern "C" fn(
        context: *const c_void,
        view_y: usize,
        view_x: usize,
        plane: *mut Plane,
        error: *const ErrorSink,
    ) -> Status,
}
