//! The step that measures error and flicker of a time step.

use std::path::Path;

use lumistack_core::Task;
use lumistack_core::metrics::SquaredError;
use lumistack_report::SequenceTime;

use super::context::Context;
use crate::error::PipelineError;
use crate::plan::steps::PartKind;
use crate::plan::times::name;
use crate::stage::flicker::Shown;
use crate::stage::measure;
use crate::stage::report::thumbnails;

impl Context<'_> {
    pub(super) fn measure(&mut self, part: usize, task: Task<'_>) -> Result<bool, PipelineError> {
        let plan = self.plan;
        let (field, patterns) = (self.field(part)?, self.of(part, "patterns", |state| state.patterns.clone())?);
        let Some((time, sequence)) = plan.time(part) else { return Ok(true) };
        // Flicker compares the patterns and the target of this time step with the patterns and the
        // target of the previous time step.
        let before = time.checked_sub(1).and_then(|time| plan.at_time(part, time));
        let before = match before {
            None => None,
            Some(before) => {
                let patterns = self.of(before, "patterns", |state| state.patterns.clone())?;
                Some((self.field(before)?, patterns))
            }
        };
        let now = Shown { stack: &patterns.solved.stack, target: &field.target };
        let then = before.as_ref().map(|(field, before)| Shown { stack: &before.solved.stack, target: &field.target });
        let stamps = self.stamps(part);
        let (found, key, cached) = measure::run(&patterns.display, &patterns.weights, now, then, &stamps, task)?;
        // Make the entry in the sequence's report.
        let reports = matches!(&plan.parts[sequence].kind, PartKind::Sequence(times) if times.sequence.reports);
        let compared = |error: SquaredError| (error.count > 0).then_some(error);
        let (steps, solution) = (&patterns.solved.steps, &patterns.solved.solution);
        let [wanted, shown] = thumbnails(&patterns.display, &field, &patterns.solved);
        let place = plan.parts[part].folder.strip_prefix(&plan.parts[sequence].folder);
        let place = place.unwrap_or(Path::new("")).to_string_lossy().into_owned();
        let entry = SequenceTime {
            name: name(time),
            source: self.source_of(part, time),
            report: reports.then(|| format!("{place}/report.html")),
            error: found.error,
            change: compared(found.change),
            still: compared(found.still),
            start: solution.as_ref().map_or_else(String::new, |solution| solution.start.clone()),
            psnr_start: steps.first().map_or(f64::NAN, |step| step.psnr_view),
            iterations: steps.last().map_or(0, |step| step.iteration),
            seconds: steps.last().map_or(f64::NAN, |step| step.seconds),
            cached: patterns.cached,
            wanted,
            shown,
        };
        let state = &mut self.states[part];
        (state.entry, state.measured) = (Some(entry), Some((found, key)));
        Ok(cached)
    }
}
