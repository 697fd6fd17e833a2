//! Computes the native picture of a lenticular display: every subpixel shows the view for the
//! direction into which the lens sends the subpixel's light.
//!
//! The screen has W × H pixels. (u, v) is the centre of a pixel, 0..1 from the bottom left, and
//! c = 0, 1, 2 is the channel. With the keys of `visual.json`:
//!
//! ```text
//! P = pitch · W / DPI · cos(atan(1 / slope))        number of lenses across the screen
//! T = H / (W · slope)                               x shift of a lens over H, in screen widths
//! s = 1 / (3 W)                                     width of a subpixel, in screen widths
//! a = frac((u + c·s + v·T) · P − center)            position across the lens, 0..1
//! view = min(⌊a · N⌋, N − 1)
//! ```
//!
//! The key `flipImageX` negates T and s, and `invView` replaces a by 1 − a. The minimum in the last
//! line matters only with `invView`, which turns a = 0 into 1. Displays of the third generation
//! arrange subpixels in cells. For these, the channel's offset in its cell, (dx / W, dy / H), is
//! added to (u, v) instead of c·s. `CellPatternMode` selects the number of the cell for the pixel
//! (x, y), counted from the bottom left:
//!
//! * 0: always cell 0
//! * 1: (x + y) mod 2, a checkerboard
//! * 2: x mod 2
//! * 3: (y + 2 (x mod 2)) mod 4
//! * 4: y mod 2
//!
//! The subpixel then has the value of the view's pixel nearest to (u, v).

use lumistack_plugin::PluginError;
use lumistack_plugin::serde_json::Value;

use crate::layout::Layout;

/// The calibration of a display, from its file `visual.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Number of lenses per inch, measured across the slanted lenses.
    pub pitch: f64,
    /// Slant of the lenses: `slope` in the equations of this file.
    pub slope: f64,
    /// Phase that is subtracted: `center` in the equations of this file.
    pub center: f64,
    /// Number of panel pixels per inch.
    pub dpi: f64,
    /// [columns, rows] of the screen.
    pub screen: [usize; 2],
    /// True if the phase a is replaced by 1 − a, which reverses the order of the views.
    pub inv_view: bool,
    /// True if the lens sheet is mirrored.
    pub flip_x: bool,
    /// True if subpixels are in the order blue, green, red.
    pub flip_subpixels: bool,
    /// Offsets [x, y] of red, green and blue in every cell, pixels. The list is empty if subpixels
    /// are stripes.
    pub cells: Vec<[[f64; 2]; 3]>,
    /// Value of the key `CellPatternMode`, which selects the cell of a pixel.
    pub mode: usize,
}

/// Largest side of a screen, pixels.
const SIDE_LIMIT: f64 = 32768.0;

