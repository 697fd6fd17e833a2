//! `[sequence]`: time steps of an animation, a moving window, a folder of light fields or a source.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::PipelineError;

/// A sequence: given light fields of one geometry, an animated scene, a window that moves through a
/// scene, or the time steps of a source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SequenceJob {
    /// Number of time steps. Default: one for every light field in the folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub times: Option<usize>,
    /// Iterations at every time step after the first. The first time step takes
    /// `factorize.iterations`.
    pub iterations: u32,
    /// Angle by which the window turns about its vertical axis from the first time step to the
    /// last, degrees. With a positive angle, the scene looks as if the viewer walked to the right.
    pub turn_deg: f64,
    /// Shift of the window from the first time step to the last, `[x, y, z]` in display space at
    /// the first time step, millimetres.
    pub shift_mm: [f64; 3],
    /// Duration from the first time step to the last, seconds, for the animations of a scene or for
    /// a source. The first time step is at `pose.time_s` or `source.time_s`; both are 0 by default.
    pub duration_s: f64,
    /// If true, every time step has a full report. The report of the sequence is always written.
    pub reports: bool,
    /// Number of time steps in a chunk. Chunks do not depend on each other's patterns, so several
    /// machines solve them in parallel. Default: all time steps are one chain of warm starts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chunk_times: Option<usize>,
    /// Number of time steps before a chunk that are solved once more for this chunk. The first of
    /// them has no warm start. With their patterns, the chunk begins almost as in a sequence
    /// without chunks. Default 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub warm_up_times: Option<usize>,
}

impl Default for SequenceJob {
    fn default() -> Self {
        Self {
            times: None,
            iterations: 5,
            turn_deg: 0.0,
            shift_mm: [0.0; 3],
            duration_s: 0.0,
            reports: false,
            chunk_times: None,
            warm_up_times: None,
        }
    }
}

impl SequenceJob {
    /// Maximum number of time steps: names of their folders have four digits.
    pub const MOST: usize = 9999;

    /// Checks ranges, and keys that only a scene or a source can have.
    pub(super) fn check(&self, has_scene: bool, has_light_field: bool) -> Result<(), PipelineError> {
        let fail = |key: &str, expected: &str, found: String| Err(PipelineError::job(key, expected, found));
        // Only for a folder of light fields, `times` may be absent, since the folder determines the
        // number.
        match self.times {
            Some(times) if !(1..=Self::MOST).contains(&times) => {
                return fail("sequence.times", "1 to 9999", times.to_string());
            }
            None if !has_light_field => {
                let expected = "the number of time steps (`--times`), since the input is not a folder of light fields";
                return fail("sequence.times", expected, "nothing".into());
            }
            _ => {}
        }
        // Keys that have no effect for this input are mistakes, so they are errors.
        if (self.turn_deg != 0.0 || self.shift_mm != [0.0; 3]) && !has_scene {
            return fail(
                "sequence",
                "a job with `scene` for the keys `turn_deg` and `shift_mm`",
                "a job without `scene`".into(),
            );
        }
        if self.duration_s != 0.0 && has_light_field {
            let expected = "a job with `scene` or `source` for the key `duration_s`";
            return fail("sequence", expected, "a job with light fields".into());
        }
        // Check ranges. The types allow any number, also NaN.
        if self.chunk_times == Some(0) {
            return fail("sequence.chunk_times", "1 or more", "0".into());
        }
        if let Some(times) = self.warm_up_times
            && !self.chunk_times.is_some_and(|chunk| (1..=chunk).contains(&times))
        {
            return fail(
                "sequence.warm_up_times",
                "a number from 1 to `chunk_times`, which must also be set",
                times.to_string(),
            );
        }
        if !self.duration_s.is_finite() {
            return fail("sequence.duration_s", "a finite number of seconds", self.duration_s.to_string());
        }
        if !self.turn_deg.is_finite() {
            return fail("sequence.turn_deg", "a finite number of degrees", self.turn_deg.to_string());
        }
        if !self.shift_mm.iter().all(|shift| shift.is_finite()) {
            return fail("sequence.shift_mm", "three finite lengths in millimetres", format!("{:?}", self.shift_mm));
        }
        Ok(())
    }
}
