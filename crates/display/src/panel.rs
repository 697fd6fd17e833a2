//! Calibration of the physical panels: the output of the computer that drives a panel, and the real
//! positions of the panel's pixels.
//!
//! ```text
//! output pixel ─rotate, flip─▶ upright pixel (u, v) ─crop─▶ nominal position (x, y) mm
//!     ─homography─▶ position on the layer, mm ─pitch─▶ mask pixel
//!
//! x = (u − nudge_x − u_centre) · panel_pitch,   y = (v_centre − v + nudge_y) · panel_pitch
//! ```
//!
//! Patterns do not depend on the calibration: output plugins apply it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Sampling;

/// One physical panel.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[cfg_attr(not(target_arch = "wasm32"), derive(Deserialize), serde(deny_unknown_fields))]
pub struct Panel {
    /// Name of the output that drives the panel, as `lumistack show --list` prints it. Panels
    /// without this key take the outputs that no panel names, from left to right.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<String>,
    /// Rotation of the upright picture on the output, clockwise: 0, 90, 180 or 270 degrees.
    #[serde(default)]
    pub rotate_deg: u32,
    /// Mirroring of the upright picture before its rotation, for a panel that is seen from behind.
    #[serde(default)]
    pub flip: Flip,
    /// [left, top, columns, rows] of the region of the upright picture that is used; its centre is
    /// the layer's centre. Default: the whole picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<[usize; 4]>,
    /// [right, down] shift of the upright picture, panel pixels.
    #[serde(default)]
    pub nudge_px: [f64; 2],
    /// Map from a pixel's nominal position to its real position, as the rows of a 3 × 3 matrix.
    /// Positions are in millimetres from the layer's centre, x right, y up. Default: the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub homography: Option<[[f64; 3]; 3]>,
    /// Measured crosstalk in addition to `layers[].crosstalk`, which the patterns already account
    /// for. The additional crosstalk is compensated when the patterns are shown. Row = emitted
    /// channel, column = channel of the picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crosstalk: Option<[[f64; 3]; 3]>,
    /// Interpolation of the mask at a panel pixel.
    #[serde(default)]
    pub resample: Sampling,
}

/// The mirroring of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Flip {
    /// The picture is not mirrored.
    #[default]
    None,
    /// Left and right are exchanged.
    Horizontal,
    /// Top and bottom are exchanged.
    Vertical,
}

/// Measured data of a real lens array that differs from the array for which the patterns were made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
#[cfg_attr(not(target_arch = "wasm32"), derive(Deserialize), serde(deny_unknown_fields))]
pub struct Lens {
    /// Distance between the axes of neighbouring lenslets, millimetres; default: the backlight's
    /// `pitch_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pitch_mm: Option<f64>,
    /// Focal length in air, millimetres; default: the length at which the horizontal bins fill the
    /// width of the panel behind one lenslet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_mm: Option<f64>,
    /// Rotation against the panel, counterclockwise seen from the front, degrees.
    #[serde(default)]
    pub rotation_deg: f64,
    /// [x, y] shift of the array in addition to the backlight's `offset_mm`, millimetres.
    #[serde(default)]
    pub offset_mm: [f64; 2],
}

/// In the browser build, every [`Panel`](super::Panel) and [`Lens`](super::Lens) has the default
/// values. That build uses neither, and the code that reads them would take 5 % of the page's size.
#[cfg(target_arch = "wasm32")]
mod unread {
    use serde::de::{Deserialize, Deserializer, IgnoredAny};

    impl<'de> Deserialize<'de> for super::Panel {
        fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
            IgnoredAny::deserialize(deserializer).map(|_| Self::default())
        }
    }

    impl<'de> Deserialize<'de> for super::Lens {
        fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
            IgnoredAny::deserialize(deserializer).map(|_| Self::default())
        }
    }
}

/// A matrix is taken as singular if its determinant, divided by the product of its rows' lengths,
/// is below this limit.
const SINGULAR: f64 = 1e-9;

impl Panel {
    /// Returns the first invalid key, the expected value and the value found; `None` if all keys
    /// are valid.
    pub(crate) fn problem(&self) -> Option<(&'static str, &'static str, String)> {
        if !matches!(self.rotate_deg, 0 | 90 | 180 | 270) {
            return Some(("rotate_deg", "0, 90, 180 or 270", self.rotate_deg.to_string()));
        }
        if let Some(crop) = self.crop
            && (crop[2] == 0 || crop[3] == 0)
        {
            return Some(("crop", "[left, top, columns, rows] with at least one column and row", format!("{crop:?}")));
        }
        if !self.nudge_px.iter().all(|shift| shift.is_finite()) {
            return Some(("nudge_px", "finite numbers", format!("{:?}", self.nudge_px)));
        }
        for (key, matrix) in [("homography", &self.homography), ("crosstalk", &self.crosstalk)] {
            if let Some(matrix) = matrix
                && !is_regular(matrix)
            {
                return Some((key, "a 3 × 3 matrix that can be inverted", format!("{matrix:?}")));
            }
        }
        None
    }
}

