//! Computes the panels' homographies from photographs of the crosshair array.
//!
//! There is one photograph per layer, all from one camera position e. A layer's photograph shows
//! the array on this layer alone, drawn in perspective for e. One layer is the reference. Its
//! photograph determines the camera, which maps a point P of the display plane to the photograph:
//!
//! ```text
//! photograph = centre + size · distort(H(P)),   distort(u) = u · (1 + k₁ |u|² + k₂ |u|⁴)
//! ```
//!
//! H is a homography, and `size` is half the photograph's diagonal. If a layer at d is misplaced,
//! its cross for point P of the display plane appears at another point P'. The cross was drawn at
//! point q of the layer, but the real panel shows it at point t. D is the distance of e from the
//! display plane:
//!
//! ```text
//! q = e + (P − e) · (D − d) / D        t = e + (P' − e) · (D − d) / D
//! ```
//!
//! The homography that maps q to t, for all crosses, is the panel's calibration.

mod camera;
mod crosses;

use image::GrayImage;
use lumistack_plugin::display::{Display, Homography};
use thiserror::Error;

use crate::pattern;

pub use camera::Camera;
pub use crosses::{Cross, find_crosses};

/// A photograph from which no calibration can be computed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CalibrationError {
    /// The array was not found.
    #[error("photograph of layer {layer}: expected {expected}, found {found}")]
    Array {
        /// Index of the photographed layer.
        layer: usize,
        /// The content that the photograph should have.
        expected: String,
        /// The content that was found in the photograph.
        found: String,
    },
    /// The camera model does not fit the crosses.
    #[error(
        "photograph of layer {layer}: expected crosses that fit the perspective of a camera with a reprojection error of at most 3 pixels, found an error of {rms_px:.1} pixels. Take a sharp photograph that shows all crosses"
    )]
    Fit {
        /// Index of the photographed layer.
        layer: usize,
        /// Root mean square reprojection error, pixels of the photograph.
        rms_px: f64,
    },
}

/// Calibration of one layer's panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Index of the layer.
    pub layer: usize,
    /// The panel's new homography. It includes the previous homography, with which the array was
    /// drawn.
    pub homography: Homography,
    /// Number of crosses found.
    pub crosses: usize,
    /// Root mean square error of the crosses under the new homography, millimetres.
    pub rms_mm: f64,
    /// Root mean square error of the crosses under the previous homography, millimetres.
    pub moved_mm: f64,
}

/// Smallest number of crosses from which a calibration is computed.
const FEWEST: usize = 9;
/// Largest reprojection error with which a photograph is accepted, pixels of the photograph.
const ROUGH_PX: f64 = 3.0;

/// Calibrates the panels of the layers in `others`, each from one photograph. `eye_mm` is the
/// camera's position in display space, for which the array was drawn. Returns the camera fitted to
/// the photograph of `reference`, and one result per layer in `others`.
///
/// # Errors
/// If a photograph does not show the array, or if the camera model does not fit the crosses of the
/// reference layer.
pub fn calibrate(
    display: &Display,
    eye_mm: [f64; 3],
    reference: (usize, &GrayImage),
    others: &[(usize, &GrayImage)],
) -> Result<(Camera, Vec<Found>), CalibrationError> {
    let spacing = pattern::spacing_mm(display);
    // Fit the camera to the crosses of the reference layer, which are on the display plane by
    // definition.
    let on_plane = |cross: &Cross| cross.index.map(|i| f64::from(i) * spacing);
    let found = array(display, reference)?;
    let pairs: Vec<_> = found.iter().map(|cross| (on_plane(cross), cross.at_px)).collect();
    let size = [reference.1.width(), reference.1.height()].map(f64::from);
    let camera = Camera::fit(&pairs, size);
    let rms_px = camera.rms_px(&pairs);
    if rms_px.is_nan() || rms_px > ROUGH_PX {
        return Err(CalibrationError::Fit { layer: reference.0, rms_px });
    }
    let mut all = Vec::new();
    for &(layer, photograph) in others {
        // Project the drawn and the photographed position of every cross onto the layer. Fit the
        // homography from the drawn to the photographed positions.
        let found = array(display, (layer, photograph))?;
        let d_mm = display.layers[layer].d_mm;
        let share = (eye_mm[2] - d_mm) / eye_mm[2];
        let onto_layer = |p: [f64; 2]| [0, 1].map(|axis| eye_mm[axis] + (p[axis] - eye_mm[axis]) * share);
        let pairs: Vec<_> =
            found.iter().map(|cross| (onto_layer(on_plane(cross)), onto_layer(camera.on_plane(cross.at_px)))).collect();
        let map = camera::homography(&pairs);
        let rms = |distance: &dyn Fn([f64; 2], [f64; 2]) -> f64| {
            (pairs.iter().map(|(q, t)| distance(*q, *t).powi(2)).sum::<f64>() / pairs.len() as f64).sqrt()
        };
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        // Compose the new map with the panel's previous homography. Scale the result so that its
        // last element is 1.
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
        .map_err(|found| wrong("the array of crosses with the mark of its central cross".into(), found))?;
    if found.len() < FEWEST {
        let expected = format!("at least {FEWEST} of {} crosses", (2 * cols + 1) * (2 * rows + 1));
        return Err(wrong(expected, format!("{} crosses", found.len())));
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
