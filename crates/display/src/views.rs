//! How densely views sample the zone.

use std::fmt;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::zone::bin_width;
use crate::{Display, GridError, Projection, ViewGrid, native_step};

/// Views per axis that [`Views::Auto`] takes at most.
const MOST_AUTO: usize = 101;
/// Views to a bin of a directional backlight, which shows the mean of its directions: letters on `paper-directional`, zone score for one, one that is the mean over the
/// bin, and three: 22.5, 22.9 and 24.1 dB.
const VIEWS_PER_BIN: f64 = 3.0;
/// Share of a step by which the outermost view may stand outside of the zone; so the zone's rim is no further than three quarters of a step from it.
const BEYOND: f64 = 0.25;
/// Rounding of quotients that are whole numbers.
const ROUNDING: f64 = 1e-9;

/// Which views sample the zone |s| ≤ tan(α/2) of a display. In files `"auto"`, `[horizontal, vertical]`, or `{ step = [x, y] }`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Views {
    /// As many as make a display right between them: at multiples of its [native step](native_step).
    #[default]
    Auto,
    /// So many, [horizontal, vertical], at the centres of equal bins of the zone (the paper's).
    Fixed([usize; 2]),
    /// At all multiples of these slopes (x, y), ≥ 0, that lie in the zone. 0 is one view, straight ahead.
    Step([f64; 2]),
}

impl Views {
    /// The grid over full angles of `fov_deg`, at the steps that `auto` gives where the choice is the display's.
    fn grid(
        self,
        projection: Projection,
        fov_deg: [f64; 2],
        auto: impl FnOnce() -> [f64; 2],
    ) -> Result<ViewGrid, GridError> {
        let step = match self {
            Self::Fixed(views) => return ViewGrid::uniform(projection, views, fov_deg),
            Self::Step(step) => step,
            Self::Auto => auto(),
        };
        // checks the angles
        ViewGrid::uniform(projection, [1, 1], fov_deg)?;
        let slopes = |axis: usize| {
            let most = steps_within(half_width(fov_deg[axis]), step[axis]) as i64;
            (-most..=most).map(|k| k as f64 * step[axis]).collect::<Vec<f64>>()
        };
        let slope_y = slopes(1).into_iter().rev().collect();
        Ok(ViewGrid { projection, slope_x: slopes(0), slope_y })
    }
}

/// tan(α/2) of a full angle.
fn half_width(fov_deg: f64) -> f64 {
    (0.5 * fov_deg.to_radians()).tan()
}

/// Views on either side of the middle one.
fn steps_within(half_width: f64, step: f64) -> usize {
    if step > 0.0 { (half_width / step + BEYOND + ROUNDING) as usize } else { 0 }
}

impl Display {
    /// The views of the light field that the display is made for.
    ///
    /// # Errors
    /// If an angle is outside of 0..180°, there are no views, or the viewing distance is not above 0.
    pub fn view_grid(&self, projection: Projection) -> Result<ViewGrid, GridError> {
        self.field.views.grid(projection, self.field.fov_deg, || self.auto_step(usize::MAX))
    }

    /// Number of those views, [horizontal, vertical]; none where the display makes no sense.
    pub fn views(&self) -> [usize; 2] {
        let [rows, cols] = self.view_grid(Projection::Oblique).map_or([0, 0], |grid| grid.views());
        [cols, rows]
    }

    /// The step of slopes (x, y) of [`Views::Auto`]: the [native](native_step) one, and a third of a bin of a directional backlight, thinned to every second, third, ... native slope until there are no more than `most_views`. An axis
    /// that shows parallax at all has three views at least: a display that was solved for one direction is right in no other.
    pub fn auto_step(&self, most_views: usize) -> [f64; 2] {
        let half = self.field.fov_deg.map(half_width);
        let mut native = native_step(self);
        for (axis, native) in native.iter_mut().enumerate() {
            *native = native.map(|native| bin_width(self, axis).map_or(native, |bin| native.min(bin / VIEWS_PER_BIN)));
        }
        let step = |every: f64| {
            [0, 1].map(|axis| match native[axis] {
                // the outermost of three views then stand inside of the zone
                Some(native) if half[axis] > 0.0 => (every * native).min(0.8 * half[axis]),
                _ => 0.0,
            })
        };
        let count = |step: [f64; 2]| [0, 1].map(|axis| 2 * steps_within(half[axis], step[axis]) + 1);
        let fits = |step: [f64; 2]| {
            let [x, y] = count(step);
            x.max(y) <= MOST_AUTO && x.saturating_mul(y) <= most_views
        };
        // no coarser than three views
        let axes = [0, 1].map(|axis| native[axis].map_or(1.0, |native| half[axis] / native / (MOST_AUTO / 2) as f64));
        let mut every = axes[0].max(axes[1]).floor().max(1.0);
        while !fits(step(every)) && count(step(every)).iter().any(|count| *count > 3) {
            every += 1.0;
        }
        step(every)
    }

    /// The same display with its choice of views made: where they are [`Views::Auto`], no more than `most_views`.
    #[must_use]
    pub fn with_views_chosen(mut self, most_views: usize) -> Self {
        if self.field.views == Views::Auto {
            self.field.views = Views::Step(self.auto_step(most_views));
        }
        self
    }
}

