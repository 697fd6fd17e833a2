//! Scattering at a surface: glTF's metallic-roughness model with its extensions, conserving energy.
//!
//! With base colour c, metallic m, transmission t, F the reflectance of [`fresnel`] and K the compensation of [`albedo`]:
//!
//! ```text
//! f     = κ f_coat + (1 − κ E_coat(o)) [σ f_fibres + (1 − max(σ) E_fibres(o)) f_base]
//! f_base = m K F(c) D V + (1 − m) [K F(f0) D V + (1 − E_d(o)) ((1 − t) c/π + t c T)]          opaque or thin-walled
//! f_base = m K F(c) D V + (1 − m) [(1 − t) (K F(f0) D V + (1 − E_d(o)) c/π) + t glass]        solid
//! ```
//!
//! E_d is the albedo of the dielectric's reflection lobe (its largest channel), so that what is not reflected is scattered and a white
//! dielectric neither gains nor loses (albedo scaling). The clear coat (factor κ, index 1.5, own normal) and the fibres (colour σ, [`sheen`])
//! scale what lies below them in the same way (`KHR_materials_clearcoat`, `KHR_materials_sheen`). T is the reflection lobe mirrored
//! to the far side (`KHR_materials_transmission`: thin wall). `glass` is in [`glass`], thin films (`KHR_materials_iridescence`) in
//! [`fresnel`]. f0 = min(((n − 1)/(n + 1))² colour, 1) specular and f90 = specular (`KHR_materials_specular`); an index of 0 gives
//! f0 = colour. Anisotropy stretches α of the base's reflection (`KHR_materials_anisotropy`).
//!
//! Lobes with α < [`MIRROR_ALPHA`] are perfect mirrors: they can only be sampled, not evaluated.

mod albedo;
mod fresnel;
mod ggx;
mod glass;
mod sheen;
mod spectrum;
mod table;

use std::f32::consts::FRAC_1_PI;

use glam::{Mat3, Vec2, Vec3};

use self::albedo::{Albedo, COMMON_IOR, albedo};
pub(crate) use self::fresnel::Film;
use self::fresnel::{Fresnel, dielectric_rise, metal_rise, normal_reflectance};
use self::glass::{Glass, GlassOptions};
use self::sheen::Fibres;
pub(crate) use self::spectrum::{Wave, index_at};
use crate::math::concentric_disc;
use crate::matt::Normals;
use crate::shading::{Appearance, Coating, Extras, Frame};

/// Below this α a lobe is a perfect mirror (perceptual roughness 0.032): light sampling could not find it.
pub(crate) const MIRROR_ALPHA: f32 = 1e-3;
/// Reflectance of the clear coat at normal incidence: [`COMMON_IOR`].
const COAT_F0: f32 = 0.04;

/// The scattering function at one point for one outgoing direction.
pub(crate) struct Bsdf {
    /// Columns: tangent, bitangent, shading normal; the normal is on the viewer's side.
    scene_from_local: Mat3,
    geometric_normal: Vec3,
    /// Outgoing direction in the local frame, z > 0.
    o: Vec3,
    alpha: Vec2,
    mirror: bool,
    metal: Fresnel,
    dielectric: Fresnel,
    /// The dielectric's index, by which its reflectance rises.
    ior: f32,
    diffuse: Vec3,
    /// Normals of diffuse scattering in the local frame; z but where normals were bent or mapped.
    diffuse_normals: Normals,
    thin: Vec3,
    thin_scale: f32,
    glass: Option<Glass>,
    film: Option<Film>,
    coat: Option<Coat>,
    fibres: Option<(Vec3, Fibres)>,
    /// Chances of the lobes [`REFLECTION`] to [`COAT`]; their sum is 1, or all are 0.
    chances: [f32; LOBES],
}

const REFLECTION: usize = 0;
const DIFFUSE: usize = 1;
const THIN: usize = 2;
const GLASS: usize = 3;
const FIBRES: usize = 4;
const COAT: usize = 5;
const LOBES: usize = 6;

