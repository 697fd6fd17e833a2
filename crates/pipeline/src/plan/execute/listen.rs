//! Listeners of a step: its warnings are kept for the report, and its progress tells the time of a sequence.

use lumistack_core::{Collector, Progress, Warning, Warnings};

/// Keeps warnings for the report and passes them on.
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

/// Says which time a stage belongs to.
pub(super) struct PlaceProgress<'a> {
    pub(super) next: &'a dyn Progress,
    pub(super) place: Option<String>,
}

impl Progress for PlaceProgress<'_> {
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
