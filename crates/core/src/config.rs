//! Strict configuration files: TOML whose unknown keys are errors that name the line and the nearest known key.

use serde::de::DeserializeOwned;
use thiserror::Error;

/// A configuration file that cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("line {line}, column {column}: {message}{}", suggestion.as_ref().map_or(String::new(), |key| format!("; did you mean `{key}`?")))]
pub struct ConfigError {
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1.
    pub column: usize,
    /// Byte range in the text.
    pub span: std::ops::Range<usize>,
    /// What was found and what was expected.
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
        ConfigError {
            line: before.matches('\n').count() + 1,
            column: before.chars().rev().take_while(|&c| c != '\n').count() + 1,
            span,
            suggestion: nearest_key(&message),
            message,
        }
    })
}

/// Reads the unknown and the expected names out of serde's message and picks the expected one that is spelled most like the other.
pub fn nearest_key(message: &str) -> Option<String> {
    if !message.starts_with("unknown ") {
        return None;
    }
    let mut names = message.split('`').skip(1).step_by(2);
    let unknown = names.next()?;
    nearest(unknown, names).map(String::from)
}

/// The candidate that is spelled most like `name`, when one is close enough to be what was meant.
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
    }
}
