//! Passes the newest value to a thread that must not block.

use std::sync::{Mutex, PoisonError, TryLockError};

/// Holds the newest value, or none. [`take`](Self::take) never blocks, not even on the lock: while
/// another thread holds the lock, it returns `None`.
#[derive(Debug)]
pub struct Feed<T>(Mutex<Option<T>>);

impl<T> Default for Feed<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T> Feed<T> {
    /// Stores `new`; returns the previous value if it was not taken.
    pub fn put(&self, new: T) -> Option<T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).replace(new)
    }

    /// Takes the value without blocking; `None` if there is no value, or the lock is held.
    pub fn take(&self) -> Option<T> {
        match self.0.try_lock() {
            Ok(mut place) => place.take(),
            Err(TryLockError::Poisoned(place)) => place.into_inner().take(),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_wins_without_waiting() {
        let feed = Feed::default();
        assert_eq!(feed.take(), None);
        assert_eq!((feed.put(1), feed.put(2), feed.take(), feed.take()), (None, Some(1), Some(2), None));
        // While the lock is held, `take` returns `None` instead of blocking. The value is returned
        // later.
        feed.put(3);
        let held = feed.0.lock().unwrap();
        assert_eq!(feed.take(), None);
        drop(held);
        assert_eq!(feed.take(), Some(3));
    }
}
