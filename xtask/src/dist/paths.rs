//! Keeps the paths of the building machine out of releases. These paths contain the name of a user,
//! and differ between machines, so two machines would make different files from the same sources.
//!
//! The compiler writes the paths of source files into messages of panics. A flag replaces the
//! beginning of these paths, and a check finds paths that remain.

use std::io::Read as _;
use std::path::Path;
use std::process::Command;

use crate::tools::{self, Outcome, command, output_of};

/// A folder of this machine, and the name that replaces it in releases.
struct Folder {
    path: String,
    name: &'static str,
}

/// Returns the folders that contain sources. If a folder is within another folder, the outer folder
/// is first, since the compiler uses the last flag that matches a path.
fn folders() -> Outcome<Vec<Folder>> {
    let home = std::env::home_dir().ok_or("expected a home folder of the user, found none")?;
    let cargo = std::env::var("CARGO_HOME").map_or_else(|_| home.join(".cargo"), Into::into);
    let sysroot = output_of(command("rustc").args(["--print", "sysroot"])).ok_or("rustc does not start")?;
    let mut folders = vec![
        Folder { path: tools::text(&home), name: "home" },
        Folder { path: tools::text(&tools::root()), name: "lumistack" },
        Folder { path: tools::text(&cargo), name: "cargo" },
        Folder { path: sysroot.trim().to_owned(), name: "rust" },
    ];
    folders.sort_by_key(|folder| folder.path.len());
    Ok(folders)
}

/// Sets the flags with which cargo's compiler replaces the folders. Flags of the environment stay.
pub fn replace(builder: &mut Command) -> Outcome {
    let own = std::env::var("CARGO_ENCODED_RUSTFLAGS").ok();
    let spaced = || std::env::var("RUSTFLAGS").map(|flags| flags.split_whitespace().collect::<Vec<_>>().join("\x1f"));
    let mut flags: Vec<String> = own.or_else(|| spaced().ok()).filter(|flags| !flags.is_empty()).into_iter().collect();
    flags.extend(folders()?.iter().map(|folder| format!("--remap-path-prefix={}={}", folder.path, folder.name)));
    builder.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\x1f"));
    Ok(())
}

/// Checks files, which are given by name and content.
///
/// # Errors
/// If a file contains a path inside one of the folders; the message quotes the first path that is
/// found.
pub fn check<'a>(mut files: impl Iterator<Item = (&'a str, &'a [u8])>) -> Outcome {
    let folders = folders()?;
    files.try_for_each(|(name, bytes)| check_bytes(name, bytes, &folders))
}

/// Checks the files in a zip or a wheel.
///
/// # Errors
/// As [`check`], or if the archive cannot be read.
pub fn check_zip(path: &Path) -> Outcome {
    let folders = folders()?;
    let failed = |error: String| format!("{}: {error}", path.display());
    let file = std::fs::File::open(path).map_err(|error| failed(error.to_string()))?;
    let mut archive = zip::ZipArchive::new(file).map_err(|error| failed(error.to_string()))?;
    for place in 0..archive.len() {
        let mut member = archive.by_index(place).map_err(|error| failed(error.to_string()))?;
        let mut bytes = Vec::new();
        member.read_to_end(&mut bytes).map_err(|error| failed(error.to_string()))?;
        let name = member.name().map_err(|error| failed(error.to_string()))?.into_owned();
        check_bytes(&format!("{}: {name}", path.display()), &bytes, &folders)?;
    }
    Ok(())
}

fn check_bytes(name: &str, bytes: &[u8], folders: &[Folder]) -> Outcome {
    for folder in folders {
        if let Some(place) = find(bytes, &folder.path) {
            let end = bytes.len().min(place + 120);
            let quoted: String =
                bytes[place..end].iter().map(|&byte| char::from(byte)).take_while(|c| c.is_ascii_graphic()).collect();
            return Err(format!("{name}: expected no path of this machine, found `{quoted}` at byte {place}"));
        }
    }
    Ok(())
}

/// Finds the first path inside a folder: the folder's path and a separator.
fn find(bytes: &[u8], folder: &str) -> Option<usize> {
    let folder = folder.trim_end_matches(['/', '\\']).as_bytes();
    let inside = |place: usize| bytes.get(place + folder.len()).is_some_and(|byte| matches!(byte, b'/' | b'\\'));
    if folder.is_empty() {
        return None;
    }
    bytes
        .windows(folder.len())
        .enumerate()
        .find(|(place, window)| *window == folder && inside(*place))
        .map(|(place, _)| place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_inside_a_folder_is_found() {
        let folders = [Folder { path: "/home/user".into(), name: "home" }];
        let check = |text: &str| check_bytes("a file", text.as_bytes(), &folders);
        assert_eq!(check("see /home/username/x, /home/user and /home"), Ok(()));
        let error = check("\0/home/user/.cargo/lib.rs\0").unwrap_err();
        assert_eq!(error, "a file: expected no path of this machine, found `/home/user/.cargo/lib.rs` at byte 1");
        assert!(check(r"/home/user\x").is_err());
        // the root folder `/` has no name to search for, so nothing is found
        assert_eq!(find(b"/usr/lib", "/"), None);
    }
}
