//! A still: one light field, the patterns of one display, its outputs and its report.

use super::steps::{Kind, Plan, What};

/// Adds the steps to a part's light field; gives the last one's id. `first` are steps that must come before the first of them, `ingested` one that has loaded the
/// scene already.
pub(crate) fn add_field(plan: &mut Plan, part: usize, first: Vec<String>, ingested: Option<&str>) -> String {
    let job = &plan.parts[part].job;
    let denoised = job.render.denoise.filters();
    if job.scene.is_none() {
        let what = if job.light_field.is_some() { What::Read } else { What::Source };
        return plan.add_step(part, what, first);
    }
    let ingest = match ingested {
        Some(id) => id.to_owned(),
        None => plan.add_step(part, What::Ingest, first.clone()),
    };
    let mut inputs = vec![ingest];
    inputs.extend(first);
    let mut last = plan.add_step(part, What::Place, inputs);
    last = plan.add_step(part, What::Trace, vec![last]);
    if denoised {
        last = plan.add_step(part, What::Denoise, vec![last]);
    }
    plan.add_step(part, What::Expose, vec![last])
}

/// Adds the step to the scene's pictures all over the zone, which reports alone look at.
pub(crate) fn add_score(plan: &mut Plan, part: usize, field: &str) -> Vec<String> {
    if plan.parts[part].job.scene.is_none() {
        return Vec::new();
    }
    vec![plan.add_step(part, What::Score, vec![field.to_owned()])]
}

/// Adds the steps from the light field to the outputs of a display, with a report or without; gives the ids of patterns and report. Patterns may start from those
/// of `before`.
pub(crate) fn add_display(
    plan: &mut Plan,
    part: usize,
    field: &str,
    score: &[String],
    before: Option<[String; 2]>,
    reports: bool,
) -> [String; 2] {
    let field = field.to_owned();
    let mut inputs = vec![field.clone()];
    inputs.extend(before.iter().map(|[patterns, _]| patterns.clone()));
    let patterns = plan.add_step(part, What::Patterns, inputs);
    let mut last = vec![patterns.clone(), field.clone()];
    let is_node = matches!(plan.parts[part].kind, Kind::Node(_));
    let outputs = plan.parts[part].job.outputs.clone();
    for (number, _) in outputs.iter().enumerate().filter(|(_, output)| !output.takes_light_field()) {
        last.push(plan.add_step(part, What::StackOutput(number), vec![patterns.clone(), field.clone()]));
    }
    if !is_node {
        last.extend(add_field_outputs(plan, part, &field));
    }
    if plan.time(part).is_some() {
        let mut inputs = vec![patterns.clone(), field.clone()];
        inputs.extend(before.into_iter().flatten());
        last.push(plan.add_step(part, What::Measure, inputs));
    }
    if reports {
        last.extend_from_slice(score);
        last = vec![plan.add_step(part, What::Report, last)];
    }
    let end = last.pop().unwrap_or_else(|| patterns.clone());
    [patterns, end]
}

/// Adds the outputs of a part's light field.
pub(crate) fn add_field_outputs(plan: &mut Plan, part: usize, field: &str) -> Vec<String> {
    let outputs = plan.parts[part].job.outputs.clone();
    let of_field = outputs.iter().enumerate().filter(|(_, output)| output.takes_light_field());
    of_field.map(|(number, _)| plan.add_step(part, What::FieldOutput(number), vec![field.to_owned()])).collect()
}
