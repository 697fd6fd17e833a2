//! Prints help and errors of usage. The texts are clap's, but with the name under which the command
//! was started, and without terms of Rust.

use std::io::{IsTerminal, Write};

use clap::Error;
use clap::error::ErrorKind;

use crate::program::hinted;

/// Prints clap's error, or the requested help.
pub(crate) fn print(error: &Error) {
    let to_stdout = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
    let is_terminal = if to_stdout { std::io::stdout().is_terminal() } else { std::io::stderr().is_terminal() };
    let styled = error.render();
    let text = if is_terminal && wants_colour() { styled.ansi().to_string() } else { styled.to_string() };
    let text = hinted(&in_words(&text));
    // Ignore errors of the write, since a reader may close the pipe early.
    let _ = if to_stdout {
        std::io::stdout().write_all(text.as_bytes())
    } else {
        std::io::stderr().write_all(text.as_bytes())
    };
}

/// Returns false if the environment requires text without colours: by `NO_COLOR` (no-color.org), or
/// by a terminal that shows only plain text.
fn wants_colour() -> bool {
    std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
        && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Replaces the messages of Rust's number parsers by plain messages.
fn in_words(text: &str) -> String {
    let unit = match text.split_once(" <").and_then(|(_, rest)| rest.split_once('>')) {
        Some(("MM", _)) => " in millimetres",
        Some(("DEG", _)) => " in degrees",
        Some(("S", _)) => " in seconds",
        Some(("HZ", _)) => " in hertz",
        Some(("EV", _)) => " of stops",
        Some(("PX", _)) => " in pixels",
        _ => "",
    };
    let number = format!("expected a number{unit}");
    let whole = "expected a whole number, 0 or more";
    let text = [
        ("invalid float literal", number.as_str()),
        ("cannot parse float from empty string", number.as_str()),
        ("invalid digit found in string", whole),
        ("cannot parse integer from empty string", whole),
        ("number too large to fit in target type", "expected a smaller number"),
        ("number too small to fit in target type", "expected a larger number"),
    ]
    .iter()
    .fold(text.to_owned(), |text, (rust, words)| text.replace(rust, words));
    // Rewrites clap's message about a number outside of a range: "70000 is not in 0..=65535".
    let Some((before, after)) = text.split_once(" is not in ") else { return text };
    let end = after.find(|c: char| !(c.is_ascii_digit() || ".=-".contains(c))).unwrap_or(after.len());
    let (range, rest) = after.split_at(end);
    let Some((first, last)) = range.split_once("..=") else { return text };
    let value = before.rfind(' ').map_or(0, |space| space + 1);
    format!("{}expected {first} to {last}{rest}", &before[..value])
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::Args;

    #[test]
    fn errors_of_numbers_name_their_unit() {
        let said = |words: &[&str]| {
            let words = ["lumistack"].iter().chain(words);
            in_words(&Args::try_parse_from(words).unwrap_err().render().to_string())
        };
        let text = said(&["factorize", "a.npy", "-o", "a", "--pitch-mm", "wide"]);
        assert!(text.contains("'wide' for '--pitch-mm <MM>': expected a number in millimetres"), "{text}");
        let text = said(&["run", "a.glb", "--frames", "2.5"]);
        assert!(text.contains("'2.5' for '--frames <M>': expected a whole number, 0 or more"), "{text}");
        let text = said(&["preview", "a", "--port", "70000"]);
        assert!(text.contains("'70000' for '--port <N>': expected 0 to 65535"), "{text}");
        let text = said(&["run", "a.glb", "--time", ""]);
        assert!(text.contains("expected a number in seconds"), "{text}");
    }
}
