//! The settings of the page: a preset of a display, and changes to it.

use lumistack_display::{Display, FieldGeometry, Variation, Views};
use lumistack_factorizer::{ZONE_ITERATIONS, held_bytes};
use lumistack_shot::{Denoise, RenderJob, ZoneSamples};
use serde::{Deserialize, Serialize};

use crate::decoders::Wanted;
use crate::error::Error;

/// Largest memory of a light field's views, MiB. The views and all data that is computed from them
/// need much less than 4 GiB, the largest memory of a WebAssembly module.
const FIELD_MIB: u64 = 256;
/// Largest memory of a solve in addition to its views, bytes.
const MOST_SOLVING: u64 = 700 << 20;
/// Default for the paths per pixel, summed over all views. The command uses this number if it does
/// not choose the number by measuring the noise.
const ZONE_SAMPLES: u32 = 800;
/// Allowed columns of a light field.
const COLS: std::ops::RangeInclusive<usize> = 16..=640;

/// A display that comes with the program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Preset {
    /// Name of the display's file without its extension.
    pub name: String,
    /// The display.
    pub display: Display,
}

/// Returns the displays that come with the program. The module contains them as JSON, since a
/// reader of TOML would be a tenth of the module.
///
/// # Errors
/// No error can occur, since a test reads the presets and compares them with the display files of
/// the command.
pub fn presets() -> Result<Vec<Preset>, Error> {
    serde_json::from_str(include_str!("presets.json")).map_err(|error| Error(format!("presets: {error}")))
}

/// The settings of the page, read from JSON. If `layers`, `frames`, `brightness` or `gap_mm` is
/// missing, the preset's value is used; any other missing key has the default below.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Name of a preset.
    pub preset: String,
    /// Pixel columns of the light field, 16 to 640. The masks' resolution changes by the same
    /// factor; the width in millimetres stays the same.
    pub cols: usize,
    /// Number of layers.
    pub layers: Option<usize>,
    /// Number of frames.
    pub frames: Option<usize>,
    /// Brightness β, above 0, at most 1.
    pub brightness: Option<f64>,
    /// Gap between neighbouring layers, mm.
    pub gap_mm: Option<f64>,
    /// Paths per pixel of all views together, like the command's `render.zone_samples`.
    pub zone_samples: u32,
    /// Iterations of the last solve; the default is the command's number.
    pub iterations: Option<u32>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            preset: "paper-three-layer".into(),
            cols: 160,
            layers: None,
            frames: None,
            brightness: None,
            gap_mm: None,
            zone_samples: ZONE_SAMPLES,
            iterations: None,
        }
    }
}

impl Settings {
    /// Reads settings from JSON.
    ///
    /// # Errors
    /// If the text is malformed or a key is unknown.
    pub fn from_json(text: &str) -> Result<Self, Error> {
        serde_json::from_str(text).map_err(|error| Error(format!("settings: {error}")))
    }

    /// Makes the chosen display. If the preset leaves the choice of views to the program, this
    /// function also chooses the views.
    ///
    /// # Errors
    /// If there is no such preset, a value is out of range, or the display needs more memory than a
    /// page has.
    pub fn display(&self) -> Result<Display, Error> {
        let preset = presets()?.into_iter().find(|preset| preset.name == self.preset);
        let preset = preset.ok_or_else(|| Error::value("preset", "the name of a built-in display", &self.preset))?;
        if !COLS.contains(&self.cols) {
            return Err(Error::value("cols", "16 to 640 columns of pixels", self.cols));
        }
        let base = preset.display;
        let [cols, rows] = base.field.resolution;
        let rows = ((self.cols * rows) as f64 / cols as f64).round().max(1.0) as usize;
        let Self { layers, frames, brightness, gap_mm, .. } = *self;
        let variation = Variation { layers, frames, brightness, gap_mm, ..Variation::default() };
        let display = variation.applied_to(&base.with_resolution([self.cols, rows]))?;
        let most = self.render().affordable_views(self.cols * rows);
        let display = display.with_views_chosen(most);
        affordable(&display)?;
        Ok(display)
    }

