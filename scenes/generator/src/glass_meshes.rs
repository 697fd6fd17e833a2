//! The unusual meshes of the scene `glass`: a rippled plate (sparse accessors), a paper ribbon
//! (triangle strip), and a cut gem (no indices).

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};
use serde_json::{Value, json};

use crate::gltf_document::{Document, TRIANGLE_STRIP, TRIANGLES};
use crate::mesh::Mesh;

/// Number of cells along each side of the plate.
const PLATE_CELLS: u32 = 48;
/// Radius of the area with waves, in half-widths of the plate; outside of it the plate is flat.
const RIPPLE_RADIUS: f64 = 0.8;
/// Height of the wave in the plate's middle, in half-widths of the plate.
const RIPPLE_HEIGHT: f64 = 0.035;
/// Number of waves between the plate's middle and [`RIPPLE_RADIUS`].
const RIPPLES: f64 = 3.0;

/// Makes a square plate of half-width 1 in the plane y = 0, with circular waves (rings) around its
/// middle.
///
/// The accessors for positions and normals contain the flat plate, and the rings as sparse entries.
pub(crate) fn rippled_plate(document: &mut Document, material: usize) -> Value {
    let place = |u: f64, v: f64| DVec3::new(2.0 * u - 1.0, 0.0, 2.0 * v - 1.0);
    let flat = Mesh::grid(PLATE_CELLS, PLATE_CELLS, |u, v| (place(u, v), DVec3::Y));
    let rippled = Mesh::grid(PLATE_CELLS, PLATE_CELLS, |u, v| {
        let point = place(u, v);
        let (height, slope) = ripple(point.x.hypot(point.z));
        let outwards = DVec3::new(point.x, 0.0, point.z).normalize_or_zero();
        (point + DVec3::Y * height, (DVec3::Y - slope * outwards).normalize())
    });
    let rows = |points: &[DVec3]| -> Vec<[f32; 3]> { points.iter().map(|point| point.as_vec3().to_array()).collect() };
    let positions = document.add_sparse(&rows(&flat.positions), &rows(&rippled.positions));
    let normals = document.add_sparse(&rows(&flat.normals), &rows(&rippled.normals));
    let indices = document.add_indices(&flat.indices);
    json!({
        "attributes": { "POSITION": positions, "NORMAL": normals },
        "indices": indices, "material": material, "mode": TRIANGLES
    })
}

/// Returns height and slope of the rings at the distance r from the middle. With q = r/R, the
/// height is h = a (1 − q²)² (1 + cos 2πnq)/2. Here a is [`RIPPLE_HEIGHT`], n is [`RIPPLES`] and R
/// is [`RIPPLE_RADIUS`].
fn ripple(radius: f64) -> (f64, f64) {
    let q = radius / RIPPLE_RADIUS;
    if q >= 1.0 {
        return (0.0, 0.0);
    }
    let (sin, cos) = (TAU * RIPPLES * q).sin_cos();
    let (fade, wave) = ((1.0 - q * q).powi(2), 0.5 + 0.5 * cos);
    let (fade_slope, wave_slope) = (-4.0 * q * (1.0 - q * q), -0.5 * TAU * RIPPLES * sin);
    let slope = RIPPLE_HEIGHT * (fade_slope * wave + fade * wave_slope) / RIPPLE_RADIUS;
    (RIPPLE_HEIGHT * fade * wave, slope)
}

/// Makes a wavy strip of paper that stands on its edge on y = 0, as one triangle strip without
/// indices.
///
/// The strip is `length` long in x and `height` high. It has one and a half waves of the amplitude
/// `swing` in z.
pub(crate) fn paper_ribbon(document: &mut Document, [length, height, swing]: [f64; 3], material: usize) -> Value {
    const STEPS: u32 = 64;
    const WAVES: f64 = 1.5;
    let mut positions = Vec::new();
    let mut normals = Vec::new();
    let mut texcoords = Vec::new();
    for step in 0..=STEPS {
        let u = f64::from(step) / f64::from(STEPS);
        let (sin, cos) = (TAU * WAVES * u).sin_cos();
        let slope = swing * TAU * WAVES * cos / length;
        let normal = DVec3::new(-slope, 0.0, 1.0).normalize();
        // the top vertex precedes the bottom vertex, so that the first triangle is
        // counter-clockwise seen from +z
        for (v, y) in [(0.0, height), (1.0, 0.0)] {
            positions.push(DVec3::new((u - 0.5) * length, y, swing * sin).as_vec3().to_array());
            normals.push(normal.as_vec3().to_array());
            texcoords.push(DVec2::new(u, v).as_vec2().to_array());
        }
    }
    let attributes = json!({
        "POSITION": document.add_floats(&positions, true),
        "NORMAL": document.add_floats(&normals, true),
        "TEXCOORD_0": document.add_floats(&texcoords, true)
    });
    json!({ "attributes": attributes, "material": material, "mode": TRIANGLE_STRIP })
}

/// Makes a cut gem of radius 1 that stands on its point. Its triangles have neither indices nor
/// normals, for which the glTF specification defines flat shading.
pub(crate) fn cut_gem(document: &mut Document, material: usize) -> Value {
    const SIDES: u32 = 8;
    let ring = |k: u32, half_steps: u32, radius: f64, height: f64| {
        let (sin, cos) = (TAU * f64::from(2 * (k % SIDES) + half_steps) / f64::from(2 * SIDES)).sin_cos();
        DVec3::new(radius * sin, height, radius * cos)
    };
    let girdle = |k: u32| ring(k, 0, 1.0, 1.1);
    let crown = |k: u32| ring(k, 1, 0.6, 1.5);
    let mut corners = Vec::new();
    for k in 0..SIDES {
        corners.extend([girdle(k), DVec3::ZERO, girdle(k + 1)]);
        corners.extend([girdle(k), girdle(k + 1), crown(k)]);
        corners.extend([crown(k), girdle(k + 1), crown(k + 1)]);
        corners.extend([crown(k), crown(k + 1), DVec3::Y * 1.5]);
    }
    let positions: Vec<_> = corners.iter().map(|corner| corner.as_vec3().to_array()).collect();
    let attributes = json!({ "POSITION": document.add_floats(&positions, true) });
    json!({ "attributes": attributes, "material": material })
}