impl Calibration {
    /// Parses the JSON of `visual.json`. A number x may have the form `{"value": x}`.
    ///
    /// # Errors
    /// If the JSON is malformed, or a number is missing or invalid.
    pub fn from_json(json: &Value) -> Result<Self, PluginError> {
        // Read a number, which may be in an object with the key `value`.
        let number = |key: &str| -> Option<f64> {
            let value = json.get(key)?;
            value.get("value").unwrap_or(value).as_f64().filter(|number| number.is_finite())
        };
        let wrong = |key: &str, expected: &str| {
            let found = json.get(key).map_or("nothing".into(), Value::to_string);
            PluginError::Refused(format!("{key}: expected {expected}, found {found}"))
        };
        let needed = |key: &str| number(key).ok_or_else(|| wrong(key, "a number"));
        let positive =
            |key: &str| needed(key).and_then(|x| if x > 0.0 { Ok(x) } else { Err(wrong(key, "a number above 0")) });
        let side = |key: &str| {
            let side = positive(key)?;
            if side.fract() == 0.0 && side <= SIDE_LIMIT {
                Ok(side as usize)
            } else {
                Err(wrong(key, "a whole number from 1 to 32768"))
            }
        };
        let flag = |key: &str| number(key).is_some_and(|number| number >= 0.5);
        let slope = needed("slope")?;
        if slope == 0.0 {
            return Err(wrong("slope", "a number other than 0"));
        }
        // Read the cells of subpixels, which only newer screens have.
        let cells = match json.get("subpixelCells") {
            None | Some(Value::Null) => Vec::new(),
            Some(Value::Array(cells)) => {
                let cell = |cell: &Value| {
                    let offset = |key: &str| cell.get(key).and_then(Value::as_f64);
                    Some([
                        [offset("ROffsetX")?, offset("ROffsetY")?],
                        [offset("GOffsetX")?, offset("GOffsetY")?],
                        [offset("BOffsetX")?, offset("BOffsetY")?],
                    ])
                };
                let read: Option<Vec<_>> = cells.iter().map(cell).collect();
                read.ok_or_else(|| wrong("subpixelCells", "cells of ROffsetX, ROffsetY, GOffsetX, ..., BOffsetY"))?
            }
            Some(_) => return Err(wrong("subpixelCells", "a list of cells")),
        };
        let mode = number("CellPatternMode").unwrap_or(0.0);
        let least = match mode {
            0.0 => 1,
            1.0 | 2.0 | 4.0 => 2,
            3.0 => 4,
            _ => return Err(wrong("CellPatternMode", "a whole number from 0 to 4")),
        };
        if !cells.is_empty() && cells.len() < least {
            let expected = format!("at least {least} cells, as CellPatternMode {mode} needs");
            return Err(wrong("subpixelCells", &expected));
        }
        Ok(Self {
            pitch: positive("pitch")?,
            slope,
            center: needed("center")?,
            dpi: positive("DPI")?,
            screen: [side("screenW")?, side("screenH")?],
            inv_view: flag("invView"),
            flip_x: flag("flipImageX"),
            flip_subpixels: flag("flipSubp"),
            cells,
            mode: mode as usize,
        })
    }

    /// Returns [P, T, sign of s]. The head of this file defines these symbols.
    fn lenses(&self) -> [f64; 3] {
        let [width, height] = self.screen.map(|side| side as f64);
        let sign = if self.flip_x { -1.0 } else { 1.0 };
        let periods = self.pitch * width / self.dpi * (1.0 / self.slope).atan().cos();
        [periods, sign * height / (width * self.slope), sign]
    }

    /// Returns which of `views` views a subpixel shows. `pixel` is [x, y] from the bottom left.
    pub fn view(&self, pixel: [usize; 2], channel: usize, views: usize) -> usize {
        self.view_through(self.lenses(), pixel, channel, views)
    }

    fn view_through(&self, [periods, tilt, sign]: [f64; 3], pixel: [usize; 2], channel: usize, views: usize) -> usize {
        let [width, height] = self.screen.map(|side| side as f64);
        let [u, v] = [(pixel[0] as f64 + 0.5) / width, (pixel[1] as f64 + 0.5) / height];
        let place = if self.flip_subpixels { 2 - channel } else { channel };
        let across = if self.cells.is_empty() {
            u + place as f64 * sign / (3.0 * width) + v * tilt
        } else {
            let [x, y] = pixel;
            let cell = match self.mode {
                1 => (x + y) % 2,
                2 => x % 2,
                3 => (y + 2 * (x % 2)) % 4,
                4 => y % 2,
                _ => 0,
            };
            let [dx, dy] = self.cells[cell][place];
            u + dx / width + (v + dy / height) * tilt
        };
        let phase = across * periods - self.center;
        let a = phase - phase.floor();
        let a = if self.inv_view { 1.0 - a } else { a };
        ((a * views as f64) as usize).min(views - 1)
    }

