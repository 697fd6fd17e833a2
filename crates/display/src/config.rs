//! The display's description: a TOML file, millimetres and degrees.

use lumistack_core::config::{self, ConfigError};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{FieldGeometry, GridError, Projection, ViewGrid};

/// A tensor display and the light field that it is made for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Display {
    /// Format of the file.
    #[serde(default = "schema")]
    pub schema: String,
    /// Version of the format.
    #[serde(default = "version")]
    pub version: u32,
    /// Name for people.
    pub name: String,
    /// Time-multiplexed frames M of one period, ≥ 1.
    pub frames: usize,
    /// Refresh rate of the panels, hertz; the eye sees refresh_hz / frames periods a second.
    #[serde(default = "default_refresh_hz")]
    pub refresh_hz: f64,
    /// Brightness scale β (eq. 27), above 0 and at most 1: the display emits β times the target.
    #[serde(default = "default_brightness")]
    pub brightness: f64,
    /// How a ray reads a layer between pixel centres.
    #[serde(default)]
    pub sampling: Sampling,
    /// What a ray reads that leaves a layer.
    #[serde(default)]
    pub missing: Missing,
    /// The light field.
    pub field: FieldConfig,
    /// What lights the layers.
    #[serde(default)]
    pub backlight: Backlight,
    /// Layers, rear to front; `d_mm` rises.
    pub layers: Vec<Layer>,
}

fn schema() -> String {
    Display::SCHEMA.into()
}

fn version() -> u32 {
    1
}

fn default_refresh_hz() -> f64 {
    60.0
}

fn default_brightness() -> f64 {
    1.0
}

/// Sampling of the target light field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldConfig {
    /// [columns, rows] of pixels on z = 0.
    pub resolution: [usize; 2],
    /// Pixel pitch on z = 0, millimetres.
    pub pitch_mm: f64,
    /// [horizontal, vertical] number of views.
    pub views: [usize; 2],
    /// [horizontal, vertical] full angle of view, degrees.
    pub fov_deg: [f64; 2],
    /// How the rays of one view relate.
    #[serde(default)]
    pub projection: ProjectionKind,
    /// Viewing distance of a perspective grid, millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_mm: Option<f64>,
}

/// Kind of view grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ProjectionKind {
    /// Parallel projections (the paper's).
    #[default]
    Oblique,
    /// Pinholes at `distance_mm`.
    Perspective,
}

/// How a ray reads a layer between pixel centres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// The pixel it meets: floor(ξ + ½).
    #[default]
    Nearest,
    /// A mixture of the four around it.
    Bilinear,
}

/// What a ray reads that leaves a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Missing {
    /// The ray has weight 0.
    #[default]
    Drop,
    /// Transmittance 1.
    Clear,
}

/// One light-attenuating layer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Signed distance from z = 0, millimetres; rear is negative.
    pub d_mm: f64,
    /// [columns, rows] of the mask that is optimized.
    pub resolution: [usize; 2],
    /// Mask pixel pitch, millimetres.
    pub pitch_mm: f64,
    /// [x, y] of the layer's centre, millimetres.
    #[serde(default)]
    pub offset_mm: [f64; 2],
    /// Transmittance of the darkest state relative to the brightest, 0..1. Recorded for output and analysis; the solver's box is 0..1.
    #[serde(default)]
    pub black_level: f64,
    /// From linear transmittance to the panel's code values.
    #[serde(default)]
    pub transfer: Transfer,
    /// [columns, rows] of the physical panel, where it differs from the mask.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_resolution: Option<[usize; 2]>,
    /// Pitch of the physical panel, millimetres, where it differs from the mask's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub panel_pitch_mm: Option<f64>,
}

/// A panel's transfer function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transfer {
    /// IEC 61966-2-1.
    #[default]
    Srgb,
    /// Codes proportional to light.
    Linear,
    /// Light = code^gamma.
    Gamma(f64),
}

/// What lights the layers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Backlight {
    /// Unit radiance in all directions.
    #[default]
    Uniform,
    /// A low-resolution light field emitter.
    Lenslets(LensletBacklight),
}

