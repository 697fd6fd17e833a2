//! Schedule of the time steps of a video.

use std::time::Duration;

/// Plays time steps in order at a rate. Time steps that would be shown too late are skipped and
/// counted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Player {
    count: usize,
    rate_hz: f64,
    most_late: usize,
    next: usize,
    begun: Option<Duration>,
    /// Number of time steps that were skipped.
    pub dropped: usize,
}

/// The action that is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// Show this time step, counted from 0.
    Time(usize),
    /// Nothing is due; call again after this time.
    Wait(Duration),
    /// The video has ended.
    End,
}

impl Player {
    /// Plays `count` time steps at `rate_hz` > 0. If more than `most_late` later time steps are due
    /// already, playback skips to the newest of them. The last time step is always shown.
    pub fn new(count: usize, rate_hz: f64, most_late: usize) -> Self {
        Self { count, rate_hz, most_late, next: 0, begun: None, dropped: 0 }
    }

    /// Returns the next action for a caller that is ready at the time `now`. Any clock may be used.
    /// The first call starts the video.
    pub fn next(&mut self, now: Duration) -> Due {
        let begun = *self.begun.get_or_insert(now);
        // time steps since the beginning
        let passed = now.saturating_sub(begun).as_secs_f64() * self.rate_hz + EARLY;
        let newest = passed.floor() as usize;
        if newest > self.next.saturating_add(self.most_late) {
            // The last time step is never skipped, so the video ends with its last picture.
            let to = newest.min(self.count.saturating_sub(1)).max(self.next);
            self.dropped += to - self.next;
            self.next = to;
        }
        if self.next >= self.count {
            return Due::End;
        }
        if self.next as f64 > passed {
            let after = Duration::try_from_secs_f64(self.next as f64 / self.rate_hz).unwrap_or(Duration::MAX);
            return Due::Wait(begun.saturating_add(after).saturating_sub(now));
        }
        self.next += 1;
        Due::Time(self.next - 1)
    }
}

/// Fraction of the interval by which a time step may be early, so that a rounding error does not
/// delay it.
const EARLY: f64 = 1e-6;
