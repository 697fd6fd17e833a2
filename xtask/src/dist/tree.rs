//! What an installation has beside the program: manual pages, completions, documents, schemas and the first scene.

use std::path::{Path, PathBuf};

use super::build::Target;
use crate::tools::{self, Outcome, command, run};

/// A file of an installation; its path begins below the prefix, as in `bin/lumistack`.
#[derive(Clone)]
pub struct File {
    /// Folders and name, between `/`.
    pub path: String,
    /// Whether it is a program.
    pub runs: bool,
    /// What is in it.
    pub bytes: Vec<u8>,
}

/// Completions by shell, where their shells look for them.
const COMPLETIONS: [(&str, &str); 3] = [
    ("bash", "share/bash-completion/completions/lumistack"),
    ("zsh", "share/zsh/site-functions/_lumistack"),
    ("fish", "share/fish/vendor_completions.d/lumistack.fish"),
];

/// Where documents go, with the links between them.
const DOCUMENTS: &str = "share/doc/lumistack";

/// Files of the repository that come along, and where to.
const COPIED: [(&str, &str); 9] = [
    ("README.md", DOCUMENTS),
    ("CHANGELOG.md", DOCUMENTS),
    ("LICENSE-MIT", DOCUMENTS),
    ("LICENSE-APACHE", DOCUMENTS),
    ("docs", DOCUMENTS),
    ("docs/plugins", DOCUMENTS),
    ("docs/schema", DOCUMENTS),
    ("scenes/still-life", "share/lumistack"),
    // by which the scene's job is checked
    ("docs/schema", "share/lumistack"),
];

/// Endings of what comes along of folders.
const ENDINGS: [&str; 7] = [".md", ".jpg", ".json", ".toml", ".gltf", ".bin", ".hdr"];

/// All files but the program, which writes some of them.
pub fn shared(program: &Path, licences: &str) -> Outcome<Vec<File>> {
    let mut files = vec![file(&format!("{DOCUMENTS}/THIRD-PARTY.txt"), licences.as_bytes().to_vec())];
    let pages = tools::root().join("target/man");
    let _ = std::fs::remove_dir_all(&pages);
    run(command(program).arg("man").arg(&pages))?;
    for page in sorted(&pages)? {
        files.push(file(&format!("share/man/man1/{}", name_of(&page)), read(&page)?));
    }
    for (shell, place) in COMPLETIONS {
        let said = command(program).args(["completions", shell]).output();
        let said = said.map_err(|error| format!("{}: {error}", program.display()))?;
        files.push(file(place, said.stdout));
    }
    for (from, to) in COPIED {
        let path = tools::root().join(from);
        if path.is_file() {
            files.push(file(&format!("{to}/{from}"), read(&path)?));
            continue;
        }
        for path in sorted(&path)?.into_iter().filter(|path| path.is_file()) {
            let name = name_of(&path);
            if ENDINGS.iter().any(|ending| name.ends_with(ending)) {
                files.push(file(&format!("{to}/{from}/{name}"), read(&path)?));
            }
        }
    }
    Ok(files)
}

/// The same with the program of a target.
pub fn with_program(shared: &[File], program: &Path, target: &Target) -> Outcome<Vec<File>> {
    let program = File { path: format!("bin/lumistack{}", target.ending), runs: true, bytes: read(program)? };
    Ok(std::iter::once(program).chain(shared.iter().cloned()).collect())
}

fn file(path: &str, bytes: Vec<u8>) -> File {
    File { path: path.into(), runs: false, bytes }
}

fn read(path: &Path) -> Outcome<Vec<u8>> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn sorted(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    Ok(paths)
}
