//! Warnings and errors of the newest request, for pages and for an attached program.

use std::collections::HashSet;
use std::sync::{Arc, Mutex};

use lumistack_core::{Warning, Warnings};
use lumistack_live::Mailbox;
use serde_json::json;

use super::door::Events;
use super::requests::lock;

/// Passes each warning to `to` only once, since a scene is rendered many times. Pages show the
/// newest warning. An attached program receives every warning, also a repeated one.
pub(super) struct Once<'a> {
    to: &'a dyn Warnings,
    messages: &'a Messages,
    events: &'a Events,
    seen: Mutex<HashSet<String>>,
}

/// The message of the newest request; empty if there is none.
#[derive(Default)]
pub(super) struct Messages(Mailbox<String>);

impl Messages {
    /// Returns the number and the text of the message; the number is 0 before the first message.
    pub(super) fn newest(&self) -> (u64, Arc<String>) {
        self.0.after(0).unwrap_or_default()
    }

    /// Replaces the message, unless its text is already the same.
    pub(super) fn say(&self, text: String) {
        if *self.newest().1 != text {
            self.0.post(text);
        }
    }
}

/// Largest number of warnings in memory.
const MOST_SEEN: usize = 1000;

impl<'a> Once<'a> {
    pub(super) fn new(to: &'a dyn Warnings, messages: &'a Messages, events: &'a Events) -> Self {
        Self { to, messages, events, seen: Mutex::default() }
    }
}

impl Warnings for Once<'_> {
    fn warn(&self, warning: Warning) {
        // On the page, messages of the live display itself need no prefix that names their origin.
        let is_own = warning.place == "live";
        self.messages.say(if is_own { warning.message.clone() } else { warning.to_string() });
        self.events.send(&json!({"event": "warning", "place": warning.place, "message": warning.message}));
        let mut seen = lock(&self.seen);
        if seen.len() >= MOST_SEEN {
            seen.clear();
        }
        if seen.insert(warning.to_string()) {
            drop(seen);
            self.to.warn(warning);
        }
    }
}
