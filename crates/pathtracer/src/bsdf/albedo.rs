//! Directional albedo of the GGX reflection lobe, tabulated once.
//!
//! E(μ, α) is the albedo of the lobe without Fresnel and B(μ, α) that with (1 − o·h)⁵ in its place, so that Schlick's Fresnel gives
//! F₀(E − B) + F₉₀B. Single scattering loses 1 − E; Turquin 2019 ("Practical multiple scattering compensation for microfacet
//! models") returns it by the factor 1 + F₀(1/E − 1), which makes a white metal lossless.

use std::sync::OnceLock;

use glam::Vec3;

use super::ggx;

/// Nodes over the cosine μ and over perceptual roughness √α.
const COSINES: usize = 64;
const ROUGHNESSES: usize = 32;
/// Samples per node: a rank-1 lattice; its error is below the interpolation error of about 1e-3.
const SAMPLES: u32 = 987;
/// Step of the Fibonacci lattice of [`SAMPLES`] points.
const LATTICE_STEP: u32 = 610;
/// The smallest cosine and α of the table: there the lobe is a mirror.
const SMALLEST: f32 = 1e-3;

/// E and B for a cosine and α.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Albedo {
    /// Albedo without Fresnel, in (0, 1].
    pub(crate) full: f32,
    /// Albedo with (1 − o·h)⁵ for Fresnel.
    pub(crate) grazing: f32,
}

impl Albedo {
    /// Albedo of the lobe with Schlick's Fresnel, before compensation.
    #[inline]
    pub(crate) fn schlick(&self, f0: f32, f90: f32) -> f32 {
        f0 * (self.full - self.grazing) + f90 * self.grazing
    }

    /// Turquin's factor.
    #[inline]
    pub(crate) fn compensation(&self, f0: f32) -> f32 {
        1.0 + f0 * (1.0 / self.full - 1.0)
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
    };
    mix(mix(lower[0], lower[1], fx), mix(upper[0], upper[1], fx), fy)
}

fn tabulate() -> Vec<Albedo> {
    let mut table = Vec::with_capacity(COSINES * ROUGHNESSES);
    for j in 0..ROUGHNESSES {
        let roughness = j as f32 / (ROUGHNESSES - 1) as f32;
        let alpha = (roughness * roughness).max(SMALLEST);
        for i in 0..COSINES {
            table.push(integrate((i as f32 / (COSINES - 1) as f32).max(SMALLEST), alpha));
        }
    }
    table
}

fn integrate(cosine: f32, alpha: f32) -> Albedo {
    let o = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
    let (mut full, mut grazing) = (0.0, 0.0);
    for k in 0..SAMPLES {
        let u = [(k as f32 + 0.5) / SAMPLES as f32, ((k * LATTICE_STEP) % SAMPLES) as f32 / SAMPLES as f32];
        let h = ggx::sample_normal(o, alpha, u);
        let i = ggx::reflect(o, h);
        if i.z > 0.0 {
            let weight = f64::from(ggx::masking_ratio(o.z, i.z, alpha));
            full += weight;
            grazing += weight * f64::from(1.0 - o.dot(h)).max(0.0).powi(5);
        }
    }
    let n = f64::from(SAMPLES);
    Albedo { full: (full / n) as f32, grazing: (grazing / n) as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest difference between the interpolated table and a direct integration.
    const TABLE_TOLERANCE: f32 = 4e-3;

    #[test]
    fn the_table_interpolates_the_integral() {
        for cosine in [0.05, 0.3, 0.77, 1.0] {
            for alpha in [0.003f32, 0.02, 0.1, 0.4, 1.0] {
                let (table, direct) = (albedo(cosine, alpha.sqrt()), integrate(cosine, alpha));
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
}
