//! What every reader returns, and the activations that files share.

use glam::{Quat, Vec3};
use lumistack_scene::Cloud;
use thiserror::Error;

/// What a file's axes mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// x right, y up, z towards the viewer: those of glTF and of a scene.
    RightUpBack,
    /// x right, y down, z away from the viewer: those of the cameras that captures are trained with.
    RightDownFront,
}

impl Axes {
    /// The turn to the axes of a scene.
    pub fn scene_from_file(self) -> Quat {
        match self {
            Self::RightUpBack => Quat::IDENTITY,
            // half a turn about x
            Self::RightDownFront => Quat::from_xyzw(1.0, 0.0, 0.0, 0.0),
        }
    }
}

/// A cloud and what is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Not validated.
    pub cloud: Cloud,
    /// Its axes.
    pub axes: Axes,
    /// What of the file is left out.
    pub left_out: Vec<String>,
}

/// A file that cannot be read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{place}: expected {expected}, found {found}")]
pub struct ReadError {
    /// Place in the file.
    pub place: String,
    /// What was needed.
    pub expected: String,
    /// What was there.
    pub found: String,
}

impl ReadError {
    pub(super) fn new(place: impl Into<String>, expected: impl Into<String>, found: impl ToString) -> Self {
        Self { place: place.into(), expected: expected.into(), found: found.to_string() }
    }
}

/// Bytes that a file may unpack to.
pub const MAX_BYTES: u64 = 8 << 30;

/// Opacity of what trainers keep: 1/(1 + e^−x).
pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Coefficient of the constant harmonic that shows a colour.
pub(super) fn constant(colour: f32) -> f32 {
    (colour - 0.5) / 0.282_094_8
}

/// Degree of so many coefficients beyond the constant one.
pub(super) fn degree_of(coefficients: usize) -> Option<usize> {
    [0, 3, 8, 15].iter().position(|known| *known == coefficients)
}

/// A quaternion of which the largest component is left out, the others in the order of `rest`; `largest` counts in that order.
pub(super) fn from_smallest_three(rest: [f32; 3], largest: usize) -> [f32; 4] {
    let mut all = [0.0; 4];
    let others = (0..4).filter(|i| *i != largest);
    others.zip(rest).for_each(|(i, value)| all[i] = value);
    all[largest] = (1.0 - rest.iter().map(|value| value * value).sum::<f32>()).max(0.0).sqrt();
    all
}

/// Room for a cloud of so many splats.
pub(super) fn cloud(place: &str, count: usize, degree: usize) -> Cloud {
    Cloud {
        place: place.to_owned(),
        positions: Vec::with_capacity(count),
        rotations: Vec::with_capacity(count),
        scales: Vec::with_capacity(count),
        opacities: Vec::with_capacity(count),
        degree,
        harmonics: Vec::with_capacity(3 * (degree + 1).pow(2) * count),
        ..Cloud::default()
    }
}

/// Scales are kept as logarithms.
pub(super) fn exp(log: Vec3) -> Vec3 {
    Vec3::new(log.x.exp(), log.y.exp(), log.z.exp())
}
