//! Predicts the time that a number of workers needs for a graph.
//!
//! ```text
//! length of a path = Σ (seconds + overhead) from a unit to the end
//! a free worker takes the ready unit with the longest path
//! ```
//! The makespan is the time from the first unit's start to the last unit's end. With many workers,
//! it approaches the length of the longest path. With one worker, it is the sum over all units.
//!
//! Memory and transfers are not modelled. The measured time of a unit includes its reads from the
//! shared folder.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use serde::Serialize;

use crate::graph::Graph;

/// Predicted schedule of a graph on a number of workers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Prediction {
    /// Number of workers.
    pub workers: usize,
    /// Time from the first unit's start to the last unit's end, seconds.
    pub makespan_seconds: f64,
    /// Fraction of the workers' time in which they execute units, 0 to 1.
    pub busy: f64,
}

/// Returns, for each unit, the seconds of the longest chain of units that begins with this unit.
/// Each unit of a chain depends on the one before it.
pub fn paths(graph: &Graph, overhead_seconds: f64) -> Vec<f64> {
    let mut after = vec![0.0f64; graph.units.len()];
    let mut paths = vec![0.0; graph.units.len()];
    let inputs = graph.inputs();
    for (index, unit) in graph.units.iter().enumerate().rev() {
        paths[index] = after[index] + unit.seconds + overhead_seconds;
        for &input in &inputs[index] {
            after[input] = after[input].max(paths[index]);
        }
    }
    paths
}

/// Simulates the schedule on a number of workers (at least one). Each unit takes its own seconds
/// and the overhead.
pub fn predict(graph: &Graph, workers: usize, overhead_seconds: f64) -> Prediction {
    let workers = workers.max(1);
    let priority = paths(graph, overhead_seconds);
    let inputs = graph.inputs();
    let mut waits: Vec<usize> = inputs.iter().map(Vec::len).collect();
    let mut followers = vec![Vec::new(); graph.units.len()];
    for (index, inputs) in inputs.iter().enumerate() {
        inputs.iter().for_each(|&input| followers[input].push(index));
    }
    // The heap sorts times by their bits, since the bits of non-negative floats have the order of
    // the floats.
    let bits = |seconds: f64| seconds.max(0.0).to_bits();
    let mut ready: BinaryHeap<(u64, Reverse<usize>)> =
        (0..waits.len()).filter(|&i| waits[i] == 0).map(|i| (bits(priority[i]), Reverse(i))).collect();
    let mut running: BinaryHeap<Reverse<(u64, usize)>> = BinaryHeap::new();
    let (mut now, mut sum) = (0.0, 0.0);
    loop {
        // Each free worker takes, of the ready units that are left, the unit with the longest path
        // to the end of the graph.
        while running.len() < workers
            && let Some((_, Reverse(index))) = ready.pop()
        {
            let seconds = graph.units[index].seconds + overhead_seconds;
            sum += seconds;
            running.push(Reverse((bits(now + seconds), index)));
        }
        // Advance to the time at which the next unit ends. Other units may then become ready.
        let Some(Reverse((end, index))) = running.pop() else { break };
        now = f64::from_bits(end);
        for &next in &followers[index] {
            waits[next] -= 1;
            if waits[next] == 0 {
                ready.push((bits(priority[next]), Reverse(next)));
            }
        }
    }
    let busy = if now > 0.0 { sum / (now * workers as f64) } else { 1.0 };
    Prediction { workers, makespan_seconds: now, busy }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::tests::sample;

    #[test]
    fn one_worker_takes_the_sum_and_many_take_the_longest_path() {
        let graph = sample();
        let sum: f64 = graph.units.iter().map(|unit| unit.seconds).sum();
        let one = predict(&graph, 1, 0.0);
        assert_eq!((one.makespan_seconds, one.busy), (sum, 1.0));
        // The longest path has these units: place, views, field, two factorizations, finish.
        let longest = 1.0 + 8.0 + 1.0 + 2.0 + 2.0 + 1.0;
        assert_eq!(paths(&graph, 0.0)[0], longest);
        assert_eq!(predict(&graph, 1000, 0.0).makespan_seconds, longest);
        assert_eq!(predict(&graph, 1, 0.5).makespan_seconds, sum + 0.5 * graph.units.len() as f64);
        // Two workers begin with place, then trace the views of each time step in pairs, then make
        // both light fields in parallel. The factorizations follow one after the other, then
        // finish.
        assert_eq!(predict(&graph, 2, 0.0).makespan_seconds, 1.0 + 8.0 + 8.0 + 1.0 + 2.0 + 2.0 + 1.0);
    }
}
