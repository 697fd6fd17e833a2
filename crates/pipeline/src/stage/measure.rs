//! Error and flicker of a time step, cached between runs.

use std::path::Path;

use lumistack_core::Task;
use lumistack_core::metrics::SquaredError;
use lumistack_display::{Display, Weights};
use serde::{Deserialize, Serialize};

use super::factorize::add_stack;
use super::field::add_weights;
use super::flicker::{self, Shown, TimeError};
use crate::error::PipelineError;
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::key::KeyBuilder;
use crate::store::stamps::Stamps;

/// Sums of squared errors, and numbers of summed values, in the form of their JSON file.
#[derive(Serialize, Deserialize)]
struct CachedSums {
    error: (f64, u64),
    change: (f64, u64),
    still: (f64, u64),
}

/// Returns the errors of a time step, their key, and true if they were cached.
///
/// # Errors
/// If the file cannot be written, or the task is cancelled.
pub(crate) fn run(
    display: &Display,
    weights: &Weights,
    now: Shown<'_>,
    before: Option<Shown<'_>>,
    stamps: &Stamps,
    task: Task<'_>,
) -> Result<(TimeError, String, bool), PipelineError> {
    // Errors depend on the display, the weights, and the patterns and targets of both time steps.
    let mut key = KeyBuilder::new("measure", code::FIELDS);
    key.add("display", display.without_panels().to_toml().as_bytes());
    add_weights(&mut key, weights);
    for shown in before.into_iter().chain([now]) {
        key.add_field("target", shown.target);
        add_stack(&mut key, shown.stack);
    }
    let (key, file) = (key.finish(), Path::new("cache/measure-figures.json"));
    let path = stamps.dir().join(file);
    // The file has sums instead of scores in dB, since a sequence adds the sums of its time steps.
    let kept = || {
        let CachedSums { error, change, still } = read_json(&path)?;
        let [error, change, still] = [error, change, still].map(|(sum, count)| SquaredError { sum, count });
        Some(TimeError { error, change, still })
    };
    let make = || {
        let found = flicker::measure(display, now, before, weights, task)?;
        let pair = |error: SquaredError| (error.sum, error.count);
        write_json(
            &path,
            &CachedSums { error: pair(found.error), change: pair(found.change), still: pair(found.still) },
        )?;
        Ok((found, vec![file.to_owned()]))
    };
    let (found, cached) = stamps.reuse_or_make("measure", &key, kept, make)?;
    Ok((found, key, cached))
}
