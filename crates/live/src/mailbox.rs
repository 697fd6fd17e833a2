//! A mailbox that holds only the newest value.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The newest value of a series, for any number of readers.
///
/// Posting and reading exchange only a pointer, so a thread never waits for another thread's work.
/// If a value is replaced before any thread reads it, the value is dropped.
#[derive(Debug)]
pub struct Mailbox<T> {
    newest: Mutex<Held<T>>,
    posted: Condvar,
}

#[derive(Debug)]
struct Held<T> {
    number: u64,
    value: Option<Arc<T>>,
}

impl<T> Default for Mailbox<T> {
    fn default() -> Self {
        Self { newest: Mutex::new(Held { number: 0, value: None }), posted: Condvar::new() }
    }
}

impl<T> Mailbox<T> {
    /// Replaces the value. Returns the number of the new value; the first number is 1.
    pub fn post(&self, value: T) -> u64 {
        let value = Some(Arc::new(value));
        let mut held = self.held();
        held.number += 1;
        let (number, before) = (held.number, std::mem::replace(&mut held.value, value));
        drop(held);
        self.posted.notify_all();
        // drop the old value outside of the lock, since freeing patterns takes time
        drop(before);
        number
    }

    /// Returns the newest value with its number, if this number is above `seen`. A new reader
    /// passes 0.
    pub fn after(&self, seen: u64) -> Option<(u64, Arc<T>)> {
        newer(&self.held(), seen)
    }

    /// Waits until [`after`](Self::after) returns a value, but at most for `limit`. Returns the
    /// value; `None` after the limit.
    pub fn wait_after(&self, seen: u64, limit: Duration) -> Option<(u64, Arc<T>)> {
        let held = self.posted.wait_timeout_while(self.held(), limit, |held| held.number <= seen);
        newer(&held.unwrap_or_else(PoisonError::into_inner).0, seen)
    }

    fn held(&self) -> MutexGuard<'_, Held<T>> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn newer<T>(held: &Held<T>, seen: u64) -> Option<(u64, Arc<T>)> {
    held.value.as_ref().filter(|_| held.number > seen).map(|value| (held.number, value.clone()))
}
