//! Directional albedo of the GGX reflection lobe, tabulated.
//!
//! Here μ is the cosine between the viewer's direction and the normal, and α is the squared
//! roughness. Fresnel's term is F = F₀ + (F₉₀ − F₀) s. The function s rises from 0 at normal
//! incidence to 1 at grazing incidence (see [`fresnel`]). E(μ, α) is the albedo of the lobe if 1
//! replaces F, and B(μ, α) is the albedo if s replaces F. So the albedo with F is F₀(E − B) + F₉₀B,
//! without compensation.
//!
//! The lobe scatters light once, and so loses the fraction 1 − E of the light. On a real surface
//! the lost light strikes the surface again, which multiplies this light by F̄, the mean of F. The
//! fraction Ē, the mean of E, then leaves, and the rest strikes once more. The factor K on the lobe
//! adds the light that leaves later:
//!
//! ```text
//! E K = E + (1 − E) F̄ Ē (1 + F̄(1 − Ē) + F̄²(1 − Ē)² + …) = E + (1 − E) F̄ Ē / (1 − F̄(1 − Ē))
//! F̄ = 2 ∫ F(μ) μ dμ = F₀ + (1 − F₀)/21,   Ē = 2 ∫ E(μ) μ dμ
//! ```
//!
//! F̄ is computed with the s of a metal. The F̄ of a dielectric is a little greater: 0.092 instead
//! of 0.086 at n = 1.5. The greater F̄ would change a dielectric's gloss by less than a percent.
//!
//! With K a white metal is lossless, and a coloured metal becomes more saturated. Sources:
//!
//! * Turquin 2019, "Practical multiple scattering compensation for microfacet models": a factor on
//!   the lobe that depends on the viewer alone.
//! * Kulla, Conty 2017, "Revisiting physically based shading at Imageworks": the series.

use std::sync::LazyLock;

use glam::{Vec2, Vec3};

use super::table::{Slice, Table, slice};
use super::{fresnel, ggx};

/// Number of nodes over the cosine μ, in the table for lobes that are not stretched.
const COSINES: usize = 64;
/// Number of nodes over perceptual roughness √α, in the same table.
const ROUGHNESSES: usize = 32;
/// Number of samples per node, on a rank-1 lattice. Their error is below the interpolation error of
/// about 1e-3.
const SAMPLES: u32 = 987;
/// Step of the Fibonacci lattice of [`SAMPLES`] points.
const LATTICE_STEP: u32 = 610;
/// Numbers of nodes of the table for stretched lobes, one per coordinate. The coordinates are the
/// root of the cosine, cos² of the azimuth, √α along the stretch, and √α across the stretch.
const STRETCHED: [usize; 4] = [16, 6, 13, 13];
/// Number of samples per node of the table for stretched lobes.
const STRETCHED_SAMPLES: u32 = 377;
/// Step of the Fibonacci lattice of [`STRETCHED_SAMPLES`] points.
const STRETCHED_STEP: u32 = 233;
/// The smallest cosine and the smallest α of the tables. Below this α the lobe is a mirror.
const SMALLEST: f32 = 1e-3;
/// The index of refraction for which the tables of E also hold B: glTF's default, and the index of
/// clear coats. The top of the file defines E and B.
pub(crate) const COMMON_IOR: f32 = 1.5;
/// Numbers of nodes of the table for other indices of refraction, one per coordinate. The
/// coordinates are the root of the cosine, √α, and the root of (n − 1)/(n + 1).
const INDICES: [usize; 3] = [40, 16, 20];
/// Number of samples per node of the table for other indices.
const INDICES_SAMPLES: u32 = 377;
/// Step of the Fibonacci lattice of [`INDICES_SAMPLES`] points.
const INDICES_STEP: u32 = 233;
/// Largest (n − 1)/(n + 1) in the table of [`INDICES`], for the index n = 4. A higher index is
/// treated as 4.
const LARGEST_ROOT: f32 = 0.6;

/// Position of E, the albedo without Fresnel's term, in a node of a table.
const FULL: usize = 0;
/// Position of the mean of E over all cosines in a node of a table.
const MEAN: usize = 3;

