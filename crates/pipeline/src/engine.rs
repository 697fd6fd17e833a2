//! Converts a `.blend` file before the plan of a run is made, and chooses our path tracer if the
//! conversion loses nothing.
//!
//! Settings with the value `auto` depend on the engine. Blender takes minutes per view, so a
//! display chooses few views if Blender may render them, and light is not shared between views.
//! If the conversion loses nothing, the plan gets the settings for our path tracer.

use std::path::Path;

use lumistack_core::Task;
use lumistack_usd::BlendContents;

use crate::error::PipelineError;
use crate::job::{Engine, Job};
use crate::reader::is_blend;
use crate::store::handover;

/// If the job's engine is `auto`, converts its `.blend` file. If the conversion loses nothing,
/// returns the job with the engine `lumistack`. In all other cases returns the job as it is.
/// `cache_dir` is the folder in which the run caches the conversion.
///
/// # Errors
/// If the job is wrong, or Blender does not convert the file.
pub(crate) fn settled(job: &Job, cache_dir: Option<&Path>, task: Task<'_>) -> Result<Job, PipelineError> {
    let Some(scene) = undecided(job) else { return Ok(job.clone()) };
    job.check()?;
    task.progress.begin("read scene", 1, "scene");
    let handed = handover::hand_over(scene, job.pose.time_s, cache_dir, task);
    task.progress.end();
    Ok(with_engine(job, &handed?.account.contents))
}

/// Acts as [`settled`] if the conversion is cached. Otherwise returns the job as it is.
pub(crate) fn settled_by_cache(job: &Job, cache_dir: &Path) -> Job {
    let known = undecided(job).and_then(|scene| handover::known(scene, job.pose.time_s, cache_dir));
    known.map_or_else(|| job.clone(), |contents| with_engine(job, &contents))
}

/// Returns true if the content of the job's scene decides on the engine, and `cache_dir` has no
/// valid conversion of the scene.
pub(crate) fn is_open(job: &Job, cache_dir: &Path) -> bool {
    undecided(job).is_some_and(|scene| handover::known(scene, job.pose.time_s, cache_dir).is_none())
}

/// Returns the scene of the job if its content decides on the engine: a `.blend` file with the
/// engine `auto`.
fn undecided(job: &Job) -> Option<&Path> {
    job.scene.as_deref().filter(|scene| is_blend(scene) && job.render.engine == Engine::Auto)
}

fn with_engine(job: &Job, contents: &BlendContents) -> Job {
    let mut job = job.clone();
    if contents.lost.is_empty() {
        job.render.engine = Engine::Lumistack;
    }
    job
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::{Denoise, DisplayJob};

    /// If the conversion of a `.blend` file loses nothing, the file gets the views and the denoiser
    /// of the same scene in a glTF file.
    #[test]
    fn a_file_that_our_path_tracer_shows_gets_its_settings() {
        let job = |scene: &str| Job {
            scene: Some(scene.into()),
            ..Job::new(DisplayJob::by_name_or_path("paper-three-layer"))
        };
        let settings = |job: &Job| {
            let display = job.resolve_display().unwrap();
            (display.views(), job.denoise_for(&display))
        };
        let of_gltf = settings(&job("shot.glb"));
        let blend = job("shot.blend");
        assert!(settings(&blend).0 < of_gltf.0 && settings(&blend).1 == Denoise::Off, "Blender may render");
        let whole = BlendContents::default();
        assert_eq!(settings(&with_engine(&blend, &whole)), of_gltf);
        let hairy = BlendContents { lost: vec!["hair".into()], ..whole.clone() };
        assert_eq!(settings(&with_engine(&blend, &hairy)), settings(&blend));
        // an engine that the job names is not changed
        let mut named = blend.clone();
        named.render.engine = Engine::Blender;
        assert!(undecided(&named).is_none() && undecided(&job("shot.glb")).is_none() && undecided(&blend).is_some());
    }
}
