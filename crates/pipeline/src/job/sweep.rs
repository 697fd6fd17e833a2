//! `[sweep]`: designs to compare.

use lumistack_design::table::Plots;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::PipelineError;
use lumistack_core::path_text::is_default;

/// Values for each parameter; every combination is one design. A parameter without values keeps the
/// display's value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SweepJob {
    /// Presets, or display files relative to the job; default: the job's display.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub displays: Vec<String>,
    /// Numbers of layers N.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<usize>,
    /// Numbers of frames M.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<usize>,
    /// Brightness scales β.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub brightness: Vec<f64>,
    /// Gaps between neighbouring layers Δd, millimetres.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub gap_mm: Vec<f64>,
    /// Fields of view of the light field and of a directional backlight, `[horizontal, vertical]`
    /// full angles in degrees. Each needs its own light field.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fov_deg: Vec<[f64; 2]>,
    /// Numbers of lenslets, `[columns, rows]`. Displays without a directional backlight do not
    /// change.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lenslets: Vec<[usize; 2]>,
    /// Plots that are drawn from the table: `none`, `few` or `all`.
    #[serde(skip_serializing_if = "is_default")]
    pub plots: Plots,
    /// Constraints of a search, which solves only promising designs to the last iteration.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub search: Option<SearchJob>,
}

/// Constraints of a search.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SearchJob {
    /// Maximum distance from the rearmost to the frontmost component, millimetres. The components
    /// are the layers and a directional backlight.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_thickness_mm: Option<f64>,
    /// Maximum refresh rate of the panels, Hz. All frames together must be shown 60 times a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_refresh_hz: Option<f64>,
    /// Maximum number of panels: one per layer, and one behind the lenslets.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_panels: Option<usize>,
    /// Minimum brightness scale β.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_brightness: Option<f64>,
    /// Sufficient score, dB: the zone score, or the PSNR at the target views if there is no zone
    /// score. The search considers all designs that reach this score. Without this key, or if no
    /// design reaches it, the search considers all designs within 0.3 dB of the highest score.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub enough_db: Option<f64>,
}

impl SweepJob {
    /// Returns the number of designs, including equal designs.
    pub fn count(&self) -> usize {
        let lengths = [
            self.displays.len(),
            self.layers.len(),
            self.frames.len(),
            self.brightness.len(),
            self.gap_mm.len(),
            self.fov_deg.len(),
            self.lenslets.len(),
        ];
        lengths.iter().fold(1, |count: usize, length| count.saturating_mul(*length.max(&1)))
    }

    /// Checks the number of designs and the constraints. The values of each display are checked
    /// when the display is made.
    pub(crate) fn check(&self) -> Result<(), PipelineError> {
        if self.count() > Self::MOST {
            let expected = format!("at most {} designs", Self::MOST);
            return Err(PipelineError::job("sweep", expected, self.count().to_string()));
        }
        let Some(search) = &self.search else { return Ok(()) };
        let numbers = [
            ("max_thickness_mm", search.max_thickness_mm),
            ("max_refresh_hz", search.max_refresh_hz),
            ("min_brightness", search.min_brightness),
            ("enough_db", search.enough_db),
        ];
        for (key, number) in numbers {
            if let Some(number) = number.filter(|number| !(number.is_finite() && *number >= 0.0)) {
                return Err(PipelineError::job(format!("sweep.search.{key}"), "a number ≥ 0", number.to_string()));
            }
        }
        Ok(())
    }

    /// Maximum number of designs; more are an error.
    pub const MOST: usize = 10_000;
}
