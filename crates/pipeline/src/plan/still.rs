//! Steps of a still: one light field, patterns of one display, outputs and a report.

use super::steps::{PartKind, Plan, StepKind};

/// Steps of other parts that the light field of a part depends on.
#[derive(Clone, Copy, Default)]
pub(crate) struct Before<'a> {
    /// Id of the step that loaded the scene.
    pub(crate) ingested: Option<&'a str>,
    /// Id of the step that placed the window at the first time step.
    pub(crate) placed: Option<&'a str>,
    /// Id of the step that made the light field of the first time step. Exposure and geometry of
    /// this light field apply to all time steps.
    pub(crate) first: Option<&'a str>,
}

/// Adds the steps that make a part's light field. Returns the id of the last step.
pub(crate) fn add_field(plan: &mut Plan, part: usize, before: Before<'_>) -> String {
    let job = &plan.parts[part].job;
    let denoised = job.render.denoise.filters();
    let ids = |id: Option<&str>| id.map(str::to_owned).into_iter().collect::<Vec<_>>();
    if job.scene.is_none() {
        let kind = if job.light_field.is_some() { StepKind::Read } else { StepKind::Source };
        return plan.add_step(part, kind, ids(before.first));
    }
    let ingest = match before.ingested {
        Some(id) => id.to_owned(),
        None => plan.add_step(part, StepKind::Ingest, ids(before.placed)),
    };
    let mut inputs = vec![ingest];
    inputs.extend(ids(before.placed));
    let mut last = plan.add_step(part, StepKind::Place, inputs);
    last = plan.add_step(part, StepKind::Trace, vec![last]);
    if denoised {
        last = plan.add_step(part, StepKind::Denoise, vec![last]);
    }
    // The exposure of the first time step applies to all time steps, so the first light field must
    // exist before this step.
    let mut inputs = ids(before.first);
    inputs.push(last);
    plan.add_step(part, StepKind::Expose, inputs)
}

/// Adds the step that renders the scene for the zone score, which only reports use. Returns the
/// step's id; empty without a scene.
pub(crate) fn add_score(plan: &mut Plan, part: usize, field: &str) -> Vec<String> {
    if plan.parts[part].job.scene.is_none() {
        return Vec::new();
    }
    vec![plan.add_step(part, StepKind::Score, vec![field.to_owned()])]
}

/// Ids of the steps that belong to the same display at the previous time step.
pub(crate) struct TimeBefore {
    pub(crate) patterns: String,
    pub(crate) field: String,
    /// Ids of the steps that make the light fields of the warm-up time steps before a chunk. The
    /// list is empty if the solver starts from `patterns`.
    pub(crate) warm_up: Vec<String>,
}

/// Adds the steps of a display: patterns, outputs, for a time step also error and flicker, and a
/// report if `reports` is true.
///
/// If `before` has no warm-up time steps, the solver starts from `before.patterns`. Returns two
/// ids: of the step that makes the patterns, and of the last step.
pub(crate) fn add_display(
    plan: &mut Plan,
    part: usize,
    field: &str,
    score: &[String],
    before: Option<TimeBefore>,
    reports: bool,
) -> [String; 2] {
    // The patterns depend on the light field and a warm start.
    let field = field.to_owned();
    let mut inputs = vec![field.clone()];
    if let Some(before) = &before {
        match before.warm_up.as_slice() {
            [] => inputs.push(before.patterns.clone()),
            fields => inputs.extend_from_slice(fields),
        }
    }
    let patterns = plan.add_step(part, StepKind::Patterns, inputs);
    let mut last = vec![patterns.clone(), field.clone()];
    // Outputs of the light field belong to the graph, not to its nodes.
    let is_node = matches!(plan.parts[part].kind, PartKind::Node(_));
    let outputs = plan.parts[part].job.outputs.clone();
    for (number, _) in outputs.iter().enumerate().filter(|(_, output)| !output.takes_light_field()) {
        last.push(plan.add_step(part, StepKind::StackOutput(number), vec![patterns.clone(), field.clone()]));
    }
    if !is_node {
        last.extend(add_field_outputs(plan, part, &field));
    }
    // Flicker compares each time step with the previous one.
    if plan.time(part).is_some() {
        let mut inputs = vec![patterns.clone(), field.clone()];
        inputs.extend(before.into_iter().flat_map(|before| [before.patterns, before.field]));
        last.push(plan.add_step(part, StepKind::Measure, inputs));
    }
    if reports {
        last.extend_from_slice(score);
        last = vec![plan.add_step(part, StepKind::Report, last)];
    }
    let end = last.pop().unwrap_or_else(|| patterns.clone());
    [patterns, end]
}

/// Adds the steps that write the outputs of a part's light field. Returns their ids.
pub(crate) fn add_field_outputs(plan: &mut Plan, part: usize, field: &str) -> Vec<String> {
    let outputs = plan.parts[part].job.outputs.clone();
    let of_field = outputs.iter().enumerate().filter(|(_, output)| output.takes_light_field());
    of_field.map(|(number, _)| plan.add_step(part, StepKind::FieldOutput(number), vec![field.to_owned()])).collect()
}
