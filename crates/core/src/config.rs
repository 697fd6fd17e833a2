//! Strict configuration files: TOML in which an unknown key is an error. The error's message names
//! the line and the nearest known key.

use serde::de::DeserializeOwned;
use thiserror::Error;

/// A configuration file that cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("line {line}, column {column}: {message}{}", suggestion.as_ref().map_or(String::new(), |key| format!("; did you mean `{key}`?")))]
pub struct ConfigError {
    /// Line of the error in the text, from 1.
    pub line: usize,
    /// Column of the error in its line, from 1.
    pub column: usize,
    /// Range of bytes in the text to which the error applies.
    pub span: std::ops::Range<usize>,
    /// One sentence that states the expected and the found value, or the unknown key.
    pub message: String,
    /// The known key that is spelled most like the unknown one.
    pub suggestion: Option<String>,
}

/// Parses TOML into a type that denies unknown fields.
///
/// # Errors
/// On malformed TOML, unknown keys, missing keys and values of the wrong type.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|error| {
        let message = error.message().to_string();
        let span = error.span().unwrap_or(0..0);
        let before = &text[..span.start.min(text.len())];
        let line = &before[before.rfind('\n').map_or(0, |end| end + 1)..];
        let message = plain(&message, line.split_once('=').map_or("", |(key, _)| key.trim()));
        ConfigError {
            line: before.matches('\n').count() + 1,
            column: before.chars().rev().take_while(|&c| c != '\n').count() + 1,
            span,
            suggestion: nearest_key(&message),
            message,
        }
    })
}

/// Translates serde's sentence about a value of a wrong type into terms of the file. `key` names
/// the value, and the key's ending gives the unit (`pitch_mm`). Returns other sentences unchanged.
pub fn plain(message: &str, key: &str) -> String {
    let kinds = ["invalid type: ", "invalid value: ", "invalid length "];
    let Some((kind, rest)) = kinds.iter().find_map(|kind| Some((*kind, message.strip_prefix(*kind)?))) else {
        return message.into();
    };
    let Some((found, expected)) = rest.rsplit_once(", expected ") else { return message.into() };
    // a message about JSON has the position after the expected type; keep the position for the end
    // of the new message
    let (expected, place) = expected.find(" at line ").map_or((expected, ""), |at| expected.split_at(at));
    let unit = UNITS.iter().find(|(ending, _)| key.ends_with(ending)).map_or("", |(_, unit)| *unit);
    let expected = match expected {
        "f32" | "f64" => format!("a number{unit}"),
        "u8" | "u16" | "u32" | "u64" | "usize" => format!("a whole number{unit}, 0 or more"),
        "i8" | "i16" | "i32" | "i64" | "isize" => format!("a whole number{unit}"),
        "a boolean" => "true or false".into(),
        "a string" | "string" | "str" => "a text in quotes".into(),
        "path string" => "a path in quotes".into(),
        "a sequence" => "a list in [ ]".into(),
        "a map" => "a table of keys and values".into(),
        other if other.starts_with("struct ") => format!("a table of keys and values{}", table_of(key)),
        other => match other.strip_prefix("an array of length ").or_else(|| other.strip_prefix("a tuple of size ")) {
            Some(count) => format!("a list of {count} values{unit}"),
            None => other.into(),
        },
    };
    let found = match found.split_once(' ') {
        _ if kind == "invalid length " => format!("a list of length {found}"),
        Some(("string", text)) => format!("the text {text}"),
        Some(("integer" | "boolean", value)) => value.replace('`', ""),
        Some(("floating", value)) => value.trim_start_matches("point ").replace('`', ""),
        None if found == "sequence" => "a list".into(),
        None if found == "map" => "a table".into(),
        None if found == "null" || found == "unit" => "nothing".into(),
        _ => found.into(),
    };
    format!("expected {expected}, found {found}{place}")
}

/// Returns the text that names a table in a message; empty for the top level.
fn table_of(key: &str) -> String {
    if key.is_empty() { String::new() } else { format!(", [{key}]") }
}

/// Endings of keys, and the units that they stand for in messages.
const UNITS: [(&str, &str); 10] = [
    ("_mm", " in millimetres"),
    ("_um", " in micrometres"),
    ("_deg", " in degrees"),
    ("_hz", " in hertz"),
    ("_s", " in seconds"),
    ("_px", " in pixels"),
    ("_ev", " of stops"),
    ("_db", " in decibels"),
    ("_nits", " in candela per square metre"),
    ("_percent", " in per cent"),
];

/// Reads the unknown name and the expected names from serde's message. Returns the expected name
/// that is spelled most like the unknown one; `None` if there is none.
pub fn nearest_key(message: &str) -> Option<String> {
    if !message.starts_with("unknown ") {
        return None;
    }
    let mut names = message.split('`').skip(1).step_by(2);
    let unknown = names.next()?;
    nearest(unknown, names).map(String::from)
}

/// Returns the candidate that is spelled most like `name`; `None` if no candidate is similar
/// enough for `name` to be a typo of it.
pub fn nearest<'a>(name: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::normalized_damerau_levenshtein(name, candidate), candidate))
        .filter(|(similarity, _)| *similarity >= 0.4)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Settings {
        #[allow(dead_code, reason = "only its name matters here")]
        samples: u32,
        #[allow(dead_code, reason = "only its name matters here")]
        #[serde(default)]
        seed: u64,
    }

    #[test]
    fn a_typo_names_its_line_and_the_nearest_key() {
        let error = parse::<Settings>("seed = 1\nsampels = 3\n").unwrap_err();
        assert_eq!((error.line, error.column), (2, 1));
        assert_eq!(error.suggestion.as_deref(), Some("samples"));
        assert!(error.to_string().ends_with("did you mean `samples`?"), "{error}");
    }

    #[test]
    fn a_wrong_type_names_its_place() {
        let error = parse::<Settings>("samples = \"many\"").unwrap_err();
        assert_eq!((error.line, error.column, error.suggestion), (1, 11, None));
        assert!(parse::<Settings>("samples = ").is_err());
        assert_eq!(error.message, "expected a whole number, 0 or more, found the text \"many\"");
    }

    #[test]
    fn types_are_told_in_units() {
        for (message, key, expected) in [
            (
                "invalid type: string \"wide\", expected f64",
                "lens_deg",
                "expected a number in degrees, found the text \"wide\"",
            ),
            (
                "invalid type: floating point `2.5`, expected usize",
                "frames",
                "expected a whole number, 0 or more, found 2.5",
            ),
            ("invalid value: integer `-2`, expected u32", "frames", "expected a whole number, 0 or more, found -2"),
            (
                "invalid length 1, expected an array of length 2",
                "size_mm",
                "expected a list of 2 values in millimetres, found a list of length 1",
            ),
            (
                "invalid type: string \"a\", expected struct DisplayJob",
                "display",
                "expected a table of keys and values, [display], found the text \"a\"",
            ),
            ("invalid type: boolean `true`, expected path string", "scene", "expected a path in quotes, found true"),
            (
                "invalid type: string \"x\", expected f64 at line 2 column 18",
                "pitch_mm",
                "expected a number in millimetres, found the text \"x\" at line 2 column 18",
            ),
            ("unknown field `x`, expected `y`", "x", "unknown field `x`, expected `y`"),
        ] {
            assert_eq!(plain(message, key), expected);
        }
    }
}
