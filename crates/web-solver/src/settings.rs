//! What the page chooses: a display, and how much of it.

use lumistack_display::{Display, PRESETS, Variation, Views};
use lumistack_factorizer::{ZONE_ITERATIONS, held_bytes};
use lumistack_shot::{Denoise, RenderJob, ZoneSamples};
use serde::Deserialize;

use crate::error::Error;

/// Memory that the views of a light field may take, MiB: with all that is made of them they stay well below what a module can have.
const FIELD_MIB: u64 = 256;
/// Bytes that a solve may take beside its views.
const MOST_SOLVING: u64 = 700 << 20;
/// Paths per pixel of all views together: what the command takes where it measures nothing.
const ZONE_SAMPLES: u32 = 800;
/// Columns of a light field.
const COLS: std::ops::RangeInclusive<usize> = 16..=640;

/// Choices, as JSON. What is not given is the preset's.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Name of a preset.
    pub preset: String,
    /// Columns of the light field, 16 to 640; masks scale along, the width in millimetres stays.
    pub cols: usize,
    /// Number of layers.
    pub layers: Option<usize>,
    /// Frames of a period.
    pub frames: Option<usize>,
    /// Brightness β, above 0, at most 1.
    pub brightness: Option<f64>,
    /// Distance of neighbouring layers, millimetres.
    pub gap_mm: Option<f64>,
    /// Paths per pixel of all views together, as the command's `render.zone_samples`.
    pub zone_samples: u32,
    /// Full updates of the last solve; without it as many as the command makes.
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
    /// Reads what the page says.
    ///
    /// # Errors
    /// On malformed text and unknown keys.
    pub fn from_json(text: &str) -> Result<Self, Error> {
        serde_json::from_str(text).map_err(|error| Error(format!("settings: {error}")))
    }

    /// The display that is asked for, with its choice of views made.
    ///
    /// # Errors
    /// When there is no such preset, a value is out of range, or the display takes more memory than a page has.
    pub fn display(&self) -> Result<Display, Error> {
        let preset = PRESETS.iter().find(|(name, _)| *name == self.preset);
        let (_, text) = preset.ok_or_else(|| Error::value("preset", "the name of a preset", &self.preset))?;
        if !COLS.contains(&self.cols) {
            return Err(Error::value("cols", "16 to 640 columns", self.cols));
        }
        let base = Display::from_toml(text)?;
        let [cols, rows] = base.field.resolution;
        let rows = ((self.cols * rows) as f64 / cols as f64).round().max(1.0) as usize;
        let Self { layers, frames, brightness, gap_mm, .. } = *self;
        let variation = Variation { layers, frames, brightness, gap_mm, ..Variation::default() };
        let display = variation.applied_to(&base.with_resolution([self.cols, rows]))?;
        let most = self.render().affordable_views(self.cols * rows);
        let display = display.with_views_chosen(most);
        let bytes = held_bytes(&display, &display.geometry()?, 1);
        if bytes > MOST_SOLVING {
            let found = format!("{} MB for this display; take fewer columns or frames", bytes / 1_000_000);
            return Err(Error::value("display", &format!("at most {} MB", MOST_SOLVING / 1_000_000), found));
        }
        Ok(display)
    }

    /// A job for the command that makes the same of a file beside it. The display stands in `display.toml`.
    pub fn job(&self, path: &str) -> String {
        let mut text = format!("scene = {path:?}\n\n[display]\nfile = \"display.toml\"\n");
        text += &format!("\n[render]\nzone_samples = {}\n", self.zone_samples);
        if let Some(iterations) = self.iterations {
            text += &format!("\n[factorize]\niterations = {iterations}\n");
        }
        text
    }

    /// How views are rendered.
    pub(crate) fn render(&self) -> RenderJob {
        RenderJob { zone_samples: ZoneSamples::Count(self.zone_samples), field_mib: FIELD_MIB, ..RenderJob::default() }
    }

    /// What takes noise out of the views of a display, as the command chooses it.
    pub(crate) fn denoise(display: &Display) -> Denoise {
        if matches!(display.field.views, Views::Fixed(_)) { Denoise::Off } else { Denoise::Shared }
    }

    /// Full updates of the last solve.
    pub(crate) fn iterations(&self, display: &Display) -> u32 {
        let fixed = matches!(display.field.views, Views::Fixed(_));
        let default = if fixed { lumistack_factorizer::Settings::default().iterations } else { ZONE_ITERATIONS };
        self.iterations.unwrap_or(default)
    }
}
