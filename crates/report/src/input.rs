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
    /// Full updates completed.
    pub iteration: u32,
    /// Σ w (βL − L̃)² (eq. 27).
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
    /// Number of coarser levels at the start, each at half the resolution.
    pub coarse_levels: u32,
    /// KKT residual: root mean square change of the emission by one further exact coordinate step
    /// of a value.
    pub kkt_residual: f64,
    /// For layers of few bits, `psnr_view` (dB) of three stacks: continuous, rounded to the panels'
    /// levels, and re-optimized on the levels, which is the result.
    pub levels: Option<[f64; 3]>,
}

/// One stage of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name for readers: "render", "factorize".
    pub name: String,
    /// Wall time in this run, seconds.
    pub seconds: f64,
    /// The result was cached by an earlier run.
    pub cached: bool,
}

/// Effect of a denoiser on one view or on all, in exposed radiance, over all channels. Pairs are a
/// value and its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DenoisedView {
    /// Mean of the unbiased picture.
    pub mean: f64,
    /// Mean of the filtered picture minus `mean`.
    pub mean_change: [f64; 2],
    /// Mean squared error of the unbiased picture.
    pub mse_before: [f64; 2],
    /// Mean squared error of the filtered picture.
    pub mse_after: [f64; 2],
}

/// Effect of a denoiser on the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Denoising<'a> {
    /// Its name, for readers.
    pub name: &'a str,
    /// Over all views.
    pub overall: DenoisedView,
    /// Per view, in the order of the target's grid.
    pub views: Vec<DenoisedView>,
    /// The central view as rendered, `[row][col][rgb]`, in the target's size and exposure.
    pub unbiased: &'a [f32],
    /// The filtered central view, in the same form.
    pub filtered: &'a [f32],
}

/// Quality of the display over its whole zone.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneFigures {
    /// Errors of pixel-averaged views, per direction.
    pub score: ZoneScore,
    /// The references are views of a given light field that were withheld from the solver, rather
    /// than renders.
    pub left_out: bool,
    /// Directions whose references have enough samples for SSIM, FLIP and display on the page.
    pub views: Vec<ZoneView>,
}

/// A direction on the page.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneView {
    /// The direction: a grid of one view.
    pub direction: ViewGrid,
    /// Its error.
    pub score: DirectionScore,
    /// The scene's picture in this direction, `[row][col][rgb]` in the target's size.
    pub target: Vec<f32>,
    /// The display's pixel-averaged view in this direction.
    pub seen: EmittedView,
}

/// A file or folder that the run wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// Its description, for readers.
    pub label: String,
    /// Path relative to the report, with `/` between parts.
    pub path: String,
    /// The reason if nothing was written; `None` on success.
    pub failed: Option<String>,
}

/// Input of a report.
#[derive(Clone, Copy, Debug)]
pub struct ReportInput<'a> {
    /// Title, usually the scene's or the job's name.
    pub title: &'a str,
    /// The display.
    pub display: &'a Display,
    /// Its layer stack.
    pub stack: &'a LayerStack,
    /// The target light field.
    pub target: &'a LightField,
    /// Weights of the target's rays.
    pub weights: &'a Weights,
    /// Views withheld from the solver, usually at [`lumistack_display::ViewGrid::in_between`].
    /// Without them in-between views are shown as simulated only.
    pub held_out: Option<&'a LightField>,
    /// Extrapolated views, outside the target's, usually at
    /// [`lumistack_display::ViewGrid::outside`]. Without them such views are shown as simulated
    /// only.
    pub outside: Option<&'a LightField>,
    /// Quality of the display over its whole zone. `None` without reference pictures.
    pub zone: Option<&'a ZoneFigures>,
    /// Pixels of a view per degree of visual angle, for FLIP; usually
    /// [`Flip::DEFAULT_PIXELS_PER_DEGREE`](lumistack_core::metrics::Flip).
    pub pixels_per_degree: f64,
    /// The solver's history; may be empty.
    pub convergence: &'a [Iteration],
    /// The solver's summary, if a solver ran.
    pub solution: Option<&'a Solution>,
    /// Timings; may be empty.
    pub stages: &'a [Stage],
    /// The resolved job, with all defaults.
    pub settings: &'a serde_json::Value,
    /// Effect of a denoiser on the target, if one was used.
    pub denoising: Option<&'a Denoising<'a>>,
    /// Facts about the scene (name, triangles, ...), if there is one.
    pub scene: Option<&'a serde_json::Value>,
    /// Depth statistics, if a scene was rendered.
    pub depth: Option<&'a DepthBudget>,
    /// Warnings of all stages.
    pub warnings: &'a [Warning],
    /// Other files of the run.
    pub outputs: &'a [Output],
    /// The command line of the run.
    pub command: Option<&'a str>,
    /// Lumistack's version.
    pub version: &'a str,
}

/// The two files of a report.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Text of `report.html`.
    pub html: String,
    /// Content of `report.json`.
    pub json: serde_json::Value,
    /// Main figure: PSNR of pixel-averaged views over the whole zone, dB.
    pub psnr_zone: Option<f64>,
    /// The same for the worst tenth of the directions, dB.
    pub psnr_zone_worst: Option<f64>,
    /// PSNR of all target rays, L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of all target rays, L̃ against βL, dB.
    pub psnr_raw: f64,
    /// `psnr_view` of the held-out views, dB.
    pub held_out_psnr_view: Option<f64>,
    /// `psnr_view` of the views outside the zone, dB.
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
    #[error("encoding a picture: {0}")]
    Picture(#[from] image::ImageError),
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] lumistack_plot::PlotError),
    /// The display could not be written as JSON.
    #[error("writing report.json: {0}")]
    Json(#[from] serde_json::Error),
}
