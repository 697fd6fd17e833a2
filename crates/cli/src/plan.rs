//! `--plan`: prints the steps of a run, in order, and which of them are cached.

use std::path::Path;

use lumistack_pipeline::{Job, PipelineError, Plan, Registry, Step, plan};

use crate::console::say;
use crate::values::{duration_text, size_text};

/// Prints the plan of a job in a run folder, without running it.
pub(crate) fn print(job: &Job, folder: &Path, registry: &Registry, json: bool) -> Result<(), PipelineError> {
    let plan = plan(job, folder, registry)?;
    if json {
        let mut event = serde_json::to_value(&plan).expect("plans serialize");
        event["event"] = "plan".into();
        say!("{event}");
        return Ok(());
    }
    table(&plan).into_iter().for_each(|line| say!("{line}"));
    Ok(())
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
    let seconds: f64 = plan.steps.iter().map(|step| step.seconds).sum();
    let most = plan.steps.iter().map(|step| step.memory_bytes).max().unwrap_or(0);
    let cached = plan.steps.iter().filter(|step| step.cached == Some(true)).count();
    let (count, time, memory) = (plan.steps.len(), duration_text(seconds), size_text(most));
    lines.push(format!(
        "{count} steps in {}, {cached} of them cached; estimated {time}, at most {memory} of memory",
        plan.folder.display()
    ));
    lines
}
