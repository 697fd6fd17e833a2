//! The scattering function at a point: its lobes, and the choice among them.

use glam::{Vec2, Vec3};

use super::albedo::{self, Albedo, COMMON_IOR, albedo};
use super::appearance::{Appearance, Extras};
use super::diffuse::Diffuse;
use super::frame::{Frame, local_frame, local_viewer};
use super::fresnel::{Fresnel, dielectric_rise, normal_reflectance};
use super::ggx;
use super::lobe::{Facet, Light, Lobe, MIRROR_ALPHA, Microfacet, Sample, Surface};
use super::lobes::{LOBES, Lobes};

/// The scattering function at one point for one outgoing direction.
pub(crate) struct Bsdf {
    pub(crate) facet: Facet,
    lobes: Lobes,
    /// Chance of every lobe. The sum of the chances is 1, or all are 0.
    chances: [f32; LOBES],
}

/// A direction that [`Bsdf::sample`] chose.
pub(crate) struct Scatter {
    /// Direction of incidence, in the scene.
    pub(crate) direction: Vec3,
    /// f |cos| / density, with the scattering function f.
    pub(crate) weight: Vec3,
    /// Density per solid angle; infinite for a mirror.
    pub(crate) pdf: f32,
    /// True if the light crosses the surface.
    pub(crate) crossed: bool,
    /// True if the light crosses into or out of a solid, not through a thin wall.
    pub(crate) refracted: bool,
    /// α of the chosen lobe, which widens the ray's footprint; 1 for diffuse, 0 for a mirror.
    pub(crate) alpha: f32,
}

impl Bsdf {
    /// Makes the scattering function of a material. `to_viewer` is a unit vector, and the normals
    /// of `frame` are on the viewer's side. `front` is true if the viewer sees the front face.
    pub(crate) fn new(appearance: &Appearance, to_viewer: Vec3, frame: &Frame, front: bool) -> Self {
        let Appearance { base, metallic, roughness, ior, transmission, solid, compensated, .. } = *appearance;
        let extras = appearance.extras.as_ref();
        let scene_from_local = local_frame(frame.shading, frame.tangent);
        let o = local_viewer(&scene_from_local, to_viewer);
        // The base is a mirror if its α is below MIRROR_ALPHA, and if anisotropy does not enlarge α
        // along the tangent.
        let stretch = extras.map_or(0.0, |extras| extras.anisotropy);
        let mirror = roughness * roughness < MIRROR_ALPHA && stretch == 0.0;
        let across = (roughness * roughness).max(MIRROR_ALPHA);
        let alpha = Vec2::new(across + (1.0 - across) * stretch * stretch, across);
        let table_roughness = if mirror { 0.0 } else { roughness };
        let table: Albedo = if stretch == 0.0 { albedo(o.z, table_roughness) } else { albedo::stretched(o, alpha) };
        let facet = Facet { scene_from_local, geometric_normal: frame.geometric, o, alpha, mirror };
        // collect the parameters that several lobes need
        let (f0, f90) = dielectric_reflectance(ior, extras);
        let mut surface = Surface {
            facet: &facet,
            frame,
            to_viewer,
            front,
            color: base,
            metallic,
            ior,
            glass_share: if solid && ior > 0.0 { transmission } else { 0.0 },
            thin_share: if solid { 0.0 } else { transmission },
            roughness: table_roughness,
            is_stretched: stretch != 0.0,
            compensated,
            table,
            film: extras.and_then(|extras| extras.film),
            specular: extras.map_or(1.0, |extras| extras.specular),
            glass_f0: f0,
            wave_weight: extras.map_or(Vec3::ONE, |extras| extras.wave_weight),
            dielectric: Fresnel { f0, f90, weight: Vec3::ONE },
            dielectric_compensation: Vec3::ONE,
            dielectric_albedo: Vec3::ZERO,
        };
        // albedo of the dielectric's reflection; the lobes below receive the rest of the light
        let mean_rise = match ior {
            COMMON_IOR => table.dielectric,
            ..1.0 => table.metal,
            _ => albedo::dielectric(o.z, (alpha.x * alpha.y).sqrt().sqrt(), ior),
        };
        let (reflected, for_compensation) = surface.seen(&surface.dielectric, dielectric_rise(o.z, ior), mean_rise);
        surface.dielectric_compensation = surface.compensation(for_compensation);
        surface.dielectric_albedo = (reflected * surface.dielectric_compensation).min(Vec3::ONE);
        // Make the lobes. The chance of a lobe is in proportion to its albedo. Layers lie on the
        // outside of a solid, so a viewer inside the solid sees no layers.
        let seen_from_inside = solid && transmission > 0.0 && !front;
        let layers = extras.filter(|_| !seen_from_inside).map(|extras| &extras.layers);
        let lobes = Lobes::new(&surface, layers);
        let mut chances = lobes.albedos();
        let sum: f32 = chances.iter().sum();
        if sum > 0.0 {
            chances = chances.map(|chance| chance / sum);
        }
        Self { facet, lobes, chances }
    }

