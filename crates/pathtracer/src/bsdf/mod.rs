//! Scattering at a surface: glTF's metallic-roughness model with transmission, conserving energy.
//!
//! With base colour c, metallic m, transmission t, F Schlick's Fresnel term and K the compensation of [`albedo`]:
//!
//! ```text
//! f = m K F(c) D V + (1 − m) [K F(f0) D V + (1 − E_d(o)) ((1 − t) c/π + t c T)]          opaque or thin-walled
//! f = m K F(c) D V + (1 − m) [(1 − t) (K F(f0) D V + (1 − E_d(o)) c/π) + t glass]        solid
//! ```
//!
//! E_d is the albedo of the dielectric's reflection lobe, so that what is not reflected is scattered and a white dielectric neither
//! gains nor loses (albedo scaling). T is the reflection lobe mirrored to the far side (`KHR_materials_transmission`: thin wall).
//! `glass` is the rough dielectric interface of Walter et al. 2007 with exact Fresnel terms. It carries radiance/η² ("basic
//! radiance"), which leaves out the factor η² that every solid multiplies once and divides once; it is single-scattering.
//!
//! Lobes with α < [`MIRROR_ALPHA`] are perfect mirrors: they can only be sampled, not evaluated.

mod albedo;
mod ggx;

use std::f32::consts::FRAC_1_PI;

use glam::{Mat3, Vec3};

use self::albedo::{Albedo, albedo};
use crate::math::sin_cos_turns;
use crate::shading::Appearance;

/// Below this α a lobe is a perfect mirror (perceptual roughness 0.032): light sampling could not find it.
pub(crate) const MIRROR_ALPHA: f32 = 1e-3;
/// Indices of refraction closer to 1 than this do not bend light.
const NO_REFRACTION: f32 = 1e-3;
/// F₉₀ falls to 0 with F₀ below 2 %, where no real material is: an index of 1 then reflects nothing at any angle.
const F90_PER_F0: f32 = 50.0;

/// The scattering function at one point for one outgoing direction.
pub(crate) struct Bsdf {
    /// Columns: tangent, bitangent, shading normal; the normal is on the viewer's side.
    scene_from_local: Mat3,
    geometric_normal: Vec3,
    /// Outgoing direction in the local frame, z > 0.
    o: Vec3,
    alpha: f32,
    mirror: bool,
    metal: Lobe,
    dielectric: Lobe,
    diffuse: Vec3,
    thin: Vec3,
    thin_scale: f32,
    glass: Option<Glass>,
    /// Chances of the lobes [`REFLECTION`], [`DIFFUSE`], [`THIN`] and [`GLASS`]; their sum is 1, or all are 0.
    chances: [f32; 4],
}

const REFLECTION: usize = 0;
const DIFFUSE: usize = 1;
const THIN: usize = 2;
const GLASS: usize = 3;

/// Schlick's Fresnel term with its weight: `weight · (f0 + (f90 − f0)(1 − o·h)⁵)`, per channel.
struct Lobe {
    f0: Vec3,
    f90: f32,
    weight: Vec3,
}

struct Glass {
    /// Index on the far side over that on the viewer's side.
    eta: f32,
    weight: f32,
    /// Tint of what is transmitted.
    tint: Vec3,
    straight: bool,
}

/// A direction that [`Bsdf::sample`] chose.
pub(crate) struct Scatter {
    /// Direction of incidence, in the scene.
    pub(crate) direction: Vec3,
    /// f |cos| / density.
    pub(crate) weight: Vec3,
    /// Density per solid angle; infinite for a mirror.
    pub(crate) pdf: f32,
    /// Whether the surface was crossed.
    pub(crate) crossed: bool,
    /// Whether it was crossed into or out of a solid, not a thin wall.
    pub(crate) refracted: bool,
    /// α of the chosen lobe, 1 for diffuse; widens the ray's footprint.
    pub(crate) alpha: f32,
}