    /// Adapts the chosen display to a light field, as the command does.
    ///
    /// # Errors
    /// If display and light field do not fit each other, or the adapted display needs more memory
    /// than a page has.
    pub(crate) fn display_for(&self, geometry: &FieldGeometry) -> Result<Display, Error> {
        let display = self.display()?.adapted_to(geometry)?;
        affordable(&display)?;
        Ok(display)
    }

    /// Returns the geometry for a light field whose files do not state it: the display's geometry,
    /// as in the command. The largest width of its views is the chosen number of columns.
    pub(crate) fn wanted(&self, display: &Display) -> Wanted {
        Wanted { width_mm: display.field_pixels().size_mm()[0], fov_deg: display.field.fov_deg, cols: self.cols }
    }

    /// Returns the job file by which the command computes the same patterns. The command expects
    /// `display.toml` and the input `path` beside it. `resolution` is [columns, rows] if the input
    /// is a light field, and `None` if it is a scene.
    pub fn job(&self, path: &str, resolution: Option<[usize; 2]>) -> String {
        let input = if resolution.is_some() { "light_field" } else { "scene" };
        // A JSON string is a TOML string, too; Rust's own form of escapes is not.
        let path = serde_json::Value::from(path);
        let mut text = format!("{input} = {path}\n\n[display]\nfile = \"display.toml\"\n");
        match resolution {
            Some(resolution) => text += &format!("\n[geometry]\nresolution = {resolution:?}\n"),
            None => text += &format!("\n[render]\nzone_samples = {}\n", self.zone_samples),
        }
        if let Some(iterations) = self.iterations {
            text += &format!("\n[factorize]\niterations = {iterations}\n");
        }
        text
    }

    /// Returns the settings with which views are rendered.
    pub(crate) fn render(&self) -> RenderJob {
        RenderJob { zone_samples: ZoneSamples::Count(self.zone_samples), field_mib: FIELD_MIB, ..RenderJob::default() }
    }

    /// Returns the noise filter for the views of a display. The command `lumistack` uses the same
    /// filter by default.
    pub(crate) fn denoise(display: &Display) -> Denoise {
        if matches!(display.field.views, Views::Fixed(_)) { Denoise::Off } else { Denoise::Shared }
    }

    /// Returns the number of iterations of the last solve. There are two defaults: one for fixed
    /// views, such as a given light field, and one for views that the program chooses.
    pub(crate) fn iterations(&self, display: &Display) -> u32 {
        let fixed = matches!(display.field.views, Views::Fixed(_));
        let default = if fixed { lumistack_factorizer::Settings::default().iterations } else { ZONE_ITERATIONS };
        self.iterations.unwrap_or(default)
    }
}

/// Returns an error if a display needs more memory than a page has.
fn affordable(display: &Display) -> Result<(), Error> {
    let geometry = display.geometry()?;
    let bytes = held_bytes(display, &geometry, 1);
    if bytes > MOST_SOLVING {
        let found = format!("{} MB for this display; take fewer columns or frames", bytes / 1_000_000);
        return Err(Error::value("display", &format!("at most {} MB", MOST_SOLVING / 1_000_000), found));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use lumistack_display::PRESETS;

    use super::*;

    #[test]
    fn presets_are_those_of_the_command() {
        let preset = |(name, text): &(&str, &str)| Preset {
            name: (*name).to_owned(),
            display: Display::from_toml(text).unwrap(),
        };
        let expected: Vec<Preset> = PRESETS.iter().map(preset).collect();
        if std::env::var_os("LUMISTACK_WRITE").is_some() {
            let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/presets.json");
            let lines: Vec<String> = expected.iter().map(|preset| serde_json::to_string(preset).unwrap()).collect();
            std::fs::write(path, format!("[\n{}\n]\n", lines.join(",\n"))).unwrap();
            return;
        }
        let remedy = "LUMISTACK_WRITE=1 cargo test -p lumistack-web-solver presets writes presets.json";
        assert_eq!(presets().unwrap(), expected, "{remedy}");
    }

    /// A file name may contain accents as separate combining characters, as on macOS.
    #[test]
    fn a_job_names_any_file() {
        let name = "Cafe\u{301} \"1\" \\ ก็.glb";
        let text = Settings::default().job(name, None);
        let job: serde_json::Value = lumistack_core::config::parse(&text).unwrap();
        assert_eq!(job["scene"].as_str(), Some(name));
    }
}
