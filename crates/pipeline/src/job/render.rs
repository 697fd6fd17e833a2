//! `[render]`: settings of the path tracer.

use serde::{Deserialize, Serialize};

use crate::error::PipelineError;

/// Path tracer settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderJob {
    /// Paths per pixel and view.
    pub samples: u32,
    /// Bounces after the first hit.
    pub max_bounces: u32,
    /// Largest value of a single path, which dims brighter ones and so loses light; none keeps all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clamp: Option<f32>,
    /// `point`: rays at the view's slope; `bin`: spread over the view's bin.
    pub angular_filter: AngularFilter,
    /// Full angle under which a lens focused on the window is seen from it, degrees; 0 for a pinhole. Instead of `angular_filter`.
    pub lens_deg: f64,
    /// In-between views per axis that are rendered for the report only; 0 for none.
    pub held_out: usize,
    /// Views on either side beyond the outermost ones, one view spacing apart, that are rendered for the report only; 0 for none.
    pub outside: usize,
}

/// Angular extent of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AngularFilter {
    /// One slope per view.
    #[default]
    Point,
    /// Slopes spread over the view's bin.
    Bin,
}

impl Default for RenderJob {
    fn default() -> Self {
        Self {
            samples: 32,
            max_bounces: 6,
            clamp: None,
            angular_filter: AngularFilter::Point,
            lens_deg: 0.0,
            held_out: 2,
            outside: 1,
        }
    }
}

impl RenderJob {
    /// Checks values that no parser checks.
    pub(super) fn check(&self) -> Result<(), PipelineError> {
        let fail = |key: &str, expected: &str, found: String| Err(PipelineError::value("job", key, expected, found));
        if !(1..=65536).contains(&self.samples) {
            return fail("render.samples", "1 to 65536", self.samples.to_string());
        }
        if self.max_bounces > 1024 {
            return fail("render.max_bounces", "0 to 1024", self.max_bounces.to_string());
        }
        if !(0.0..=90.0).contains(&self.lens_deg) {
            return fail("render.lens_deg", "0 to 90", self.lens_deg.to_string());
        }
        if self.lens_deg > 0.0 && self.angular_filter == AngularFilter::Bin {
            return fail("render.lens_deg", "either a lens or `angular_filter = \"bin\"`", "both".into());
        }
        if let Some(limit) = self.clamp.filter(|limit| !(*limit > 0.0 && limit.is_finite())) {
            return fail("render.clamp", "a number above 0", limit.to_string());
        }
        for (key, count) in [("render.held_out", self.held_out), ("render.outside", self.outside)] {
            if count > 64 {
                return fail(key, "0 to 64", count.to_string());
            }
        }
        Ok(())
    }
}
