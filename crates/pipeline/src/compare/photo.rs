//! Compares a photograph of panels with the simulation of their run.
//!
//! The homography of the display's four corners rectifies the photograph. A factor g adapts the
//! photograph's exposure to the simulation. The factor minimizes Σ (g p − s)², where p are the
//! values of the photograph and s those of the simulation. The values are linear; clipped pixels
//! are excluded:
//!
//! ```text
//! g = Σ s p / Σ p²
//! ```
//!
//! If the camera's position is unknown, it is computed from the corners and the focal length f in
//! pixels. The optical axis of a pinhole camera goes through the middle of the picture. Let H be
//! the homography from millimetres on the display to pixels, where pixels are counted from that
//! middle:
//!
//! ```text
//! H ∝ diag(f, f, 1) [r_1 r_2 t],      eye = −Rᵀ t
//! ```
//!
//! Here r_1 and r_2 are the display's x and y axes in the camera's frame; they are orthonormalized.
//! The columns of R are r_1, r_2 and the display's z axis r_3. The display's centre is at t in the
//! camera's frame. Source: Zhang, "A Flexible New Technique for Camera Calibration" (2000), section
//! 3.1.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use lumistack_display::Homography;
use lumistack_field_io::picture::Picture;
use serde::Serialize;

use super::likeness::{Likeness, Sums, difference, save};
use crate::error::{PipelineError, field_error};
use crate::simulate::{RunFolder, Viewpoint};

/// The position of the camera that took a photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pose {
    /// A measured position.
    Known(Viewpoint),
    /// The position is computed from the corners of the display in the photograph and from the
    /// focal length. The focal length is in millimetres, for a picture of 36 mm × 24 mm (EXIF:
    /// FocalLengthIn35mmFilm).
    FocalMm(f64),
}

/// Comparison of a photograph with the simulation.
#[derive(Clone, Debug, Serialize)]
pub struct PhotoComparison {
    /// Scores of the photograph against the simulation, after the photograph's exposure is adapted.
    pub likeness: Likeness,
    /// Factor g by which the photograph's linear values are multiplied.
    pub gain: f64,
    /// Fraction of the display's pixels at which the photograph is clipped. These pixels are
    /// excluded from the comparison.
    pub clipped: f64,
    /// The camera's position that was computed from the corners: `[x, y, z]` in display space,
    /// millimetres. `None` if the position was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eye_mm: Option<[f64; 3]>,
    /// Written pictures.
    #[serde(serialize_with = "lumistack_core::path_text::told_each")]
    pub pictures: Vec<PathBuf>,
}

