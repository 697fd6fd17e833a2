//! The interface between air and a solid, which reflects and refracts light.
//!
//! The formulas for f |i_z| are those of Walter et al. 2007, with Fresnel's exact term F. The
//! symbols D, V, G₂, h, o and i are defined in [`ggx`]. The symbol η is the index of refraction on
//! the far side divided by the index on the viewer's side.
//!
//! ```text
//! reflection     F D V |i_z|
//! transmission   (1 − F) D G₂ |o·h| J / |o_z|,   J = η² |i·h| / (o·h + η i·h)²
//! ```
//!
//! The path carries basic radiance: radiance divided by the squared index of the medium. Basic
//! radiance does not change when light enters or leaves a solid, so the term of transmission needs
//! no further factor η². Single scattering loses the fraction 1 − E(o, α, η) of the light. So both
//! terms are divided by the tabulated albedo E, as in Turquin 2019, which makes clear glass
//! lossless. Stretched glass has another albedo, and so has glass whose reflection a film or
//! `KHR_materials_specular` changes. These two kinds of glass are not compensated.

use std::sync::LazyLock;

use glam::{Vec2, Vec3};

use super::fresnel::{self, Film};
use super::ggx;
use super::lobe::{Facet, Light, Lobe, Sample, Surface, mean};
use super::table::{Slice, Table, slice};

/// Glass whose index of refraction differs from 1 by less than this does not bend light.
const NO_REFRACTION: f32 = 1e-3;
/// Numbers of nodes of the albedo table, one per coordinate. The coordinates are the root of the
/// cosine, perceptual roughness, and the root of |n − 1|/(n + 1) for the index n.
const NODES: [usize; 3] = [24, 16, 16];
/// Largest root of the reflectance at normal incidence in the table (index 4); the smallest is 0.
const LARGEST_ROOT: f32 = 0.6;
/// Number of samples per node; they lie on a Fibonacci lattice.
const SAMPLES: u32 = 610;
const LATTICE_STEP: u32 = 377;
/// The smallest cosine and α of the table.
const SMALLEST: f32 = 1e-3;

/// A glass interface at one point.
pub(crate) struct Glass {
    /// Index of refraction on the far side divided by the index on the viewer's side.
    eta: f32,
    /// Fraction of the light that the glass gets: its fraction of the surface, times the fraction
    /// that the layers above pass.
    weight: f32,
    /// Tint of the transmitted light.
    tint: Vec3,
    /// True if transmitted light keeps its direction.
    straight: bool,
    /// 1/E, with the tabulated albedo E; 1 if the glass is not compensated.
    compensation: f32,
    /// The changed reflection, if `KHR_materials_specular` or a film changes it.
    changed: Option<Changed>,
}

/// The reflectance of an interface that a film or `KHR_materials_specular` changes.
#[derive(Clone, Copy)]
struct Changed {
    /// Reflectance at normal incidence: `bare_f0` for the bare interface, `f0` after the change.
    bare_f0: f32,
    f0: Vec3,
    f90: f32,
    film: Option<Film>,
    front: bool,
}

impl Glass {
    #[inline]
    pub(crate) fn new(surface: &Surface<'_>, below: f32) -> Option<Self> {
        let &Surface { ior, front, specular, roughness, film, glass_f0: f0, glass_share, metallic, .. } = surface;
        if glass_share <= 0.0 || metallic >= 1.0 {
            return None;
        }
        let bare_f0 = fresnel::normal_reflectance(ior);
        let straight = (ior - 1.0).abs() < NO_REFRACTION;
        let is_changed = specular != 1.0 || (f0 - bare_f0).abs().max_element() > 1e-6 || film.is_some();
        let compensated = surface.compensated && !surface.is_stretched;
        let compensation = if compensated && !is_changed && roughness > 0.0 && !straight {
            1.0 / albedo(surface.facet.o.z, roughness, ior, front)
        } else {
            1.0
        };
        Some(Self {
            eta: if front { ior } else { 1.0 / ior },
            weight: below * (1.0 - metallic) * glass_share,
            tint: surface.color.map(f32::sqrt) * surface.wave_weight,
            straight,
            compensation,
            changed: is_changed.then_some(Changed { bare_f0, f0, f90: specular, film, front }),
        })
    }