impl Bsdf {
    /// `to_viewer` is a unit vector; `normals` are the geometric and the shading normal on the viewer's side. `front` tells whether the
    /// viewer sees the front face.
    pub(crate) fn new(
        appearance: &Appearance,
        to_viewer: Vec3,
        geometric_normal: Vec3,
        shading_normal: Vec3,
        front: bool,
    ) -> Self {
        let (tangent, bitangent) = shading_normal.any_orthonormal_pair();
        let scene_from_local = Mat3::from_cols(tangent, bitangent, shading_normal);
        let mut o = scene_from_local.transpose() * to_viewer;
        o.z = o.z.max(1e-6);
        let Appearance { base, metallic, roughness, ior, transmission, solid, .. } = *appearance;
        let mirror = roughness * roughness < MIRROR_ALPHA;
        let alpha = (roughness * roughness).max(MIRROR_ALPHA);
        let table: Albedo = albedo(o.z, if mirror { 0.0 } else { roughness });
        let f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
        let f90 = (F90_PER_F0 * f0).min(1.0);
        let glass_share = if solid { transmission } else { 0.0 };
        let layered = (1.0 - metallic) * (1.0 - glass_share);
        let dielectric_compensation = table.compensation(f0);
        let reflected = (table.schlick(f0, f90) * dielectric_compensation).min(1.0);
        let thin_share = if solid { 0.0 } else { transmission };
        let diffuse = layered * (1.0 - reflected) * (1.0 - thin_share) * base;
        let thin = layered * (1.0 - reflected) * thin_share * base;
        let metal_weight = metallic * Vec3::from_array(base.to_array().map(|f0| table.compensation(f0)));
        let glass = (glass_share > 0.0 && metallic < 1.0).then(|| Glass {
            eta: if front { ior } else { 1.0 / ior },
            weight: (1.0 - metallic) * glass_share,
            tint: base.max(Vec3::ZERO).powf(0.5),
            straight: (ior - 1.0).abs() < NO_REFRACTION,
        });
        let metal_albedo: Vec3 = Vec3::from_array(base.to_array().map(|f0| table.schlick(f0, 1.0))) * metal_weight;
        let mean = |v: Vec3| v.element_sum() * (1.0 / 3.0);
        let mut chances = [
            mean(metal_albedo) + layered * reflected,
            mean(diffuse),
            mean(thin),
            glass.as_ref().map_or(0.0, |glass| glass.weight * (0.5 + 0.5 * mean(glass.tint))),
        ];
        let sum: f32 = chances.iter().sum();
        if sum > 0.0 {
            chances = chances.map(|chance| chance / sum);
        }
        Self {
            scene_from_local,
            geometric_normal,
            o,
            alpha,
            mirror,
            metal: Lobe { f0: base, f90: 1.0, weight: metal_weight },
            dielectric: Lobe { f0: Vec3::splat(f0), f90, weight: Vec3::splat(layered * dielectric_compensation) },
            diffuse,
            thin,
            thin_scale: 1.0 / table.full,
            glass,
            chances,
        }
    }

    /// Whether any lobe can be evaluated, so that light sampling makes sense.
    pub(crate) fn is_smooth(&self) -> bool {
        self.chances[DIFFUSE] > 0.0 || (!self.mirror && self.chances.iter().any(|&chance| chance > 0.0))
    }

    /// Share of light that a thin wall as smooth as a mirror lets through on its straight way.
    pub(crate) fn straight(&self) -> Vec3 {
        if self.mirror { self.thin } else { Vec3::ZERO }
    }

