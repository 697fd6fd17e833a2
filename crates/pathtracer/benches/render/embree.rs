//! Calls Embree 4, from its Python wheel. The loop over rays is the same as for Lumistack, so the
//! loop costs both libraries the same time.
//!
//! The library is opened at run time. Constants and layouts are copied from Embree 4's `rtcore`
//! headers.

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::path::Path;
use std::ptr::null_mut;

use glam::Vec3;

use crate::case::Outcome;

/// A scene of one triangle mesh.
pub struct Embree {
    scene: *mut c_void,
    intersect1: unsafe extern "C" fn(*mut c_void, *mut RayHit, *mut c_void),
    intersect8: unsafe extern "C" fn(*const c_int, *mut c_void, *mut RayHit8, *mut Arguments),
    occluded1: unsafe extern "C" fn(*mut c_void, *mut RayHit, *mut c_void),
    /// Vertices and indices, which Embree reads as long as the scene lives.
    _arrays: (Vec<f32>, Vec<u32>),
}

// SAFETY: Embree's queries may run on any number of threads once the scene is committed, which
// `new` does
unsafe impl Sync for Embree {}

/// `RTCRayHit`, followed by unused memory for fields of other versions.
#[repr(C, align(16))]
struct RayHit {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: u32,
    id: u32,
    flags: u32,
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: u32,
    geometry: u32,
    instance: [u32; 2],
    rest: [u32; 12],
}

/// `RTCRayHit8`, followed by unused memory for fields of other versions.
#[repr(C, align(32))]
struct RayHit8 {
    origin: [[f32; 8]; 3],
    near: [f32; 8],
    direction: [[f32; 8]; 3],
    time: [f32; 8],
    far: [f32; 8],
    mask: [u32; 8],
    id: [u32; 8],
    flags: [u32; 8],
    normal: [[f32; 8]; 3],
    uv: [[f32; 8]; 2],
    primitive: [u32; 8],
    geometry: [u32; 8],
    instance: [[u32; 8]; 2],
    rest: [[u32; 8]; 4],
}

/// `RTCIntersectArguments`, followed by unused memory for fields of other versions.
#[repr(C)]
struct Arguments {
    flags: u32,
    features: u32,
    context: *mut c_void,
    filter: *mut c_void,
    intersect: *mut c_void,
    rest: [u64; 4],
}

const COHERENT: u32 = 1 << 16;
const NOTHING: u32 = u32::MAX;
const FORMAT_FLOAT3: c_uint = 0x9003;
const FORMAT_UINT3: c_uint = 0x5003;
const QUALITY_HIGH: c_uint = 2;

unsafe extern "C" {
    fn dlopen(file: *const c_char, flags: c_int) -> *mut c_void;
    fn dlsym(library: *mut c_void, name: *const c_char) -> *mut c_void;
}

