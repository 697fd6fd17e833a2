//! Light of one wavelength, for glass that disperses (`KHR_materials_dispersion`).
//!
//! The three channels are treated as light whose spectra are the non-negative part of linear sRGB's
//! matching functions. Each spectrum is scaled to a mean of 1, so that white stays white. A path
//! that enters dispersing glass keeps one wavelength, drawn from the mean of the three spectra. The
//! weight of a channel is the channel's spectrum divided by the mean spectrum, at that wavelength.
//! So the expectation over wavelengths is exact.
//!
//! The index of refraction is n(λ) = n_d + (n_d − 1) (dispersion/20) (523655/λ² − 1.5168), with λ
//! in nanometres. This is Cauchy's equation, with constants from Abbe's number 20/dispersion.

use std::sync::OnceLock;

use glam::Vec3;

use super::fresnel::RGB_FROM_XYZ;

/// Shortest wavelength of the spectra, nanometres.
const FIRST_NM: f32 = 400.0;
/// Longest wavelength of the spectra, nanometres.
const LAST_NM: f32 = 700.0;
/// Number of bands of wavelengths; the spectra are constant in each band.
const BANDS: usize = 60;

/// A wavelength, and the weight of each channel at it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wave {
    pub(crate) nanometres: f32,
    pub(crate) weight: Vec3,
}

impl Wave {
    /// Draws a wavelength by the uniform number `u`. Over all `u`, the mean of each channel's
    /// weight is 1.
    pub(crate) fn sample(u: f32) -> Self {
        let spectra = spectra();
        let last = BANDS - 1;
        let band = spectra.cumulative.partition_point(|&c| c <= u).min(last);
        let below = if band == 0 { 0.0 } else { spectra.cumulative[band - 1] };
        let inside = ((u - below) / (spectra.cumulative[band] - below)).clamp(0.0, 1.0);
        Self {
            nanometres: FIRST_NM + (LAST_NM - FIRST_NM) * (band as f32 + inside) / BANDS as f32,
            weight: spectra.weights[band],
        }
    }
}

/// Returns the index of refraction at a wavelength, at least 1.
pub(crate) fn index_at(ior: f32, dispersion: f32, nanometres: f32) -> f32 {
    (ior + (ior - 1.0) * dispersion / 20.0 * (523_655.0 / (nanometres * nanometres) - 1.5168)).max(1.0)
}

struct Spectra {
    /// Cumulative probability up to and including each band.
    cumulative: [f32; BANDS],
    /// Spectra of the three channels, divided by their mean.
    weights: [Vec3; BANDS],
}

fn spectra() -> &'static Spectra {
    static SPECTRA: OnceLock<Spectra> = OnceLock::new();
    SPECTRA.get_or_init(|| {
        let mut rgb: [Vec3; BANDS] = std::array::from_fn(|band| {
            let nanometres = FIRST_NM + (LAST_NM - FIRST_NM) * (band as f32 + 0.5) / BANDS as f32;
            (RGB_FROM_XYZ * matching(nanometres)).max(Vec3::ZERO)
        });
        let mean = rgb.iter().sum::<Vec3>() / BANDS as f32;
        rgb.iter_mut().for_each(|rgb| *rgb /= mean);
        let mut running = 0.0;
        let cumulative = rgb.map(|rgb| {
            running += rgb.element_sum() / 3.0 / BANDS as f32;
            running
        });
        Spectra { cumulative, weights: rgb.map(|rgb| 3.0 * rgb / rgb.element_sum()) }
    })
}

/// Returns the CIE 1931 colour-matching functions, as sums of Gaussians whose two flanks have
/// different widths (Wyman, Sloan, Shirley 2013).
fn matching(nanometres: f32) -> Vec3 {
    let lobe = |height: f32, centre: f32, left: f32, right: f32| {
        let t = (nanometres - centre) / if nanometres < centre { left } else { right };
        height * (-0.5 * t * t).exp()
    };
    Vec3::new(
        lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) + lobe(-0.065, 501.1, 20.4, 26.2),
        lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1),
        lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_stays_white_and_colours_stand_in_order() {
        let count = 100_000;
        let (mut sum, mut centre) = (Vec3::ZERO, Vec3::ZERO);
        for k in 0..count {
            let wave = Wave::sample((k as f32 + 0.5) / count as f32);
            assert!((FIRST_NM..=LAST_NM).contains(&wave.nanometres) && wave.weight.min_element() >= 0.0);
            assert!((wave.weight.element_sum() - 3.0).abs() < 1e-4);
            sum += wave.weight / count as f32;
            centre += wave.weight * wave.nanometres / count as f32;
        }
        assert!((sum - Vec3::ONE).abs().max_element() < 2e-3, "{sum}");
        assert!(centre.x > 570.0 && (520.0..560.0).contains(&centre.y) && centre.z < 480.0, "{centre}");
        assert!(Wave::sample(1.0).weight.is_finite());
    }

    #[test]
    fn the_abbe_number_is_that_of_the_glass() {
        // crown glass of Abbe number 59 has the dispersion 20/59
        let n = |nanometres| index_at(1.517, 20.0 / 59.0, nanometres);
        assert!((n(587.56) - 1.517).abs() < 1e-4);
        assert!((0.517 / (n(486.13) - n(656.27)) - 59.0).abs() < 0.1);
        assert_eq!(index_at(1.0, 5.0, 400.0), 1.0);
        assert_eq!(index_at(1.05, 100.0, 700.0), 1.0, "never less dense than air");
    }
}