/// The clear coat, in a frame of its own.
struct Coat {
    scene_from_local: Mat3,
    o: Vec3,
    alpha: Vec2,
    mirror: bool,
    /// Factor times compensation.
    weight: f32,
    albedo: f32,
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
    /// `to_viewer` is a unit vector; the normals of `frame` are on the viewer's side. `front` tells whether the viewer sees the front face.
    pub(crate) fn new(appearance: &Appearance, to_viewer: Vec3, frame: &Frame, front: bool) -> Self {
        let Appearance { base, metallic, roughness, ior, transmission, solid, compensated, .. } = *appearance;
        let extras = appearance.extras.as_ref();
        let scene_from_local = local_frame(frame.shading, frame.tangent);
        let o = local_viewer(&scene_from_local, to_viewer);
        let stretch = extras.map_or(0.0, |extras| extras.anisotropy);
        let mirror = roughness * roughness < MIRROR_ALPHA && stretch == 0.0;
        let across = (roughness * roughness).max(MIRROR_ALPHA);
        let alpha = Vec2::new(across + (1.0 - across) * stretch * stretch, across);
        let table_roughness = if mirror { 0.0 } else { roughness };
        let table: Albedo = if stretch == 0.0 { albedo(o.z, table_roughness) } else { albedo::stretched(o, alpha) };
        let compensate = |f0: Vec3| if compensated { table.compensation(f0) } else { Vec3::ONE };

        // layers above the base
        let seen_from_inside = solid && transmission > 0.0 && !front;
        let above = extras.filter(|_| !seen_from_inside);
        let coat =
            above.and_then(|above| above.coating).map(|coat| Coat::new(&coat, frame.coat, to_viewer, compensated));
        let mut below = 1.0 - coat.as_ref().map_or(0.0, |coat| coat.albedo);
        let mut fibres_albedo = 0.0;
        let fibres = above.and_then(|above| above.sheen).map(|sheen| {
            let (albedo, scale) = sheen::albedo(o.z, sheen.roughness);
            let color = below * scale * sheen.color;
            fibres_albedo = below * albedo * sheen.color.element_sum() * (1.0 / 3.0);
            below *= 1.0 - sheen.color.max_element() * albedo;
            (color, Fibres::new(sheen.roughness))
        });

        let film = extras.and_then(|extras| extras.film);
        let (f0, f90) = dielectric_reflectance(ior, extras);
        // what the lobe reflects at its mean, for the albedo of what lies below
        let seen = |lobe: &Fresnel, rise: f32, mean_rise: f32| match &film {
            Some(film) => {
                let fresnel = film.over(lobe.reflectance(rise), lobe.f0, o.z);
                (fresnel * table.full, fresnel)
            }
            None => (table.reflected(lobe.f0, lobe.f90, mean_rise), lobe.f0),
        };
        let glass_share = if solid && ior > 0.0 { transmission } else { 0.0 };
        let layered = below * (1.0 - metallic) * (1.0 - glass_share);
        let mut dielectric = Fresnel { f0, f90, weight: Vec3::ONE };
        let mean_rise = match ior {
            COMMON_IOR => table.dielectric,
            ..1.0 => table.metal,
            _ => albedo::dielectric(o.z, (alpha.x * alpha.y).sqrt().sqrt(), ior),
        };
        let (reflected, for_compensation) = seen(&dielectric, dielectric_rise(o.z, ior), mean_rise);
        let compensation = compensate(for_compensation);
        let reflected = (reflected * compensation).min(Vec3::ONE);
        dielectric.weight = layered * compensation;
        let passed = layered * (1.0 - reflected.max_element());
        let thin_share = if solid { 0.0 } else { transmission };
        let diffuse = passed * (1.0 - thin_share) * base;
        let thin = passed * thin_share * base;
        let mut metal = Fresnel { f0: base, f90: 1.0, weight: Vec3::ZERO };
        let mut metal_albedo = Vec3::ZERO;
        if metallic > 0.0 {
            let (reflected, for_compensation) = seen(&metal, metal_rise(o.z), table.metal);
            metal.weight = below * metallic * compensate(for_compensation);
            metal_albedo = reflected * metal.weight;
        }
        let glass = (glass_share > 0.0 && metallic < 1.0).then(|| {
            let options = GlassOptions {
                ior,
                front,
                weight: below * (1.0 - metallic) * glass_share,
                tint: base.map(f32::sqrt) * extras.map_or(Vec3::ONE, |extras| extras.wave_weight),
                specular: extras.map_or(1.0, |extras| extras.specular),
                f0: if extras.is_some() { f0 } else { Vec3::splat(normal_reflectance(ior)) },
                film,
                roughness: table_roughness,
                compensated: compensated && stretch == 0.0,
            };
            Glass::new(o, &options)
        });
        let mean = |v: Vec3| v.element_sum() * (1.0 / 3.0);
        let mut chances = [
            mean(metal_albedo + layered * reflected),
            mean(diffuse),
            mean(thin),
            glass.as_ref().map_or(0.0, |glass| glass.weight * (0.5 + 0.5 * mean(glass.tint))),
            fibres_albedo,
            coat.as_ref().map_or(0.0, |coat| coat.albedo),
        ];
        let sum: f32 = chances.iter().sum();
        if sum > 0.0 {
            chances = chances.map(|chance| chance / sum);
        }
        let thin_scale = if compensated { 1.0 / table.full } else { 1.0 };
        let geometric_normal = frame.geometric;
        let diffuse_normals = frame
            .diffuse
            .turned(|normal| if normal == frame.shading { Vec3::Z } else { scene_from_local.transpose() * normal });
        Self {
            scene_from_local,
            geometric_normal,
            o,
            alpha,
            mirror,
            metal,
            dielectric,
            ior,
            diffuse,
            diffuse_normals,
            thin,
            thin_scale,
            glass,
            film,
            coat,
            fibres,
            chances,
        }
    }

