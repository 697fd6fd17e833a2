//! Hands what is ready to a thread that must not wait.

use std::sync::{Mutex, PoisonError, TryLockError};

/// A place for one thing: the newest that is ready. Who takes never waits, not even for the lock: what cannot be had now is there the next time.
#[derive(Debug)]
pub struct Feed<T>(Mutex<Option<T>>);

impl<T> Default for Feed<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T> Feed<T> {
    /// Puts the newest there; gives back one that nobody took.
    pub fn put(&self, new: T) -> Option<T> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).replace(new)
    }

    /// Takes what is there, without waiting.
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
    fn the_newest_wins_and_nobody_waits() {
        let feed = Feed::default();
        assert_eq!(feed.take(), None);
        assert_eq!((feed.put(1), feed.put(2), feed.take(), feed.take()), (None, Some(1), Some(2), None));
        // somebody who holds the place for long costs nothing but the newest
        feed.put(3);
        let held = feed.0.lock().unwrap();
        assert_eq!(feed.take(), None);
        drop(held);
        assert_eq!(feed.take(), Some(3));
    }
}
