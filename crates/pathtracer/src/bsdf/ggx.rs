//! The anisotropic GGX distribution D of microfacet normals h, with Smith's height-correlated
//! masking and shadowing G₂.
//!
//! ```text
//! D(h) = 1 / (π α_x α_y (h_x²/α_x² + h_y²/α_y² + h_z²)²)         V = G₂ / (4 |o_z| |i_z|)
//! ```
//!
//! (Walter et al. 2007; Heitz 2014.) Directions are unit vectors in a frame whose z is the shading
//! normal and whose x is the direction of stretch. The direction o, with o_z > 0, points to the
//! viewer. The direction i points to the light.
//!
//! Normals are sampled by the area that the viewer sees (Heitz 2018), with the spherical-cap
//! construction of Dupuy, Benyoub 2023. Where only the reflected direction matters, most normals
//! that reflect below the horizon are left out (Eto, Tokuyoshi 2023, "Bounded VNDF sampling for
//! Smith–GGX reflections").

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use crate::math::sin_cos_turns;

/// Returns the density D(h) of microfacet normals per solid angle. It is computed from the
/// components of `h`, since 1 − cos² would lose digits.
#[inline]
pub(crate) fn density(h: Vec3, alpha: Vec2) -> f32 {
    let (x, y) = (h.x / alpha.x, h.y / alpha.y);
    let s = x * x + y * y + h.z * h.z;
    1.0 / (PI * alpha.x * alpha.y * s * s)
}

/// Returns √(α_x² v_x² + α_y² v_y² + v_z²). All of Smith's terms follow from this root. For
/// example, 1 + 2Λ is the root divided by |v_z|.
#[inline]
fn smith_root(v: Vec3, alpha: Vec2) -> f32 {
    let (x, y) = (alpha.x * v.x, alpha.y * v.y);
    (x * x + y * y + v.z * v.z).sqrt()
}

/// Returns the visibility V = G₂ / (4 |o_z| |i_z|). The formula holds for reflection and for
/// transmission.
#[inline]
pub(crate) fn visibility(o: Vec3, i: Vec3, alpha: Vec2) -> f32 {
    let (o_z, i_z) = (o.z.abs(), i.z.abs());
    0.5 / (i_z * smith_root(o, alpha) + o_z * smith_root(i, alpha)).max(f32::MIN_POSITIVE)
}

/// Returns the density per solid angle of the direction `i` to which a normal `h` of
/// [`sample_normal`] reflects `o`: G₁(o) D(h) / (4 o_z). The formula holds if `i` is above the
/// horizon.
#[inline]
pub(crate) fn reflection_pdf(o: Vec3, h: Vec3, alpha: Vec2) -> f32 {
    density(h, alpha) / (2.0 * (o.z + smith_root(o, alpha)))
}

/// Returns [`density`] times [`visibility`], and the density per solid angle with which
/// [`sample_reflection`] finds `i`.
#[inline]
pub(crate) fn reflection(o: Vec3, i: Vec3, h: Vec3, alpha: Vec2) -> (f32, f32) {
    let (density, root_o, root_i) = (density(h, alpha), smith_root(o, alpha), smith_root(i, alpha));
    let (o_z, i_z) = (o.z.abs(), i.z.abs());
    let visibility = 0.5 / (i_z * root_o + o_z * root_i).max(f32::MIN_POSITIVE);
    (density * visibility, density / (2.0 * (cap_share(o, alpha) * o.z + root_o)))
}

/// Returns the fraction k of bounded VNDF sampling (source at the top of the file). The cap of
/// [`sample_cap`] extends down to z = −k o_z, where o_z belongs to the stretched `o`. With k = 1
/// all visible normals are sampled. A smaller k leaves out some normals that reflect `o` below the
/// horizon.
#[inline]
fn cap_share(o: Vec3, alpha: Vec2) -> f32 {
    let a = alpha.min_element().min(1.0);
    let s = 1.0 + (o.x * o.x + o.y * o.y).sqrt();
    let (a2, s2) = (a * a, s * s);
    (1.0 - a2) * s2 / (s2 + a2 * o.z * o.z)
}

/// Returns the density per solid angle of the normal that [`sample_normal`] returns: G₁(o) D(h)
/// (o·h) / o_z.
#[inline]
pub(crate) fn normal_pdf(o: Vec3, h: Vec3, alpha: Vec2) -> f32 {
    4.0 * o.dot(h).max(0.0) * reflection_pdf(o, h, alpha)
}

/// Returns the weight G₂/G₁ of a sampled direction `i`, to which a sampled visible normal reflects
/// or refracts `o`.
#[inline]
pub(crate) fn masking_ratio(o: Vec3, i: Vec3, alpha: Vec2) -> f32 {
    let i_z = i.z.abs();
    let (root_o, root_i) = (smith_root(o, alpha), smith_root(i, alpha));
    i_z * (o.z + root_o) / (i_z * root_o + o.z * root_i).max(f32::MIN_POSITIVE)
}

/// Samples a visible microfacet normal by two uniform numbers.
#[inline]
pub(crate) fn sample_normal(o: Vec3, alpha: Vec2, u: [f32; 2]) -> Vec3 {
    sample_cap(o, alpha, 1.0, u)
}

/// Samples the direction to which a visible microfacet reflects `o`; few such directions are below
/// the horizon.
#[inline]
pub(crate) fn sample_reflection(o: Vec3, alpha: Vec2, u: [f32; 2]) -> Vec3 {
    reflect(o, sample_cap(o, alpha, cap_share(o, alpha), u))
}

#[inline]
fn sample_cap(o: Vec3, alpha: Vec2, share: f32, u: [f32; 2]) -> Vec3 {
    let stretched = Vec3::new(alpha.x * o.x, alpha.y * o.y, o.z).normalize();
    let (sin_phi, cos_phi) = sin_cos_turns(u[0]);
    let lowest = share * stretched.z;
    let z = (1.0 - u[1]) * (1.0 + lowest) - lowest;
    let sin_theta = (1.0 - z * z).max(0.0).sqrt();
    let cap = Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, z) + stretched;
    Vec3::new(alpha.x * cap.x, alpha.y * cap.y, cap.z.max(0.0)).try_normalize().unwrap_or(Vec3::Z)
}

/// Returns the reflection of `o` about `h`.
#[inline]
pub(crate) fn reflect(o: Vec3, h: Vec3) -> Vec3 {
    2.0 * o.dot(h) * h - o
}
