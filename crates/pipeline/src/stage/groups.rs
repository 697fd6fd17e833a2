//! Work on several views at the same time.
//!
//! Many threads trace a view together, but a single thread reads, hashes or writes the view's file.
//! On a machine with 16 cores, views that were handled one by one kept 5.5 cores busy (625 views of
//! 840 × 525 pixels). So the views of a group are handled at the same time. The size of the group
//! bounds the memory.

use lumistack_core::{Collector, Task};
use rayon::prelude::*;

use crate::error::PipelineError;

/// Largest number of views that are handled at the same time. More views take more memory, and
/// hardly less time.
const MOST: usize = 8;

/// Returns the number of views that are handled at the same time.
pub(crate) fn views_at_once() -> usize {
    rayon::current_num_threads().min(MOST)
}

/// Calls `one(index, element, task)` for every element; the calls for the elements of a group run
/// at the same time. After each group, passes the results of the group to `then`, in the order of
/// the elements. Warnings also keep this order.
///
/// # Errors
/// The first error of `one` or `then`, in the order of the elements. Later groups are then not
/// handled.
pub(crate) fn in_groups<T: Sync, R: Send>(
    all: &[T],
    task: Task<'_>,
    one: impl Fn(usize, &T, Task<'_>) -> Result<R, PipelineError> + Sync,
    mut then: impl FnMut(R) -> Result<(), PipelineError>,
) -> Result<(), PipelineError> {
    let size = views_at_once();
    for (group, elements) in all.chunks(size).enumerate() {
        let results = elements.par_iter().enumerate().map(|(index, element)| {
            let warnings = Collector::default();
            let result = one(group * size + index, element, Task { warnings: &warnings, ..task });
            (result, warnings.take())
        });
        for (result, warnings) in results.collect::<Vec<_>>() {
            warnings.into_iter().for_each(|warning| task.warnings.warn(warning));
            then(result?)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use lumistack_core::Cancel;

    use super::*;

    #[test]
    fn results_and_warnings_keep_the_order() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let all: Vec<usize> = (0..5 * views_at_once() + 1).collect();
        let mut squares = Vec::new();
        let one = |index: usize, &element: &usize, task: Task<'_>| {
            // The elements of a group finish out of order.
            std::thread::sleep(std::time::Duration::from_millis(3 * (all.len() - index) as u64 % 7));
            assert_eq!(index, element);
            task.warn(index.to_string(), "odd");
            Ok(element * element)
        };
        in_groups(&all, task, one, |square| {
            squares.push(square);
            Ok(())
        })
        .unwrap();
        assert_eq!(squares, all.iter().map(|element| element * element).collect::<Vec<_>>());
        let places: Vec<String> = warnings.take().into_iter().map(|warning| warning.place).collect();
        assert_eq!(places, all.iter().map(ToString::to_string).collect::<Vec<_>>());
    }

    #[test]
    fn the_first_error_ends_the_work_after_its_group() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let all: Vec<usize> = (0..100 * views_at_once()).collect();
        let (begun, mut passed) = (AtomicUsize::new(0), Vec::new());
        let one = |_: usize, &element: &usize, _: Task<'_>| {
            begun.fetch_add(1, Ordering::Relaxed);
            if element >= views_at_once() {
                Err(PipelineError::job("views", "0", element.to_string()))
            } else {
                Ok(element)
            }
        };
        let failed = in_groups(&all, task, one, |element| {
            passed.push(element);
            Ok(())
        });
        let message = failed.unwrap_err().to_string();
        assert!(message.contains(&format!("found {}", views_at_once())), "{message}");
        assert_eq!(passed, (0..views_at_once()).collect::<Vec<_>>());
        assert_eq!(begun.into_inner(), 2 * views_at_once());
    }
}