impl Lens {
    /// Returns the first invalid key, the expected value and the value found; `None` if all keys
    /// are valid.
    pub(crate) fn problem(&self) -> Option<(&'static str, &'static str, String)> {
        for (key, length) in [("pitch_mm", self.pitch_mm), ("focal_mm", self.focal_mm)] {
            if let Some(length) = length
                && !(length.is_finite() && length > 0.0)
            {
                return Some((key, "a number above 0", length.to_string()));
            }
        }
        if self.rotation_deg.is_nan() || self.rotation_deg.abs() > 45.0 {
            return Some(("rotation_deg", "-45 to 45", self.rotation_deg.to_string()));
        }
        let finite = self.offset_mm.iter().all(|shift| shift.is_finite());
        (!finite).then(|| ("offset_mm", "finite numbers", format!("{:?}", self.offset_mm)))
    }
}

fn is_regular(m: &[[f64; 3]; 3]) -> bool {
    let minor = |a: usize, b: usize| m[1][a] * m[2][b] - m[1][b] * m[2][a];
    let determinant = m[0][0] * minor(1, 2) - m[0][1] * minor(0, 2) + m[0][2] * minor(0, 1);
    let norm = m.iter().map(|row| row.iter().map(|value| value * value).sum::<f64>().sqrt()).product::<f64>();
    determinant.is_finite() && determinant.abs() > SINGULAR * norm
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Display;
    use crate::config::tests::SMALL;

    const PANEL: &str = "d_mm = 12.0\n[layers.panel]\n";

    fn with(lines: &str) -> String {
        // In TOML, the front layer's other keys must stand before its table `panel`.
        let (head, _) = SMALL.split_at(SMALL.rfind("d_mm = 12.0").unwrap());
        format!("{head}resolution = [16, 10]\npitch_mm = 1.0\n{PANEL}{lines}")
    }

    #[test]
    fn every_key_of_a_panel_survives_and_patterns_do_not_depend_on_it() {
        let text = with(
            "output = \"DP-2\"\nrotate_deg = 270\nflip = \"vertical\"\ncrop = [4, 2, 32, 20]\nnudge_px = [1.5, -2.0]\nresample = \"bilinear\"\n\
             homography = [[1.0, 0.01, 0.2], [0.0, 1.0, -0.1], [0.0, 1e-5, 1.0]]\ncrosstalk = [[0.9, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.1, 0.9]]\n",
        );
        let display = Display::from_toml(&text).unwrap();
        let panel = display.layers[2].panel.as_ref().unwrap();
        assert_eq!(
            (panel.output.as_deref(), panel.flip, panel.crop),
            (Some("DP-2"), Flip::Vertical, Some([4, 2, 32, 20]))
        );
        assert_eq!(Display::from_toml(&display.to_toml()).unwrap(), display);
        assert_eq!(display.without_panels(), Display::from_toml(SMALL).unwrap());
    }

    #[test]
    fn errors_name_the_key() {
        for (line, message) in [
            ("rotate_deg = 45", "layers[2].panel.rotate_deg: expected 0, 90, 180 or 270, found 45"),
            ("crop = [0, 0, 0, 4]", "layers[2].panel.crop: expected [left, top, columns, rows]"),
            ("nudge_px = [nan, 0.0]", "layers[2].panel.nudge_px: expected finite numbers"),
            (
                "homography = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 1.0]]",
                "layers[2].panel.homography: expected a 3 × 3",
            ),
            (
                "crosstalk = [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]",
                "layers[2].panel.crosstalk: expected a 3 × 3",
            ),
        ] {
            let error = Display::from_toml(&with(line)).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
        let unknown = Display::from_toml(&with("rotation = 90")).unwrap_err().to_string();
        assert!(unknown.contains("unknown field `rotation`"), "{unknown}");
        let lens = Lens { focal_mm: Some(0.0), ..Lens::default() };
        assert_eq!(lens.problem().unwrap().0, "focal_mm");
        assert_eq!(Lens { rotation_deg: f64::NAN, ..Lens::default() }.problem().unwrap().0, "rotation_deg");
    }
}