/// A lenslet grid in front of a panel: a light field emitter of low resolution (section 3.3).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LensletBacklight {
    /// Signed distance of the lenslets from z = 0, millimetres; behind every layer.
    pub d_mm: f64,
    /// [columns, rows] of lenslets.
    pub lenslets: [usize; 2],
    /// Lenslet pitch, millimetres.
    pub pitch_mm: f64,
    /// [horizontal, vertical] full angle over which the bins spread, degrees.
    pub fov_deg: [f64; 2],
    /// [horizontal, vertical] number of angular bins.
    pub views: [usize; 2],
    /// [x, y] of the grid's centre, millimetres.
    #[serde(default)]
    pub offset_mm: [f64; 2],
    /// What a ray reads beyond the bins.
    #[serde(default)]
    pub outside_bins: OutsideBins,
}

/// What a ray reads beyond a lenslet's angular bins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OutsideBins {
    /// Nothing: 0.
    #[default]
    Dark,
    /// The neighbouring lenslet's bins, as behind a real lens array.
    Repeat,
}

/// A display file that cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DisplayError {
    /// The text does not parse.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The view grid makes no sense.
    #[error("field: {0}")]
    Grid(#[from] GridError),
    /// A value makes no sense.
    #[error("{key}: expected {expected}, found {found}")]
    Value {
        /// The key, for example `layers[2].d_mm`.
        key: String,
        /// What was needed.
        expected: String,
        /// What was there.
        found: String,
    },
}

impl Display {
    /// Value of the key `schema`.
    pub const SCHEMA: &'static str = "lumistack/display";

    /// Reads and checks a display file.
    ///
    /// # Errors
    /// On malformed text, unknown keys and values out of range.
    pub fn from_toml(text: &str) -> Result<Self, DisplayError> {
        let display: Self = config::parse(text)?;
        display.check()?;
        Ok(display)
    }

