//! The description of a display, a TOML file with lengths in millimetres and angles in degrees.

use lumistack_core::config;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    Backlight, ColourOrder, ColourSequence, DisplayError, FieldGeometry, Formation, Layer, LensletBacklight, Missing,
    Projection, Sampling, ViewGrid, Views,
};

/// A tensor display and the light field that it is made for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Display {
    /// Format of the file.
    #[serde(default = "format")]
    pub schema: String,
    /// Version of the format.
    #[serde(default = "version")]
    pub version: u32,
    /// Name, as shown to the user.
    pub name: String,
    /// Number M of time-multiplexed frames in one period, ≥ 1.
    pub frames: usize,
    /// Refresh rate of the panels, hertz. A refresh shows one frame, or one colour of a frame; see
    /// [`period_hz`](Self::period_hz).
    #[serde(default = "default_refresh_hz")]
    pub refresh_hz: f64,
    /// Order of the colours of a frame in time: together, or one after another.
    #[serde(default)]
    pub colour_sequence: ColourSequence,
    /// Order of the colours that are shown one after another.
    #[serde(default, skip_serializing_if = "ColourOrder::is_default")]
    pub colour_order: ColourOrder,
    /// The way in which the layers of one frame form an image.
    #[serde(default)]
    pub formation: Formation,
    /// Brightness scale β (eq. 27), above 0 and at most 1: the display emits β times the target.
    #[serde(default = "default_brightness")]
    pub brightness: f64,
    /// Interpolation between the pixel centres of a layer.
    #[serde(default)]
    pub sampling: Sampling,
    /// Rule for a ray that misses a layer.
    #[serde(default)]
    pub missing: Missing,
    /// Views and pixels of the light field that the display shows.
    pub field: FieldConfig,
    /// The light source behind the layers.
    #[serde(default)]
    pub backlight: Backlight,
    /// Layers from rear to front, so that `d_mm` rises.
    pub layers: Vec<Layer>,
}

fn format() -> String {
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FieldConfig {
    /// [columns, rows] of pixels on z = 0.
    pub resolution: [usize; 2],
    /// Pixel pitch on z = 0, millimetres.
    pub pitch_mm: f64,
    /// The views that sample the viewing zone.
    #[serde(default)]
    pub views: Views,
    /// [horizontal, vertical] full angle of view, degrees.
    pub fov_deg: [f64; 2],
    /// Projection of the rays of one view.
    #[serde(default)]
    pub projection: ProjectionKind,
    /// Viewing distance of a perspective grid, millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_mm: Option<f64>,
}

/// Projection of the views of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ProjectionKind {
    /// Every view is a parallel projection, as in the paper.
    #[default]
    Oblique,
    /// Every view is the picture of a pinhole camera at distance `distance_mm`.
    Perspective,
}

impl Display {
    /// Value of the key `schema`.
    pub const SCHEMA: &'static str = "lumistack/display";

    /// Returns a plain display of `frames` frames. Its layers at `d_mm` (rear to front,
    /// millimetres) all have the field's pixels. The display has oblique views, a uniform
    /// backlight, and every other key at its default. `resolution` and `views` are [columns, rows],
    /// `fov_deg` full angles in degrees. The values are not checked: call [`check`](Self::check).
    ///
    /// ```
    /// use lumistack_display::{Display, Missing};
    /// let plain = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 0.0, 12.0], 2);
    /// let display = Display { missing: Missing::Clear, ..plain };
    /// assert!(display.check().is_ok());
    /// ```
    pub fn uniform(
        resolution: [usize; 2],
        pitch_mm: f64,
        views: [usize; 2],
        fov_deg: [f64; 2],
        d_mm: &[f64],
        frames: usize,
    ) -> Self {
        Self {
            schema: format(),
            version: version(),
            name: format!("{} layers, {frames} frames", d_mm.len()),
            frames,
            refresh_hz: default_refresh_hz(),
            colour_sequence: ColourSequence::default(),
            colour_order: ColourOrder::default(),
            formation: Formation::default(),
            brightness: default_brightness(),
            sampling: Sampling::default(),
            missing: Missing::default(),
            field: FieldConfig {
                resolution,
                pitch_mm,
                views: Views::Fixed(views),
                fov_deg,
                projection: ProjectionKind::default(),
                distance_mm: None,
            },
            backlight: Backlight::default(),
            layers: d_mm.iter().map(|&d_mm| Layer::new(d_mm, resolution, pitch_mm)).collect(),
        }
    }