    /// Whether any lobe can be evaluated, so that light sampling makes sense.
    pub(crate) fn is_smooth(&self) -> bool {
        let rough = |lobe: usize| match lobe {
            DIFFUSE | FIBRES => true,
            COAT => self.coat.as_ref().is_some_and(|coat| !coat.mirror),
            _ => !self.mirror,
        };
        (0..LOBES).any(|lobe| self.chances[lobe] > 0.0 && rough(lobe))
    }

    /// Whether light from behind can be evaluated.
    pub(crate) fn transmits(&self) -> bool {
        !self.mirror && self.chances[THIN] + self.chances[GLASS] > 0.0
    }

    /// Share of light that a thin wall as smooth as a mirror lets through on its straight way.
    pub(crate) fn straight(&self) -> Vec3 {
        if self.mirror { self.thin } else { Vec3::ZERO }
    }

    /// f |cos| for light from `direction`, and the density with which [`sample`](Self::sample) finds it. Mirrors count as zero.
    pub(crate) fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        self.evaluate_above(self.geometric_normal, direction)
    }

    /// The same with another horizon than that of the geometric normal.
    pub(crate) fn evaluate_above(&self, horizon: Vec3, direction: Vec3) -> (Vec3, f32) {
        let side = direction.dot(horizon);
        let i = self.scene_from_local.transpose() * direction;
        // geometric and shading normal must agree on which side the light comes from; otherwise it would leak through the surface
        let (mut value, mut pdf) = if side * i.z > 0.0 { self.evaluate_base(i) } else { (Vec3::ZERO, 0.0) };
        // diffuse scattering has a normal of its own, and so a horizon
        let cosine = i.dot(self.diffuse_normals.mapped);
        if side > 0.0 && cosine > 0.0 {
            let density = cosine * FRAC_1_PI;
            value += self.diffuse * (density * self.diffuse_normals.unshadowed(i));
            pdf += self.chances[DIFFUSE] * density;
        }
        if let Some(coat) = &self.coat
            && side > 0.0
        {
            let (coat_value, coat_pdf) = coat.evaluate(direction);
            value += Vec3::splat(coat_value);
            pdf += self.chances[COAT] * coat_pdf;
        }
        (value, pdf)
    }

    /// Chooses a direction for `u` in [0, 1)². The first number also chooses the lobe and is stretched over the lobe's share, which
    /// leaves each lobe a stratified set of its own; `u_fresnel` chooses between reflection and refraction in glass. `None` when light
    /// is absorbed.
    pub(crate) fn sample(&self, u: [f32; 2], u_fresnel: f32) -> Option<Scatter> {
        let mut first = u[0];
        let lobe = choose(&self.chances, &mut first)?;
        let chance = self.chances[lobe];
        let u = [first, u[1]];
        let (i, alpha) = match lobe {
            DIFFUSE => {
                let i = cosine_direction(u);
                let normal = self.diffuse_normals.mapped;
                let i = if normal == Vec3::Z { i } else { local_frame(normal, None) * i };
                let direction = (self.scene_from_local * i).try_normalize()?;
                return (direction.dot(self.geometric_normal) > 0.0).then(|| self.finish(direction, 1.0)).flatten();
            }
            REFLECTION if self.mirror => {
                let i = Vec3::new(-self.o.x, -self.o.y, self.o.z);
                return self.finish_mirror(i, self.reflectance(self.o.z) / chance, false);
            }
            THIN if self.mirror => return self.finish_mirror(-self.o, self.thin / chance, false),
            REFLECTION | THIN => {
                let i = ggx::sample_reflection(self.o, self.alpha, u);
                if i.z <= 0.0 {
                    return None;
                }
                (if lobe == THIN { Vec3::new(i.x, i.y, -i.z) } else { i }, self.alpha.max_element())
            }
            FIBRES => (self.fibres.as_ref()?.1.sample(self.o, u)?, 1.0),
            COAT => return self.sample_coat(self.coat.as_ref()?, chance, u),
            _ => {
                let glass = self.glass.as_ref()?;
                let scale = glass.weight / chance;
                if glass.straight {
                    return self.finish_mirror(-self.o, scale * glass.tint, true);
                }
                let h = if self.mirror { Vec3::Z } else { ggx::sample_normal(self.o, self.alpha, u) };
                let (i, weight, reflected) = glass.scatter(self.o, h, u_fresnel);
                if (i.z > 0.0) != reflected {
                    return None;
                }
                if self.mirror {
                    return self.finish_mirror(i, scale * weight, !reflected);
                }
                (i, self.alpha.max_element())
            }
        };
        let direction = (self.scene_from_local * i).try_normalize()?;
        let side = direction.dot(self.geometric_normal);
        (side * i.z > 0.0).then(|| self.finish(direction, alpha)).flatten()
    }

    fn sample_coat(&self, coat: &Coat, chance: f32, u: [f32; 2]) -> Option<Scatter> {
        let i = if coat.mirror { ggx::reflect(coat.o, Vec3::Z) } else { ggx::sample_reflection(coat.o, coat.alpha, u) };
        let direction = (coat.scene_from_local * i).try_normalize()?;
        if i.z <= 0.0 || direction.dot(self.geometric_normal) <= 0.0 {
            return None;
        }
        if !coat.mirror {
            return self.finish(direction, coat.alpha.x);
        }
        let weight = Vec3::splat(coat.reflectance(coat.o.z) / chance);
        Some(Scatter { direction, weight, pdf: f32::INFINITY, crossed: false, refracted: false, alpha: 0.0 })
    }

    fn finish(&self, direction: Vec3, alpha: f32) -> Option<Scatter> {
        let (value, pdf) = self.evaluate(direction);
        let crossed = direction.dot(self.geometric_normal) < 0.0;
        let refracted = crossed && self.glass.is_some();
        (pdf > 0.0).then(|| Scatter { direction, weight: value / pdf, pdf, crossed, refracted, alpha })
    }

    fn finish_mirror(&self, i: Vec3, weight: Vec3, refracted: bool) -> Option<Scatter> {
        let direction = (self.scene_from_local * i).try_normalize()?;
        let side = direction.dot(self.geometric_normal);
        let crossed = i.z < 0.0;
        (side * i.z > 0.0).then_some(Scatter { direction, weight, pdf: f32::INFINITY, crossed, refracted, alpha: 0.0 })
    }

    /// Σ weight · F of the reflection lobes at the cosine between direction and microfacet normal.
    #[inline]
    fn reflectance(&self, cosine: f32) -> Vec3 {
        let metal = self.metal.reflectance(metal_rise(cosine));
        let dielectric = self.dielectric.reflectance(dielectric_rise(cosine, self.ior));
        let Some(film) = &self.film else { return self.metal.weight * metal + self.dielectric.weight * dielectric };
        let mut sum = Vec3::ZERO;
        for (lobe, bare) in [(&self.metal, metal), (&self.dielectric, dielectric)] {
            if lobe.weight != Vec3::ZERO {
                sum += lobe.weight * film.over(bare, lobe.f0, cosine);
            }
        }
        sum
    }

    fn evaluate_base(&self, i: Vec3) -> (Vec3, f32) {
        let (o, alpha) = (self.o, self.alpha);
        let mut value = Vec3::ZERO;
        let mut pdf = 0.0;
        if i.z > 0.0 {
            if !self.mirror
                && let Some(h) = (o + i).try_normalize()
            {
                let (specular, reflection_pdf) = ggx::reflection(o, i, h, alpha);
                let specular = specular * i.z;
                value += self.reflectance(o.dot(h)) * specular;
                pdf += self.chances[REFLECTION] * reflection_pdf;
                if let Some(glass) = &self.glass
                    && !glass.straight
                {
                    let (glass_value, glass_pdf) =
                        glass.reflected(o.dot(h), specular, ggx::reflection_pdf(o, h, alpha));
                    value += glass_value;
                    pdf += self.chances[GLASS] * glass_pdf;
                }
            }
            if let Some((color, fibres)) = &self.fibres {
                value += *color * fibres.evaluate(o, i);
                pdf += self.chances[FIBRES] * fibres.pdf(o, i);
            }
        } else if !self.mirror {
            if self.chances[THIN] > 0.0
                && let Some(h) = (o + Vec3::new(i.x, i.y, -i.z)).try_normalize()
            {
                let (specular, reflection_pdf) = ggx::reflection(o, i, h, alpha);
                value += self.thin * (self.thin_scale * specular * -i.z);
                pdf += self.chances[THIN] * reflection_pdf;
            }
            if let Some(glass) = &self.glass
                && !glass.straight
            {
                let (glass_value, glass_pdf) = glass.transmitted(o, i, alpha);
                value += glass_value;
                pdf += self.chances[GLASS] * glass_pdf;
            }
        }
        (value, pdf)
    }
}

