//! Skies: smooth equirectangular radiance maps in Radiance HDR.
//!
//! Row 0 of the image is +y (up), and the image's centre column looks along -z. In the image, u
//! rises to the right and v downwards, both 0..1. Columns to the right of the centre turn towards
//! +x. So the direction of (u, v) is (sin πv · sin 2π(u - ½), cos πv, -sin πv · cos 2π(u - ½)).

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use image::Rgb;
use image::codecs::hdr::HdrEncoder;

use crate::{GeneratorError, SceneFile};

const COLUMNS: usize = 64;
const ROWS: usize = 32;

/// A broad light in the sky. At the angle θ from `direction` its radiance is `color` times
/// exp(-sharpness (1 - cos θ)).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Glow {
    /// Unit direction from the scene to the light's middle.
    pub(crate) direction: DVec3,
    /// Radiance that the light adds to the sky in the light's middle, linear RGB.
    pub(crate) color: DVec3,
    /// A larger value makes the light narrower.
    pub(crate) sharpness: f64,
}

/// A sky: a gradient from the ground over the horizon to the zenith, to which broad lights are
/// added. Radiance is linear.
#[derive(Debug, Clone)]
pub(crate) struct Sky {
    /// Radiance straight up.
    pub(crate) zenith: DVec3,
    /// Radiance at the horizon.
    pub(crate) horizon: DVec3,
    /// Radiance straight down.
    pub(crate) ground: DVec3,
    /// Broad lights.
    pub(crate) glows: Vec<Glow>,
}

impl Sky {
    /// Returns the radiance from a unit direction.
    pub(crate) fn radiance(&self, direction: DVec3) -> DVec3 {
        let target = if direction.y >= 0.0 { self.zenith } else { self.ground };
        // the slope of the blend is 0 at the horizon and the poles, so that the upper and lower
        // half join smoothly
        let t = direction.y.abs();
        let base = self.horizon.lerp(target, t * t * (3.0 - 2.0 * t));
        self.glows.iter().fold(base, |sum, glow| {
            let cosine = direction.dot(glow.direction.normalize());
            sum + glow.color * (-glow.sharpness * (1.0 - cosine)).exp()
        })
    }

    /// Encodes the sky as a Radiance HDR file.
    pub(crate) fn encode(&self, file: String) -> Result<SceneFile, GeneratorError> {
        let pixels: Vec<Rgb<f32>> = (0..ROWS * COLUMNS)
            .map(|k| {
                let u = ((k % COLUMNS) as f64 + 0.5) / COLUMNS as f64;
                let v = ((k / COLUMNS) as f64 + 0.5) / ROWS as f64;
                Rgb(self.radiance(direction(u, v)).as_vec3().to_array())
            })
            .collect();
        let mut bytes = Vec::new();
        HdrEncoder::new(&mut bytes)
            .encode(&pixels, COLUMNS, ROWS)
            .map_err(|source| GeneratorError::Encode { file: file.clone(), source })?;
        Ok((file, bytes))
    }
}

fn direction(u: f64, v: f64) -> DVec3 {
    let (sin_polar, cos_polar) = (PI * v).sin_cos();
    let (sin, cos) = (TAU * (u - 0.5)).sin_cos();
    DVec3::new(sin_polar * sin, cos_polar, -sin_polar * cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn map_directions_follow_the_stated_convention() {
        assert!((direction(0.5, 0.5) - DVec3::NEG_Z).length() < 1e-12);
        assert!((direction(0.75, 0.5) - DVec3::X).length() < 1e-12);
        assert!((direction(0.3, 0.0) - DVec3::Y).length() < 1e-12);
    }

    #[test]
    fn a_glow_is_brightest_at_its_texel() {
        let sky = Sky {
            zenith: DVec3::splat(0.1),
            horizon: DVec3::splat(0.1),
            ground: DVec3::splat(0.1),
            glows: vec![Glow { direction: DVec3::X, color: DVec3::splat(4.0), sharpness: 10.0 }],
        };
        let (_, bytes) = sky.encode("sky.hdr".into()).expect("a small sky encodes");
        let decoder = image::codecs::hdr::HdrDecoder::new(bytes.as_slice()).expect("our own file decodes");
        let picture = image::DynamicImage::from_decoder(decoder).expect("our own file decodes").to_rgb32f();
        let brightest = picture.enumerate_pixels().max_by(|a, b| a.2[0].total_cmp(&b.2[0]));
        let (x, y, _) = brightest.expect("the sky has pixels");
        assert!((47..=48).contains(&x) && (15..=16).contains(&y), "{x} {y}");
    }
}
