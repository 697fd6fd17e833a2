//! Quotes values of a file in messages.

use serde_json::Value;

/// Number of characters of the longest quotation in a message.
const MAX_QUOTE_CHARS: usize = 60;

/// Returns a JSON value as text for messages.
pub(crate) fn quote(value: Option<&Value>) -> String {
    value.map_or_else(|| "nothing".to_owned(), |value| shorten(&value.to_string()))
}

/// Returns a text, or the beginning of a long text followed by three dots.
pub(crate) fn shorten(text: &str) -> String {
    match text.char_indices().nth(MAX_QUOTE_CHARS) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