    /// Returns the reflectance at a microfacet, the chance with which reflection is chosen at that
    /// facet, and the cosine of the refracted direction.
    fn reflectance(&self, cosine: f32) -> (Vec3, f32, f32) {
        let (bare, far) = fresnel::dielectric(cosine, self.eta);
        let Some(changed) = &self.changed else { return (Vec3::splat(bare), bare, far) };
        if bare >= 1.0 {
            // total reflection: no light is refracted
            return (Vec3::ONE, 1.0, far);
        }
        let rise = fresnel::rise(bare, changed.bare_f0);
        let mut fresnel = changed.f0 + (Vec3::splat(changed.f90) - changed.f0) * rise;
        if let Some(film) = &changed.film {
            // A lossless stack of layers reflects the same fraction from both sides. So the film is
            // evaluated for the cosine on the outer side.
            let outside = if changed.front { cosine } else { far };
            fresnel = film.over(fresnel, changed.f0, outside);
        }
        let fresnel = fresnel.clamp(Vec3::ZERO, Vec3::ONE);
        (fresnel, fresnel.element_sum() * (1.0 / 3.0), far)
    }

    /// Returns f |cos| and the density for a direction above the surface. The density excludes the
    /// chance of this lobe. `specular` is D V |i_z|, and `reflection_pdf` the density of reflected
    /// directions.
    fn reflected(&self, o_h: f32, specular: f32, reflection_pdf: f32) -> (Vec3, f32) {
        let (fresnel, chance, _) = self.reflectance(o_h);
        (fresnel * (self.weight * self.compensation * specular), chance * reflection_pdf)
    }

    /// Returns f |cos| and the density for a direction below the surface. The density excludes the
    /// chance of this lobe.
    fn transmitted(&self, o: Vec3, i: Vec3, alpha: Vec2) -> (Vec3, f32) {
        const NOTHING: (Vec3, f32) = (Vec3::ZERO, 0.0);
        let Some(h) = (o + self.eta * i).try_normalize() else { return NOTHING };
        let h = if h.z < 0.0 { -h } else { h };
        let (o_h, i_h) = (o.dot(h), i.dot(h));
        if o_h <= 0.0 || i_h >= 0.0 {
            return NOTHING;
        }
        let (fresnel, chance, _) = self.reflectance(o_h);
        let denominator = o_h + self.eta * i_h;
        let jacobian = self.eta * self.eta * -i_h / (denominator * denominator);
        // V is G₂ / (4 |o_z| |i_z|), so 4 V |i_z| is G₂ / |o_z|
        let specular = 4.0 * ggx::density(h, alpha) * ggx::visibility(o, i, alpha) * -i.z * o_h * jacobian;
        let value = self.tint * (Vec3::ONE - fresnel) * (self.weight * self.compensation * specular);
        (value, (1.0 - chance) * ggx::normal_pdf(o, h, alpha) * jacobian)
    }

    /// Reflects or refracts at the microfacet normal `h`. Returns the direction, the weight for a
    /// mirror (without the lobe's weight), and true if the light was reflected.
    fn scatter(&self, o: Vec3, h: Vec3, u_fresnel: f32) -> (Vec3, Vec3, bool) {
        let cosine = o.dot(h);
        let (fresnel, chance, far) = self.reflectance(cosine);
        if u_fresnel < chance {
            (ggx::reflect(o, h), fresnel / chance, true)
        } else {
            let i = (cosine / self.eta - far) * h - o / self.eta;
            (i, self.tint * (Vec3::ONE - fresnel) / (1.0 - chance), false)
        }
    }
}

impl Lobe for Glass {
    const TRANSMITS: bool = true;
    const REFRACTS: bool = true;

    fn albedo(&self) -> f32 {
        self.weight * (0.5 + 0.5 * mean(self.tint))
    }

    fn is_rough(&self, facet: &Facet) -> bool {
        !facet.mirror
    }

    fn evaluate(&self, facet: &Facet, light: &Light) -> (Vec3, f32) {
        let (o, alpha) = (facet.o, facet.alpha);
        if self.straight || facet.mirror {
            return (Vec3::ZERO, 0.0);
        }
        if light.i.z <= 0.0 {
            return self.transmitted(o, light.i, alpha);
        }
        let Some(facets) = &light.reflected else { return (Vec3::ZERO, 0.0) };
        let h = facets.normal;
        self.reflected(o.dot(h), facets.specular, ggx::reflection_pdf(o, h, alpha))
    }

