//! Collects the files that an installation has in addition to the program: manual pages,
//! completions, documents, schemas and the first scene.

use std::path::{Path, PathBuf};

use super::build::Target;
use crate::tools::{self, Outcome, command, output_of, run};

/// A file of an installation.
#[derive(Clone)]
pub struct File {
    /// Path within the prefix, with `/`, such as `bin/lumistack`.
    pub path: String,
    /// True if the file is a program.
    pub runs: bool,
    /// Content.
    pub bytes: Vec<u8>,
}

/// The file in which each shell looks for completions.
const COMPLETIONS: [(&str, &str); 3] = [
    ("bash", "share/bash-completion/completions/lumistack"),
    ("zsh", "share/zsh/site-functions/_lumistack"),
    ("fish", "share/fish/vendor_completions.d/lumistack.fish"),
];

/// Folder of documents. It has the same subfolders as the repository, so that links between
/// documents are valid.
const DOCUMENTS: &str = "share/doc/lumistack";

/// Files of the repository, and their folder in an installation.
const COPIED: [(&str, &str); 12] = [
    ("README.md", DOCUMENTS),
    ("CHANGELOG.md", DOCUMENTS),
    ("LICENSE-MIT", DOCUMENTS),
    ("LICENSE-APACHE", DOCUMENTS),
    ("docs", DOCUMENTS),
    ("docs/start", DOCUMENTS),
    ("docs/design", DOCUMENTS),
    ("docs/pictures", DOCUMENTS),
    ("docs/plugins", DOCUMENTS),
    ("docs/schema", DOCUMENTS),
    ("scenes/still-life", "share/lumistack"),
    // the first line of the scene's job refers to a schema in this folder
    ("docs/schema", "share/lumistack"),
];

/// Endings of the files that are copied from folders.
const ENDINGS: [&str; 9] = [".md", ".jpg", ".png", ".svg", ".json", ".toml", ".gltf", ".bin", ".hdr"];

/// Collects all files except the program. The program writes some of them.
pub fn shared(program: &Path, licences: &str) -> Outcome<Vec<File>> {
    let mut files = vec![file(&format!("{DOCUMENTS}/THIRD-PARTY.txt"), licences.as_bytes().to_vec())];
    let pages = tools::root().join("target/man");
    let _ = std::fs::remove_dir_all(&pages);
    run(command(program).arg("man").arg(&pages))?;
    for page in sorted(&pages)? {
        files.push(file(&format!("share/man/man1/{}", name_of(&page)), read(&page)?));
    }
    for (shell, place) in COMPLETIONS {
        let said = output_of(command(program).args(["completions", shell]));
        let said = said.ok_or_else(|| format!("`{} completions {shell}` failed", program.display()))?;
        files.push(file(place, said.into_bytes()));
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

/// Collects all files, and the program of a target.
pub fn with_program(shared: &[File], program: &Path, target: &Target) -> Outcome<Vec<File>> {
    let program = File { path: format!("bin/{}", target.program()), runs: true, bytes: read(program)? };
    Ok(std::iter::once(program).chain(shared.iter().cloned()).collect())
}

/// Copies the viewer's npm package with its licences into a folder, and returns the folder.
pub fn viewer(licences: &str) -> Outcome<PathBuf> {
    let folder = tools::root().join("target/npm");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    run(command("cp")
        .args(["-r", "web/dist", "web/package.json", "web/README.md", "LICENSE-MIT", "LICENSE-APACHE"])
        .arg(&folder))?;
    let text = folder.join("THIRD-PARTY.txt");
    std::fs::write(&text, licences).map_err(|error| format!("{}: {error}", text.display()))?;
    Ok(folder)
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
