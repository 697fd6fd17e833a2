//! From a job file to its outputs.
//!
//! ```text
//! job.toml ─▶ ingest ─▶ render ─▶ target/ ─▶ factorize ─▶ layers/ ─▶ output plugins ─▶ outputs/ ─▶ report
//!                        (or a light field that somebody else rendered)
//! ```
//!
//! A job with `[[nodes]]` feeds several displays from one light field; each has its patterns and its report in `nodes/ID/`.
//!
//! A sequence goes this way once for every time, each factorized from the patterns of the time before.

mod blender;
mod cache;
mod clean;
mod code;
mod compare;
mod denoise;
mod depth;
mod error;
mod file_params;
mod files;
mod fit;
mod flicker;
mod folder;
mod given;
mod graph;
mod ingest;
mod inspect;
mod job;
mod light;
mod look;
mod oidn;
mod path_text;
pub mod presets;
mod render;
mod run;
mod sealed;
mod sequence;
mod side;
mod simulate;
mod steps;
mod surround;
mod sweep;
mod views;
mod zone;

pub use clean::{Cleaned, Freed, clean};
pub use compare::{
    DisplayLikeness, DisplaysComparison, Likeness, PhotoComparison, Pose, RunComparison, compare_displays,
    compare_photo, compare_runs, refocused,
};
pub use depth::{Outlook, outlook, outlook_on};
pub use error::{FailedOutput, PipelineError};
pub use folder::resealed;
pub use graph::NodeSummary;
pub use ingest::{Ingested, SceneContents, is_blend, is_usd, load_scene, place_window, scene_contents, take_scene};
pub use inspect::{describe_light_field, plugin_list, plugin_text, plugins};
pub use job::{
    AngularFilter, Background, Denoise, DisplayJob, Engine, EyeJob, FactorizeJob, FitDepth, ImporterJob, Job, LightJob,
    Near, NodeJob, OutputJob, PoseJob, RenderJob, ReportJob, SearchJob, SequenceJob, SourceJob, SweepJob, Tone,
    WindowFrom, WindowJob,
};
pub use look::automatic_look;
#[cfg(feature = "dynamic")]
pub use lumistack_plugin_host::{Launcher, plugin_child};
pub use lumistack_plugin_host::{OutputData, Registry};
pub use run::{RefusedOutput, Summary, refused_outputs, render_only, run};
pub use sequence::SequenceSummary;
pub use simulate::{RunFolder, Viewpoint, picture_from, simulate_to_file, update_preview};
pub use steps::{
    ReportOn, Traced, WeightsFrom, expose_field, factorize_field, open_field, render_field, weights_of, write_output,
    write_report_on,
};
pub use sweep::{SweepSummary, sweep};
pub use views::{ViewLayer, ViewOptions, ViewPick};

/// Sets the number of worker threads of the whole program; results do not depend on it. Call it before any work.
///
/// # Errors
/// When work has already started.
pub fn set_threads(count: usize) -> Result<(), String> {
    rayon::ThreadPoolBuilder::new().num_threads(count).build_global().map_err(|error| error.to_string())
}