    /// Reads and checks a display file.
    ///
    /// # Errors
    /// On malformed text, unknown keys and values out of range.
    pub fn from_toml(text: &str) -> Result<Self, DisplayError> {
        let display: Self = config::parse(text)?;
        display.check()?;
        Ok(display)
    }

    /// Returns the display as the text of a display file. The text includes default values, except
    /// the default `colour_order` and optional keys without a value.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a display holds nothing that TOML cannot")
    }

    /// Returns the light field's pixels and views.
    ///
    /// # Errors
    /// If the view grid is invalid, or if a perspective grid has no viewing distance.
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
        let grid = self.view_grid(projection)?;
        Ok(FieldGeometry { grid, ..self.field_pixels() })
    }

    /// Returns the light field's pixels with a single view along z.
    pub fn field_pixels(&self) -> FieldGeometry {
        FieldGeometry {
            rows: self.field.resolution[1],
            cols: self.field.resolution[0],
            pitch_mm: self.field.pitch_mm,
            grid: ViewGrid::single(Projection::Oblique, [0.0, 0.0]),
        }
    }

    /// Returns the display without the calibration of its panels and its lens array, and with the
    /// default colour order. Patterns depend on none of these. So two displays that differ only in
    /// these values have the same patterns.
    #[must_use]
    pub fn without_panels(&self) -> Self {
        let mut display = Self { colour_order: Default::default(), ..self.clone() };
        display.layers.iter_mut().for_each(|layer| layer.panel = None);
        if let Backlight::Lenslets(LensletBacklight { panel, lens, .. }) = &mut display.backlight {
            (*panel, *lens) = (None, None);
        }
        display
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::LayerColour;

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

    /// Returns the display that [`SMALL`] describes: three layers, two frames, 16 × 10 pixels, 3 ×
    /// 3 views.
    pub(crate) fn small_display() -> Display {
        let plain = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[-12.0, 0.0, 12.0], 2);
        Display { name: "small".into(), brightness: 0.2, ..plain }
    }

    const LENSLETS: &str = "kind = \"lenslets\"\nd_mm = -20.0\nlenslets = [4, 3]\npitch_mm = 4.0\nfov_deg = [20.0, 20.0]\nviews = [3, 3]\n";

    #[test]
    fn a_file_that_says_little_is_a_plain_stack() {
        assert_eq!(Display::from_toml(SMALL).unwrap(), small_display());
    }

    #[test]
    fn a_written_display_reads_back_the_same() {
        let display = small_display();
        assert_eq!(Display::from_toml(&display.to_toml()).unwrap(), display);
        let every_key = format!(
            "{}[[layers]]\nd_mm = 24.0\nresolution = [16, 10]\npitch_mm = 1.0\npeak = 0.8\nblack_level = 0.01\nbits = 6\n\
             transfer = {{ gamma = 2.2 }}\nblur_px = 0.5\ncrosstalk = [[0.9, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.7]]\ncolour = \"mono\"\n\
             filters = [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]]\npanel_resolution = [32, 20]\npanel_pitch_mm = 0.5\n\
             [backlight]\n{LENSLETS}black_level = 0.02\noutside_bins = \"repeat\"\ntransfer = \"linear\"\n\
             panel_resolution = [32, 20]\npanel_pitch_mm = 0.5\n",
            SMALL.replace("frames = 2", "frames = 2\nformation = \"polarization\"\ncolour_sequence = \"field\"")
        );
        let display = Display::from_toml(&every_key).unwrap();
        let layer = &display.layers[3];
        assert_eq!((display.formation, display.colour_sequence), (Formation::Polarization, ColourSequence::Field));
        assert_eq!((layer.peak, layer.bits, layer.blur_px, layer.filters.len()), (0.8, Some(6), 0.5, 2));
        assert_eq!((layer.colour, layer.crosstalk.unwrap()[0]), (LayerColour::Mono, [0.9, 0.1, 0.0]));
        assert_eq!(Display::from_toml(&display.to_toml()).unwrap(), display);
    }

    #[test]
    fn errors_name_the_key() {
        let front = "d_mm = 12.0";
        for (from, to, message) in [
            ("frames = 2", "frams = 2", "line 3, column 1: unknown field `frams`"),
            ("frames = 2", "frames = 0", "frames: expected 1 to 1000, found 0"),
            ("d_mm = 0.0", "d_mm = -12.0", "layers[1].d_mm: expected more than layers[0].d_mm = -12"),
            ("brightness = 0.2", "brightness = 1.5", "brightness: expected a number above 0"),
            ("fov_deg = [20.0, 20.0]", "fov_deg = [20.0, nan]", "field: fov_deg"),
            ("views = [3, 3]", "views = [3, 0]", "field.views: expected 1 to"),
            ("views = [3, 3]", "views = [3, 3]\nprojection = \"perspective\"", "field.distance_mm"),
            ("frames = 2", "frames = 2\nformation = \"product\"", "line 4, column 13: unknown variant `product`"),
            (front, "d_mm = 12.0\npeak = 0.0", "layers[2].peak: expected a number above 0 and at most 1, found 0"),
            (front, "d_mm = 12.0\npeak = nan", "layers[2].peak: expected a number above 0 and at most 1, found NaN"),
            (front, "d_mm = 12.0\nbits = 0", "layers[2].bits: expected 1 to 16, found 0"),
            (front, "d_mm = 12.0\nbits = 17", "layers[2].bits: expected 1 to 16, found 17"),
            (
                front,
                "d_mm = 12.0\nbits = 6\ntransfer = { gamma = [2.0, 2.2, 2.4] }",
                "layers[2].bits: expected no `bits`, or a transfer function that all channels share",
            ),
            (
                front,
                "d_mm = 12.0\ntransfer = { table = [[0, 0], [255, 0]] }",
                "layers[2].transfer.table: expected two or more pairs",
            ),
            (front, "d_mm = 12.0\nblur_px = -1.0", "layers[2].blur_px: expected 0 to 8 pixels, found -1"),
            (front, "d_mm = 12.0\nblur_px = 8.5", "layers[2].blur_px: expected 0 to 8 pixels, found 8.5"),
            (
                front,
                "d_mm = 12.0\ncrosstalk = [[1.0, 0.0, 0.0], [0.6, 0.6, 0.0], [0.0, 0.0, 1.0]]",
                "layers[2].crosstalk[1]: expected shares ≥ 0 whose sum is above 0 and at most 1, found [0.6, 0.6, 0.0]",
            ),
            (
                front,
                "d_mm = 12.0\ncrosstalk = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]",
                "layers[2].crosstalk[2]",
            ),
            (
                front,
                "d_mm = 12.0\ncrosstalk = [[1.0, -0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]",
                "layers[2].crosstalk[0]",
            ),
            (
                front,
                "d_mm = 12.0\nfilters = [[1.0, 0.0, 0.0]]",
                "layers[2].filters: expected no filters, or colour = \"mono\"",
            ),
            (
                front,
                "d_mm = 12.0\ncolour = \"mono\"\nfilters = [[1.0, 0.0, 0.0], [0.0, 1.1, 0.0]]",
                "layers[2].filters[1]: expected three factors in 0..1, found [0.0, 1.1, 0.0]",
            ),
        ] {
            let error = Display::from_toml(&SMALL.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
        let error = Display::from_toml(&format!("{SMALL}[backlight]\n{LENSLETS}black_level = 1.0\n")).unwrap_err();
        assert_eq!(error.to_string(), "backlight.black_level: expected 0 to less than 1, found 1");
        let error =
            Display::from_toml(&format!("{SMALL}[backlight]\n{LENSLETS}transfer = {{ gamma = 0.0 }}\n")).unwrap_err();
        assert_eq!(error.to_string(), "backlight.transfer.gamma: expected a number above 0, found 0");
    }

    /// Returns the keys of a table. The parser's error about an unknown key lists these keys.
    fn keys<T: serde::de::DeserializeOwned>() -> Vec<String> {
        let Err(error) = config::parse::<T>("no_such_key = 1") else { panic!("unknown keys are accepted") };
        let names: Vec<String> = error.message.split('`').skip(1).step_by(2).map(String::from).collect();
        assert_eq!(names[0], "no_such_key", "{}", error.message);
        names[1..].to_vec()
    }

    #[test]
    fn every_key_is_documented() {
        let text = include_str!("../../../docs/JOB.md");
        let table = &text[text.find("\n## Display").unwrap()..];
        for (prefix, keys) in [
            ("", keys::<Display>()),
            ("field.", keys::<FieldConfig>()),
            ("layers[].", keys::<Layer>()),
            ("layers[].panel.", keys::<crate::Panel>()),
            ("backlight.", keys::<LensletBacklight>()),
            ("backlight.lens.", keys::<crate::Lens>()),
        ] {
            let tables = ["field", "backlight", "layers", "panel", "lens"];
            for key in keys.iter().filter(|key| !tables.contains(&key.as_str())) {
                assert!(table.contains(&format!("`{prefix}{key}`")), "docs/JOB.md does not list `{prefix}{key}`");
            }
        }
    }
}