    /// Writes a display file with every default written out.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a display holds nothing that TOML cannot")
    }

    /// Checks every value.
    ///
    /// # Errors
    /// On the first value out of range.
    pub fn check(&self) -> Result<(), DisplayError> {
        let check = |ok: bool, key: &str, expected: &str, found: String| {
            if ok { Ok(()) } else { Err(DisplayError::Value { key: key.into(), expected: expected.into(), found }) }
        };
        let positive =
            |key: &str, value: f64| check(value.is_finite() && value > 0.0, key, "a number above 0", value.to_string());
        let finite = |key: &str, values: &[f64]| {
            check(values.iter().all(|v| v.is_finite()), key, "finite numbers", format!("{values:?}"))
        };
        let pixels = |key: &str, [cols, rows]: [usize; 2]| {
            let ok = (1..=1 << 16).contains(&cols) && (1..=1 << 16).contains(&rows);
            check(ok, key, "1 to 65536 per axis", format!("[{cols}, {rows}]"))
        };
        check(self.schema == Self::SCHEMA, "schema", Self::SCHEMA, self.schema.clone())?;
        check(self.version == 1, "version", "1", self.version.to_string())?;
        check((1..=1000).contains(&self.frames), "frames", "1 to 1000", self.frames.to_string())?;
        positive("refresh_hz", self.refresh_hz)?;
        let brightness_ok = self.brightness > 0.0 && self.brightness <= 1.0;
        check(brightness_ok, "brightness", "above 0, at most 1", self.brightness.to_string())?;
        pixels("field.resolution", self.field.resolution)?;
        pixels("field.views", self.field.views)?;
        self.geometry()?.check()?;
        check(!self.layers.is_empty(), "layers", "at least one layer", "none".into())?;
        for (n, layer) in self.layers.iter().enumerate() {
            let key = |name: &str| format!("layers[{n}].{name}");
            finite(&key("d_mm"), &[layer.d_mm])?;
            finite(&key("offset_mm"), &layer.offset_mm)?;
            positive(&key("pitch_mm"), layer.pitch_mm)?;
            pixels(&key("resolution"), layer.resolution)?;
            let black_ok = (0.0..1.0).contains(&layer.black_level);
            check(black_ok, &key("black_level"), "0 to less than 1", layer.black_level.to_string())?;
            if let Transfer::Gamma(gamma) = layer.transfer {
                positive(&key("transfer.gamma"), gamma)?;
            }
            if let Some(resolution) = layer.panel_resolution {
                pixels(&key("panel_resolution"), resolution)?;
            }
            if let Some(pitch_mm) = layer.panel_pitch_mm {
                positive(&key("panel_pitch_mm"), pitch_mm)?;
            }
            if n > 0 {
                let behind = self.layers[n - 1].d_mm;
                let expected = format!("more than layers[{}].d_mm = {behind} (layers go rear to front)", n - 1);
                check(layer.d_mm > behind, &key("d_mm"), &expected, layer.d_mm.to_string())?;
            }
        }
        if let Backlight::Lenslets(backlight) = &self.backlight {
            finite("backlight.offset_mm", &backlight.offset_mm)?;
            positive("backlight.pitch_mm", backlight.pitch_mm)?;
            pixels("backlight.lenslets", backlight.lenslets)?;
            pixels("backlight.views", backlight.views)?;
            let fov_ok = backlight.fov_deg.iter().all(|fov| *fov > 0.0 && *fov < 180.0);
            check(fov_ok, "backlight.fov_deg", "angles between 0 and 180", format!("{:?}", backlight.fov_deg))?;
            let behind = self.layers[0].d_mm;
            let expected = format!("at most layers[0].d_mm = {behind}");
            check(backlight.d_mm <= behind, "backlight.d_mm", &expected, backlight.d_mm.to_string())?;
        }
        Ok(())
    }

    /// The light field's pixels and views.
    ///
    /// # Errors
    /// If the view grid makes no sense.
    pub fn geometry(&self) -> Result<FieldGeometry, DisplayError> {
        let field = &self.field;
        let projection = match (field.projection, field.distance_mm) {
            (ProjectionKind::Oblique, _) => Projection::Oblique,
            (ProjectionKind::Perspective, Some(distance_mm)) => Projection::Perspective { distance_mm },
            (ProjectionKind::Perspective, None) => {
                return Err(DisplayError::Value {
                    key: "field.distance_mm".into(),
                    expected: "the viewing distance of a perspective grid".into(),
                    found: "nothing".into(),
                });
            }
        };
        let grid = ViewGrid::uniform(projection, field.views, field.fov_deg)?;
        Ok(FieldGeometry { grid, ..self.field_pixels() })
    }

    /// The light field's pixels with one straight view.
    pub fn field_pixels(&self) -> FieldGeometry {
        FieldGeometry {
            rows: self.field.resolution[1],
            cols: self.field.resolution[0],
            pitch_mm: self.field.pitch_mm,
            grid: ViewGrid::single(Projection::Oblique, [0.0, 0.0]),
        }
    }

    /// The same display at another resolution: the field becomes `resolution` = [columns, rows] pixels over the same width, and the masks are
    /// scaled by the same factors, and so is the number of lenslets over the same area: a coarse preview keeps the display's character. Physical panels stay.
    #[must_use]
    pub fn with_resolution(&self, resolution: [usize; 2]) -> Self {
        let mut display = self.clone();
        let old = self.field.resolution;
        let pitch_factor = old[0] as f64 / resolution[0] as f64;
        let scaled = |count: usize, axis: usize| {
            ((count as f64 * resolution[axis] as f64 / old[axis] as f64).round() as usize).max(1)
        };
        display.field.resolution = resolution;
        display.field.pitch_mm *= pitch_factor;
        for layer in &mut display.layers {
            layer.resolution = [scaled(layer.resolution[0], 0), scaled(layer.resolution[1], 1)];
            layer.pitch_mm *= pitch_factor;
        }
        if let Backlight::Lenslets(backlight) = &mut display.backlight {
            let cols = scaled(backlight.lenslets[0], 0);
            backlight.pitch_mm *= backlight.lenslets[0] as f64 / cols as f64;
            backlight.lenslets = [cols, scaled(backlight.lenslets[1], 1)];
        }
        display
    }

    /// The same display for a light field that already exists: masks take its resolution and size, the view grid its angles (as the full
    /// angle whose bins are as wide as the field's). Distances and frames stay.
    #[must_use]
    pub fn adapted_to(&self, geometry: &FieldGeometry) -> Self {
        let mut display = self.with_resolution([geometry.cols, geometry.rows]);
        let pitch_factor = geometry.pitch_mm / display.field.pitch_mm;
        display.field.pitch_mm = geometry.pitch_mm;
        for layer in &mut display.layers {
            layer.pitch_mm *= pitch_factor;
        }
        let [view_rows, view_cols] = geometry.grid.views();
        let bins = geometry.grid.bin_width();
        display.field.views = [view_cols, view_rows];
        display.field.fov_deg =
            [0, 1].map(|axis| 2.0 * (0.5 * bins[axis] * display.field.views[axis] as f64).atan().to_degrees());
        (display.field.projection, display.field.distance_mm) = match geometry.grid.projection {
            Projection::Oblique => (ProjectionKind::Oblique, None),
            Projection::Perspective { distance_mm } => (ProjectionKind::Perspective, Some(distance_mm)),
        };
        display
    }

    /// Frames that the eye sees a second.
    pub fn period_hz(&self) -> f64 {
        self.refresh_hz / self.frames as f64
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const SMALL: &str = r#"
name = "small"
frames = 2
brightness = 0.2
[field]
resolution = [16, 10]
pitch_mm = 1.0
views = [3, 3]
fov_deg = [20.0, 20.0]
[[layers]]
d_mm = -12.0
resolution = [16, 10]
pitch_mm = 1.0
[[layers]]
d_mm = 0.0
resolution = [16, 10]
pitch_mm = 1.0
[[layers]]
d_mm = 12.0
resolution = [16, 10]
pitch_mm = 1.0
"#;

    /// Three layers, two frames, 16 × 10 pixels, 3 × 3 views.
    pub(crate) fn small_display() -> Display {
        Display::from_toml(SMALL).unwrap()
    }

    #[test]
    fn a_written_display_reads_back_the_same() {
        let display = small_display();
        assert_eq!(Display::from_toml(&display.to_toml()).unwrap(), display);
        let lenslets = format!(
            "{SMALL}[backlight]\nkind = \"lenslets\"\nd_mm = -20.0\nlenslets = [4, 3]\npitch_mm = 4.0\nfov_deg = [20.0, 20.0]\nviews = [3, 3]\n"
        );
        let display = Display::from_toml(&lenslets).unwrap();
        assert_eq!(Display::from_toml(&display.to_toml()).unwrap(), display);
    }

    #[test]
    fn errors_name_the_key() {
        for (from, to, message) in [
            ("frames = 2", "frams = 2", "line 3, column 1: unknown field `frams`"),
            ("frames = 2", "frames = 0", "frames: expected 1 to 1000, found 0"),
            ("d_mm = 0.0", "d_mm = -12.0", "layers[1].d_mm: expected more than layers[0].d_mm = -12"),
            ("brightness = 0.2", "brightness = 1.5", "brightness: expected above 0"),
            ("fov_deg = [20.0, 20.0]", "fov_deg = [20.0, nan]", "field: fov_deg"),
            ("views = [3, 3]", "views = [3, 0]", "field.views: expected 1 to"),
            ("views = [3, 3]", "views = [3, 3]\nprojection = \"perspective\"", "field.distance_mm"),
        ] {
            let error = Display::from_toml(&SMALL.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
    }

    #[test]
    fn an_adapted_display_has_the_light_fields_geometry() {
        let wide = small_display();
        let grid = ViewGrid::uniform(Projection::Oblique, [5, 1], [30.0, 10.0]).unwrap();
        let geometry = FieldGeometry { rows: 7, cols: 9, pitch_mm: 2.0, grid };
        let display = wide.adapted_to(&geometry);
        display.check().unwrap();
        assert_eq!((display.layers[0].resolution, display.layers[2].pitch_mm), ([9, 7], 2.0));
        let adapted = display.geometry().unwrap();
        for (a, b) in adapted.grid.slope_x.iter().zip(&geometry.grid.slope_x) {
            assert!((a - b).abs() < 1e-12);
        }
        assert_eq!(adapted.grid.views(), [1, 5]);
    }

    #[test]
    fn another_resolution_keeps_the_width() {
        let display = small_display().with_resolution([32, 19]);
        assert_eq!(display.layers[1].resolution, [32, 19]);
        assert_eq!(display.field.pitch_mm * 32.0, 16.0);
        display.check().unwrap();
    }
}
