//! From a job file to its outputs.
//!
//! ```text
//! job.toml ─▶ ingest ─▶ render ─▶ target/ ─▶ factorize ─▶ layers/ ─▶ output plugins ─▶ outputs/ ─▶ report
//!                        (or a light field that somebody else rendered)
//! ```
//!
//! Every arrow is a stage (`stage/`), and what a job asks for is a plan of them (`plan/`) in a run folder (`store/`).
//!
//! A job with `[[nodes]]` feeds several displays from one light field; each has its patterns and its report in `nodes/ID/`. A sequence goes this way once for
//! every time, each display factorized from its patterns of the time before. A sweep solves many designs on the light fields of a job, whatever that is.

mod compare;
mod error;
mod farm;
mod inspect;
mod job;
mod live;
mod only_views;
mod outlook;
mod plan;
pub mod presets;
mod reader;
mod refused;
mod run;
pub mod schema;
mod simulate;
mod stage;
mod steps;
mod store;
mod view_options;

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
pub use live::{LiveFolder, LiveSolver, Studio};
#[cfg(feature = "gpu")]
pub use lumistack_factorizer_gpu::{Adapter as GpuAdapter, adapters as gpu_adapters};
pub use lumistack_plugin_host::{Asked, OutputData, PresentContext, Registry, Told, present};
#[cfg(feature = "dynamic")]
pub use lumistack_plugin_host::{Launcher, plugin_child};
pub use lumistack_shot::automatic_look;
pub use only_views::render_only;
pub use outlook::{Outlook, outlook, outlook_on};
pub use plan::steps::{Plan, Step};
pub use plan::sweep::SweepSummary;
pub use plan::units::Cut;
pub use reader::{is_blend, is_usd};
pub use refused::{RefusedOutput, refused_outputs};
pub use run::{NodeSummary, SequenceSummary, Summary, plan, run, run_step, sweep};
pub use simulate::{RunFolder, Viewpoint, picture_from, simulate_to_file, update_preview};
pub use stage::denoise::oidn_version;
pub use stage::ingest::{Ingested, SceneContents, load_scene, scene_contents, take_scene};
pub use stage::place::place_window;
pub use stage::score::References;
pub use steps::{
    ReportOn, Traced, WeightsFrom, expose_field, factorize_field, open_field, render_field, weights_of, write_output,
    write_report_on,
};
pub use store::clean::{Cleaned, Freed, clean};
pub use store::settings::resealed;
pub use view_options::{ViewLayer, ViewOptions, ViewPick};

/// Sets the number of worker threads of the whole program; results do not depend on it. Call it before any work.
///
/// # Errors
/// When work has already started.
pub fn set_threads(count: usize) -> Result<(), String> {
    rayon::ThreadPoolBuilder::new().num_threads(count).build_global().map_err(|error| error.to_string())
}
