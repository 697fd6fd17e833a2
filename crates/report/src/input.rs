//! Inputs and results of a report.

use lumistack_core::{Cancelled, Warning};
use lumistack_display::{
    DirectionScore, Display, EmittedView, LayerStack, LightField, StackError, ViewGrid, WeightError, Weights, ZoneScore,
};
use thiserror::Error;

use crate::depth::DepthBudget;

/// One iteration of the solver, as the pipeline recorded it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Full updates done so far.
    pub iteration: u32,
    /// Σ w (βL − L̃)² (eq. 27).
    pub objective: f64,
    /// PSNR of L̃/β against L, dB.
    pub psnr_view: f64,
    /// Seconds since the solver started.
    pub seconds: f64,
}

/// How the solver came to the patterns.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Name of the solver that was used.
    pub solver: String,
    /// How the patterns started.
    pub start: String,
    /// Levels of half the resolution at which it began.
    pub coarse_levels: u32,
    /// How far the patterns are from the first-order (KKT) conditions: root mean square change of
    /// the emission that one more exact coordinate step of a value would make.
    pub unsettled: f64,
    /// `psnr_view` (dB) of three kinds of patterns, where layers have few bits: continuous, rounded
    /// to the panels' levels, and re-optimized on the levels. The last is the result.
    pub levels: Option<[f64; 3]>,
}

/// One stage of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name for people: "render", "factorize".
    pub name: String,
    /// Wall time in this run, seconds.
    pub seconds: f64,
    /// True if its result came from an earlier run.
    pub cached: bool,
}

/// The effect of a denoiser on one view or on all, in exposed radiance, all channels together.
/// Pairs are a value and its standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DenoisedView {
    /// Mean of the unbiased picture.
    pub mean: f64,
    /// Mean of the filtered picture minus that.
    pub mean_change: [f64; 2],
    /// Mean squared error of the unbiased picture.
    pub mse_before: [f64; 2],
    /// Mean squared error of the filtered one.
    pub mse_after: [f64; 2],
}

/// The effect of a denoiser on the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Denoising<'a> {
    /// Its name, for people.
    pub name: &'a str,
    /// Over all views.
    pub overall: DenoisedView,
    /// Per view, in the order of the target's grid.
    pub views: Vec<DenoisedView>,
    /// The middle view as rendered, `[row][col][rgb]`, of the target's size, as displayed.
    pub unbiased: &'a [f32],
    /// The middle view filtered, likewise.
    pub filtered: &'a [f32],
}

/// How right the display is all over its zone.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneFigures {
    /// Errors of the seen pictures, direction by direction.
    pub score: ZoneScore,
    /// True if they are held-out views of a given light field rather than renders.
    pub left_out: bool,
    /// Directions whose references have enough samples for SSIM and FLIP, and to be looked at.
    pub views: Vec<ZoneView>,
}

/// A direction to look at.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneView {
    /// From where: a grid of one view.
    pub direction: ViewGrid,
    /// Its error.
    pub score: DirectionScore,
    /// The scene's picture from there, `[row][col][rgb]` of the target's size.
    pub target: Vec<f32>,
    /// The seen picture that the display shows there.
    pub seen: EmittedView,
}

/// A file or folder that the run wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// Its name, for people.
    pub label: String,
    /// Path relative to the report, with `/` between parts.
    pub path: String,
    /// Why nothing was written; `None` where it was.
    pub failed: Option<String>,
}

/// Everything that a report shows.
#[derive(Clone, Copy, Debug)]
pub struct ReportInput<'a> {
    /// Headline, usually the scene's or the job's name.
    pub title: &'a str,
    /// The display.
    pub display: &'a Display,
    /// Its patterns.
    pub stack: &'a LayerStack,
    /// The light field that the display should show.
    pub target: &'a LightField,
    /// Weights of the target's rays.
    pub weights: &'a Weights,
    /// Views that the solver did not see, usually at [`lumistack_display::ViewGrid::in_between`].
    /// Without them in-between views are shown as simulated only.
    pub held_out: Option<&'a LightField>,
    /// Views outside the target's, usually at [`lumistack_display::ViewGrid::outside`]. Without
    /// them such views are shown as simulated only.
    pub outside: Option<&'a LightField>,
    /// How right the display is all over its zone. `None` where the scene's pictures from there are
    /// not known.
    pub zone: Option<&'a ZoneFigures>,
    /// Pixels of a view per degree of visual angle, for FLIP; usually
    /// [`Flip::DEFAULT_PIXELS_PER_DEGREE`](lumistack_core::metrics::Flip).
    pub pixels_per_degree: f64,
    /// The solver's history; may be empty.
    pub convergence: &'a [Iteration],
    /// The solver's own figures, where a solver ran.
    pub solution: Option<&'a Solution>,
    /// Timings; may be empty.
    pub stages: &'a [Stage],
    /// The resolved job, every default written out.
    pub settings: &'a serde_json::Value,
    /// The effect of a denoiser on the target, where one was used.
    pub denoising: Option<&'a Denoising<'a>>,
    /// Facts about the scene (name, triangles, ...), where there is one.
    pub scene: Option<&'a serde_json::Value>,
    /// Demands of the scene's depth on the display, where a scene was rendered.
    pub depth: Option<&'a DepthBudget>,
    /// Warnings of all stages.
    pub warnings: &'a [Warning],
    /// Other outputs of the run.
    pub outputs: &'a [Output],
    /// The command line that made the run.
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
    /// Headline: PSNR of seen pictures all over the zone, dB.
    pub psnr_zone: Option<f64>,
    /// The same of the worst tenth of the directions, dB.
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

/// A report that cannot be made.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The patterns are not the display's.
    #[error("layer stack: {0}")]
    Stack(#[from] StackError),
    /// The weights are not the target's.
    #[error(transparent)]
    Weights(#[from] WeightError),
    /// The work was stopped.
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
