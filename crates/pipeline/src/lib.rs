//! The pipeline from a job file to its outputs.
//!
//! ```text
//! job.toml ─▶ ingest ─▶ render ─▶ target/ ─▶ factorize ─▶ layers/ ─▶ output plugins
//!                        (or a light field of another renderer)      ─▶ outputs/ ─▶ report
//! ```
//!
//! In this diagram, names that end with a slash are folders of a run. The other names, except
//! `job.toml`, are stages: `render` stands for the stages place, trace, denoise and expose, and
//! `output plugins` for the stage output. The module `stage` has the code of the stages. The module
//! `plan` lists the stages of a job as steps. The module `store` manages the run folder in which
//! the steps work.
//!
//! * A job with `[[nodes]]` solves several displays for one light field. The folder `nodes/ID/` has
//!   the patterns and the report of one display.
//! * A sequence has the stages above for each time step. The solver starts a time step from the
//!   patterns of the previous time step, unless a fresh start is better.
//! * A sweep solves many designs, for the light fields of a still or of a sequence.
//!
//! ```
//! use lumistack_core::{Cancel, Collector, Task};
//! use lumistack_pipeline::{Job, Registry, run};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("job.toml");
//! // a job that renders a scene has `scene = "model.glb"` in place of `[source]`
//! std::fs::write(
//!     &path,
//!     r#"
//!     [source]
//!     plugin = "test_views"
//!     [display]
//!     preset = "paper-three-layer"
//!     resolution = [24, 15]
//!     views = [3, 3]
//!     frames = 2
//!     [factorize]
//!     iterations = 4
//!     [[outputs]]
//!     plugin = "images"
//!     "#,
//! )?;
//! let (warnings, cancel) = (Collector::default(), Cancel::default());
//! let task = Task::quiet(&warnings, &cancel);
//! let run_dir = folder.path().join("run");
//! let summary = run(&Job::load(&path)?, &run_dir, &Registry::built_in()?, None, task)?;
//! for warning in warnings.take() {
//!     eprintln!("warning: {warning}");
//! }
//! assert!(summary.report.is_file() && run_dir.join("outputs/tensor-display/images").is_dir());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bare;
mod compare;
mod engine;
mod error;
mod farm;
mod inspect;
mod job;
mod live;
mod plan;
mod predict;
pub mod presets;
mod reader;
mod refused;
mod render_views;
mod run;
pub mod schema;
mod simulate;
mod stage;
mod steps;
mod store;
mod view_options;

pub use bare::lacking;
pub use compare::{
    DisplayLikeness, DisplaysComparison, Likeness, PhotoComparison, Pose, RunComparison, ZoneLikeness,
    compare_displays, compare_photo, compare_runs, refocused,
};
pub use error::{BadValue, FailedOutput, PipelineError, Place};
pub use farm::{FarmPlan, UnitDone, code, farm_plan, farm_unit};
pub use inspect::{describe_light_field, plugin_list, plugin_text, plugins};
pub use job::{
    AngularFilter, Background, Denoise, DisplayJob, Engine, EyeJob, FactorizeJob, FitDepth, ImporterJob, Job, LightJob,
    Near, NodeJob, OutputJob, PoseJob, RenderJob, ReportJob, SearchJob, SequenceJob, SourceJob, SweepJob, Tone,
    WindowFrom, WindowJob, ZoneSamples,
};
pub use live::{LiveFields, LiveFolder, LiveSolver};
#[cfg(feature = "gpu")]
pub use lumistack_factorizer_gpu::{Adapter as GpuAdapter, adapters as gpu_adapters};
#[cfg(feature = "dynamic")]
pub use lumistack_plugin_host::{Launcher, plugin_child};
pub use lumistack_plugin_host::{OutputData, PresentContext, PresenterInput, PresenterOutput, Registry, present};
pub use lumistack_shot::automatic_tone_mapping;
pub use plan::estimate::needs_of;
pub use plan::steps::{Plan, Step};
pub use plan::sweep::SweepSummary;
pub use plan::units::BlockSize;
pub use predict::{Prediction, predict, predict_on};
pub use reader::{is_blend, is_usd};
pub use refused::{RefusedOutput, refused_outputs};
pub use render_views::render_views;
pub use run::{NodeSummary, SequenceSummary, Summary, plan, run, run_step, sweep};
pub use simulate::{RunFolder, Viewpoint, picture_from, simulate_to_file, update_preview};
pub use stage::denoise::oidn_version;
pub use stage::ingest::{Ingested, SceneContents, ingest_scene, load_scene, scene_contents};
pub use stage::place::place_window;
pub use stage::score::{ReferencePictures, References, keep_missing};
pub use steps::{
    RenderedField, ReportOn, WeightsFrom, expose_field, factorize_field, open_field, render_field, weights_of,
    write_output, write_report_on,
};
pub use store::clean::{Cleaned, Freed, clean};
pub use store::settings::with_new_seal;
pub use view_options::{ExtraChannel, ViewOptions, ViewSelection};

/// Sets the number of worker threads of the program. Results do not depend on this number. Call
/// this function before any other work.
///
/// # Errors
/// If work has already started.
pub fn set_threads(count: usize) -> Result<(), String> {
    rayon::ThreadPoolBuilder::new().num_threads(count).build_global().map_err(|error| error.to_string())
}
