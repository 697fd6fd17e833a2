//! Listeners of a step. One collects the step's warnings for the report, the other adds the number
//! of the time step to the shown progress.

use lumistack_core::{Collector, Progress, Warning, Warnings};

/// Collects warnings for the report, and also forwards them.
pub(super) struct Tee<'a> {
    pub(super) list: Collector,
    next: &'a dyn Warnings,
}

impl<'a> Tee<'a> {
    pub(super) fn new(next: &'a dyn Warnings) -> Self {
        Self { list: Collector::default(), next }
    }
}

impl Warnings for Tee<'_> {
    fn warn(&self, warning: Warning) {
        self.list.warn(warning.clone());
        self.next.warn(warning);
    }
}

/// Adds the number of the time step to the name of the stage.
pub(super) struct TimeStepProgress<'a> {
    pub(super) next: &'a dyn Progress,
    pub(super) place: Option<String>,
}

impl Progress for TimeStepProgress<'_> {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        match &self.place {
            Some(place) => self.next.begin(&format!("{stage} {place}"), total, unit),
            None => self.next.begin(stage, total, unit),
        }
    }

    fn advance(&self, steps: u64, note: &str) {
        self.next.advance(steps, note);
    }

    fn end(&self) {
        self.next.end();
    }
}
