//! The results and measures that all kinds of lights share.

use glam::Vec3;

/// Light that arrives at a point unless something blocks it.
pub(crate) struct LightSample {
    /// Direction to the light.
    pub(crate) direction: Vec3,
    /// End of the shadow ray: the position of a point light or spotlight, or a point just in front
    /// of an emitting triangle. `None` for light from infinity.
    pub(crate) end: Option<Vec3>,
    /// Radiance divided by density; for punctual lights, irradiance divided by the chance of the
    /// light. It is still to be multiplied by f |cos| with the scattering function f, by
    /// visibility, and by the weight of the power heuristic.
    pub(crate) weight: Vec3,
    /// 1 over the density per solid angle, where the density includes the choice of the light. 0
    /// for punctual lights, which scattered rays never find.
    pub(crate) inverse_pdf: f32,
}

/// Returns the strength of a light for choosing among lights: the length of its colour, scaled so
/// that white has 1. Chances in proportion to this strength minimize the sum of the channels'
/// squared errors. With luminance instead, blue light would be chosen fourteen times more rarely
/// than white light, and its noise would show.
pub(super) fn magnitude(rgb: Vec3) -> f32 {
    rgb.length() * (1.0 / 3.0f32).sqrt()
}
