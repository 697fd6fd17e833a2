//! `--plan`: prints the steps of a run, in order, and which of them are cached.

use std::path::Path;

use lumistack_pipeline::{Job, PipelineError, Plan, Registry, Step, ZoneSamples, plan};

use crate::console::say;
use crate::values::{duration_text, size_text};

/// Estimated time from which the plan suggests a small run first, seconds.
const LONG_S: f64 = 1800.0;
/// Width of the small run that the plan suggests, pixels.
const SMALL_COLS: usize = 210;
/// Paths per pixel of the small run, summed over all views.
const SMALL_ZONE_SAMPLES: u32 = 100;

/// Prints the plan of a job in a run folder, without running it.
pub(crate) fn print(job: &Job, folder: &Path, registry: &Registry, json: bool) -> Result<(), PipelineError> {
    let plan = plan(job, folder, registry)?;
    if json {
        let mut event = serde_json::to_value(&plan).expect("plans serialize");
        event["event"] = "plan".into();
        say!("{event}");
        return Ok(());
    }
    if let Some(hint) = small_first(job, folder, registry, plan_seconds(&plan)) {
        say!("{hint}");
    }
    table(&plan).into_iter().for_each(|line| say!("{line}"));
    if plan.assumes_blender {
        say!(
            "This plan assumes that Blender renders the views. If Lumistack's path tracer supports all content of the file, the path tracer renders the views instead. It renders more views, which need more time, memory and disk space; --engine lumistack plans this case"
        );
    }
    Ok(())
}

fn plan_seconds(plan: &Plan) -> f64 {
    plan.steps.iter().map(|step| step.seconds).sum()
}

/// Returns a line that suggests a small run before a long one. `None` for a short run, for a job
/// without a scene, and for a small display. Also `None` if the small run saves less than half of
/// the time.
fn small_first(job: &Job, folder: &Path, registry: &Registry, seconds: f64) -> Option<String> {
    if seconds < LONG_S || job.scene.is_none() {
        return None;
    }
    let [cols, rows] = job.resolve_display().ok()?.field.resolution;
    if cols <= SMALL_COLS {
        return None;
    }
    let mut small = job.clone();
    let resolution = [SMALL_COLS, (rows * SMALL_COLS + cols / 2) / cols];
    small.display.resolution = Some(resolution);
    small.render.zone_samples = ZoneSamples::Count(SMALL_ZONE_SAMPLES);
    small.render.samples = None;
    // a folder that does not exist has no cached results
    let small_seconds = plan_seconds(&plan(&small, &folder.join("small"), registry).ok()?);
    let [cols, rows] = resolution;
    (small_seconds < 0.5 * seconds).then(|| {
        format!(
            "this run takes about {}; first try a small run in another folder, with --resolution {cols}x{rows} --zone-samples {SMALL_ZONE_SAMPLES}, which takes about {}",
            duration_text(seconds),
            duration_text(small_seconds)
        )
    })
}

/// Returns a line per step, and a last line with the total time and the largest memory.
fn table(plan: &Plan) -> Vec<String> {
    let width = plan.steps.iter().map(|step| step.id.chars().count()).max().unwrap_or(0).max(4);
    let mut lines = vec![format!(
        "{:width$}  {:9}  {:6}  {:>8}  {:>8}  {:16}  inputs",
        "step", "stage", "cached", "time", "memory", "key"
    )];
    for step in &plan.steps {
        let Step { id, stage, inputs, key, cached, memory_bytes, seconds, .. } = step;
        let cached = match cached {
            Some(true) => "yes",
            Some(false) => "no",
            None => "unknown",
        };
        let (time, memory) = (duration_text(*seconds), size_text(*memory_bytes));
        let key = key.as_deref().unwrap_or("not yet known");
        lines.push(format!(
            "{id:width$}  {stage:9}  {cached:7} {time:>8}  {memory:>8}  {key:16}  {}",
            inputs.join(", ")
        ));
    }
    let seconds = plan_seconds(plan);
    let most = plan.steps.iter().map(|step| step.memory_bytes).max().unwrap_or(0);
    let cached = plan.steps.iter().filter(|step| step.cached == Some(true)).count();
    let (count, time) = (plan.steps.len(), duration_text(seconds));
    let (memory, disk) = (size_text(most), size_text(plan.disk_bytes));
    lines.push(format!(
        "number of steps in {}: {count}; number of cached steps: {cached}; estimated time {time}, at most {memory} of memory, about {disk} of disk space",
        plan.folder.display()
    ));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_run_is_preceded_by_a_small_one() {
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/still-life/still-life.gltf");
        let mut job = Job::new(lumistack_pipeline::DisplayJob::by_name_or_path("paper-three-layer"));
        job.scene = Some(scene);
        let (registry, folder) = (Registry::built_in().unwrap(), Path::new("nowhere"));
        let hint = |job: &Job, seconds| small_first(job, folder, &registry, seconds);
        let line = hint(&job, 1e7).unwrap();
        assert!(
            line.starts_with("this run takes about 2777.8 h;")
                && line.contains("--resolution 210x131 --zone-samples 100"),
            "{line}"
        );
        assert_eq!(hint(&job, 600.0), None, "ten minutes are short");
        job.display.resolution = Some([105, 66]);
        assert_eq!(hint(&job, 1e7), None, "the job is small");
    }
}
