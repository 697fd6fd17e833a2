//! A mailbox that holds only the newest value.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The newest value of a series, for any number of readers.
///
/// Posting and reading exchange a pointer, so no thread waits for the work of another. A value that
/// is replaced before it is read is dropped.
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
    /// Replaces the value. Returns its number; the first is 1.
    pub fn post(&self, value: T) -> u64 {
        let value = Some(Arc::new(value));
        let mut held = self.held();
        held.number += 1;
        let (number, before) = (held.number, std::mem::replace(&mut held.value, value));
        drop(held);
        self.posted.notify_all();
        // freed outside of the lock, since freeing patterns takes time
        drop(before);
        number
    }

    /// Returns the newest value with its number, if it is newer than number `seen`. A new reader
    /// passes 0.
    pub fn after(&self, seen: u64) -> Option<(u64, Arc<T>)> {
        newer(&self.held(), seen)
    }

    /// Waits for [`after`](Self::after) up to a limit.
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
