//! Directional albedo of the GGX reflection lobe, tabulated once.
//!
//! E(μ, α) is the albedo of the lobe without Fresnel and B(μ, α) that with (1 − o·h)⁵ in its place, so that Schlick's Fresnel gives
//! F₀(E − B) + F₉₀B. Single scattering loses 1 − E of what it reflects. That share strikes the surface again, is reflected by the mean F̄ of the
//! Fresnel term, and leaves in the share Ē or strikes once more, so that the lobe has to be multiplied by K:
//!
//! ```text
//! E K = E + (1 − E) F̄ Ē (1 + F̄(1 − Ē) + F̄²(1 − Ē)² + …) = E + (1 − E) F̄ Ē / (1 − F̄(1 − Ē))
//! F̄ = 2 ∫ F(μ) μ dμ = F₀ + (1 − F₀)/21,   Ē = 2 ∫ E(μ) μ dμ
//! ```
//!
//! A white metal is lossless, a coloured one becomes more saturated. Sources: Turquin 2019, "Practical multiple scattering compensation for
//! microfacet models" (a factor on the lobe that depends on the viewer alone); Kulla, Conty 2017, "Revisiting physically based shading at
//! Imageworks" (the series).

use std::sync::OnceLock;

use glam::{Vec2, Vec3};

use super::ggx;

/// Nodes over the cosine μ and over perceptual roughness √α.
const COSINES: usize = 64;
const ROUGHNESSES: usize = 32;
/// Samples per node: a rank-1 lattice; its error is below the interpolation error of about 1e-3.
const SAMPLES: u32 = 987;
/// Step of the Fibonacci lattice of [`SAMPLES`] points.
const LATTICE_STEP: u32 = 610;
/// Nodes of the table for stretched lobes, and its samples: root of the cosine, azimuth, √α along and across.
const STRETCHED: [usize; 4] = [16, 6, 13, 13];
const STRETCHED_SAMPLES: u32 = 377;
const STRETCHED_STEP: u32 = 233;
/// The smallest cosine and α of the table: there the lobe is a mirror.
const SMALLEST: f32 = 1e-3;

/// E and B for a cosine and α.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Albedo {
    /// Albedo without Fresnel, in (0, 1].
    pub(crate) full: f32,
    /// Albedo with (1 − o·h)⁵ for Fresnel.
    pub(crate) grazing: f32,
    /// Mean of `full` over all cosines, by their projected solid angle.
    pub(crate) mean: f32,
}

impl Albedo {
    /// Albedo of the lobe with Schlick's Fresnel, before compensation.
    #[inline]
    pub(crate) fn schlick(&self, f0: Vec3, f90: f32) -> Vec3 {
        f0 * (self.full - self.grazing) + f90 * self.grazing
    }

    /// Factor that returns what single scattering loses.
    #[inline]
    pub(crate) fn compensation(&self, f0: Vec3) -> Vec3 {
        let fresnel = f0 + (Vec3::ONE - f0) * (1.0 / 21.0);
        let further = fresnel * self.mean / (Vec3::ONE - fresnel * (1.0 - self.mean));
        Vec3::ONE + further * (1.0 / self.full - 1.0)
    }
}

/// Looks the albedo up, bilinearly in the cosine and in perceptual roughness √α.
#[inline]
pub(crate) fn albedo(cosine: f32, roughness: f32) -> Albedo {
    static TABLE: OnceLock<Vec<Albedo>> = OnceLock::new();
    let table = TABLE.get_or_init(tabulate);
    let x = cosine.clamp(0.0, 1.0) * (COSINES - 1) as f32;
    let y = roughness.clamp(0.0, 1.0) * (ROUGHNESSES - 1) as f32;
    let (i, j) = ((x as usize).min(COSINES - 2), (y as usize).min(ROUGHNESSES - 2));
    let (fx, fy) = (x - i as f32, y - j as f32);
    let corners = &table[j * COSINES + i..(j + 1) * COSINES + i + 2];
    let (lower, upper) = (&corners[..2], &corners[COSINES..COSINES + 2]);
    let mix = |a: Albedo, b: Albedo, t: f32| Albedo {
        full: a.full + (b.full - a.full) * t,
        grazing: a.grazing + (b.grazing - a.grazing) * t,
        mean: a.mean + (b.mean - a.mean) * t,
    };
    mix(mix(lower[0], lower[1], fx), mix(upper[0], upper[1], fx), fy)
}

