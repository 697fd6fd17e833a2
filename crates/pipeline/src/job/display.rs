//! `[display]`: a preset or a display file, and values to change in it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use lumistack_display::{Display, Missing, Sampling, Views};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::PipelineError;
use crate::presets;
use lumistack_core::path_text::PathText;

/// A preset or a display file, and values to change in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DisplayJob {
    /// Name of a preset; see `lumistack displays`. A table has either this key or `file`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("enum" = presets::names().collect::<Vec<_>>()))]
    pub preset: Option<String>,
    /// Path of a display file. A table has either this key or `preset`.
    #[serde(skip_serializing_if = "Option::is_none", with = "lumistack_core::path_text::optional")]
    #[schemars(with = "Option<PathText>")]
    pub file: Option<PathBuf>,
    /// Resolution of the light field, `[columns, rows]`. The numbers of mask pixels and of lenslets
    /// change in proportion; the width in millimetres stays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resolution: Option<[usize; 2]>,
    /// Views that sample the viewing zone. `"auto"` selects the number that the display needs.
    /// `[horizontal, vertical]` are numbers of views. `{ step = [x, y] }` selects views at
    /// multiples of these slopes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub views: Option<Views>,
    /// Field of view, `[horizontal, vertical]` full angles in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_deg: Option<[f64; 2]>,
    /// Number of frames M.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Brightness scale β.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brightness: Option<f64>,
    /// Interpolation of a layer between its pixels' centres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sampling: Option<Sampling>,
    /// Handling of a ray that misses a layer: `drop` (weight 0) or `clear` (as if the layer were
    /// not there).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing: Option<Missing>,
}

impl DisplayJob {
    /// Interprets a user's text. A text that ends with `.toml`, or contains `/` or `\`, is the path
    /// of a display file. Any other text is the name of a preset.
    pub fn by_name_or_path(text: impl AsRef<OsStr>) -> Self {
        let path = Path::new(text.as_ref());
        match path.to_str() {
            Some(name) if !(name.ends_with(".toml") || name.contains(['/', '\\'])) => {
                Self { preset: Some(name.into()), ..Default::default() }
            }
            // Names of presets are UTF-8, so a text that is not UTF-8 is also a path.
            _ => Self { file: Some(path.to_owned()), ..Default::default() },
        }
    }

    /// Loads the preset or the display file, and applies the other values of this table.
    ///
    /// # Errors
    /// The errors of [`Job::resolve_display`](super::Job::resolve_display).
    pub fn resolve(&self) -> Result<Display, PipelineError> {
        let (place, display) = match (&self.preset, &self.file) {
            (Some(name), None) => (PathBuf::from(name), presets::load(name)?),
            (None, Some(path)) => (path.clone(), presets::load_file(path)?),
            _ => {
                let found = if self.preset.is_some() { "both" } else { "neither" };
                return Err(PipelineError::job("display", "either `preset` or `file`", found));
            }
        };
        self.changed(&place, display)
    }

    /// Applies the values of this table to a display. `place` is the display's preset or file, for
    /// errors.
    ///
    /// # Errors
    /// If a changed value is out of range.
    pub fn changed(&self, place: &Path, mut display: Display) -> Result<Display, PipelineError> {
        let job = self;
        if let Some(views) = job.views {
            display.field.views = views;
        }
        if let Some(fov_deg) = job.fov_deg {
            display.field.fov_deg = fov_deg;
        }
        display.frames = job.frames.unwrap_or(display.frames);
        display.brightness = job.brightness.unwrap_or(display.brightness);
        display.sampling = job.sampling.unwrap_or(display.sampling);
        display.missing = job.missing.unwrap_or(display.missing);
        if let Some(resolution) = job.resolution {
            if resolution.contains(&0) {
                let found = format!("{resolution:?}");
                return Err(PipelineError::job("display.resolution", "at least [1, 1]", found));
            }
            display = display.with_resolution(resolution);
        }
        let place = place.to_owned();
        display.check().map_err(|source| PipelineError::Display { path: place, text: String::new(), source })?;
        Ok(display)
    }
}
