//! Homographies from photographs of the crosshair array.
//!
//! One photograph per layer, all from one place and without touching the camera: the array on that layer alone, drawn in perspective for the camera's place e.
//! The reference layer's photograph says how the camera sees the display's plane:
//!
//! ```text
//! photograph = centre + size · distort(H(P)),   distort(u) = u · (1 + k₁ |u|² + k₂ |u|⁴)
//! ```
//!
//! Every cross of another layer is then seen where some point P' of that plane is; on the layer itself it is at t = e + (P' − e) · (D − d) / D, and was meant to be
//! at q, the same of P. The homography from q to t is what the panel's calibration wants.

mod camera;
mod crosses;

use image::GrayImage;
use lumistack_plugin::display::{Display, Homography};
use thiserror::Error;

use crate::pattern;

pub use camera::Camera;
pub use crosses::{Cross, find_crosses};

/// A photograph from which nothing can be learned.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CalibrationError {
    /// The array is not found.
    #[error("photograph of layer {layer}: expected {expected}, found {found}")]
    Array {
        /// Which.
        layer: usize,
        /// What was needed.
        expected: String,
        /// What was there.
        found: String,
    },
    /// No map fits the points.
    #[error(
        "photograph of layer {layer}: the crosses do not lie as an array in perspective does: {rms_px:.1} pixels off"
    )]
    Fit {
        /// Which.
        layer: usize,
        /// Root mean square distance, pixels of the photograph.
        rms_px: f64,
    },
}

/// What a photograph says about a layer's panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Which layer.
    pub layer: usize,
    /// The homography for its calibration, what it had before included.
    pub homography: Homography,
    /// Crosses that were found.
    pub crosses: usize,
    /// Root mean square distance of the crosses from what the homography says, millimetres.
    pub rms_mm: f64,
    /// How far the panel's pixels were from where they should have been, millimetres: root mean square over the crosses.
    pub moved_mm: f64,
}

/// Crosses that must be found at least.
const FEWEST: usize = 9;
/// Distance beyond which crosses are no array in perspective, pixels of the photograph.
const ROUGH_PX: f64 = 3.0;

/// What photographs (a layer each) say about the layers other than the reference.
///
/// # Errors
/// If a photograph does not show the array, or the crosses do not lie as they should.
pub fn calibrate(
    display: &Display,
    eye_mm: [f64; 3],
    reference: (usize, &GrayImage),
    others: &[(usize, &GrayImage)],
) -> Result<(Camera, Vec<Found>), CalibrationError> {
    let spacing = pattern::spacing_mm(display);
    let on_plane = |cross: &Cross| cross.index.map(|i| f64::from(i) * spacing);
    let seen = array(display, reference)?;
    let pairs: Vec<_> = seen.iter().map(|cross| (on_plane(cross), cross.at_px)).collect();
    let size = [reference.1.width(), reference.1.height()].map(f64::from);
    let camera = Camera::fit(&pairs, size);
    let rms_px = camera.rms_px(&pairs);
    if rms_px.is_nan() || rms_px > ROUGH_PX {
        return Err(CalibrationError::Fit { layer: reference.0, rms_px });
    }
    let mut all = Vec::new();
    for &(layer, photograph) in others {
        let seen = array(display, (layer, photograph))?;
        let d_mm = display.layers[layer].d_mm;
        let share = (eye_mm[2] - d_mm) / eye_mm[2];
        let onto_layer = |p: [f64; 2]| [0, 1].map(|axis| eye_mm[axis] + (p[axis] - eye_mm[axis]) * share);
        let pairs: Vec<_> =
            seen.iter().map(|cross| (onto_layer(on_plane(cross)), onto_layer(camera.on_plane(cross.at_px)))).collect();
        let map = camera::homography(&pairs);
        let rms = |distance: &dyn Fn([f64; 2], [f64; 2]) -> f64| {
            (pairs.iter().map(|(q, t)| distance(*q, *t).powi(2)).sum::<f64>() / pairs.len() as f64).sqrt()
        };
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let before = display.layers[layer].panel.as_ref().and_then(|panel| panel.homography);
        let mut homography = map.after(&before.map_or(Homography::IDENTITY, Homography));
        let scale = homography.0[2][2];
        homography.0.iter_mut().flatten().for_each(|value| *value /= scale);
        all.push(Found {
            layer,
            homography,
            crosses: pairs.len(),
            rms_mm: rms(&|q, t| apart(map.apply(q), t)),
            moved_mm: rms(&apart),
        });
    }
    Ok((camera, all))
}

fn array(display: &Display, (layer, photograph): (usize, &GrayImage)) -> Result<Vec<Cross>, CalibrationError> {
    let wrong = |expected: String, found: String| CalibrationError::Array { layer, expected, found };
    let [cols, rows] = pattern::crosses(display);
    let found = find_crosses(photograph, [cols, rows])
        .map_err(|found| wrong("the array of crosses with the mark of its middle one".into(), found))?;
    if found.len() < FEWEST {
        let expected = format!("at least {FEWEST} of {} crosses", (2 * cols + 1) * (2 * rows + 1));
        return Err(wrong(expected, found.len().to_string()));
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