/// Albedo of a stretched lobe: linear in the root of the cosine, in cos² of the azimuth from the stretch, and in √α along and across.
pub(crate) fn stretched(o: Vec3, alpha: Vec2) -> Albedo {
    static TABLE: OnceLock<Vec<Albedo>> = OnceLock::new();
    let table = TABLE.get_or_init(tabulate_stretched);
    let across = o.x * o.x + o.y * o.y;
    let azimuth = if across > 0.0 { o.x * o.x / across } else { 0.5 };
    let at = [o.z.max(0.0).sqrt(), azimuth, alpha.x.sqrt(), alpha.y.sqrt()];
    let mut index = [0; 4];
    let mut share = [0.0; 4];
    for axis in 0..4 {
        let x = at[axis].clamp(0.0, 1.0) * (STRETCHED[axis] - 1) as f32;
        index[axis] = (x as usize).min(STRETCHED[axis] - 2);
        share[axis] = x - index[axis] as f32;
    }
    let mut sum = Albedo { full: 0.0, grazing: 0.0, mean: 0.0 };
    for corner in 0..16 {
        let bit = |axis: usize| (corner >> axis) & 1;
        let weight: f32 = (0..4).map(|axis| if bit(axis) == 1 { share[axis] } else { 1.0 - share[axis] }).product();
        let node = (0..4).rev().fold(0, |node, axis| node * STRETCHED[axis] + index[axis] + bit(axis));
        sum.full += weight * table[node].full;
        sum.grazing += weight * table[node].grazing;
        sum.mean += weight * table[node].mean;
    }
    sum
}

fn tabulate_stretched() -> Vec<Albedo> {
    let node = |index: usize| {
        let mut rest = index;
        let [root, azimuth, along, across] = STRETCHED.map(|nodes| {
            let fraction = (rest % nodes) as f32 / (nodes - 1) as f32;
            rest /= nodes;
            fraction
        });
        let cosine = (root * root).max(SMALLEST);
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let o = Vec3::new(sine * azimuth.sqrt(), sine * (1.0 - azimuth).sqrt(), cosine);
        let alpha = Vec2::new(along * along, across * across).max(Vec2::splat(SMALLEST));
        integrate(o, alpha, STRETCHED_SAMPLES, STRETCHED_STEP)
    };
    let mut table: Vec<Albedo> = (0..STRETCHED.iter().product()).map(node).collect();
    let [roots, azimuths, ..] = STRETCHED;
    for lobe in table.chunks_exact_mut(roots * azimuths) {
        // μ = root²
        let over = |cosines: &[Albedo]| mean_over(cosines, |root| 4.0 * root.powi(3));
        let mean = lobe.chunks_exact(roots).map(over).sum::<f32>() / azimuths as f32;
        lobe.iter_mut().for_each(|node| node.mean = mean);
    }
    table
}

/// ∫ E density over nodes that are spread evenly over 0..1, for a density whose own integral is 1: exact where E is constant.
fn mean_over(nodes: &[Albedo], density: impl Fn(f32) -> f32) -> f32 {
    let last = (nodes.len() - 1) as f32;
    let (mut sum, mut weights) = (0.0, 0.0);
    for (i, node) in nodes.iter().enumerate() {
        let x = i as f32 / last;
        let weight = density(x) * if i == 0 || i + 1 == nodes.len() { 0.5 } else { 1.0 };
        (sum, weights) = (sum + weight * node.full, weights + weight);
    }
    sum / weights
}

