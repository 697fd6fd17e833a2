//! Options that the controls of the viewer set: the eye's adaptation and pupil, and errors of the
//! display's construction.

use lumistack_display::{Backlight, Display, Projection};
use serde::Deserialize;

use crate::{Error, err, json};

/// Distance between the pupil and the display plane if views are parallel projections, which have
/// no viewing distance, millimetres.
const ARM_LENGTH_MM: f64 = 600.0;
/// Largest number of points of a pupil along each axis.
const PUPIL_LIMIT: usize = 9;

/// Settings; every key is optional.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Factor on the emitted light: 1 shows the light itself, 1/β (the default) shows the picture
    /// that an adapted eye sees.
    pub gain: Option<f64>,
    /// Error of every gap between neighbouring layers, and of the gap to the backlight,
    /// millimetres. The middle of the layers does not move.
    pub gap_mm: f64,
    /// [x, y] offset of the front layer, millimetres.
    pub shift_mm: [f64; 2],
    /// Black level c, 0..1: a value f that a ray hits becomes c + (1 − c) f.
    pub black_level: f64,
    /// Diameter of a pupil that is focused on z = 0, millimetres; 0 for a pinhole.
    pub pupil_mm: f64,
    /// Distance of the eye from z = 0, millimetres. With a distance, views are perspective; `None`
    /// keeps the target's projection.
    pub eye_distance_mm: Option<f64>,
    /// Number of a single frame to show; `None` shows the mean of all frames.
    pub frame: Option<usize>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            gain: None,
            gap_mm: 0.0,
            shift_mm: [0.0; 2],
            black_level: 0.0,
            pupil_mm: 0.0,
            eye_distance_mm: None,
            frame: None,
        }
    }
}

impl Options {
    /// Reads and checks options for a display of `frames` frames.
    ///
    /// # Errors
    /// If the text is malformed or a value is out of range. Outside of a browser also if a key is
    /// unknown.
    pub fn from_json(text: &str, frames: usize) -> Result<Self, Error> {
        let options: Self = json::parse(text).map_err(|error| err(format!("options: {error}")))?;
        let expect = |ok: bool, key: &str, expected: &str, found: String| {
            let text = || err(format!("options: {key}: expected {expected}, found {found}"));
            if ok { Ok(()) } else { Err(text()) }
        };
        for (key, value) in [("gain", options.gain), ("eye_distance_mm", options.eye_distance_mm)] {
            let Some(value) = value else { continue };
            expect(value.is_finite() && value > 0.0, key, "a number above 0", value.to_string())?;
        }
        expect(options.gap_mm.is_finite(), "gap_mm", "a number", options.gap_mm.to_string())?;
        let shift = options.shift_mm;
        expect(shift.iter().all(|v| v.is_finite()), "shift_mm", "two numbers", format!("{shift:?}"))?;
        let black = options.black_level;
        expect((0.0..=1.0).contains(&black), "black_level", "0 to 1", black.to_string())?;
        expect((0.0..=100.0).contains(&options.pupil_mm), "pupil_mm", "0 to 100", options.pupil_mm.to_string())?;
        if let Some(frame) = options.frame {
            let expected = format!("a frame from 0 to {}", frames.saturating_sub(1));
            expect(frame < frames, "frame", &expected, frame.to_string())?;
        }
        Ok(options)
    }

    /// Returns the display with the construction errors that these options set.
    pub fn built(&self, display: &Display) -> Display {
        let mut built = display.clone();
        let middle = (built.layers.len() as f64 - 1.0) / 2.0;
        for (n, layer) in built.layers.iter_mut().enumerate() {
            layer.d_mm += self.gap_mm * (n as f64 - middle);
        }
        if let Backlight::Lenslets(backlight) = &mut built.backlight {
            backlight.d_mm -= self.gap_mm * (1.0 + middle);
        }
        if let Some(front) = built.layers.last_mut() {
            front.offset_mm[0] += self.shift_mm[0];
            front.offset_mm[1] += self.shift_mm[1];
        }
        built
    }

    /// Returns the projection of the drawn views: perspective if the options set the eye's
    /// distance, otherwise `target`, the projection of the target's views.
    pub fn projection(&self, target: Projection) -> Projection {
        self.eye_distance_mm.map_or(target, |distance_mm| Projection::Perspective { distance_mm })
    }

    /// Returns the points of the pupil whose views are averaged. They are a square grid of slopes,
    /// relative to the slope of the pupil's centre. Only points on the pupil's disc are used. A
    /// pinhole has one point.
    pub fn pupil(&self, display: &Display, target: Projection) -> Pupil {
        let distance_mm = match self.projection(target) {
            Projection::Perspective { distance_mm } => distance_mm,
            Projection::Oblique => ARM_LENGTH_MM,
        };
        if self.pupil_mm == 0.0 {
            return Pupil { offsets: vec![0.0], on_disc: vec![true] };
        }
        let radius = 0.5 * self.pupil_mm / distance_mm;
        // Seen from neighbouring points, a layer should be shifted by at most half a pixel. This
        // determines the number of points, up to the limit.
        let blur_px = display.layers.iter().map(|layer| layer.d_mm.abs() * 2.0 * radius / layer.pitch_mm);
        let count = (blur_px.fold(0.0, f64::max).ceil() as usize * 2 + 1).clamp(3, PUPIL_LIMIT);
        let offsets: Vec<f64> =
            (0..count).map(|i| radius * (2.0 * i as f64 + 1.0 - count as f64) / count as f64).collect();
        let inside = |y: &f64, x: &f64| x.hypot(*y) <= radius;
        let on_disc = offsets.iter().flat_map(|y| offsets.iter().map(move |x| inside(y, x))).collect();
        Pupil { offsets, on_disc }
    }
}

/// Points of a pupil; see [`Options::pupil`].
#[derive(Clone, Debug, PartialEq)]
pub struct Pupil {
    /// Slopes of the grid relative to the pupil's centre, alike for both axes.
    pub offsets: Vec<f64>,
    /// True for every point `[y][x]` of the grid, row by row, that lies on the disc.
    pub on_disc: Vec<bool>,
}

impl Pupil {
    /// Returns the indices [y, x] of the points on the disc.
    pub fn places(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        let count = self.offsets.len();
        self.on_disc.iter().enumerate().filter(|(_, on)| **on).map(move |(i, _)| [i / count, i % count])
    }
}