/// Compares a photograph with the simulation of a run from the camera's position.
///
/// `corners` are the corners of the light field's rectangle in the photograph, in pixels from the
/// photograph's top left corner. Their order is top left, top right, bottom right, bottom left.
/// `None` stands for the corners of the photograph.
///
/// # Errors
/// If the run or the photograph cannot be read, the corners are not those of a convex figure, or
/// the focal length does not fit the corners. Also if all pixels are clipped or black.
pub fn compare_photo(
    run: &Path,
    photo: &Path,
    pose: Pose,
    corners: Option<[[f64; 2]; 4]>,
    out: Option<&Path>,
) -> Result<PhotoComparison, PipelineError> {
    let run = RunFolder::open(run)?;
    let picture = Picture::read(photo).map_err(field_error)?;
    let size = picture.size();
    let [width, height] = size.map(|side| side as f64);
    let corners = corners.unwrap_or([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]);
    let map = Homography::of_unit_square(corners).ok_or_else(|| {
        PipelineError::option("--corners", "corners", "four corners of a convex figure", format!("{corners:?}"))
    })?;
    // Find the camera's position, and simulate the run from there.
    let (viewpoint, eye_mm) = match pose {
        Pose::Known(viewpoint) => (viewpoint, None),
        Pose::FocalMm(focal_mm) => {
            let focal_px = focal_mm / DIAGONAL_35MM * width.hypot(height);
            let eye = eye_of(&map, run.display.field_pixels().size_mm(), [width, height], focal_px);
            let eye = eye.filter(|eye| focal_px > 0.0 && eye.iter().all(|v| v.is_finite()) && eye[2] > 0.0);
            let eye = eye.ok_or_else(|| {
                PipelineError::option(
                    "--focal-35mm",
                    "MM",
                    "a focal length with which a camera sees the display's corners at the pixels of --corners",
                    focal_mm.to_string(),
                )
            })?;
            (Viewpoint::Eye(eye), Some(eye))
        }
    };
    let simulated = run.picture(viewpoint, false)?;
    let [rows, cols, _] = simulated.shape();
    // Files with integer codes clip bright light, so values near the largest code are excluded.
    let ends = picture.is_encoded();
    let mut linear = picture.into_linear();
    if ends {
        linear.iter_mut().filter(|value| **value >= CLIPPED).for_each(|value| *value = f32::NAN);
    }
    let mut taken = rectified(&linear, size, &map, [rows, cols]);
    let counts: Vec<bool> = taken.chunks_exact(3).map(|rgb| rgb.iter().all(|value| value.is_finite())).collect();
    let clipped = counts.iter().filter(|counts| !**counts).count() as f64 / counts.len().max(1) as f64;
    // Compute the factor g, whose equation is in the module's documentation.
    let (mut products, mut squares) = (0.0, 0.0);
    for ((p, s), _) in taken.chunks_exact(3).zip(simulated.data().chunks_exact(3)).zip(&counts).filter(|(_, c)| **c) {
        products += p.iter().zip(s).map(|(p, s)| f64::from(*p) * f64::from(*s)).sum::<f64>();
        squares += p.iter().map(|p| f64::from(*p) * f64::from(*p)).sum::<f64>();
    }
    let gain = products / squares;
    if !gain.is_finite() {
        let found = format!("{:.0} % of the display's pixels clipped, and all other pixels black", 100.0 * clipped);
        return Err(PipelineError::value(
            photo,
            "exposure",
            "a photograph with pixels between black and clipped",
            found,
        ));
    }
    // Compare at the simulation's exposure. Clipped pixels become white in the written picture.
    for value in &mut taken {
        *value = if value.is_finite() { *value * gain as f32 } else { 1.0 };
    }
    let mut sums = Sums::new();
    sums.add(simulated.data(), &taken, [rows, cols], &counts);
    let mut pictures = Vec::new();
    if let Some(out) = out {
        let path = out.join("photograph.png");
        let panes = vec![simulated.data().to_vec(), taken.clone(), difference(simulated.data(), &taken)];
        save(&path, panes, [rows, cols])?;
        pictures.push(path);
    }
    Ok(PhotoComparison { likeness: sums.likeness(), gain, clipped, eye_mm, pictures })
}

/// Diagonal of a picture of 36 mm × 24 mm, to which EXIF relates focal lengths.
const DIAGONAL_35MM: f64 = 43.266_615;
/// Linear value of the code 254 of 255; from this value on, a pixel is regarded as clipped.
const CLIPPED: f32 = 0.991;