    /// Computes the screen's picture `[row][col][rgb]`, with row 0 at the top, from a quilt's
    /// codes.
    ///
    /// # Panics
    /// If the length of `quilt` does not match `layout`.
    pub fn weave(&self, quilt: &[u8], layout: &Layout) -> Vec<u8> {
        let [width, height] = self.screen;
        let (tile, views) = (layout.tile(), layout.views());
        assert_eq!(quilt.len(), 3 * layout.size[0] * layout.size[1], "the number of codes does not fit the layout");
        let corners: Vec<[usize; 2]> = (0..views).map(|view| layout.corner(view)).collect();
        let lenses = self.lenses();
        let mut native = vec![0; 3 * width * height];
        for (row, line) in native.chunks_exact_mut(3 * width).enumerate() {
            let tile_row = (2 * row + 1) * tile[1] / (2 * height);
            for (col, rgb) in line.chunks_exact_mut(3).enumerate() {
                let tile_col = (2 * col + 1) * tile[0] / (2 * width);
                for (channel, code) in rgb.iter_mut().enumerate() {
                    let [x, y] = corners[self.view_through(lenses, [col, height - 1 - row], channel, views)];
                    *code = quilt[3 * ((y + tile_row) * layout.size[0] + x + tile_col) + channel];
                }
            }
        }
        native
    }
}

#[cfg(test)]
mod tests {
    use lumistack_plugin::serde_json::json;

    use super::*;

    fn plain() -> Value {
        json!({"pitch": {"value": 50.0}, "slope": {"value": -7.5}, "center": 0.25, "DPI": {"value": 283.0},
            "screenW": {"value": 384.0}, "screenH": {"value": 216.0}, "invView": {"value": 1.0}})
    }

    #[test]
    fn missing_and_invalid_values_are_named() {
        let good = Calibration::from_json(&plain()).unwrap();
        assert_eq!((good.center, good.inv_view, good.flip_x, good.screen), (0.25, true, false, [384, 216]));
        for (key, value, message) in [
            ("pitch", json!(null), "pitch: expected a number, found null"),
            ("pitch", json!({"value": -1.0}), "pitch: expected a number above 0"),
            ("slope", json!(0), "slope: expected a number other than 0"),
            ("screenW", json!(10.5), "screenW: expected a whole number from 1 to 32768"),
            ("subpixelCells", json!([{"ROffsetX": 0.1}]), "subpixelCells: expected cells of ROffsetX"),
            ("CellPatternMode", json!({"value": 7}), "CellPatternMode: expected a whole number from 0 to 4"),
        ] {
            let mut bad = plain();
            bad[key] = value;
            let error = Calibration::from_json(&bad).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
        let cell = json!({"ROffsetX": 0, "ROffsetY": 0, "GOffsetX": 0, "GOffsetY": 0, "BOffsetX": 0, "BOffsetY": 0});
        let mut few = plain();
        (few["subpixelCells"], few["CellPatternMode"]) = (json!([cell, cell]), json!({"value": 3}));
        assert!(Calibration::from_json(&few).unwrap_err().to_string().contains("at least 4 cells"));
    }

    #[test]
    fn a_phase_of_zero_counts_as_the_last_view_when_inverted() {
        // There is one lens per pixel column, and nearly no slant. So at every pixel's centre u·P
        // is a whole number plus a half, and `center` subtracts the half.
        let calibration = Calibration {
            pitch: 100.0,
            slope: 1e300,
            center: 0.5,
            dpi: 100.0,
            screen: [4, 1],
            inv_view: true,
            flip_x: false,
            flip_subpixels: false,
            cells: vec![],
            mode: 0,
        };
        assert_eq!([0, 1, 2, 3].map(|x| calibration.view([x, 0], 0, 45)), [44; 4]);
        let straight = Calibration { inv_view: false, ..calibration };
        assert_eq!([0, 1, 2].map(|channel| straight.view([0, 0], channel, 44)), [0, 14, 29]);
        let swapped = Calibration { flip_subpixels: true, ..straight };
        assert_eq!(swapped.view([0, 0], 0, 44), 29);
    }
}