/// The albedos E and B, and the mean of E, for a cosine and α.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Albedo {
    /// E: albedo without Fresnel, in (0, 1].
    pub(crate) full: f32,
    /// B of metals; the top of the file defines B.
    pub(crate) metal: f32,
    /// B of dielectrics whose index of refraction is [`COMMON_IOR`].
    pub(crate) dielectric: f32,
    /// Mean of `full` over all cosines, weighted by projected solid angle.
    pub(crate) mean: f32,
}

impl Albedo {
    /// Returns the albedo of the lobe with Fresnel's term, before compensation. `rise` is B of the
    /// lobe's material, for example the field `metal`.
    #[inline]
    pub(crate) fn reflected(&self, f0: Vec3, f90: f32, rise: f32) -> Vec3 {
        f0 * (self.full - rise) + f90 * rise
    }

    /// Returns the factor K on the lobe. With this factor, the lobe includes the light that single
    /// scattering loses.
    #[inline]
    pub(crate) fn compensation(&self, f0: Vec3) -> Vec3 {
        let fresnel = f0 + (Vec3::ONE - f0) * (1.0 / 21.0);
        let further = fresnel * self.mean / (Vec3::ONE - fresnel * (1.0 - self.mean));
        Vec3::ONE + further * (1.0 / self.full - 1.0)
    }
}

impl From<[f32; 4]> for Albedo {
    fn from([full, metal, dielectric, mean]: [f32; 4]) -> Self {
        Self { full, metal, dielectric, mean }
    }
}

/// Looks the albedo up, bilinearly in the cosine and in perceptual roughness √α.
#[inline]
pub(crate) fn albedo(cosine: f32, roughness: f32) -> Albedo {
    static TABLE: LazyLock<Table<2, 4>> = LazyLock::new(|| Table::new([COSINES, ROUGHNESSES], tabulate));
    TABLE.at([cosine, roughness]).into()
}

/// Returns the albedo of a stretched lobe, interpolated linearly in four coordinates. They are the
/// root of the cosine, cos² of the azimuth φ, and √α along and across the stretch. The azimuth φ of
/// the viewer is measured from the direction of stretch.
pub(crate) fn stretched(o: Vec3, alpha: Vec2) -> Albedo {
    static TABLE: LazyLock<Table<4, 4>> = LazyLock::new(|| Table::new(STRETCHED, tabulate_stretched));
    let across = o.x * o.x + o.y * o.y;
    let azimuth = if across > 0.0 { o.x * o.x / across } else { 0.5 };
    TABLE.at([o.z.max(0.0).sqrt(), azimuth, alpha.x.sqrt(), alpha.y.sqrt()]).into()
}

/// Returns B (see the top of this file) of a dielectric with index of refraction n: the albedo if
/// `dielectric_rise` replaces Fresnel's term. B is interpolated linearly in the root of the cosine,
/// in √α, and in the root of (n − 1)/(n + 1).
pub(crate) fn dielectric(cosine: f32, roughness: f32, ior: f32) -> f32 {
    static TABLE: LazyLock<Table<3, 1>> = LazyLock::new(|| Table::new(INDICES, tabulate_indices));
    let root = (ior - 1.0).max(0.0) / (ior + 1.0) / LARGEST_ROOT;
    let [rise] = TABLE.at([cosine.max(0.0).sqrt(), roughness, root.sqrt()]);
    rise
}

fn tabulate(nodes: [usize; 2], roughness: f32) -> Slice<4> {
    let mut row = slice(nodes, roughness, |[cosine, roughness]| {
        integrate(towards(cosine), round(roughness), SAMPLES, LATTICE_STEP)
    });
    let mean = mean_over(&row, |cosine| 2.0 * cosine);
    row.iter_mut().for_each(|node| node[MEAN] = mean);
    row
}

fn tabulate_stretched(nodes: [usize; 4], across: f32) -> Slice<4> {
    let mut lobes = slice(nodes, across, |[root, azimuth, along, across]| {
        let cosine = (root * root).max(SMALLEST);
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let o = Vec3::new(sine * azimuth.sqrt(), sine * (1.0 - azimuth).sqrt(), cosine);
        let alpha = Vec2::new(along * along, across * across).max(Vec2::splat(SMALLEST));
        integrate(o, alpha, STRETCHED_SAMPLES, STRETCHED_STEP)
    });
    let [roots, azimuths, ..] = nodes;
    for lobe in lobes.chunks_exact_mut(roots * azimuths) {
        // μ = root², so the density 2 μ dμ becomes 4 root³ d root
        let over = |cosines: &[[f32; 4]]| mean_over(cosines, |root| 4.0 * root.powi(3));
        let mean = lobe.chunks_exact(roots).map(over).sum::<f32>() / azimuths as f32;
        lobe.iter_mut().for_each(|node| node[MEAN] = mean);
    }
    lobes
}

