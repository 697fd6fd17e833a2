//! Which time of a video is due.

use std::time::Duration;

/// Plays times in order at a rate. Times that would come too late are left out and counted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Player {
    count: usize,
    rate_hz: f64,
    most_late: usize,
    next: usize,
    begun: Option<Duration>,
    /// Times that were left out.
    pub dropped: usize,
}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// Take this time, counted from 0.
    Time(usize),
    /// Ask again after this long.
    Wait(Duration),
    /// All times have been.
    End,
}

impl Player {
    /// `count` times at `rate_hz` > 0; one is taken at most `most_late` times after it was due.
    pub fn new(count: usize, rate_hz: f64, most_late: usize) -> Self {
        Self { count, rate_hz, most_late, next: 0, begun: None, dropped: 0 }
    }

    /// The next time, for somebody who is ready for it `now`, on any clock. The first one is due when it is first asked for.
    pub fn next(&mut self, now: Duration) -> Due {
        let begun = *self.begun.get_or_insert(now);
        let newest = (now.saturating_sub(begun).as_secs_f64() * self.rate_hz + EARLY).floor() as usize;
        if newest > self.next + self.most_late {
            let to = newest.min(self.count);
            self.dropped += to - self.next.min(to);
            self.next = to;
        }
        if self.next >= self.count {
            return Due::End;
        }
        let due = begun + Duration::from_secs_f64(self.next as f64 / self.rate_hz);
        if now + Duration::from_secs_f64(EARLY / self.rate_hz) < due {
            return Due::Wait(due - now);
        }
        self.next += 1;
        Due::Time(self.next - 1)
    }
}

/// Share of the time between two times by which one may be early: rounding must not make it late by one.
const EARLY: f64 = 1e-6;
