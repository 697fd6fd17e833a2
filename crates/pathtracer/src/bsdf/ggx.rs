//! The GGX microfacet distribution with Smith's height-correlated masking and shadowing, isotropic.
//!
//! D(h) = 1 / (π α² ((h_x² + h_y²)/α² + h_z²)²), V = G₂ / (4 |o_z| |i_z|) (Walter et al. 2007; Heitz 2014). Directions are unit
//! vectors in the frame whose z is the shading normal; the outgoing direction o points to the viewer and has o_z > 0.
//! Normals are sampled as the viewer sees them (Heitz 2018), by the spherical-cap construction of Dupuy, Benyoub 2023.

use std::f32::consts::PI;

use glam::Vec3;

use crate::math::sin_cos_turns;

/// Density of microfacet normals per solid angle; the components of `h` avoid the cancellation of 1 − cos².
#[inline]
pub(crate) fn density(h: Vec3, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let s = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
    1.0 / (PI * a2 * s * s)
}

/// √(α² + (1 − α²) cos²θ), from which all of Smith's terms are made.
#[inline]
fn smith_root(cos_theta: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    (a2 + (1.0 - a2) * cos_theta * cos_theta).sqrt()
}

/// V = G₂ / (4 |o_z| |i_z|); the same for reflection and, with |i_z|, transmission.
#[inline]
pub(crate) fn visibility(o_z: f32, i_z: f32, alpha: f32) -> f32 {
    let (o_z, i_z) = (o_z.abs(), i_z.abs());
    0.5 / (i_z * smith_root(o_z, alpha) + o_z * smith_root(i_z, alpha)).max(f32::MIN_POSITIVE)
}

/// Density per solid angle of the reflected direction that [`sample_normal`] leads to: G₁(o) D(h) / (4 o_z).
#[inline]
pub(crate) fn reflection_pdf(o: Vec3, h: Vec3, alpha: f32) -> f32 {
    density(h, alpha) / (2.0 * (o.z + smith_root(o.z, alpha)))
}

/// Density per solid angle of the normal that [`sample_normal`] returns: G₁(o) D(h) (o·h) / o_z.
#[inline]
pub(crate) fn normal_pdf(o: Vec3, h: Vec3, alpha: f32) -> f32 {
    4.0 * o.dot(h).max(0.0) * reflection_pdf(o, h, alpha)
}

/// G₂/G₁, the weight of a sampled normal.
#[inline]
pub(crate) fn masking_ratio(o_z: f32, i_z: f32, alpha: f32) -> f32 {
    let i_z = i_z.abs();
    let (root_o, root_i) = (smith_root(o_z, alpha), smith_root(i_z, alpha));
    i_z * (o_z + root_o) / (i_z * root_o + o_z * root_i).max(f32::MIN_POSITIVE)
}

/// A visible microfacet normal for two uniform numbers.
#[inline]
pub(crate) fn sample_normal(o: Vec3, alpha: f32, u: [f32; 2]) -> Vec3 {
    let stretched = Vec3::new(alpha * o.x, alpha * o.y, o.z).normalize();
    let (sin_phi, cos_phi) = sin_cos_turns(u[0]);
    let z = (1.0 - u[1]) * (1.0 + stretched.z) - stretched.z;
    let sin_theta = (1.0 - z * z).max(0.0).sqrt();
    let cap = Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, z) + stretched;
    Vec3::new(alpha * cap.x, alpha * cap.y, cap.z.max(0.0)).try_normalize().unwrap_or(Vec3::Z)
}

/// Reflection of `o` about `h`.
#[inline]
pub(crate) fn reflect(o: Vec3, h: Vec3) -> Vec3 {
    2.0 * o.dot(h) * h - o
}
