//! `[factorize]`: settings of the factorization.

use std::path::PathBuf;

use lumistack_core::path_text::PathText;
use lumistack_display::EyeBox;
use lumistack_factorizer::{StartKind, solver_names};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::PipelineError;

/// Settings of the factorization.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FactorizeJob {
    /// Name of the solver.
    #[schemars(extend("enum" = solver_names().collect::<Vec<_>>()))]
    pub solver: String,
    /// Device of the solver: `auto`, `cpu`, `gpu` or `gpu:NAME`.
    pub device: String,
    /// Number of iterations. Default: 16 for a scene with automatic views, otherwise 50. With
    /// automatic views, the zone score changes little after 12 iterations (still life, 13 × 13
    /// views: by 0.03 dB from iteration 12 to 50).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<u32>,
    /// Start: `auto`, `random`, `smooth` or `content`.
    #[schemars(extend("enum" = StartKind::names().collect::<Vec<_>>()))]
    pub start: String,
    /// Number of coarser levels before the full resolution. Each level has half the resolution of
    /// the next. Default: the solver decides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coarse_levels: Option<u32>,
    /// Number of iterations at each coarser level.
    pub coarse_iterations: u32,
    /// If true, patterns of layers with the key `bits` are optimized again, over the transmittances
    /// that the panel can show.
    pub levels: bool,
    /// Tiles, [columns, rows], each 1 to 1000: the display is solved tile by tile, on one machine
    /// or many. Without `tiles` and `tile_mib` it is solved as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tiles: Option<[usize; 2]>,
    /// Largest memory for the solve of a tile, MiB, 1 to 16777216. The display is cut into more and
    /// more tiles, until no tile needs more, or the longer side of a tile is below 128 pixels. Not
    /// together with `tiles`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tile_mib: Option<u64>,
    /// Folder `layers` of an earlier run. Its patterns are the initial patterns, and `start` has no
    /// effect.
    #[serde(skip_serializing_if = "Option::is_none", with = "lumistack_core::path_text::optional")]
    #[schemars(with = "Option<PathText>")]
    pub warm_start: Option<PathBuf>,
    /// `.npy` file of weights ≥ 0: one per view, `[view_y][view_x]`, or one per ray,
    /// `[view_y][view_x][row][col]`.
    #[serde(skip_serializing_if = "Option::is_none", with = "lumistack_core::path_text::optional")]
    #[schemars(with = "Option<PathText>")]
    pub weights: Option<PathBuf>,
    /// Weight of rays far from all `eyes`.
    pub eye_floor: f64,
    /// Expected eye positions. The farther a ray passes from all of them, the lower is its weight.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub eyes: Vec<EyeJob>,
}

/// A Gaussian weight around an expected eye position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EyeJob {
    /// Position [x, y, z] in display space, mm; z > 0.
    pub eye_mm: [f64; 3],
    /// Standard deviation, mm.
    pub sigma_mm: f64,
    /// Value of the Gaussian for rays through the position.
    #[serde(default = "default_eye_weight")]
    pub weight: f64,
}

fn default_eye_weight() -> f64 {
    1.0
}

impl Default for FactorizeJob {
    fn default() -> Self {
        Self {
            solver: lumistack_factorizer::AUTO.into(),
            device: "auto".into(),
            iterations: None,
            start: lumistack_factorizer::AUTO.into(),
            coarse_levels: None,
            coarse_iterations: lumistack_factorizer::Settings::default().coarse_iterations,
            levels: true,
            tiles: None,
            tile_mib: None,
            warm_start: None,
            weights: None,
            eye_floor: 0.05,
            eyes: Vec::new(),
        }
    }
}

impl FactorizeJob {
    /// Returns the number of iterations of the job, or the default.
    pub fn iterations(&self) -> u32 {
        self.iterations.unwrap_or(lumistack_factorizer::Settings::default().iterations)
    }

    /// Refuses a graphics processor that the job names, for a task that only the processor can do.
    /// The error's text contains `task`, for example "tiles are solved".
    ///
    /// # Errors
    /// If the job names a graphics processor.
    pub(crate) fn check_needs_no_device(&self, task: &str) -> Result<(), PipelineError> {
        if self.device.starts_with("gpu") {
            let expected = format!("`auto` or `cpu`, since {task} only on the processor");
            return Err(PipelineError::job("factorize.device", expected, format!("`{}`", self.device)));
        }
        Ok(())
    }

    /// Checks `tiles` and `tile_mib`.
    ///
    /// # Errors
    /// If a number is out of range, or the job sets both keys. Also if the job sets one key and the
    /// device is a graphics processor.
    pub(crate) fn check_tiles(&self) -> Result<(), PipelineError> {
        let fail = |key: &str, expected: &str, found: String| Err(PipelineError::job(key, expected, found));
        if self.tiles.is_some() || self.tile_mib.is_some() {
            self.check_needs_no_device("tiles are solved")?;
        }
        match (self.tiles, self.tile_mib) {
            (Some(_), Some(_)) => fail("factorize.tile_mib", "either `tiles` or `tile_mib`", "both".into()),
            (Some(tiles), _) if tiles.iter().any(|count| !(1..=1000).contains(count)) => {
                fail("factorize.tiles", "[columns, rows], each 1 to 1000", format!("{tiles:?}"))
            }
            (_, Some(mib)) if !(1..=1 << 24).contains(&mib) => {
                fail("factorize.tile_mib", "1 to 16777216", mib.to_string())
            }
            _ => Ok(()),
        }
    }

    /// If the job sets `eyes`, checks `eyes` and `eye_floor`. Also checks that the job does not set
    /// `weights` besides `eyes`.
    ///
    /// # Errors
    /// If an eye is not in front of the display, a number is out of range, or the job sets both
    /// `weights` and `eyes`.
    pub(crate) fn check_eyes(&self) -> Result<(), PipelineError> {
        let check = |ok: bool, key: String, expected: &str, found: String| match ok {
            true => Ok(()),
            false => Err(PipelineError::job(key, expected, found)),
        };
        if self.eyes.is_empty() {
            return Ok(());
        }
        check(self.weights.is_none(), "factorize.eyes".into(), "either `weights` or `eyes`", "both".into())?;
        let from_0 = |value: f64| value.is_finite() && value >= 0.0;
        let (floor, at_least) = (self.eye_floor, "a finite number, 0 or more");
        check(from_0(floor), "factorize.eye_floor".into(), at_least, floor.to_string())?;
        for (i, EyeJob { eye_mm, sigma_mm, weight }) in self.eyes.iter().enumerate() {
            let key = |name: &str| format!("factorize.eyes[{i}].{name}");
            let is_in_front = eye_mm.iter().all(|mm| mm.is_finite()) && eye_mm[2] > 0.0;
            check(is_in_front, key("eye_mm"), "a position in front of the display (z > 0)", format!("{eye_mm:?}"))?;
            let is_positive = sigma_mm.is_finite() && *sigma_mm > 0.0;
            check(is_positive, key("sigma_mm"), "a finite number above 0", sigma_mm.to_string())?;
            check(from_0(*weight), key("weight"), at_least, weight.to_string())?;
        }
        Ok(())
    }

    /// Converts the expected eye positions to the type of the crate `display`.
    pub(crate) fn eye_boxes(&self) -> Vec<EyeBox> {
        let boxed = |&EyeJob { eye_mm, sigma_mm, weight }: &EyeJob| EyeBox { eye_mm, sigma_mm, weight };
        self.eyes.iter().map(boxed).collect()
    }
}
