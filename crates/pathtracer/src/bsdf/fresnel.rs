//! Fraction of the light that an interface reflects: Schlick's approximation, Fresnel's equations,
//! and a thin film on top.
//!
//! F = f₀ + (f₉₀ − f₀) s(cos θ), where s rises from 0 at normal incidence to 1 at grazing
//! incidence. Metals have s = (1 − cos θ)⁵ (Schlick 1994). Dielectrics have s = (F_n(cos θ) −
//! F_n(1)) / (1 − F_n(1)), where F_n is the result of Fresnel's equations for the index n. So F =
//! F_n unless the material changes f₀ or f₉₀.
//!
//! The sample code of glTF takes Schlick's term for dielectrics too. At n = 1.5 Schlick's term
//! reflects 8.6 % of diffuse light, and Fresnel's equations 9.2 %.
//!
//! A film (`KHR_materials_iridescence`) replaces F by the reflectance of outside–film–base with
//! interference. The spectrum is integrated in closed form (Belcour, Barla 2017, section 4; the
//! constants are their fit of the CIE colour-matching functions). Both interfaces have Schlick's
//! reflectances, without polarization:
//!
//! ```text
//! F = C₀ + 2 Σ_m C_m S(m D, m φ),   C₀ = R₁₂ + R_s,   C_m = (R_s − T₁₂₁) (R₁₂ R₂₃)^(m/2)
//! R_s = T₁₂₁² R₂₃ / (1 − R₁₂ R₂₃)
//! D = 2 n₂ d cos θ₂
//! ```
//!
//! R₁₂ and R₂₃ are the reflectances of the film's outer and inner interface, and T₁₂₁ = 1 − R₁₂.
//! The film has the index n₂ and the thickness d. Light crosses it at the angle θ₂. The phase shift
//! of both reflections together is φ. The Fourier transform of the colour-matching functions is S.

use std::f32::consts::{PI, TAU};

use glam::{Mat3, Vec3};

/// Number of terms of the sum over m; the spectral sensitivity is negligible at later terms.
const ORDERS: u32 = 2;
/// A film thinner than this, in nanometres, fades out: a film without thickness has no interface.
const FADE_NM: f32 = 30.0;
/// Largest f₀ of the base from which its index of refraction is computed; f₀ = 1 would give an
/// infinite index.
const MOST_F0: f32 = 0.9999;

/// A reflectance with its weight, per channel: `weight · (f0 + (f90 − f0) s)`. The rise s goes from
/// 0 at normal incidence to 1 at grazing incidence.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fresnel {
    pub(crate) f0: Vec3,
    pub(crate) f90: f32,
    pub(crate) weight: Vec3,
}

/// A thin film.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Film {
    /// Fraction of the surface that has the film.
    pub(crate) factor: f32,
    /// Index of refraction.
    pub(crate) ior: f32,
    pub(crate) thickness_nm: f32,
}

impl Fresnel {
    /// Returns the reflectance f0 + (f90 − f0) s without the weight; `rise` is s.
    #[inline]
    pub(crate) fn reflectance(&self, rise: f32) -> Vec3 {
        self.f0 + (Vec3::splat(self.f90) - self.f0) * rise
    }
}