fn tabulate_indices(nodes: [usize; 3], root: f32) -> Slice<1> {
    slice(nodes, root, |[root_of_cosine, roughness, root]| {
        let root = LARGEST_ROOT * root * root;
        let ior = (1.0 + root) / (1.0 - root);
        let rise = |o_h: f32| [fresnel::dielectric_rise(o_h, ior)];
        mean_of_lobe(towards(root_of_cosine * root_of_cosine), round(roughness), INDICES_SAMPLES, INDICES_STEP, rise)
    })
}

/// Returns the integral of E · density over 0..1. `nodes` have E at evenly spaced positions. The
/// sum over the nodes is divided by the sum of their weights, so a constant E has no error.
fn mean_over(nodes: &[[f32; 4]], density: impl Fn(f32) -> f32) -> f32 {
    let last = (nodes.len() - 1) as f32;
    let (mut sum, mut weights) = (0.0, 0.0);
    for (i, node) in nodes.iter().enumerate() {
        let x = i as f32 / last;
        let weight = density(x) * if i == 0 || i + 1 == nodes.len() { 0.5 } else { 1.0 };
        (sum, weights) = (sum + weight * node[FULL], weights + weight);
    }
    sum / weights
}

/// Returns the direction to a viewer at this cosine, or at [`SMALLEST`] if the cosine is smaller.
fn towards(cosine: f32) -> Vec3 {
    let cosine = cosine.max(SMALLEST);
    Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine)
}

/// Returns α of a lobe that is not stretched.
fn round(roughness: f32) -> Vec2 {
    Vec2::splat((roughness * roughness).max(SMALLEST))
}

/// Returns the values of a node: E, B of metals and B of dielectrics (see [`Albedo`]), and NaN for
/// the mean. The mean is computed later, from all cosines.
fn integrate(o: Vec3, alpha: Vec2, samples: u32, lattice_step: u32) -> [f32; 4] {
    let [full, metal, dielectric] = mean_of_lobe(o, alpha, samples, lattice_step, |o_h| {
        [1.0, fresnel::metal_rise(o_h), fresnel::dielectric_rise(o_h, COMMON_IOR)]
    });
    [full, metal, dielectric, f32::NAN]
}

