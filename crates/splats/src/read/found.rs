//! The result of every reader, and conversions of stored values that the formats share.

use glam::{Quat, Vec3};
use lumistack_scene::Cloud;
use thiserror::Error;

/// Directions of the three axes of a file of splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// x right, y up, z towards the viewer: the axes of glTF and of a scene.
    RightUpBack,
    /// x right, y down, z away from the viewer: the axes of the cameras that a capture was trained
    /// with.
    RightDownFront,
}

impl Axes {
    /// Returns the rotation from the file's axes to the scene's.
    pub fn scene_from_file(self) -> Quat {
        match self {
            Self::RightUpBack => Quat::IDENTITY,
            // half a turn about x reverses y and z
            Self::RightDownFront => Quat::from_xyzw(1.0, 0.0, 0.0, 0.0),
        }
    }
}

/// A cloud as read from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// The splats of the file, before validation.
    pub cloud: Cloud,
    /// The axes of the cloud's positions and rotations.
    pub axes: Axes,
    /// One message for each kind of data in the file that was not read.
    pub left_out: Vec<String>,
}

/// A file that cannot be read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{place}: expected {expected}, found {found}")]
pub struct ReadError {
    /// Place of the wrong value in the file.
    pub place: String,
    /// The values that the format allows at this place.
    pub expected: String,
    /// The value that the file has.
    pub found: String,
}

impl ReadError {
    pub(super) fn new(place: impl Into<String>, expected: impl Into<String>, found: impl ToString) -> Self {
        Self { place: place.into(), expected: expected.into(), found: found.to_string() }
    }
}

/// Largest size of a decompressed file, in bytes.
pub const MAX_BYTES: u64 = 8 << 30;

/// Converts the logit that trainers store to an opacity: 1/(1 + e^−x).
pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Converts a colour in 0..1 to the coefficient of the constant harmonic.
pub(super) fn constant(colour: f32) -> f32 {
    (colour - 0.5) / 0.282_094_8
}

/// Returns the degree of the harmonics that have this number of coefficients, not counting the
/// constant one.
pub(super) fn degree_of(coefficients: usize) -> Option<usize> {
    [0, 3, 8, 15].iter().position(|known| *known == coefficients)
}

/// Restores a unit quaternion from its three smaller components, which files store.
///
/// `rest` is the result without its component `largest`, in the same order.
pub(super) fn from_smallest_three(rest: [f32; 3], largest: usize) -> [f32; 4] {
    let mut all = [0.0; 4];
    let others = (0..4).filter(|i| *i != largest);
    others.zip(rest).for_each(|(i, value)| all[i] = value);
    all[largest] = (1.0 - rest.iter().map(|value| value * value).sum::<f32>()).max(0.0).sqrt();
    all
}

/// Makes an empty cloud with capacity for `count` splats.
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

/// Converts the logarithms that files store to scales.
pub(super) fn exp(log: Vec3) -> Vec3 {
    Vec3::new(log.x.exp(), log.y.exp(), log.z.exp())
}