    /// Returns the scattering function of the lobe `lobe` alone. `None` if the lobe's chance is 0
    /// or 1, or if the lobe is a mirror.
    #[cfg(test)]
    pub(crate) fn alone(mut self, lobe: usize) -> Option<Self> {
        let chance =
            std::mem::replace(&mut self.chances, std::array::from_fn(|other| if other == lobe { 1.0 } else { 0.0 }))
                [lobe];
        (chance > 0.0 && chance < 1.0 && self.is_smooth()).then_some(self)
    }

    /// Returns the shading normal, on the viewer's side.
    pub(crate) fn normal(&self) -> Vec3 {
        self.facet.scene_from_local.z_axis
    }

    /// Returns true if any lobe can be evaluated, so that light sampling makes sense.
    pub(crate) fn is_smooth(&self) -> bool {
        let [rough, _] = self.lobes.rough(&self.facet);
        self.chances.iter().zip(rough).any(|(&chance, rough)| rough && chance > 0.0)
    }

    /// Returns true if the surface can be evaluated for light from behind it.
    pub(crate) fn transmits(&self) -> bool {
        let [_, transmits] = self.lobes.rough(&self.facet);
        self.chances.iter().zip(transmits).any(|(&chance, transmits)| transmits && chance > 0.0)
    }

    /// Returns the fraction of the light that passes without a change of direction. It is 0 unless
    /// the surface is a thin wall as smooth as a mirror.
    pub(crate) fn straight(&self) -> Vec3 {
        self.lobes.straight(&self.facet)
    }

    /// Returns f |cos| for light from `direction`, and the density with which
    /// [`sample`](Self::sample) finds `direction`. Mirrors contribute nothing.
    pub(crate) fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        self.evaluate_above(self.facet.geometric_normal, direction)
    }

    /// Returns the same as [`evaluate`](Self::evaluate), but the normal `horizon` replaces the
    /// geometric normal.
    pub(crate) fn evaluate_above(&self, horizon: Vec3, direction: Vec3) -> (Vec3, f32) {
        let Self { facet, lobes, chances } = self;
        let side = direction.dot(horizon);
        let i = facet.scene_from_local.transpose() * direction;
        let (mut value, mut pdf) = (Vec3::ZERO, 0.0);
        let mut light = Light { direction, i, reflected: None };
        if side * i.z > 0.0 {
            if i.z > 0.0 && !facet.mirror {
                light.reflected = (facet.o + i).try_normalize().map(|normal| {
                    let (specular, pdf) = ggx::reflection(facet.o, i, normal, facet.alpha);
                    Microfacet { normal, specular: specular * i.z, pdf }
                });
            }
            lobes.evaluate::<false>(chances, facet, &light, (&mut value, &mut pdf));
        }
        if side > 0.0 {
            lobes.evaluate::<true>(chances, facet, &light, (&mut value, &mut pdf));
        }
        (value, pdf)
    }

    /// Returns the reflectance of the diffuse lobe, which scatters alike to all viewers; 0 if there
    /// is no such lobe.
    pub(crate) fn diffuse_reflectance(&self) -> Vec3 {
        self.lobes.diffuse().map_or(Vec3::ZERO, Diffuse::reflectance)
    }

    /// Returns the diffuse lobe's term of [`evaluate`](Self::evaluate).
    pub(crate) fn evaluate_diffuse(&self, direction: Vec3) -> Vec3 {
        let i = self.facet.scene_from_local.transpose() * direction;
        let light = Light { direction, i, reflected: None };
        self.lobes.diffuse().map_or(Vec3::ZERO, |lobe| lobe.evaluate(&self.facet, &light).0)
    }

    /// Samples a direction by `u` in [0, 1)². The first number also chooses the lobe and is then
    /// rescaled from the lobe's interval to [0, 1), so that each lobe's samples stay stratified.
    /// `u_fresnel` chooses between reflection and refraction in glass. Returns `None` when light is
    /// absorbed.
    pub(crate) fn sample(&self, u: [f32; 2], u_fresnel: f32) -> Option<Scatter> {
        let mut first = u[0];
        let lobe = choose(&self.chances, &mut first)?;
        let normal = self.facet.geometric_normal;
        match self.lobes.sample(lobe, &self.facet, self.chances[lobe], [first, u[1]], u_fresnel)? {
            Sample::Rough { direction, up, alpha } => {
                let side = direction.dot(normal);
                (side * up > 0.0).then_some(())?;
                let (value, pdf) = self.evaluate(direction);
                let crossed = side < 0.0;
                let refracted = crossed && self.lobes.refracts();
                (pdf > 0.0).then(|| Scatter { direction, weight: value / pdf, pdf, crossed, refracted, alpha })
            }
            Sample::Mirror { direction, up, weight, refracted } => (direction.dot(normal) * up > 0.0)
                .then_some(Scatter { direction, weight, pdf: f32::INFINITY, crossed: up < 0.0, refracted, alpha: 0.0 }),
        }
    }
}

/// Returns F₀ and F₉₀ of the dielectric base.
fn dielectric_reflectance(ior: f32, extras: Option<&Extras>) -> (Vec3, f32) {
    let f0 = normal_reflectance(ior);
    match extras {
        None => (Vec3::splat(f0), 1.0),
        Some(extras) => ((f0 * extras.specular_color).min(Vec3::ONE) * extras.specular, extras.specular),
    }
}

/// Chooses an entry by its chance, and rescales `u` from the entry's interval to [0, 1). `None`
/// when all chances are 0.
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