/// Returns the albedos of the GGX lobe if each of N functions of o·h replaces Fresnel's term.
fn mean_of_lobe<const N: usize>(
    o: Vec3,
    alpha: Vec2,
    samples: u32,
    lattice_step: u32,
    functions: impl Fn(f32) -> [f32; N],
) -> [f32; N] {
    let mut sums = [0.0; N];
    for k in 0..samples {
        let u = [(k as f32 + 0.5) / samples as f32, ((k * lattice_step) % samples) as f32 / samples as f32];
        let h = ggx::sample_normal(o, alpha, u);
        let i = ggx::reflect(o, h);
        if i.z > 0.0 {
            let weight = f64::from(ggx::masking_ratio(o, i, alpha));
            let values = functions(o.dot(h));
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * f64::from(value));
        }
    }
    sums.map(|sum| (sum / f64::from(samples)) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tolerated difference between an interpolated table and a direct integration, for each table.
    const TABLE_TOLERANCE: f32 = 4e-3;
    const STRETCHED_TOLERANCE: f32 = 0.02;
    const INDICES_TOLERANCE: f32 = 0.01;

    #[test]
    fn the_table_interpolates_the_integral() {
        for cosine in [0.05, 0.3, 0.77, 1.0] {
            for alpha in [0.003f32, 0.02, 0.1, 0.4, 1.0] {
                let table = albedo(cosine, alpha.sqrt());
                let direct: Albedo = integrate(towards(cosine), Vec2::splat(alpha), SAMPLES, LATTICE_STEP).into();
                for [table, direct] in [
                    [table.full, direct.full],
                    [table.metal, direct.metal],
                    [table.dielectric, direct.dielectric],
                    [dielectric(cosine, alpha.sqrt(), COMMON_IOR), direct.dielectric],
                ] {
                    assert!((table - direct).abs() < TABLE_TOLERANCE, "{cosine} {alpha}: {table} {direct}");
                }
                for ior in [1.02, 1.2, 1.33, 2.42, 3.9] {
                    let table = dielectric(cosine, alpha.sqrt(), ior);
                    let rise = |o_h: f32| [fresnel::dielectric_rise(o_h, ior)];
                    let [direct] = mean_of_lobe(towards(cosine), Vec2::splat(alpha), SAMPLES, LATTICE_STEP, rise);
                    assert!((table - direct).abs() < INDICES_TOLERANCE, "{cosine} {alpha} {ior}: {table} {direct}");
                }
            }
        }
        // a mirror loses nothing, and its B is (1 − μ)⁵
        let mirror = albedo(0.5, 0.0);
        assert!((mirror.full - 1.0).abs() < TABLE_TOLERANCE && (mirror.metal - 1.0 / 32.0).abs() < TABLE_TOLERANCE);
    }

    /// The closed form of the compensation factor K equals the sum of its series.
    #[test]
    fn the_compensation_is_a_series_of_reflections() {
        for (full, escape) in [(0.3f32, 0.5f32), (0.5, 0.45), (0.9, 0.95), (1.0, 1.0)] {
            let lobe = Albedo { full, metal: 0.0, dielectric: 0.0, mean: escape };
            for f0 in [0.0f32, 0.04, 0.37, 1.0] {
                // the mean of Schlick's term, by the midpoint rule
                let schlick = |x: f32| 2.0 * x * (f0 + (1.0 - f0) * (1.0 - x).powi(5));
                let mean: f32 = (0..2000).map(|i| schlick((i as f32 + 0.5) / 2000.0)).sum::<f32>() / 2000.0;
                let mut expected = full;
                let mut inside = 1.0 - full;
                for _ in 0..300 {
                    expected += inside * mean * escape;
                    inside *= mean * (1.0 - escape);
                }
                let found = full * lobe.compensation(Vec3::splat(f0)).x;
                assert!((found / expected - 1.0).abs() < 1e-4, "{full} {f0}: {found} {expected}");
            }
            assert!((lobe.compensation(Vec3::ONE).x * full - 1.0).abs() < 1e-6, "a white metal loses nothing");
        }
    }

    /// The tabulated mean equals a mean over cosines that are drawn by projected solid angle.
    #[test]
    fn the_mean_albedo_is_that_of_all_cosines() {
        for roughness in [0.1f32, 0.5, 0.9, 1.0] {
            let direct: f32 =
                (0..4000).map(|i| albedo(((i as f32 + 0.5) / 4000.0).sqrt(), roughness).full).sum::<f32>() / 4000.0;
            assert!((albedo(0.3, roughness).mean - direct).abs() < TABLE_TOLERANCE, "{roughness}: {direct}");
            let alpha = roughness * roughness;
            let round = stretched(Vec3::new(0.0, 0.6, 0.8), Vec2::splat(alpha)).mean;
            assert!((round - direct).abs() < STRETCHED_TOLERANCE, "{roughness}: {round} {direct}");
        }
    }

    #[test]
    fn the_stretched_table_interpolates_the_integral() {
        for cosine in [0.05f32, 0.3, 0.77, 1.0] {
            for azimuth in [0.0f32, 0.4, 1.0, 1.57] {
                for alpha in [[0.1, 0.02], [0.4, 0.05], [1.0, 0.1], [0.7, 0.6]] {
                    let sine = (1.0 - cosine * cosine).sqrt();
                    let o = Vec3::new(sine * azimuth.cos(), sine * azimuth.sin(), cosine);
                    let alpha = Vec2::from_array(alpha);
                    let table = stretched(o, alpha);
                    let direct: Albedo = integrate(o, alpha, SAMPLES, LATTICE_STEP).into();
                    let error = (table.full - direct.full)
                        .abs()
                        .max((table.metal - direct.metal).abs())
                        .max((table.dielectric - direct.dielectric).abs());
                    assert!(error < STRETCHED_TOLERANCE, "{o} {alpha}: {table:?} {direct:?}");
                }
            }
        }
    }
}