impl Coat {
    fn new(coating: &Coating, normal: Vec3, to_viewer: Vec3, compensated: bool) -> Self {
        let scene_from_local = local_frame(normal, None);
        let o = local_viewer(&scene_from_local, to_viewer);
        let alpha = coating.roughness * coating.roughness;
        let mirror = alpha < MIRROR_ALPHA;
        let table = albedo(o.z, if mirror { 0.0 } else { coating.roughness });
        let compensation = if compensated { table.compensation(Vec3::splat(COAT_F0)).x } else { 1.0 };
        let weight = coating.factor * compensation;
        let albedo = weight * table.reflected(Vec3::splat(COAT_F0), 1.0, table.dielectric).x;
        Self { scene_from_local, o, alpha: Vec2::splat(alpha.max(MIRROR_ALPHA)), mirror, weight, albedo }
    }

    fn reflectance(&self, cosine: f32) -> f32 {
        self.weight * fresnel::dielectric(cosine, COMMON_IOR).0
    }

    /// f |cos| and density.
    fn evaluate(&self, direction: Vec3) -> (f32, f32) {
        let i = self.scene_from_local.transpose() * direction;
        if self.mirror || i.z <= 0.0 {
            return (0.0, 0.0);
        }
        let Some(h) = (self.o + i).try_normalize() else { return (0.0, 0.0) };
        let (specular, reflection_pdf) = ggx::reflection(self.o, i, h, self.alpha);
        (self.reflectance(self.o.dot(h)) * specular * i.z, reflection_pdf)
    }
}

