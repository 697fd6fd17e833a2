//! `[display]`: which display, and what to change about it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use lumistack_display::{Display, Missing, Sampling, Views};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::PipelineError;
use crate::presets;
use lumistack_core::path_text::PathText;

/// Which display, and what to change about it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DisplayJob {
    /// Name of a preset; see `lumistack displays`. Either this or `file`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("enum" = presets::names().collect::<Vec<_>>()))]
    pub preset: Option<String>,
    /// A display file. Either this or `preset`.
    #[serde(skip_serializing_if = "Option::is_none", with = "lumistack_core::path_text::optional")]
    #[schemars(with = "Option<PathText>")]
    pub file: Option<PathBuf>,
    /// [columns, rows] of the light field; masks scale along, the width in millimetres stays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resolution: Option<[usize; 2]>,
    /// Which views sample the zone: `"auto"`, as many as it takes; [horizontal, vertical]; or `{ step = [x, y] }`, at multiples of these slopes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub views: Option<Views>,
    /// [horizontal, vertical] full angles of view, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_deg: Option<[f64; 2]>,
    /// Frames M.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Brightness scale β.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brightness: Option<f64>,
    /// How a ray reads a layer between pixel centres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sampling: Option<Sampling>,
    /// What a ray reads that leaves a layer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing: Option<Missing>,
}

impl DisplayJob {
    /// Of what a user typed: the name of a preset or the path of a file.
    pub fn by_name_or_path(text: impl AsRef<OsStr>) -> Self {
        let path = Path::new(text.as_ref());
        match path.to_str() {
            Some(name) if !(name.ends_with(".toml") || name.contains(['/', '\\'])) => {
                Self { preset: Some(name.into()), ..Default::default() }
            }
            // the names of presets are UTF-8
            _ => Self { file: Some(path.to_owned()), ..Default::default() },
        }
    }

    /// The display that is asked for.
    ///
    /// # Errors
    /// As [`Job::resolve_display`](super::Job::resolve_display).
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

    /// A display from `place` with what the job changes about it.
    ///
    /// # Errors
    /// When a changed value is out of range.
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