impl Serialize for Views {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::Fixed(views) => views.serialize(serializer),
            Self::Step(step) => Steps { step: *step }.serialize(serializer),
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Steps {
    step: [f64; 2],
}

impl<'de> Deserialize<'de> for Views {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Form)
    }
}

/// The three forms, told apart by their kinds, so that an error names the place inside of one.
struct Form;

impl<'de> Visitor<'de> for Form {
    type Value = Views;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"auto\", [horizontal, vertical] or { step = [x, y] }")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Views, E> {
        name.parse().map_err(E::custom)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, views: A) -> Result<Views, A::Error> {
        Deserialize::deserialize(SeqAccessDeserializer::new(views)).map(Views::Fixed)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Views, A::Error> {
        let Steps { step } = Deserialize::deserialize(MapAccessDeserializer::new(map))?;
        Ok(Views::Step(step))
    }
}

/// `auto`, or columns × rows as `5x3`.
impl std::str::FromStr for Views {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected auto, or columns x rows as in 5x3, found {text}");
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let (cols, rows) = text.split_once(['x', '×']).ok_or_else(wrong)?;
        let number = |text: &str| text.trim().parse().map_err(|_| wrong());
        Ok(Self::Fixed([number(cols)?, number(rows)?]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stack(cols: usize) -> Display {
        let pitch = 475.02 / cols as f64;
        let plain = Display::uniform([cols, cols * 5 / 8], pitch, [5, 5], [20.0, 20.0], &[-40.0, 0.0, 40.0], 6);
        let mut display = Display { missing: crate::Missing::Clear, ..plain };
        display.field.views = Views::Auto;
        display
    }

    /// Whole shifts of layers 40 mm from one another over 20°.
    #[test]
    fn a_display_takes_its_native_slopes() {
        for (cols, views) in [(280, 9), (420, 13), (840, 25)] {
            let display = stack(cols);
            assert_eq!(display.views(), [views, views], "{cols}");
            let grid = display.geometry().unwrap().grid;
            let step = native_step(&display)[0].unwrap();
            assert!((grid.slope_x[views - 1] / step - (views / 2) as f64).abs() < 1e-12);
            assert!(grid.slope_y[0] > grid.slope_y[1] && grid.slope_x[0] < grid.slope_x[1]);
        }
    }

    #[test]
    fn a_bin_of_a_backlight_has_three_views() {
        let mut display = stack(420);
        display.layers.retain(|layer| layer.d_mm == 0.0);
        display.backlight =
            crate::Backlight::Lenslets(crate::LensletBacklight::new(-8.5, [187, 117], 2.54, [5, 3], [20.0, 20.0]));
        assert_eq!(display.views(), [15, 9]);
        let grid = display.geometry().unwrap().grid;
        assert!((grid.slope_x[14] - 10f64.to_radians().tan() * 14.0 / 15.0).abs() < 1e-12);
    }

    #[test]
    fn views_are_thinned_to_a_budget() {
        let display = stack(840);
        for (most, views) in [(625, 25), (624, 13), (169, 13), (168, 9), (80, 7), (9, 3), (1, 3)] {
            assert_eq!(display.clone().with_views_chosen(most).views(), [views, views], "{most}");
        }
        let fixed = Display::uniform([16, 10], 1.0, [5, 3], [20.0, 20.0], &[-12.0, 12.0], 1);
        assert_eq!(fixed.clone().with_views_chosen(1), fixed, "views that were asked for stay");
    }

    /// Coarse pixels, where a native step is wider than the zone, and displays that show one direction.
    #[test]
    fn what_shows_parallax_has_three_views_and_the_rest_one() {
        let mut coarse = stack(20);
        assert_eq!(coarse.views(), [3, 3]);
        coarse.field.fov_deg[1] = 0.0;
        assert_eq!(coarse.views(), [3, 1]);
        let mut flat = stack(420);
        flat.layers.retain(|layer| layer.d_mm == 0.0);
        assert_eq!(flat.views(), [1, 1]);
        // pixels of a micrometre: no more than is sensible
        let fine = stack(400_000);
        assert!(fine.views()[0] <= MOST_AUTO && fine.views()[0] > MOST_AUTO / 2);
    }

    #[test]
    fn files_have_three_forms() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct File {
            views: Views,
        }
        for (text, views) in [
            ("views = \"auto\"\n", Views::Auto),
            ("views = [5, 3]\n", Views::Fixed([5, 3])),
            ("[views]\nstep = [0.1, 0.0]\n", Views::Step([0.1, 0.0])),
        ] {
            let file: File = toml::from_str(text).unwrap();
            assert_eq!(file.views, views);
            assert_eq!(toml::from_str::<File>(&toml::to_string(&file).unwrap()).unwrap(), file);
        }
        for (text, message) in [
            ("views = \"many\"", "expected auto, or columns x rows as in 5x3, found many"),
            ("views = 3", "expected \"auto\", [horizontal, vertical] or { step = [x, y] }"),
            ("views = [3]", "invalid length 1"),
            ("views = { steps = [1, 1] }", "unknown field `steps`"),
        ] {
            let error = toml::from_str::<File>(text).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        assert_eq!("7x5".parse(), Ok(Views::Fixed([7, 5])));
        assert!("7".parse::<Views>().is_err());
    }
}
