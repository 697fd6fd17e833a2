//! Values of a file as messages quote them.

use serde_json::Value;

/// Longest quotation from the file in a message.
const MAX_QUOTE_CHARS: usize = 60;

/// JSON for messages.
pub(crate) fn quote(value: Option<&Value>) -> String {
    value.map_or_else(|| "nothing".to_owned(), |value| shorten(&value.to_string()))
}

/// The beginning of a text that may be long.
pub(crate) fn shorten(text: &str) -> String {
    match text.char_indices().nth(MAX_QUOTE_CHARS) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