fn tabulate() -> Vec<Albedo> {
    let mut table = Vec::with_capacity(COSINES * ROUGHNESSES);
    for j in 0..ROUGHNESSES {
        let roughness = j as f32 / (ROUGHNESSES - 1) as f32;
        let alpha = Vec2::splat((roughness * roughness).max(SMALLEST));
        for i in 0..COSINES {
            table.push(integrate(
                towards((i as f32 / (COSINES - 1) as f32).max(SMALLEST)),
                alpha,
                SAMPLES,
                LATTICE_STEP,
            ));
        }
        let row = &mut table[j * COSINES..];
        let mean = mean_over(row, |cosine| 2.0 * cosine);
        row.iter_mut().for_each(|node| node.mean = mean);
    }
    table
}

/// A view with this cosine.
fn towards(cosine: f32) -> Vec3 {
    Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine)
}

fn integrate(o: Vec3, alpha: Vec2, samples: u32, lattice_step: u32) -> Albedo {
    let (mut full, mut grazing) = (0.0, 0.0);
    for k in 0..samples {
        let u = [(k as f32 + 0.5) / samples as f32, ((k * lattice_step) % samples) as f32 / samples as f32];
        let h = ggx::sample_normal(o, alpha, u);
        let i = ggx::reflect(o, h);
        if i.z > 0.0 {
            let weight = f64::from(ggx::masking_ratio(o, i, alpha));
            full += weight;
            grazing += weight * f64::from(1.0 - o.dot(h)).max(0.0).powi(5);
        }
    }
    let n = f64::from(samples);
    // the mean is known once all cosines are
    Albedo { full: (full / n) as f32, grazing: (grazing / n) as f32, mean: f32::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest difference between the interpolated table and a direct integration.
    const TABLE_TOLERANCE: f32 = 4e-3;
    const STRETCHED_TOLERANCE: f32 = 0.02;

    #[test]
    fn the_table_interpolates_the_integral() {
        for cosine in [0.05, 0.3, 0.77, 1.0] {
            for alpha in [0.003f32, 0.02, 0.1, 0.4, 1.0] {
                let (table, direct) = (
                    albedo(cosine, alpha.sqrt()),
                    integrate(towards(cosine), Vec2::splat(alpha), SAMPLES, LATTICE_STEP),
                );
                assert!((table.full - direct.full).abs() < TABLE_TOLERANCE, "{cosine} {alpha}: {table:?} {direct:?}");
                assert!(
                    (table.grazing - direct.grazing).abs() < TABLE_TOLERANCE,
                    "{cosine} {alpha}: {table:?} {direct:?}"
                );
            }
        }
        // a mirror loses nothing and reflects (1 − μ)⁵
        let mirror = albedo(0.5, 0.0);
        assert!((mirror.full - 1.0).abs() < TABLE_TOLERANCE && (mirror.grazing - 1.0 / 32.0).abs() < TABLE_TOLERANCE);
    }

    /// Against the series, summed.
    #[test]
    fn the_compensation_is_a_series_of_reflections() {
        for (full, escape) in [(0.3f32, 0.5f32), (0.5, 0.45), (0.9, 0.95), (1.0, 1.0)] {
            let lobe = Albedo { full, grazing: 0.0, mean: escape };
            for f0 in [0.0f32, 0.04, 0.37, 1.0] {
                // the mean of Schlick's term, by midpoints
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

    /// The mean over cosines, by the inverse of its distribution.
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
                    let (table, direct) = (stretched(o, alpha), integrate(o, alpha, SAMPLES, LATTICE_STEP));
                    let error = (table.full - direct.full).abs().max((table.grazing - direct.grazing).abs());
                    assert!(error < STRETCHED_TOLERANCE, "{o} {alpha}: {table:?} {direct:?}");
                }
            }
        }
    }
}
