//! The clock by which viewers, videos and steps of the solver are timed.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Time since it was asked for first.
pub(super) fn now() -> Duration {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}