    fn sample(&self, facet: &Facet, chance: f32, u: [f32; 2], u_fresnel: f32) -> Option<Sample> {
        let o = facet.o;
        let scale = self.weight / chance;
        let towards = |i: Vec3| (facet.scene_from_local * i).try_normalize();
        if self.straight {
            let weight = scale * self.tint;
            return Some(Sample::Mirror { direction: towards(-o)?, up: -o.z, weight, refracted: true });
        }
        let h = if facet.mirror { Vec3::Z } else { ggx::sample_normal(o, facet.alpha, u) };
        let (i, weight, reflected) = self.scatter(o, h, u_fresnel);
        if (i.z > 0.0) != reflected {
            return None;
        }
        let direction = towards(i)?;
        Some(if facet.mirror {
            Sample::Mirror { direction, up: i.z, weight: scale * weight, refracted: !reflected }
        } else {
            Sample::Rough { direction, up: i.z, alpha: facet.alpha.max_element() }
        })
    }
}

/// Returns the albedo of clear glass, trilinear in the root of the cosine, perceptual roughness and
/// the root of |n − 1|/(n + 1).
fn albedo(cosine: f32, roughness: f32, ior: f32, front: bool) -> f32 {
    static TABLES: LazyLock<[Table<3, 1>; 2]> = LazyLock::new(|| {
        [
            Table::new(NODES, |nodes, root| tabulate(nodes, root, false)),
            Table::new(NODES, |nodes, root| tabulate(nodes, root, true)),
        ]
    });
    let table = &TABLES[usize::from(front)];
    let root = (ior - 1.0).abs() / (ior + 1.0) / LARGEST_ROOT;
    let [albedo] = table.at([cosine.max(0.0).sqrt(), roughness, root.sqrt()]);
    albedo
}

fn tabulate(nodes: [usize; 3], root: f32, front: bool) -> Slice<1> {
    slice(nodes, root, |[root_of_cosine, roughness, root]| {
        let cosine = (root_of_cosine * root_of_cosine).max(SMALLEST);
        let root = LARGEST_ROOT * root * root;
        [integrate(cosine, (roughness * roughness).max(SMALLEST), (1.0 + root) / (1.0 - root), front)]
    })
}

fn integrate(cosine: f32, alpha: f32, ior: f32, front: bool) -> f32 {
    let o = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
    let eta = if front { ior } else { 1.0 / ior };
    let alpha = Vec2::splat(alpha);
    let weight = |k: u32| {
        let u = [(k as f32 + 0.5) / SAMPLES as f32, ((k * LATTICE_STEP) % SAMPLES) as f32 / SAMPLES as f32];
        let h = ggx::sample_normal(o, alpha, u);
        let o_h = o.dot(h);
        let (fresnel, far) = fresnel::dielectric(o_h, eta);
        let reflected = ggx::reflect(o, h);
        let refracted = (o_h / eta - far) * h - o / eta;
        let up = if reflected.z > 0.0 { fresnel * ggx::masking_ratio(o, reflected, alpha) } else { 0.0 };
        let down = if refracted.z < 0.0 { (1.0 - fresnel) * ggx::masking_ratio(o, refracted, alpha) } else { 0.0 };
        f64::from(up + down)
    };
    ((0..SAMPLES).map(weight).sum::<f64>() / f64::from(SAMPLES)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_interpolates_the_integral() {
        for cosine in [0.05f32, 0.3, 0.77, 1.0] {
            for alpha in [0.01f32, 0.1, 0.4, 1.0] {
                for ior in [1.05, 1.33, 1.5, 2.4] {
                    for front in [false, true] {
                        let table = albedo(cosine, alpha.sqrt(), ior, front);
                        let direct = integrate(cosine, alpha, ior, front);
                        assert!(
                            (table / direct - 1.0).abs() < 0.03,
                            "{cosine} {alpha} {ior} {front}: {table} {direct}"
                        );
                    }
                }
            }
        }
    }
}