/// Returns the rise s of a metal's reflectance, see the top of the file: (1 − cos)⁵.
#[inline]
pub(crate) fn metal_rise(cosine: f32) -> f32 {
    (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
}

/// Returns the rise s of a dielectric's reflectance, seen from outside; see the top of the file.
/// For an index below 1 (`KHR_materials_ior` allows 0), only the specular colour is known, so the
/// function returns [`metal_rise`].
#[inline]
pub(crate) fn dielectric_rise(cosine: f32, ior: f32) -> f32 {
    if ior < 1.0 { metal_rise(cosine) } else { rise(dielectric(cosine, ior).0, normal_reflectance(ior)) }
}

/// Returns the rise s = (reflectance − f0) / (1 − f0) of an interface that reflects `f0` at normal
/// incidence.
#[inline]
pub(crate) fn rise(reflectance: f32, f0: f32) -> f32 {
    ((reflectance - f0) / (1.0 - f0)).clamp(0.0, 1.0)
}

impl Film {
    /// Returns the reflectance with the film. `bare` is the reflectance without the film, and
    /// `base_f0` is f₀ of the base.
    pub(crate) fn over(&self, bare: Vec3, base_f0: Vec3, cosine: f32) -> Vec3 {
        bare.lerp(self.reflectance(base_f0, cosine), self.factor)
    }

    fn reflectance(&self, base_f0: Vec3, cosine: f32) -> Vec3 {
        let fade = (self.thickness_nm / FADE_NM).clamp(0.0, 1.0);
        let ior = 1.0 + (self.ior - 1.0) * fade * fade * (3.0 - 2.0 * fade);
        let sin2_film = (1.0 - cosine * cosine).max(0.0) / (ior * ior);
        let cos_film = (1.0 - sin2_film).max(0.0).sqrt();
        let r12 = schlick(normal_reflectance(ior), cosine);
        let t121 = 1.0 - r12;
        let base_root = base_f0.clamp(Vec3::ZERO, Vec3::splat(MOST_F0)).map(f32::sqrt);
        let base_ior = (Vec3::ONE + base_root) / (Vec3::ONE - base_root);
        let r23 = (base_ior / ior).map(|ratio| schlick(normal_reflectance(ratio), cos_film));
        // As seen from inside the film, this code shifts the phase by π at an interface whose far
        // medium is less dense. In nature, a denser far medium shifts it. The two rules differ by π
        // or −π at each of the two interfaces. In total this is 0 or 2π, which has no effect.
        let phase = base_ior.map(|base| PI + if base < ior { PI } else { 0.0 });
        let round_trip = (r12 * r23).clamp(Vec3::splat(1e-5), Vec3::splat(0.9999));
        let decay = round_trip.map(f32::sqrt);
        let series = t121 * t121 * r23 / (Vec3::ONE - round_trip);
        let mut sum = Vec3::splat(r12) + series;
        let mut amplitude = series - t121;
        let path_nm = 2.0 * ior * self.thickness_nm * cos_film;
        for order in 1..=ORDERS {
            amplitude *= decay;
            sum += 2.0 * amplitude * sensitivity(order as f32 * path_nm, order as f32 * phase);
        }
        sum.clamp(Vec3::ZERO, Vec3::ONE)
    }
}

/// Returns the reflectance at normal incidence: ((n − 1)/(n + 1))².
#[inline]
pub(crate) fn normal_reflectance(ior: f32) -> f32 {
    let root = (ior - 1.0) / (ior + 1.0);
    root * root
}

fn schlick(f0: f32, cosine: f32) -> f32 {
    f0 + (1.0 - f0) * metal_rise(cosine)
}

/// Returns the Fourier transform S of the colour-matching functions at the optical path difference
/// `path_nm` and with the phase `shift`, in linear RGB.
fn sensitivity(path_nm: f32, shift: Vec3) -> Vec3 {
    let phase = TAU * 1e-9 * path_nm;
    let gauss = |value: f32, position: f32, variance: f32, shift: f32| {
        value * (TAU * variance).sqrt() * (position * phase + shift).cos() * (-phase * phase * variance).exp()
    };
    let xyz = Vec3::new(
        gauss(5.4856e-13, 1.6810e6, 4.3278e9, shift.x) + gauss(9.7470e-14, 2.2399e6, 4.5282e9, shift.x),
        gauss(4.4201e-13, 1.7953e6, 9.3046e9, shift.y),
        gauss(5.2481e-13, 2.2084e6, 6.6121e9, shift.z),
    ) / 1.0685e-7;
    RGB_FROM_XYZ * xyz
}

/// Linear sRGB from CIE XYZ, D65.
pub(crate) const RGB_FROM_XYZ: Mat3 = Mat3::from_cols(
    Vec3::new(3.240_454_2, -0.969_266, 0.055_643_4),
    Vec3::new(-1.537_138_5, 1.876_010_8, -0.204_025_9),
    Vec3::new(-0.498_531_4, 0.041_556, 1.057_225_2),
);

/// Returns the reflectance of a dielectric interface for unpolarized light, and the cosine on the
/// far side. `eta` is the index on the far side divided by the index on the viewer's side.
pub(crate) fn dielectric(cosine: f32, eta: f32) -> (f32, f32) {
    let cosine = cosine.clamp(0.0, 1.0);
    let sin2_far = (1.0 - cosine * cosine) / (eta * eta);
    if sin2_far >= 1.0 {
        return (1.0, 0.0);
    }
    let far = (1.0 - sin2_far).sqrt();
    let parallel = (eta * cosine - far) / (eta * cosine + far);
    let perpendicular = (cosine - eta * far) / (cosine + eta * far);
    (0.5 * (parallel * parallel + perpendicular * perpendicular), far)
}
