//! Lights without a surface (`KHR_lights_punctual`). The irradiance of a point light or spotlight
//! is intensity over squared distance. Spotlights have the extension's smooth cone.
//!
//! Distant lights are discs of the sky. A cone of half angle θ with the irradiance E has the
//! radiance E / (π sin²θ). A direction drawn uniformly from the cone's solid angle 2π (1 − cos θ)
//! thus has the weight 2 E / (1 + cos θ). Scattered rays never find any of the lights of this file.

use std::f64::consts::PI;

use glam::Vec3;
use lumistack_scene::{Light, LightKind};

use super::sample::{LightSample, magnitude};
use super::tree::Emitter;
use crate::geometry::RenderSpace;
use crate::math::sin_cos_turns;

/// Smallest difference of the cosines of a spot's cones, from the extension's formula.
const LEAST_CONE_DIFFERENCE: f32 = 1e-3;

/// Angle by which the light tree widens the cone of a spot, against rounding at its edge.
const SPOT_MARGIN_RAD: f32 = 0.05;

/// A punctual light in render space.
pub(crate) struct PunctualLight {
    position: Vec3,
    direction: Vec3,
    intensity: Vec3,
    kind: LightKind,
}

impl PunctualLight {
    pub(crate) fn new(light: &Light, space: RenderSpace) -> Self {
        // irradiance I/d² must not depend on the scale of render space
        let scale = match light.kind {
            LightKind::Directional | LightKind::Distant { .. } => 1.0,
            LightKind::Point | LightKind::Spot { .. } => (space.scale * space.scale) as f32,
        };
        Self {
            position: space.point(light.position.as_dvec3()).as_vec3(),
            direction: light.direction,
            intensity: scale * light.intensity,
            kind: light.kind,
        }
    }

    /// Returns the power of the light. For a light from infinity, it is the power that reaches a
    /// sphere of `radius`.
    pub(crate) fn power(&self, radius: f32) -> f64 {
        let intensity = f64::from(magnitude(self.intensity));
        match self.kind {
            LightKind::Point => 4.0 * PI * intensity,
            LightKind::Spot { outer_cone_rad, .. } => 2.0 * PI * (1.0 - f64::from(outer_cone_rad).cos()) * intensity,
            LightKind::Directional | LightKind::Distant { .. } => PI * f64::from(radius * radius) * intensity,
        }
    }

    /// Returns the light's entry in the light tree; `None` for light from infinity.
    pub(crate) fn emitter(&self) -> Option<Emitter> {
        let strength = magnitude(self.intensity);
        let (normal_angle, falloff_angle) = match self.kind {
            LightKind::Point => (std::f32::consts::PI, std::f32::consts::FRAC_PI_2),
            LightKind::Spot { outer_cone_rad, .. } => (outer_cone_rad, SPOT_MARGIN_RAD),
            LightKind::Directional | LightKind::Distant { .. } => return None,
        };
        let axis = self.direction.normalize_or(Vec3::Z);
        Some(Emitter {
            min: self.position,
            max: self.position,
            strength,
            axis,
            normal_angle,
            falloff_angle,
            two_sided: false,
        })
    }

    /// Returns a sample of the light. `chance` is the chance with which this light was chosen. For
    /// a distant light, `u` chooses a direction of its cone.
    pub(crate) fn light_sample(&self, from: Vec3, chance: f32, u: [f32; 2]) -> Option<LightSample> {
        let (direction, end, intensity) = self.sample(from, u)?;
        Some(LightSample { direction, end, weight: intensity / chance, inverse_pdf: 0.0 })
    }

    /// Returns the direction to the light, the light's position (`None` at infinity), and its
    /// irradiance on a surface that faces it. For a distant light, the third value is the weight
    /// that the top of the file defines.
    fn sample(&self, from: Vec3, u: [f32; 2]) -> Option<(Vec3, Option<Vec3>, Vec3)> {
        match self.kind {
            LightKind::Directional => return Some((-self.direction, None, self.intensity)),
            LightKind::Distant { half_angle_rad } => {
                let edge = half_angle_rad.cos();
                let cosine = 1.0 - u[0] * (1.0 - edge);
                let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
                let (sin_turn, cos_turn) = sin_cos_turns(u[1]);
                let centre = -self.direction;
                let (x, y) = centre.any_orthonormal_pair();
                let direction = sine * (cos_turn * x + sin_turn * y) + cosine * centre;
                return Some((direction, None, self.intensity * (2.0 / (1.0 + edge))));
            }
            LightKind::Point | LightKind::Spot { .. } => {}
        }
        let to_light = self.position - from;
        let distance = to_light.length();
        let direction = to_light / distance;
        let falloff = match self.kind {
            LightKind::Spot { inner_cone_rad, outer_cone_rad } => {
                let (inner, outer) = (inner_cone_rad.cos(), outer_cone_rad.cos());
                let along = -direction.dot(self.direction);
                ((along - outer) / (inner - outer).max(LEAST_CONE_DIFFERENCE)).clamp(0.0, 1.0).powi(2)
            }
            LightKind::Point | LightKind::Directional | LightKind::Distant { .. } => 1.0,
        };
        (distance > 0.0 && falloff > 0.0)
            .then(|| (direction, Some(self.position), self.intensity * (falloff / (distance * distance))))
    }
}
