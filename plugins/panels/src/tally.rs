//! Counts late refreshes and measures the skew between outputs.
//!
//! A refresh is late if it comes more than 1.5 intervals after the previous refresh. In the
//! intervals between these two refreshes, the panel has repeated the previous frame.

use std::collections::BTreeMap;

use lumistack_plugin::serde::{Deserialize, Serialize};

/// Refresh statistics of one output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct Tally {
    #[serde(skip)]
    interval_s: f64,
    #[serde(skip)]
    last: Option<(u64, f64)>,
    /// Number of refreshes that were presented.
    pub shown: u64,
    /// Number of refreshes that were presented late.
    pub late: u64,
    /// Number of intervals in which a panel repeated a frame, since the next refresh was late.
    pub repeated: u64,
    /// Number of refresh numbers that were skipped between two successive presentations.
    pub dropped: u64,
    /// Number of refreshes that were presented directly after a refresh with a larger number.
    pub out_of_order: u64,
}

impl Tally {
    /// Makes a tally without refreshes. `interval_s` is the expected interval between refreshes,
    /// seconds.
    pub fn new(interval_s: f64) -> Self {
        Self { interval_s, last: None, shown: 0, late: 0, repeated: 0, dropped: 0, out_of_order: 0 }
    }

    /// Records that refresh `index` was presented at `time_s`, seconds.
    pub fn came(&mut self, index: u64, time_s: f64) {
        if let Some((last, before_s)) = self.last {
            let intervals = (time_s - before_s) / self.interval_s;
            if intervals > 1.5 {
                self.late += 1;
                self.repeated += intervals.round() as u64 - 1;
            }
            if index <= last {
                self.out_of_order += 1;
            } else {
                self.dropped += index - last - 1;
            }
        }
        self.shown += 1;
        self.last = Some((index, time_s));
    }
}

/// Statistics of the skew. The skew of a refresh is the time from its presentation on the first
/// output to its presentation on the last output.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skew {
    outputs: usize,
    open: BTreeMap<u64, Vec<f64>>,
    /// Number of refreshes with a time from every output.
    pub refreshes: u64,
    sum_s: f64,
    /// The largest skew, seconds.
    pub largest_s: f64,
}

/// Largest number of refreshes that wait for the times of further outputs. An output may never
/// report its time, so if more refreshes wait, the oldest are dropped.
const OPEN: usize = 64;

impl Skew {
    /// Makes statistics without refreshes, for this number of outputs.
    pub fn new(outputs: usize) -> Self {
        Self { outputs, ..Self::default() }
    }

    /// Records that one output presented refresh `index` at `time_s`, seconds.
    pub fn came(&mut self, index: u64, time_s: f64) {
        let times = self.open.entry(index).or_default();
        times.push(time_s);
        if times.len() == self.outputs {
            let latest = times.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let apart = latest - times.iter().copied().fold(f64::INFINITY, f64::min);
            self.refreshes += 1;
            self.sum_s += apart;
            self.largest_s = self.largest_s.max(apart);
            self.open.remove(&index);
        }
        while self.open.len() > OPEN {
            self.open.pop_first();
        }
    }

    /// Returns the mean skew, seconds; `None` before all outputs have presented one refresh.
    pub fn mean_s(&self) -> Option<f64> {
        (self.refreshes > 0).then(|| self.sum_s / self.refreshes as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_repeated_dropped_and_disordered_differ() {
        let mut tally = Tally::new(0.01);
        for (index, time_s) in [(0, 0.0), (1, 0.0101), (2, 0.0199), (3, 0.0401), (5, 0.05), (4, 0.06)] {
            tally.came(index, time_s);
        }
        assert_eq!((tally.shown, tally.late, tally.repeated), (6, 1, 1));
        assert_eq!((tally.dropped, tally.out_of_order), (1, 1));
        let mut stalled = Tally::new(0.01);
        stalled.came(0, 0.0);
        stalled.came(1, 0.2);
        assert_eq!((stalled.late, stalled.repeated), (1, 19));
    }

    #[test]
    fn skew_is_the_distance_of_the_first_and_the_last() {
        let mut skew = Skew::new(3);
        assert_eq!(skew.mean_s(), None);
        for (index, time_s) in [(0, 1.0), (0, 1.002), (1, 2.0), (0, 1.001), (1, 2.006), (1, 2.001)] {
            skew.came(index, time_s);
        }
        assert_eq!(skew.refreshes, 2);
        assert!((skew.mean_s().unwrap() - 0.004).abs() < 1e-12 && (skew.largest_s - 0.006).abs() < 1e-12);
        // One output never reports, so all refreshes stay incomplete.
        (0..1000).for_each(|index| skew.came(index, 0.0));
        assert!(skew.open.len() <= OPEN);
    }
}
