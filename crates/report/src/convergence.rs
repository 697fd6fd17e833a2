//! The solver's PSNR at round numbers of seconds.

use crate::Iteration;

/// The last iteration that was complete at a certain time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reached {
    /// Time in seconds: 1, 2 or 5 times a power of ten. The last entry has the time at which the
    /// solver ended.
    pub(crate) seconds: f64,
    pub(crate) iteration: u32,
    pub(crate) psnr_view: f64,
}

/// Largest number of entries in the table of PSNR over time. If there are more entries, the latest
/// are kept.
const LINES: usize = 12;

/// Returns the PSNR at round numbers of seconds, and at the end of the solver.
pub(crate) fn reached(history: &[Iteration]) -> Vec<Reached> {
    let Some(end) = history.last().filter(|last| last.seconds.is_finite()) else { return Vec::new() };
    let round = (-3..9).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(power)));
    let times = round.filter(|seconds| *seconds < end.seconds).chain([end.seconds]);
    let mut lines: Vec<Reached> = times
        .filter_map(|seconds| {
            let it = history.iter().rev().find(|it| it.seconds <= seconds)?;
            Some(Reached { seconds, iteration: it.iteration, psnr_view: it.psnr_view })
        })
        .collect();
    // If several round times have the same last iteration, keep only the first of these times.
    lines.dedup_by(|later, earlier| later.iteration == earlier.iteration && later.seconds != end.seconds);
    lines.drain(..lines.len().saturating_sub(LINES));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_times_and_the_end_are_listed_once() {
        let it = |iteration: u32, seconds: f64| Iteration {
            iteration,
            objective: 1.0,
            psnr_view: 20.0 + f64::from(iteration),
            seconds,
        };
        let history = [it(1, 0.03), it(2, 0.06), it(3, 0.3), it(4, 0.7)];
        let lines: Vec<(f64, u32)> = reached(&history).iter().map(|line| (line.seconds, line.iteration)).collect();
        assert_eq!(lines, [(0.05, 1), (0.1, 2), (0.5, 3), (0.7, 4)]);
        assert_eq!(reached(&history)[2].psnr_view, 23.0);
        assert!(reached(&[]).is_empty());
        assert_eq!(reached(&[it(0, 0.0)]).len(), 1);
    }
}
