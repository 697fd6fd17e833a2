//! Light for scenes that bring none, environment maps from files, and the exposure of all views together.

use std::path::Path;

use glam::{Quat, Vec3};
use lumistack_core::metrics::percentile;
use lumistack_field_io::picture::Picture;
use lumistack_scene::{Environment, Image, Pixels, Scene, SceneError, SceneParts};

use crate::error::{PipelineError, read};
use crate::run::field_error;

/// Size of the studio map; it is smooth.
const STUDIO: [usize; 2] = [128, 64];

/// Gives the scene the built-in studio light: a soft grey surround, darker below, a large key light above to the left in front of the
/// scene and a weaker fill to the right. Radiance is about 1 where it is brightest outside the lamps.
pub fn add_studio_light(parts: &mut SceneParts) {
    let [width, height] = STUDIO;
    let mut texels = Vec::with_capacity(width * height);
    let key = Vec3::new(-0.6, 0.75, 0.7).normalize();
    let fill = Vec3::new(0.9, 0.25, 0.5).normalize();
    for row in 0..height {
        let elevation = std::f32::consts::FRAC_PI_2 - (row as f32 + 0.5) / height as f32 * std::f32::consts::PI;
        for col in 0..width {
            // the centre column is −z, columns to the right turn towards +x
            let azimuth = ((col as f32 + 0.5) / width as f32 - 0.5) * std::f32::consts::TAU;
            let direction =
                Vec3::new(elevation.cos() * azimuth.sin(), elevation.sin(), -elevation.cos() * azimuth.cos());
            let surround = 0.30 + 0.25 * direction.y;
            let lobe = |axis: Vec3, sharpness: f32| (sharpness * (direction.dot(axis) - 1.0)).exp();
            let radiance = Vec3::splat(surround)
                + Vec3::new(1.0, 0.96, 0.9) * 9.0 * lobe(key, 18.0)
                + Vec3::new(0.85, 0.93, 1.0) * 1.6 * lobe(fill, 10.0);
            texels.push(radiance.to_array());
        }
    }
    set_environment(
        parts,
        Image { name: "studio light".into(), width, height, pixels: Pixels::RgbF32(texels) },
        Vec3::ONE,
    );
}

/// Replaces the scene's environment by a Radiance HDR or EXR file.
///
/// # Errors
/// When the file cannot be read or decoded.
pub fn load_environment(parts: &mut SceneParts, path: &Path, strength: f32) -> Result<(), PipelineError> {
    let bytes = read(path)?;
    let is_exr = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    let (width, height, texels) = if is_exr {
        let picture = Picture::read(path).map_err(field_error)?;
        let [width, height] = picture.size();
        (width, height, picture.into_linear().chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
    } else {
        let picture = image::load_from_memory(&bytes)
            .map_err(|error| {
                PipelineError::value(path, "environment", "a Radiance HDR or EXR picture", error.to_string())
            })?
            .into_rgb32f();
        let (width, height) = picture.dimensions();
        (width as usize, height as usize, picture.pixels().map(|p| p.0).collect())
    };
    let image = Image { name: path.display().to_string(), width, height, pixels: Pixels::RgbF32(texels) };
    set_environment(parts, image, Vec3::splat(strength));
    Ok(())
}

fn set_environment(parts: &mut SceneParts, image: Image, strength: Vec3) {
    parts.images.push(image);
    parts.environment =
        Some(Environment { image: parts.images.len() - 1, strength, scene_from_environment: Quat::IDENTITY });
}

/// Applies `change` to the parts of a scene and validates again.
///
/// # Errors
/// When the changed scene is not valid.
pub fn edited(
    scene: Scene,
    task: lumistack_core::Task<'_>,
    change: impl FnOnce(&mut SceneParts) -> Result<(), PipelineError>,
) -> Result<Scene, PipelineError> {
    let mut parts = scene.into_parts();
    let name = parts.name.clone();
    change(&mut parts)?;
    parts.validate(task).map_err(|source: SceneError| PipelineError::Scene { name, source })
}

/// Factor from scene-linear to display-referred radiance, one for all views.
///
/// The 99th percentile of the brightest channel is brought to 0.95. Where a few lamps would leave everything else dark, the median is
/// brought to 0.22 instead, as long as no more than 5 % of the pixels clip.
pub fn automatic_exposure(brightest_channel: &mut [f32]) -> f64 {
    let p = |values: &mut [f32], share: f64| f64::from(percentile(values, share));
    let (p50, p95, p99) = (p(brightest_channel, 0.50), p(brightest_channel, 0.95), p(brightest_channel, 0.99));
    let inverse = |value: f64, level: f64| if value > 0.0 { level / value } else { 0.0 };
    let factor = inverse(p99, 0.95).max(inverse(p50, 0.22).min(inverse(p95, 0.95)));
    if factor.is_finite() && factor > 0.0 { factor } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_brings_the_brightest_percent_to_white() {
        let mut values: Vec<f32> = (0..10_000).map(|i| i as f32 / 100.0).collect();
        let factor = automatic_exposure(&mut values);
        assert!((factor * 99.0 - 0.95).abs() < 0.01, "{factor}");
    }

    #[test]
    fn a_lamp_in_the_picture_does_not_darken_the_rest() {
        let mut values = vec![0.5f32; 9_700];
        values.extend([100.0; 300]);
        assert!((automatic_exposure(&mut values) * 0.5 - 0.22).abs() < 0.01);
    }

    #[test]
    fn black_pictures_get_a_finite_factor() {
        assert_eq!(automatic_exposure(&mut [0.0; 10]), 1.0);
        assert_eq!(automatic_exposure(&mut []), 1.0);
    }
}
