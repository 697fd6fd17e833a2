//! From a job file to its outputs.
//!
//! ```text
//! job.toml ─▶ ingest ─▶ render ─▶ target/ ─▶ factorize ─▶ layers/ ─▶ output plugins ─▶ outputs/ ─▶ report
//!                        (or a light field that somebody else rendered)
//! ```
//!
//! A sequence goes this way once for every time, each factorized from the patterns of the time before.

mod cache;
mod error;
mod flicker;
mod ingest;
mod inspect;
mod job;
mod light;
pub mod presets;
mod render;
mod run;
mod sequence;
mod simulate;

pub use cache::{KeyBuilder, Stamps};
pub use error::PipelineError;
pub use ingest::{Ingested, load_scene, place_window};
pub use inspect::{describe_light_field, plugin_list, plugin_text};
pub use job::{
    AngularFilter, DisplayJob, FactorizeJob, Job, LightJob, OutputJob, RenderJob, ReportJob, SequenceJob, WindowFrom,
    WindowJob,
};
pub use run::{Summary, render_only, run};
pub use sequence::SequenceSummary;
pub use simulate::{RunFolder, Viewpoint, simulate_to_file};

/// Sets the number of worker threads of the whole program; results do not depend on it. Call it before any work.
///
/// # Errors
/// When work has already started.
pub fn set_threads(count: usize) -> Result<(), String> {
    rayon::ThreadPoolBuilder::new().num_threads(count).build_global().map_err(|error| error.to_string())
}
