//! The name under which the command was started, such as `lumistack`, `python -m lumistack` or
//! `cargo lumistack`. Hints and examples contain this name, so that the user can copy them.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The package whose program `cargo lumistack` runs.
const PACKAGE: &str = "lumistack-cli";
static NAME: OnceLock<String> = OnceLock::new();

/// Stores the name under which the command was started. `first` is the first word of its command
/// line.
pub(crate) fn remember(first: Option<&OsStr>) {
    // Cargo names the package in the environment of a program that it runs, so `cargo lumistack` is
    // recognized by this name.
    let by_cargo =
        std::env::var_os("CARGO").is_some() && std::env::var("CARGO_PKG_NAME").is_ok_and(|name| name == PACKAGE);
    let first = first.map_or_else(|| "lumistack".into(), |word| word.to_string_lossy().into_owned());
    let folders: Vec<PathBuf> =
        std::env::var_os("PATH").map(|path| std::env::split_paths(&path).collect()).unwrap_or_default();
    NAME.get_or_init(|| started_as(&first, by_cargo, &folders));
}

/// Returns the beginning of the command line with which the user starts the command again.
pub(crate) fn name() -> &'static str {
    NAME.get().map_or("lumistack", String::as_str)
}

/// Replaces `lumistack` by [`name`] in a text: in hints of the form `` `lumistack ...` ``, and in
/// lines with examples.
pub(crate) fn hinted(text: &str) -> String {
    hinted_as(text, name())
}

fn hinted_as(text: &str, name: &str) -> String {
    if name == "lumistack" {
        return text.to_owned();
    }
    // A line of help may break behind the command's name.
    let named = ["`lumistack ", "`lumistack\n", "\n  lumistack "];
    named.iter().fold(text.to_owned(), |text, named| text.replace(named, &named.replace("lumistack", name)))
}

fn started_as(first: &str, by_cargo: bool, folders: &[PathBuf]) -> String {
    if by_cargo {
        return "cargo lumistack".into();
    }
    // The Python package passes the complete name, such as `python -m lumistack`.
    if first.contains(" -m ") {
        return first.into();
    }
    let path = Path::new(first);
    let Some(file) = path.file_name().filter(|_| path.components().count() > 1) else { return first.into() };
    // A shell passes the whole path of a script that it finds on PATH. The user typed only the
    // file's name.
    let canonical = |path: &Path| std::fs::canonicalize(path).ok();
    let on_path = folders.iter().map(|folder| folder.join(file)).find(|found| found.is_file());
    match on_path {
        Some(found) if canonical(&found) == canonical(path) => {
            Path::new(file).file_stem().unwrap_or(file).to_string_lossy().into_owned()
        }
        _ if first.contains(' ') => format!("\"{first}\""),
        _ => first.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hints_name_the_command_as_it_was_started() {
        let folder = tempfile::tempdir().unwrap();
        let script = folder.path().join("lumistack");
        std::fs::write(&script, "").unwrap();
        let folders = [PathBuf::from("/nowhere"), folder.path().to_owned()];
        assert_eq!(started_as("target/release/lumistack", true, &folders), "cargo lumistack");
        assert_eq!(started_as("target/release/lumistack", false, &folders), "target/release/lumistack");
        assert_eq!(started_as("lumistack", false, &folders), "lumistack");
        assert_eq!(started_as(&script.to_string_lossy(), false, &folders), "lumistack");
        assert_eq!(started_as("folder/lumistack", false, &[]), "folder/lumistack");
        assert_eq!(started_as("a folder/lumistack", false, &[]), "\"a folder/lumistack\"");
        assert_eq!(started_as("python3 -m lumistack", false, &folders), "python3 -m lumistack");
        let text = "type `lumistack\ndisplays` or `lumistack doctor`\nExamples:\n  lumistack run a.glb";
        assert_eq!(
            hinted_as(text, "cargo lumistack"),
            "type `cargo lumistack\ndisplays` or `cargo lumistack doctor`\nExamples:\n  cargo lumistack run a.glb"
        );
    }
}
