//! Fibres that stand up from the surface: the "Charlie" sheen of `KHR_materials_sheen` (Estevez,
//! Kulla 2017).
//!
//! ```text
//! f = D V,   D(h) = (2 + 1/α) sin^(1/α) θ_h / 2π,   V = 1 / ((1 + Λ(o) + Λ(i)) 4 o_z i_z)
//! ```
//!
//! Λ is the authors' fit, and α = roughness². At grazing views smooth fibres would return up to 1.4
//! times the incident light. At these views f is divided by its albedo.
//!
//! Half of the samples reflect at a normal of density D cos θ_h. The other half has density cos/π.
//! This half finds the light from above on rough fibres, which the first half samples badly.

use std::f32::consts::{FRAC_1_PI, TAU};
use std::sync::LazyLock;

use glam::{Vec3, Vec4};
use lumistack_scene::{Material, TextureUse};

use super::cosine::cosine_direction;
use super::ggx;
use super::lobe::{Facet, Layer, Light, Lobe, Sample, Surface};
use super::table::{Slice, Table, slice};
use crate::math::sin_cos_turns;
use crate::texture::{Encoding, Slot};

/// Smallest perceptual roughness; below it the lobe is a rim thinner than a degree.
const LEAST_ROUGHNESS: f32 = 0.1;
/// Fraction of the samples that reflect at the fibres' normals; all other samples have density
/// cos/π.
const FIBRE_SHARE: f32 = 0.5;
/// Numbers of nodes of the albedo table, over the root of the cosine and over roughness.
const COSINES: usize = 48;
const ROUGHNESSES: usize = 24;
/// Number of samples per node, on a Fibonacci lattice: this number and the step are successive
/// Fibonacci numbers.
const SAMPLES: u32 = 1597;
const LATTICE_STEP: u32 = 987;
/// The smallest cosine of the table.
const SMALLEST: f32 = 1e-3;

/// Parameters of the fit of Λ, for the roughest and the smoothest fibres, in the order of the
/// paper's table: a, b, c, d, e.
const FIT_ROUGH: [f32; 5] = [21.5473, 3.82987, 0.19823, -1.97760, -4.32054];
const FIT_SMOOTH: [f32; 5] = [25.3245, 3.32435, 0.16801, -1.27393, -4.85967];

/// Parameters of fibres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fabric {
    pub(crate) color: Vec3,
    /// Perceptual roughness.
    pub(crate) roughness: f32,
}

/// Textures of fibres.
pub(crate) struct FabricSlots {
    color: Option<Slot>,
    roughness: Option<Slot>,
}

/// The layer of fibres.
pub(crate) struct Sheen {
    /// Colour of the fibres, times a factor that keeps their albedo at or below 1, times the
    /// fraction of light that the layers above pass.
    color: Vec3,
    fibres: Fibres,
    albedo: f32,
}

impl Layer for Sheen {
    type Slots = FabricSlots;
    type Parameters = Fabric;

    fn is_named(material: &Material) -> bool {
        material.sheen.is_some()
    }

    fn is_seen(material: &Material) -> bool {
        material.sheen.is_some_and(|sheen| sheen.color != Vec3::ZERO)
    }

    fn slots(material: &Material, slot: &mut impl FnMut(&Option<TextureUse>, Encoding) -> Option<Slot>) -> FabricSlots {
        let sheen = material.sheen.unwrap_or_default();
        FabricSlots {
            color: slot(&sheen.color_texture, Encoding::Srgb),
            roughness: slot(&sheen.roughness_texture, Encoding::Linear),
        }
    }

    fn parameters(material: &Material, slots: &FabricSlots, texel: &impl Fn(&Option<Slot>) -> Vec4) -> Option<Fabric> {
        let sheen = material.sheen?;
        let color = (sheen.color * texel(&slots.color).truncate()).clamp(Vec3::ZERO, Vec3::ONE);
        let roughness = sheen.roughness * texel(&slots.roughness).w;
        (color != Vec3::ZERO).then_some(Fabric { color, roughness })
    }

    fn new(sheen: &Fabric, surface: &Surface<'_>, below: &mut f32) -> Self {
        let (albedo, scale) = albedo(surface.facet.o.z, sheen.roughness);
        let lobe = Self {
            color: *below * scale * sheen.color,
            fibres: Fibres::new(sheen.roughness),
            albedo: *below * albedo * sheen.color.element_sum() * (1.0 / 3.0),
        };
        *below *= 1.0 - sheen.color.max_element() * albedo;
        lobe
    }
}

impl Lobe for Sheen {
    fn albedo(&self) -> f32 {
        self.albedo
    }

    fn is_rough(&self, _: &Facet) -> bool {
        true
    }

    fn evaluate(&self, facet: &Facet, light: &Light) -> (Vec3, f32) {
        if light.i.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        (self.color * self.fibres.evaluate(facet.o, light.i), self.fibres.pdf(facet.o, light.i))
    }

    fn sample(&self, facet: &Facet, _: f32, u: [f32; 2], _: f32) -> Option<Sample> {
        let i = self.fibres.sample(facet.o, u)?;
        let direction = (facet.scene_from_local * i).try_normalize()?;
        Some(Sample::Rough { direction, up: i.z, alpha: 1.0 })
    }
}

/// White fibres of one roughness.
#[derive(Clone, Copy, Debug)]
struct Fibres {
    alpha: f32,
    fit: [f32; 5],
}

