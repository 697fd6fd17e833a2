//! Input and output of a report.

use lumistack_core::{Cancelled, Warning};
use lumistack_display::{
    DirectionScore, Display, EmittedView, LayerStack, LightField, StackError, ViewGrid, WeightError, Weights, ZoneScore,
};
use thiserror::Error;

use crate::depth::DepthBudget;

/// One iteration of the solver, recorded by the pipeline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Number of completed iterations.
    pub iteration: u32,
    /// Objective Σ w (βL − L̃)² (eq. 27).
    pub objective: f64,
    /// PSNR of L̃/β against L, dB.
    pub psnr_view: f64,
    /// Seconds since the solver started.
    pub seconds: f64,
}

/// Summary of the solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Name of the solver.
    pub solver: String,
    /// Name of the start.
    pub start: String,
    /// Number of coarser levels before the full resolution. Each level has half the resolution of
    /// the next level.
    pub coarse_levels: u32,
    /// KKT residual. For each value of the patterns, one more exact step of this value alone would
    /// change the emission. The residual is the root mean square of these changes.
    pub kkt_residual: f64,
    /// For layers of few bits, `psnr_view` (dB) of three stacks: continuous, rounded to the panels'
    /// levels, and optimized again on these levels. The last stack is the result.
    pub levels: Option<[f64; 3]>,
}

/// One stage of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name for readers, such as "render" or "factorize".
    pub name: String,
    /// Wall time in this run, seconds.
    pub seconds: f64,
    /// True if an earlier run computed the result.
    pub cached: bool,
}

/// Result of a denoiser on one view or on all views, in exposed radiance, over all channels. A pair
/// is a value and its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DenoisedView {
    /// Mean of the picture before the filter.
    pub mean: f64,
    /// Mean of the picture after the filter minus `mean`.
    pub mean_change: [f64; 2],
    /// Mean squared error of the picture before the filter; NaN if it was not measured.
    pub mse_before: [f64; 2],
    /// Mean squared error of the picture after the filter; NaN if it was not measured.
    pub mse_after: [f64; 2],
}

/// Results of a denoiser on the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Denoising<'a> {
    /// Name of the denoiser, for readers.
    pub name: &'a str,
    /// The results over all views together.
    pub overall: DenoisedView,
    /// The results of each view, in the order of the target's grid.
    pub views: Vec<DenoisedView>,
    /// The central view before the filter, `[row][col][rgb]`, in the target's size and exposure.
    pub unbiased: &'a [f32],
    /// The central view after the filter, in the same form as `unbiased`.
    pub filtered: &'a [f32],
}

/// Quality of the display over its whole zone.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneFigures {
    /// Errors of seen pictures, for each direction.
    pub score: ZoneScore,
    /// True if the reference pictures are views of a given light field that the solver did not use.
    /// False if they are renders.
    pub left_out: bool,
    /// Directions whose references show every pixel, for SSIM, FLIP and pictures on the page.
    pub views: Vec<ZoneView>,
}

/// A direction that the page shows.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneView {
    /// The direction, as a grid with one view.
    pub direction: ViewGrid,
    /// Error of the seen picture in this direction.
    pub score: DirectionScore,
    /// The scene's picture in this direction, `[row][col][rgb]` in the target's size.
    pub target: Vec<f32>,
    /// The seen picture of the display in this direction.
    pub seen: EmittedView,
}

/// A file or folder that the run wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// Description of the file or folder, for readers.
    pub label: String,
    /// Path relative to the report, with `/` between folders.
    pub path: String,
    /// The reason why the file or folder was not written; `None` if it was written.
    pub failed: Option<String>,
}

/// Input of a report.
#[derive(Clone, Copy, Debug)]
pub struct ReportInput<'a> {
    /// Title, usually the name of the scene or of the job.
    pub title: &'a str,
    /// The display.
    pub display: &'a Display,
    /// Patterns of the display.
    pub stack: &'a LayerStack,
    /// The target light field.
    pub target: &'a LightField,
    /// Weights of the target's rays.
    pub weights: &'a Weights,
    /// Held-out views, usually at [`lumistack_display::ViewGrid::in_between`]. Without them and
    /// without `zone`, views between the target's views are only simulated.
    pub held_out: Option<&'a LightField>,
    /// Views outside of the target's outermost views, usually at
    /// [`lumistack_display::ViewGrid::outside`]. Without them, views at these slopes are only
    /// simulated.
    pub outside: Option<&'a LightField>,
    /// Quality of the display over its whole zone. `None` without reference pictures.
    pub zone: Option<&'a ZoneFigures>,
    /// Pixels of a view per degree of visual angle, for FLIP; usually
    /// [`Flip::DEFAULT_PIXELS_PER_DEGREE`](lumistack_core::metrics::Flip).
    pub pixels_per_degree: f64,
    /// History of the solver; may be empty.
    pub convergence: &'a [Iteration],
    /// Summary of the solver, if one made the patterns.
    pub solution: Option<&'a Solution>,
    /// Times of the stages; may be empty.
    pub stages: &'a [Stage],
    /// The resolved job, with all defaults.
    pub settings: &'a serde_json::Value,
    /// Results of a denoiser on the target, if a denoiser was used.
    pub denoising: Option<&'a Denoising<'a>>,
    /// Facts about the scene (name, triangles, ...), if there is one.
    pub scene: Option<&'a serde_json::Value>,
    /// Depth statistics, if the scene was rendered.
    pub depth: Option<&'a DepthBudget>,
    /// Warnings of all stages.
    pub warnings: &'a [Warning],
    /// Other files of the run.
    pub outputs: &'a [Output],
    /// The command line of the run.
    pub command: Option<&'a str>,
    /// Version of Lumistack.
    pub version: &'a str,
}

/// The two files of a report.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Text of `report.html`.
    pub html: String,
    /// Content of `report.json`.
    pub json: serde_json::Value,
    /// The main score: PSNR of seen pictures over the whole zone, dB.
    pub psnr_zone: Option<f64>,
    /// PSNR of seen pictures over the worst tenth of the directions, dB.
    pub psnr_zone_worst: Option<f64>,
    /// PSNR of all rays of the measured target views, L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of all rays of the measured target views, L̃ against βL, dB.
    pub psnr_raw: f64,
    /// PSNR of L̃/β against L for the held-out views, dB.
    pub held_out_psnr_view: Option<f64>,
    /// PSNR of L̃/β against L for the views outside the zone, dB.
    pub outside_psnr_view: Option<f64>,
}

/// The report cannot be built.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The layer stack does not match the display.
    #[error("layer stack: {0}")]
    Stack(#[from] StackError),
    /// The weights do not match the target.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The run was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A picture could not be encoded.
    #[error("cannot encode a picture: {0}")]
    Picture(#[from] image::ImageError),
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] lumistack_plot::PlotError),
    /// The display could not be written as JSON.
    #[error("cannot write report.json: {0}")]
    Json(#[from] serde_json::Error),
}