impl Embree {
    /// Opens the library, and lets it build a tree of its highest quality.
    pub fn new(library: &Path, triangles: &[[Vec3; 3]]) -> Outcome<Self> {
        let path = CString::new(library.to_string_lossy().as_bytes())?;
        const NOW: c_int = 2;
        // SAFETY: the path is a C string; the library's initializers are as trusted as the library
        let handle = unsafe { dlopen(path.as_ptr(), NOW) };
        if handle.is_null() {
            return Err(format!("{}: expected a library that can be opened", library.display()).into());
        }
        let symbol = |name: &CStr| -> Outcome<*mut c_void> {
            // SAFETY: handle and name are valid
            let found = unsafe { dlsym(handle, name.as_ptr()) };
            if found.is_null() { Err(format!("Embree: expected the function {name:?}").into()) } else { Ok(found) }
        };
        let mut vertices: Vec<f32> = triangles.iter().flatten().flat_map(|v| v.to_array()).collect();
        // Embree may read four values per vertex
        vertices.push(0.0);
        let indices: Vec<u32> = (0..3 * triangles.len() as u32).collect();
        type Pointer = *mut c_void;
        // SAFETY: names and signatures are copied from the headers; the arrays live as long as the
        // scene
        unsafe {
            let new_device: extern "C" fn(*const c_char) -> Pointer = std::mem::transmute(symbol(c"rtcNewDevice")?);
            let new_scene: extern "C" fn(Pointer) -> Pointer = std::mem::transmute(symbol(c"rtcNewScene")?);
            let quality: extern "C" fn(Pointer, c_uint) = std::mem::transmute(symbol(c"rtcSetSceneBuildQuality")?);
            let new_geometry: extern "C" fn(Pointer, c_uint) -> Pointer =
                std::mem::transmute(symbol(c"rtcNewGeometry")?);
            let share: extern "C" fn(Pointer, c_uint, c_uint, c_uint, *const c_void, usize, usize, usize) =
                std::mem::transmute(symbol(c"rtcSetSharedGeometryBuffer")?);
            let commit_geometry: extern "C" fn(Pointer) = std::mem::transmute(symbol(c"rtcCommitGeometry")?);
            let attach: extern "C" fn(Pointer, Pointer) -> c_uint = std::mem::transmute(symbol(c"rtcAttachGeometry")?);
            let commit: extern "C" fn(Pointer) = std::mem::transmute(symbol(c"rtcCommitScene")?);
            let device = new_device(c"threads=2".as_ptr());
            if device.is_null() {
                return Err("Embree: expected a device, found none".into());
            }
            let scene = new_scene(device);
            quality(scene, QUALITY_HIGH);
            let geometry = new_geometry(device, 0);
            share(geometry, 1, 0, FORMAT_FLOAT3, vertices.as_ptr().cast(), 0, 12, 3 * triangles.len());
            share(geometry, 0, 0, FORMAT_UINT3, indices.as_ptr().cast(), 0, 12, triangles.len());
            commit_geometry(geometry);
            attach(scene, geometry);
            commit(scene);
            Ok(Self {
                scene,
                intersect1: std::mem::transmute::<Pointer, unsafe extern "C" fn(Pointer, *mut RayHit, Pointer)>(
                    symbol(c"rtcIntersect1")?,
                ),
                intersect8: std::mem::transmute::<
                    Pointer,
                    unsafe extern "C" fn(*const c_int, Pointer, *mut RayHit8, *mut Arguments),
                >(symbol(c"rtcIntersect8")?),
                occluded1: std::mem::transmute::<Pointer, unsafe extern "C" fn(Pointer, *mut RayHit, Pointer)>(symbol(
                    c"rtcOccluded1",
                )?),
                _arrays: (vertices, indices),
            })
        }
    }

    /// Returns the same as [`lumistack_pathtracer::rays::Tree::nearest`].
    #[inline]
    pub fn nearest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<(f32, u32)> {
        let mut query = RayHit::new(origin, direction, t_max);
        // SAFETY: the scene is committed and the structure is large enough
        unsafe { (self.intersect1)(self.scene, &mut query, null_mut()) };
        (query.geometry != NOTHING).then_some((query.far, query.primitive))
    }

    /// Returns the same as [`lumistack_pathtracer::rays::Tree::is_open`].
    #[inline]
    pub fn is_open(&self, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
        let mut query = RayHit::new(origin, direction, t_max);
        // SAFETY: as in `nearest`; Embree uses only the fields of the ray
        unsafe { (self.occluded1)(self.scene, &mut query, null_mut()) };
        query.far >= 0.0
    }

    /// Traces up to eight coherent rays, and returns the number of rays that hit.
    pub fn nearest8(&self, rays: &[(Vec3, Vec3, f32)]) -> usize {
        // SAFETY: all zeroes are valid numbers
        let mut query: RayHit8 = unsafe { std::mem::zeroed() };
        let mut valid = Lanes([0; 8]);
        for (lane, (origin, direction, t_max)) in rays.iter().enumerate() {
            for axis in 0..3 {
                query.origin[axis][lane] = origin[axis];
                query.direction[axis][lane] = direction[axis];
            }
            query.far[lane] = *t_max;
            query.mask[lane] = u32::MAX;
            valid.0[lane] = -1;
        }
        query.geometry = [NOTHING; 8];
        let mut arguments = Arguments {
            flags: COHERENT,
            features: u32::MAX,
            context: null_mut(),
            filter: null_mut(),
            intersect: null_mut(),
            rest: [0; 4],
        };
        // SAFETY: the scene is committed, structures are aligned and large enough
        unsafe { (self.intersect8)(valid.0.as_ptr(), self.scene, &mut query, &mut arguments) };
        query.geometry[..rays.len()].iter().filter(|&&geometry| geometry != NOTHING).count()
    }
}

#[repr(align(32))]
struct Lanes([c_int; 8]);

impl RayHit {
    #[inline]
    fn new(origin: Vec3, direction: Vec3, t_max: f32) -> Self {
        Self {
            origin: origin.to_array(),
            near: 0.0,
            direction: direction.to_array(),
            time: 0.0,
            far: t_max,
            mask: u32::MAX,
            id: 0,
            flags: 0,
            normal: [0.0; 3],
            uv: [0.0; 2],
            primitive: NOTHING,
            geometry: NOTHING,
            instance: [NOTHING; 2],
            rest: [0; 12],
        }
    }
}
