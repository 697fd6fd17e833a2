//! Parameters of the scattering function at a point.

use glam::Vec3;

use super::fresnel::Film;
use super::lobes::Layers;
use super::spectrum::{Wave, index_at};

/// A material with its textures looked up at a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Appearance {
    /// Base colour, 0..1.
    pub(crate) base: Vec3,
    pub(crate) metallic: f32,
    /// Perceptual roughness, 0..1.
    pub(crate) roughness: f32,
    pub(crate) ior: f32,
    pub(crate) transmission: f32,
    /// True if the material is a solid, into which transmitted light refracts; false for a thin
    /// wall.
    pub(crate) solid: bool,
    /// True if microfacets return the light that single scattering loses.
    pub(crate) compensated: bool,
    pub(crate) extras: Option<Extras>,
}

/// Parameters that most materials lack.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extras {
    pub(crate) specular: f32,
    pub(crate) specular_color: Vec3,
    /// Strength of the anisotropy, 0..1.
    pub(crate) anisotropy: f32,
    pub(crate) film: Option<Film>,
    pub(crate) layers: Layers,
    /// Strength of the dispersion: 20 divided by the Abbe number.
    pub(crate) dispersion: f32,
    /// Factor per colour channel on transmitted light. It differs from 1 only at the point where a
    /// path enters dispersing glass and draws its wavelength.
    pub(crate) wave_weight: Vec3,
}

impl Appearance {
    /// Gives dispersing glass the index of refraction of the path's wavelength, and returns that
    /// wavelength. A path without a wavelength draws one by the number that `u` returns. The result
    /// is `None` for materials that do not disperse.
    pub(crate) fn disperse(&mut self, path_nm: Option<f32>, u: impl FnOnce() -> f32) -> Option<f32> {
        let extras = self.extras.as_mut().filter(|extras| extras.dispersion > 0.0)?;
        let wave = match path_nm {
            Some(nanometres) => Wave { nanometres, weight: Vec3::ONE },
            None => Wave::sample(u()),
        };
        extras.wave_weight = wave.weight;
        self.ior = index_at(self.ior, extras.dispersion, wave.nanometres);
        Some(wave.nanometres)
    }
}
