//! The JSON that describes data and displays at the C interface. Readers ignore unknown keys, since
//! the host may be newer than the plugin.

use lumistack_display::{Display, FieldGeometry, Projection, SeenDepth, ViewGrid};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use serde_path_to_error::{Path, Segment};

use crate::PluginError;

/// Shapes and geometry of the data that a host lends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "port", rename_all = "snake_case")]
pub enum Description {
    /// The layer stack of a tensor display.
    LayerStack {
        /// Brightness β of the layer stack.
        brightness: f64,
        /// Number of frames of the layer stack.
        frames: usize,
        /// [rows, cols] of each layer, rearmost first.
        layers: Vec<[usize; 2]>,
        /// Shape of a directional backlight's emission: [bins_y, bins_x, lenslet_rows,
        /// lenslet_cols].
        emission: Option<[usize; 4]>,
        /// Geometry of the light field that the stack was solved for.
        target: Geometry,
        /// True if the target's views can be read. Older hosts lack this key and lend no views.
        #[serde(default)]
        target_views: bool,
        /// Depth of the target's central view. Older hosts lack this key, and so do hosts that do
        /// not know the depth.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        target_depth: Option<Depth>,
    },
    /// Radiance of many views.
    LightField {
        /// The light field's geometry.
        geometry: Geometry,
        /// Depth of the central view.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        depth: Option<Depth>,
        /// Random seed for nodes.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seed: Option<u64>,
        /// Weights of the rays for nodes; without this key all rays have the same weight.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        weights: Option<RayWeights>,
        /// Layer stack that a node may start from.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        start: Option<Start>,
    },
}

/// Weights of the rays of a light field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RayWeights {
    /// One weight per view, `[view_y][view_x]`.
    PerView(Vec<Vec<f64>>),
    /// One weight per ray, which the host lends view by view.
    PerRay,
}

/// Describes a warm start: patterns in the display's shape, which the host lends plane by plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// Brightness β of the layer stack.
    pub brightness: f64,
}

/// Depth of a light field's central view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Depth {
    rows: usize,
    cols: usize,
    /// `[row][col]`, millimetres towards the viewer; null for rays without a hit.
    z_mm: Vec<Option<f32>>,
}

impl From<&SeenDepth> for Depth {
    fn from(seen: &SeenDepth) -> Self {
        // rounding to 10 nm shortens the JSON
        let rounded = |z: &f32| (f64::from(*z) * 1e5).round() / 1e5;
        let z_mm = seen.z_mm.iter().map(|z| z.as_ref().map(|z| rounded(z) as f32)).collect();
        Self { rows: seen.rows, cols: seen.cols, z_mm }
    }
}

impl TryFrom<Depth> for SeenDepth {
    type Error = PluginError;

    fn try_from(json: Depth) -> Result<Self, PluginError> {
        let Depth { rows, cols, z_mm } = json;
        if rows.checked_mul(cols) != Some(z_mm.len()) || z_mm.is_empty() {
            let found = z_mm.len();
            return Err(PluginError::Refused(format!(
                "depth: expected rows × cols = {rows} × {cols} values and at least one pixel, found {found} values"
            )));
        }
        Ok(Self { rows, cols, z_mm })
    }
}

/// Geometry of a light field: its views and pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    rows: usize,
    cols: usize,
    pitch_mm: f64,
    projection: String,
    distance_mm: Option<f64>,
    slope_x: Vec<f64>,
    slope_y: Vec<f64>,
}

const OBLIQUE: &str = "oblique";
const PERSPECTIVE: &str = "perspective";

impl From<&FieldGeometry> for Geometry {
    fn from(field: &FieldGeometry) -> Self {
        let (projection, distance_mm) = match field.grid.projection {
            Projection::Oblique => (OBLIQUE, None),
            Projection::Perspective { distance_mm } => (PERSPECTIVE, Some(distance_mm)),
        };
        Self {
            rows: field.rows,
            cols: field.cols,
            pitch_mm: field.pitch_mm,
            projection: projection.into(),
            distance_mm,
            slope_x: field.grid.slope_x.clone(),
            slope_y: field.grid.slope_y.clone(),
        }
    }
}

impl TryFrom<Geometry> for FieldGeometry {
    type Error = PluginError;

