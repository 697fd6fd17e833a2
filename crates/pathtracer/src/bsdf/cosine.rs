//! Directions of the upper hemisphere by the cosine law.

use glam::Vec3;

use crate::math::concentric_disc;

/// Maps two uniform numbers to a direction of the upper hemisphere. Its density is cos/π, with the
/// cosine of the angle to the z axis.
#[inline]
pub(crate) fn cosine_direction(u: [f32; 2]) -> Vec3 {
    let (x, y) = concentric_disc(u);
    Vec3::new(x, y, (1.0 - x * x - y * y).max(1e-12).sqrt())
}

/// Computes [`cosine_direction`] for the first `count` of N pairs of numbers, as arrays of x, y and
/// z. The values for later pairs are meaningless.
#[inline]
pub(crate) fn cosine_directions<const N: usize>(u: &[[f32; N]; 2], count: usize) -> [[f32; N]; 3] {
    /// The number of values that fit into one vector on every machine.
    const STEP: usize = 4;
    const { assert!(N.is_multiple_of(STEP)) };
    let mut directions = [[0.0; N]; 3];
    for first in (0..count.min(N)).step_by(STEP) {
        for index in first..first + STEP {
            let direction = cosine_direction([u[0][index], u[1][index]]);
            (0..3).for_each(|axis| directions[axis][index] = direction[axis]);
        }
    }
    directions
}