impl Fibres {
    /// Makes fibres of a perceptual roughness, which is raised to [`LEAST_ROUGHNESS`].
    fn new(roughness: f32) -> Self {
        let roughness = roughness.clamp(LEAST_ROUGHNESS, 1.0);
        let alpha = roughness * roughness;
        let smooth = (1.0 - alpha) * (1.0 - alpha);
        Self { alpha, fit: std::array::from_fn(|k| FIT_ROUGH[k] + (FIT_SMOOTH[k] - FIT_ROUGH[k]) * smooth) }
    }

    /// Returns f |cos| of white fibres, for two directions above the surface.
    fn evaluate(&self, o: Vec3, i: Vec3) -> f32 {
        let Some(h) = (o + i).try_normalize() else { return 0.0 };
        self.density(h) / ((1.0 + self.lambda(o.z) + self.lambda(i.z)) * 4.0 * o.z)
    }

    /// Returns the density per solid angle of [`sample`](Self::sample).
    fn pdf(&self, o: Vec3, i: Vec3) -> f32 {
        let Some(h) = (o + i).try_normalize() else { return 0.0 };
        let fibres = self.density(h) * h.z / (4.0 * o.dot(h)).max(f32::MIN_POSITIVE);
        FIBRE_SHARE * fibres + (1.0 - FIBRE_SHARE) * i.z * FRAC_1_PI
    }

    /// Samples a direction; `None` if it is below the surface.
    fn sample(&self, o: Vec3, u: [f32; 2]) -> Option<Vec3> {
        if u[0] >= FIBRE_SHARE {
            return Some(cosine_direction([(u[0] - FIBRE_SHARE) / (1.0 - FIBRE_SHARE), u[1]]));
        }
        let sine = u[1].powf(self.alpha / (2.0 * self.alpha + 1.0));
        let (sin_phi, cos_phi) = sin_cos_turns(u[0] / FIBRE_SHARE);
        let h = Vec3::new(sine * cos_phi, sine * sin_phi, (1.0 - sine * sine).max(0.0).sqrt());
        // A normal h that faces away from the viewer gives the same direction as −h. But −h points
        // into the surface, so no fibre has this normal.
        let i = ggx::reflect(o, h);
        (o.dot(h) > 0.0 && i.z > 0.0).then_some(i)
    }

    fn density(&self, h: Vec3) -> f32 {
        let inverse = 1.0 / self.alpha;
        (2.0 + inverse) / TAU * (h.x * h.x + h.y * h.y).powf(0.5 * inverse)
    }

    fn lambda(&self, cosine: f32) -> f32 {
        let [a, b, c, d, e] = self.fit;
        let l = |x: f32| a / (1.0 + b * x.powf(c)) + d * x + e;
        let cosine = cosine.clamp(0.0, 1.0);
        if cosine < 0.5 { l(cosine).exp() } else { (2.0 * l(0.5) - l(1.0 - cosine)).exp() }
    }
}

/// Returns the albedo of white fibres, for the viewer's cosine and a perceptual roughness. The
/// albedo is limited to 1; the second result is the factor on f that limits it.
fn albedo(cosine: f32, roughness: f32) -> (f32, f32) {
    let raw = raw_albedo(cosine, roughness);
    (raw.min(1.0), 1.0 / raw.max(1.0))
}

/// Returns the albedo of white fibres, which may exceed 1. It is interpolated bilinearly in the
/// root of the cosine and in roughness.
fn raw_albedo(cosine: f32, roughness: f32) -> f32 {
    static TABLE: LazyLock<Table<2, 1>> = LazyLock::new(|| Table::new([COSINES, ROUGHNESSES], tabulate));
    let rough = (roughness - LEAST_ROUGHNESS) / (1.0 - LEAST_ROUGHNESS);
    let [albedo] = TABLE.at([cosine.max(0.0).sqrt(), rough]);
    albedo
}

fn tabulate(nodes: [usize; 2], rough: f32) -> Slice<1> {
    slice(nodes, rough, |[root_of_cosine, rough]| {
        let fibres = Fibres::new(LEAST_ROUGHNESS + (1.0 - LEAST_ROUGHNESS) * rough);
        [fibres.integrate((root_of_cosine * root_of_cosine).max(SMALLEST))]
    })
}

impl Fibres {
    fn integrate(&self, cosine: f32) -> f32 {
        let o = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
        let weight = |k: u32| {
            let u = [(k as f32 + 0.5) / SAMPLES as f32, ((k * LATTICE_STEP) % SAMPLES) as f32 / SAMPLES as f32];
            self.sample(o, u).map_or(0.0, |i| f64::from(self.evaluate(o, i) / self.pdf(o, i)))
        };
        ((0..SAMPLES).map(weight).sum::<f64>() / f64::from(SAMPLES)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_interpolates_an_albedo_of_at_most_one() {
        for cosine in [0.03f32, 0.1, 0.3, 0.6, 1.0] {
            for roughness in [0.1, 0.2, 0.33, 0.5, 0.77, 1.0] {
                let (table, direct) = (raw_albedo(cosine, roughness), Fibres::new(roughness).integrate(cosine));
                assert!((table - direct).abs() < 0.01, "{cosine} {roughness}: {table} {direct}");
                let (seen, scale) = albedo(cosine, roughness);
                assert!((0.0..=1.0).contains(&seen) && (table * scale - seen).abs() < 1e-6, "{cosine} {roughness}");
            }
        }
    }
}