    fn try_from(json: Geometry) -> Result<Self, PluginError> {
        let projection = match (json.projection.as_str(), json.distance_mm) {
            (OBLIQUE, _) => Projection::Oblique,
            (PERSPECTIVE, Some(distance_mm)) => Projection::Perspective { distance_mm },
            (other, _) => {
                return Err(PluginError::Refused(format!(
                    "expected projection `oblique`, or `perspective` with `distance_mm`, found `{other}`"
                )));
            }
        };
        let grid = ViewGrid { projection, slope_x: json.slope_x, slope_y: json.slope_y };
        let field = FieldGeometry { rows: json.rows, cols: json.cols, pitch_mm: json.pitch_mm, grid };
        field.check().map_err(|error| PluginError::Refused(error.to_string()))?;
        Ok(field)
    }
}

/// Reads a display and skips keys that this version does not know, since the host may be newer. In
/// a display *file* an unknown key is an error; the host has already checked the file.
pub(crate) fn display_from_json(text: &str) -> Result<Display, PluginError> {
    let mut json: Value = serde_json::from_str(text).map_err(|error| PluginError::failed("display", error))?;
    let display: Display = loop {
        let error = match serde_path_to_error::deserialize(&json) {
            Ok(display) => break display,
            Err(error) => error,
        };
        // serde states the unknown key only in the text of its error
        let message = error.inner().to_string();
        let unknown = message.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
        if !unknown.is_some_and(|key| remove_key(&mut json, error.path(), key)) {
            return Err(PluginError::failed("display", error));
        }
    };
    display.check().map_err(|error| PluginError::Refused(error.to_string()))?;
    Ok(display)
}

/// Removes `key` from its object. `path` leads to this object, or to the key itself. Returns false
/// if there is no such key.
fn remove_key(json: &mut Value, path: &Path, key: &str) -> bool {
    let mut place = json;
    for segment in path {
        let next = match segment {
            Segment::Map { key: name } if name != key => place.get_mut(name),
            Segment::Seq { index } => place.get_mut(index),
            _ => break,
        };
        match next {
            Some(next) => place = next,
            None => return false,
        }
    }
    place.as_object_mut().is_some_and(|object| object.remove(key).is_some())
}

#[cfg(test)]
mod tests {
    use lumistack_display::{Backlight, LensletBacklight, Transfer};
    use serde_json::json;

    use super::*;

    fn display() -> Display {
        let mut display = Display::uniform([4, 3], 1.0, [3, 3], [20.0, 20.0], &[0.0], 2);
        display.layers[0].transfer = Transfer::gamma(2.2);
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-9.0, [2, 2], 2.0, [3, 3], [20.0, 20.0]));
        display
    }

    #[test]
    fn keys_of_a_newer_host_are_stepped_over() {
        let mut json = serde_json::to_value(display()).unwrap();
        assert_eq!(display_from_json(&json.to_string()).unwrap(), display());
        json["pitch_mm"] = json!(7);
        json["field"]["future"] = json!({"a": [1]});
        json["layers"][0]["diffuser"] = json!("holographic");
        json["backlight"]["lamp"] = json!(3);
        assert_eq!(display_from_json(&json.to_string()).unwrap(), display());
    }

    #[test]
    fn displays_that_make_no_sense_are_still_refused() {
        let mut json = serde_json::to_value(display()).unwrap();
        json["frames"] = json!(0);
        assert!(display_from_json(&json.to_string()).unwrap_err().to_string().contains("frames"));
        json["frames"] = json!("many");
        assert!(display_from_json(&json.to_string()).unwrap_err().to_string().contains("frames"));
        assert!(display_from_json("{").is_err());
    }

    #[test]
    fn geometry_survives_json() {
        for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 612.5 }] {
            let grid = ViewGrid::uniform(projection, [3, 2], [21.3, 10.1]).unwrap();
            let field = FieldGeometry { rows: 5, cols: 7, pitch_mm: 0.2827, grid };
            let text = serde_json::to_string(&Geometry::from(&field)).unwrap();
            let read: Geometry = serde_json::from_str(&text).unwrap();
            assert_eq!(FieldGeometry::try_from(read).unwrap(), field);
        }
    }
}
