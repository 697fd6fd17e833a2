//! The choice of the views that sample the viewing zone.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::{GridError, Projection, ViewGrid};

/// Fraction of a step by which the outermost view may be outside the zone. So the zone's edge is at
/// most three quarters of a step from the outermost view.
const BEYOND: f64 = 0.25;
/// Largest number of views per axis.
const MOST: usize = 1 << 16;
/// Tolerance with which a quotient is rounded down to a whole number.
const ROUNDING: f64 = 1e-9;

/// The views that sample the zone |s| ≤ tan(α/2) of a display. The forms in files are `"auto"`,
/// `[horizontal, vertical]` and `{ step = [x, y] }`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Views {
    /// Views at multiples of the step of [`auto_step`](crate::Display::auto_step). A display that
    /// shows these views well also shows the views between them well.
    #[default]
    Auto,
    /// A number of views, [horizontal, vertical], at the centres of equal bins of the zone, as in
    /// the paper.
    Fixed([usize; 2]),
    /// Views at all multiples of a step of slopes (x, y), ≥ 0, in the zone and up to a quarter of a
    /// step outside it. A step of 0 gives one view, straight ahead.
    Step([f64; 2]),
}

impl Views {
    /// Returns the view grid over the full angles `fov_deg`. For [`Views::Auto`] its steps are the
    /// result of `auto`.
    pub(crate) fn grid(
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
        // return an error for invalid angles
        ViewGrid::uniform(projection, [1, 1], fov_deg)?;
        // A tiny step would need more memory than there is, so count the views before they are
        // listed.
        let sides = [0, 1].map(|axis| steps_within(half_width(fov_deg[axis]), step[axis]));
        let views = sides.map(views_of);
        if views.iter().any(|count| *count > MOST) {
            let expected = "1 to 65536 per axis";
            return Err(GridError { what: "views", expected, found: format!("{views:?}") });
        }
        let slopes = |axis: usize| {
            let most = sides[axis] as i64;
            (-most..=most).map(|k| k as f64 * step[axis]).collect::<Vec<f64>>()
        };
        let slope_y = slopes(1).into_iter().rev().collect();
        Ok(ViewGrid { projection, slope_x: slopes(0), slope_y })
    }
}

/// Returns tan(α/2) of a full angle α in degrees.
pub(crate) fn half_width(fov_deg: f64) -> f64 {
    (0.5 * fov_deg.to_radians()).tan()
}

/// Returns the number of views on either side of the middle view.
pub(crate) fn steps_within(half_width: f64, step: f64) -> usize {
    if step > 0.0 { (half_width / step + BEYOND + ROUNDING) as usize } else { 0 }
}

/// Returns the number of views with `side` views on either side of the middle view.
pub(crate) fn views_of(side: usize) -> usize {
    side.saturating_mul(2).saturating_add(1)
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

/// The form `{ step = [x, y] }`: views at all multiples of a step.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Steps {
    /// [x, y] difference of the slopes of neighbouring views.
    step: [f64; 2],
}

impl<'de> Deserialize<'de> for Views {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Form)
    }
}

/// Describes the three forms in which files state views.
impl JsonSchema for Views {
    fn schema_name() -> Cow<'static, str> {
        "Views".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "The views that sample the zone: `\"auto\"` for the number that the display needs to be correct between views, a number of columns and rows, or a step of slopes.",
            "anyOf": [{ "const": "auto" }, <[usize; 2]>::json_schema(generator), Steps::json_schema(generator)],
        })
    }
}

/// Selects the form by the type of the value: text, list or table. So an error states what is wrong
/// within that form.
struct Form;

impl<'de> Visitor<'de> for Form {
    type Value = Views;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"auto\", [horizontal, vertical] or { step = [x, y] }")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Views, E> {
        // A text such as `5x3` is allowed only on the command line. Files have the list [5, 3]
        // instead.
        if name == "auto" { Ok(Views::Auto) } else { Err(E::invalid_value(Unexpected::Str(name), &self)) }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, views: A) -> Result<Views, A::Error> {
        Deserialize::deserialize(SeqAccessDeserializer::new(views)).map(Views::Fixed)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Views, A::Error> {
        let Steps { step } = Deserialize::deserialize(MapAccessDeserializer::new(map))?;
        Ok(Views::Step(step))
    }
}

/// Reads `auto`, or columns × rows as `5x3`.
impl std::str::FromStr for Views {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected auto, or two numbers (columns and rows of views) such as 5x3, found {text}");
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

    #[test]
    fn steps_that_give_too_many_views_are_refused() {
        let grid = |step: [f64; 2]| {
            let grid = Views::Step(step).grid(Projection::Oblique, [20.0, 20.0], || [0.0; 2]);
            grid.map(|grid| grid.views()).map_err(|error| error.to_string())
        };
        assert_eq!(grid([0.1, 0.0]), Ok([1, 5]));
        let half = half_width(20.0);
        assert_eq!(grid([half / 32767.0, 0.1]), Ok([5, 65535]));
        let error = grid([0.1, half / 32768.0]).unwrap_err();
        assert_eq!(error, "views: expected 1 to 65536 per axis, found [5, 65537]");
        for step in [1e-9, 1e-18, f64::MIN_POSITIVE] {
            let error = grid([step, 0.1]).unwrap_err();
            assert!(error.starts_with("views: expected 1 to 65536 per axis, found ["), "{step}: {error}");
        }
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
            ("views = \"5x3\"", "expected \"auto\", [horizontal, vertical] or { step = [x, y] }"),
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