    /// f |cos| for light from `direction`, and the density with which [`sample`](Self::sample) finds it. Mirrors count as zero.
    pub(crate) fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        let i = self.scene_from_local.transpose() * direction;
        if !self.same_side(direction, i) {
            return (Vec3::ZERO, 0.0);
        }
        self.evaluate_local(i)
    }

    /// Chooses a direction for `u` in [0, 1)². The first number also chooses the lobe and is stretched over the lobe's share, which
    /// leaves each lobe a stratified set of its own; `u_fresnel` chooses between reflection and refraction in glass. `None` when light
    /// is absorbed.
    pub(crate) fn sample(&self, u: [f32; 2], u_fresnel: f32) -> Option<Scatter> {
        let mut first = u[0];
        let lobe = choose(&self.chances, &mut first)?;
        let chance = self.chances[lobe];
        let u = [first, u[1]];
        let i = match lobe {
            DIFFUSE => cosine_direction(u),
            REFLECTION if self.mirror => {
                let i = Vec3::new(-self.o.x, -self.o.y, self.o.z);
                return self.finish_mirror(i, self.reflectance(self.o.z) / chance, false, false);
            }
            THIN if self.mirror => return self.finish_mirror(-self.o, self.thin / chance, true, false),
            REFLECTION | THIN => {
                let i = ggx::reflect(self.o, ggx::sample_normal(self.o, self.alpha, u));
                if i.z <= 0.0 {
                    return None;
                }
                if lobe == THIN { Vec3::new(i.x, i.y, -i.z) } else { i }
            }
            _ => return self.sample_glass(self.glass.as_ref()?, chance, u, u_fresnel),
        };
        self.finish(i, if lobe == DIFFUSE { 1.0 } else { self.alpha })
    }

    fn sample_glass(&self, glass: &Glass, chance: f32, u: [f32; 2], u_fresnel: f32) -> Option<Scatter> {
        let scale = glass.weight / chance;
        if glass.straight {
            return self.finish_mirror(-self.o, scale * glass.tint, true, true);
        }
        let h = if self.mirror { Vec3::Z } else { ggx::sample_normal(self.o, self.alpha, u) };
        let cosine = self.o.dot(h);
        let (fresnel, cosine_far) = fresnel_dielectric(cosine, glass.eta);
        let reflected = u_fresnel < fresnel;
        let i = if reflected {
            ggx::reflect(self.o, h)
        } else {
            (cosine / glass.eta - cosine_far) * h - self.o / glass.eta
        };
        if self.mirror {
            let weight = if reflected { Vec3::ONE } else { glass.tint };
            return self.finish_mirror(i, scale * weight, !reflected, !reflected);
        }
        if (i.z > 0.0) != reflected {
            return None;
        }
        self.finish(i, self.alpha)
    }

    fn finish(&self, i: Vec3, alpha: f32) -> Option<Scatter> {
        let direction = (self.scene_from_local * i).try_normalize()?;
        if !self.same_side(direction, i) {
            return None;
        }
        let (value, pdf) = self.evaluate_local(i);
        let crossed = i.z < 0.0;
        let refracted = crossed && self.glass.is_some();
        (pdf > 0.0).then(|| Scatter { direction, weight: value / pdf, pdf, crossed, refracted, alpha })
    }

    fn finish_mirror(&self, i: Vec3, weight: Vec3, crossed: bool, refracted: bool) -> Option<Scatter> {
        let direction = (self.scene_from_local * i).try_normalize()?;
        self.same_side(direction, i).then_some(Scatter {
            direction,
            weight,
            pdf: f32::INFINITY,
            crossed,
            refracted,
            alpha: 0.0,
        })
    }

    /// Geometric and shading normal must agree on which side the light comes from; otherwise light would leak through the surface.
    fn same_side(&self, direction: Vec3, i: Vec3) -> bool {
        direction.dot(self.geometric_normal) * i.z > 0.0
    }

    /// Σ weight · F of the reflection lobes at the cosine between direction and microfacet normal.
    #[inline]
    fn reflectance(&self, cosine: f32) -> Vec3 {
        let grazing = (1.0 - cosine.clamp(0.0, 1.0)).powi(5);
        [&self.metal, &self.dielectric]
            .into_iter()
            .map(|lobe| lobe.weight * (lobe.f0 + (Vec3::splat(lobe.f90) - lobe.f0) * grazing))
            .sum()
    }

    fn evaluate_local(&self, i: Vec3) -> (Vec3, f32) {
        let (o, alpha) = (self.o, self.alpha);
        let mut value = Vec3::ZERO;
        let mut pdf = 0.0;
        if i.z > 0.0 {
            value += self.diffuse * (i.z * FRAC_1_PI);
            pdf += self.chances[DIFFUSE] * i.z * FRAC_1_PI;
            if !self.mirror
                && let Some(h) = (o + i).try_normalize()
            {
                let specular = ggx::density(h, alpha) * ggx::visibility(o.z, i.z, alpha) * i.z;
                let reflection_pdf = ggx::reflection_pdf(o, h, alpha);
                value += self.reflectance(o.dot(h)) * specular;
                pdf += self.chances[REFLECTION] * reflection_pdf;
                if let Some(glass) = &self.glass
                    && !glass.straight
                {
                    let (fresnel, _) = fresnel_dielectric(o.dot(h), glass.eta);
                    value += Vec3::splat(glass.weight * fresnel * specular);
                    pdf += self.chances[GLASS] * fresnel * reflection_pdf;
                }
            }
        } else if !self.mirror {
            if self.chances[THIN] > 0.0
                && let Some(h) = (o + Vec3::new(i.x, i.y, -i.z)).try_normalize()
            {
                let specular = ggx::density(h, alpha) * ggx::visibility(o.z, i.z, alpha) * -i.z;
                value += self.thin * (self.thin_scale * specular);
                pdf += self.chances[THIN] * ggx::reflection_pdf(o, h, alpha);
            }
            if let Some(glass) = &self.glass
                && !glass.straight
                && let Some(h) = (o + glass.eta * i).try_normalize()
            {
                let h = if h.z < 0.0 { -h } else { h };
                let (o_h, i_h) = (o.dot(h), i.dot(h));
                if o_h > 0.0 && i_h < 0.0 {
                    let (fresnel, _) = fresnel_dielectric(o_h, glass.eta);
                    let denominator = o_h + glass.eta * i_h;
                    let jacobian = glass.eta * glass.eta * -i_h / (denominator * denominator);
                    // D G₂ |o·h| / |o_z| times the jacobian; V holds G₂ / (4 |o_z| |i_z|)
                    let specular =
                        4.0 * ggx::density(h, alpha) * ggx::visibility(o.z, i.z, alpha) * -i.z * o_h * jacobian;
                    value += glass.tint * (glass.weight * (1.0 - fresnel) * specular);
                    pdf += self.chances[GLASS] * (1.0 - fresnel) * ggx::normal_pdf(o, h, alpha) * jacobian;
                }
            }
        }
        (value, pdf)
    }
}