/// Returns the camera's position in display space, millimetres. `map` is the homography from the
/// unit square to the picture. The unit square represents the display of `size_mm`. `None` if the
/// homography is degenerate.
fn eye_of(map: &Homography, size_mm: [f64; 2], [width, height]: [f64; 2], focal_px: f64) -> Option<[f64; 3]> {
    let m = &map.0;
    let unit = DMat3::from_cols_array_2d(m).transpose();
    // Maps millimetres, with y up, to the unit square, with y down.
    let from_mm = DMat3::from_cols(
        DVec3::new(1.0 / size_mm[0], 0.0, 0.0),
        DVec3::new(0.0, -1.0 / size_mm[1], 0.0),
        DVec3::new(0.5, 0.5, 1.0),
    );
    // Maps pixels, with y down, to the camera's frame: right, up and forward.
    let to_camera = DMat3::from_diagonal(DVec3::new(1.0 / focal_px, -1.0 / focal_px, 1.0))
        * DMat3::from_translation(-0.5 * DVec2::new(width, height));
    let h = to_camera * unit * from_mm;
    let scale = 0.5 * (h.x_axis.length() + h.y_axis.length());
    let (a, b) = (h.x_axis.try_normalize()?, h.y_axis.try_normalize()?);
    let (sum, difference) = ((a + b).try_normalize()?, (a - b).try_normalize()?);
    let [r_1, r_2] = [sum + difference, sum - difference].map(|r| r * std::f64::consts::FRAC_1_SQRT_2);
    // In a right-handed frame, z is x × y. The camera's frame is left-handed, so the cross product
    // gets the opposite sign. The display's z axis points to the camera.
    let r_3 = -r_1.cross(r_2);
    let t = h.z_axis / scale;
    Some([-r_1.dot(t), -r_2.dot(t), -r_3.dot(t)])
}

/// Number of sample points per axis in each pixel of the rectified picture.
const POINTS: usize = 4;

/// Returns the part of a picture to which a homography maps the unit square, resampled to [rows,
/// cols]. The picture is `[row][col][rgb]` of size [width, height].
fn rectified(rgb: &[f32], [width, height]: [usize; 2], map: &Homography, [rows, cols]: [usize; 2]) -> Vec<f32> {
    let mut result = vec![0.0f32; 3 * rows * cols];
    let share = 1.0 / (POINTS * POINTS) as f32;
    for (i, pixel) in result.chunks_exact_mut(3).enumerate() {
        let (row, col) = (i / cols, i % cols);
        for (py, px) in (0..POINTS).flat_map(|y| (0..POINTS).map(move |x| (y, x))) {
            let part = |i: usize, p: usize, count: usize| (i as f64 + (p as f64 + 0.5) / POINTS as f64) / count as f64;
            let [x, y] = map.apply([part(col, px, cols), part(row, py, rows)]);
            let axis = |at: f64, count: usize| {
                let at = (at - 0.5).clamp(0.0, (count - 1) as f64);
                (at.floor() as usize, (at.floor() as usize + 1).min(count - 1), (at - at.floor()) as f32)
            };
            let ((left, right, tx), (top, bottom, ty)) = (axis(x, width), axis(y, height));
            for (c, value) in pixel.iter_mut().enumerate() {
                let mix = |row: usize| {
                    (1.0 - tx) * rgb[3 * (row * width + left) + c] + tx * rgb[3 * (row * width + right) + c]
                };
                *value += share * ((1.0 - ty) * mix(top) + ty * mix(bottom));
            }
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Projects corners through a pinhole camera, and recovers the camera's position from them.
    #[test]
    fn corners_tell_where_the_camera_stood() {
        let (size_mm, picture, focal_px) = ([300.0, 200.0], [1600.0, 1200.0], 1900.0);
        for eye in [DVec3::new(120.0, -80.0, 700.0), DVec3::new(0.0, 0.0, 500.0), DVec3::new(-400.0, 90.0, 600.0)] {
            // The camera looks at a point off the centre, and is rolled.
            let forward = (DVec3::new(20.0, 10.0, 0.0) - eye).normalize();
            let right = forward.cross(DVec3::new(0.1, 1.0, 0.0)).normalize();
            let up = right.cross(forward);
            let corner = |x: f64, y: f64| {
                let seen = DVec3::new(0.5 * x * size_mm[0], 0.5 * y * size_mm[1], 0.0) - eye;
                let depth = seen.dot(forward);
                [
                    0.5 * picture[0] + focal_px * seen.dot(right) / depth,
                    0.5 * picture[1] - focal_px * seen.dot(up) / depth,
                ]
            };
            let corners = [corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)];
            let map = Homography::of_unit_square(corners).unwrap();
            let found = DVec3::from_array(eye_of(&map, size_mm, picture, focal_px).unwrap());
            assert!((found - eye).length() < 1e-6, "{found} instead of {eye}");
        }
    }
}
