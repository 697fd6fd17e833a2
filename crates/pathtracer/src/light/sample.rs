//! The measures that all kinds of lights share.

use glam::Vec3;

/// Light that could arrive at a point.
pub(crate) struct LightSample {
    /// Towards the light.
    pub(crate) direction: Vec3,
    /// Where the shadow ray ends, just before the light; `None` for light from infinity.
    pub(crate) end: Option<Vec3>,
    /// Radiance over density: multiply by f |cos|, visibility and the heuristic's weight.
    pub(crate) weight: Vec3,
    /// 1 over the density per solid angle, including the choice of the light; 0 for punctual
    /// lights, which no other technique finds.
    pub(crate) inverse_pdf: f32,
}

/// The measure of light for choosing among lights: the length of its colour, 1 for white. Chances
/// in proportion to it minimize the squared error of the channels together. By luminance, blue
/// light would be chosen fourteen times more rarely than white, and its noise would show.
pub(super) fn magnitude(rgb: Vec3) -> f32 {
    rgb.length() * (1.0 / 3.0f32).sqrt()
}