/// Share of light that a clear coat lets through to and from a base, for what the base emits.
pub(crate) fn coat_transmittance(coating: &Coating, cosine: f32) -> f32 {
    let table = albedo(cosine, coating.roughness);
    let f0 = Vec3::splat(COAT_F0);
    1.0 - coating.factor * table.reflected(f0, 1.0, table.dielectric).x * table.compensation(f0).x
}

/// F₀ and F₉₀ of the dielectric base.
fn dielectric_reflectance(ior: f32, extras: Option<&Extras>) -> (Vec3, f32) {
    let f0 = normal_reflectance(ior);
    match extras {
        None => (Vec3::splat(f0), 1.0),
        Some(extras) => ((f0 * extras.specular_color).min(Vec3::ONE) * extras.specular, extras.specular),
    }
}

/// Columns: tangent, bitangent, normal.
fn local_frame(normal: Vec3, tangent: Option<Vec3>) -> Mat3 {
    match tangent.and_then(|tangent| (tangent - normal * normal.dot(tangent)).try_normalize()) {
        Some(tangent) => Mat3::from_cols(tangent, normal.cross(tangent), normal),
        None => {
            let (tangent, bitangent) = normal.any_orthonormal_pair();
            Mat3::from_cols(tangent, bitangent, normal)
        }
    }
}

fn local_viewer(scene_from_local: &Mat3, to_viewer: Vec3) -> Vec3 {
    let mut o = scene_from_local.transpose() * to_viewer;
    o.z = o.z.max(1e-6);
    o
}

/// Chooses an entry by its chance and stretches `u` over the entry's share. `None` when all chances are 0.
fn choose(chances: &[f32; LOBES], u: &mut f32) -> Option<usize> {
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

/// A direction of the upper hemisphere with density cos/π.
#[inline]
pub(crate) fn cosine_direction(u: [f32; 2]) -> Vec3 {
    let (x, y) = concentric_disc(u);
    Vec3::new(x, y, (1.0 - x * x - y * y).max(1e-12).sqrt())
}

/// [`cosine_direction`] for the first `count` of many numbers; x, y and z of the others are of no use.
#[inline]
pub(crate) fn cosine_directions<const N: usize>(u: &[[f32; N]; 2], count: usize) -> [[f32; N]; 3] {
    /// Numbers that every machine works out at once.
    const STEP: usize = 4;
    const { assert!(N.is_multiple_of(STEP)) };
    let mut directions = [[0.0; N]; 3];
    for first in (0..count.min(N)).step_by(STEP) {
        for index in first..first + STEP {
            let direction = cosine_direction([u[0][index], u[1][index]]);
            (0..3).for_each(|axis| directions[axis][index] = direction[axis]);
        }
    }
    directions
}

#[cfg(test)]
mod tests;