/// Reflectance of a dielectric interface for unpolarized light, and the cosine on the far side; `eta` is the index there over the index here.
fn fresnel_dielectric(cosine: f32, eta: f32) -> (f32, f32) {
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

/// Chooses an entry by its chance and stretches `u` over the entry's share. `None` when all chances are 0.
fn choose(chances: &[f32; 4], u: &mut f32) -> Option<usize> {
    let last = chances.iter().rposition(|&chance| chance > 0.0)?;
    let mut below = 0.0;
    for (index, &chance) in chances.iter().enumerate() {
        if *u < below + chance || index == last {
            *u = ((*u - below) / chance).clamp(0.0, 1.0 - f32::EPSILON);
            return Some(index);
        }
        below += chance;
    }
    None
}

/// A direction of the upper hemisphere with density cos/π (concentric map of Shirley, Chiu 1997).
fn cosine_direction(u: [f32; 2]) -> Vec3 {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    let (radius, turns) = if a == 0.0 && b == 0.0 {
        (0.0, 0.0)
    } else if a.abs() > b.abs() {
        (a, 0.125 * (b / a))
    } else {
        (b, 0.25 - 0.125 * (a / b))
    };
    let (sin, cos) = sin_cos_turns(turns);
    Vec3::new(radius * cos, radius * sin, (1.0 - radius * radius).max(1e-12).sqrt())
}

#[cfg(test)]
mod tests;
