//! Computes a hash of a crate's own sources, for the build script of that crate.
//!
//! Results are kept between runs, and thus between versions of the program. The key of a result
//! contains the fingerprints of all crates whose code affects the result. After any change to that
//! code, results get other keys, so old results are not used. With a version number raised by hand,
//! some changes would be missed.
//!
//! ```text
//! build.rs   fn main() { lumistack_fingerprint::emit(&[]); }
//! lib.rs     pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
//! ```
//!
//! The same sources give the same fingerprint on every machine. Names are relative to the crate,
//! have `/` between folders, and are sorted; contents are hashed byte by byte. Files outside of the
//! crate's folder are not read, so packaged crates build too.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Folder of the crate's code.
const SOURCES: &str = "src";
const MANIFEST: &str = "Cargo.toml";
/// Name of the original manifest in a packaged crate, whose `Cargo.toml` cargo has rewritten.
const ORIGINAL_MANIFEST: &str = "Cargo.toml.orig";

/// Sets `LUMISTACK_FINGERPRINT` for the crate whose build script calls this function. The
/// fingerprint covers `src`, the manifest, and the folders `more`, relative to the crate's folder.
///
/// # Panics
/// If cargo does not run the build script, or the sources cannot be read: a crate without a
/// fingerprint must not build.
pub fn emit(more: &[&str]) {
    let folder = std::env::var_os("CARGO_MANIFEST_DIR").expect("cargo runs build scripts and sets CARGO_MANIFEST_DIR");
    let folder = Path::new(&folder);
    let fingerprint = of(folder, more).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    for watched in [&[SOURCES, MANIFEST, "build.rs"], more].concat() {
        println!("cargo::rerun-if-changed={watched}");
    }
    println!("cargo::rustc-env=LUMISTACK_FINGERPRINT={fingerprint}");
}

/// Returns the fingerprint of the crate in `folder`, 32 hexadecimal digits. For `more` see
/// [`emit`].
///
/// # Errors
/// If a file or folder cannot be read.
pub fn of(folder: &Path, more: &[&str]) -> io::Result<String> {
    let mut files = Vec::new();
    for part in [&[SOURCES], more].concat() {
        collect(&folder.join(part), part, &mut files)?;
    }
    let original = folder.join(ORIGINAL_MANIFEST);
    let manifest = if original.is_file() { original } else { folder.join(MANIFEST) };
    files.push((MANIFEST.into(), manifest));
    files.sort();
    let mut hash = blake3::Hasher::new();
    for (name, path) in files {
        let bytes = fs::read(path)?;
        // hash the lengths too, so that the end of one text cannot pass for the beginning of the
        // next
        for part in [name.as_bytes(), &bytes] {
            hash.update(&(part.len() as u64).to_le_bytes()).update(part);
        }
    }
    Ok(hash.finalize().to_hex()[..32].to_string())
}

/// Adds the files in a folder and its subfolders, under names relative to the crate. Hidden files
/// and compiled Python are left out, since they are not sources.
fn collect(folder: &Path, name: &str, files: &mut Vec<(String, PathBuf)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let Some(own) = path.file_name().and_then(|own| own.to_str()) else { continue };
        if own.starts_with('.') || own == "__pycache__" {
            continue;
        }
        let name = format!("{name}/{own}");
        if path.is_dir() {
            collect(&path, &name, files)?;
        } else {
            files.push((name, path));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(folder: &Path, files: &[(&str, &str)]) {
        for (name, text) in files {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
    }

    const CRATE: [(&str, &str); 4] = [
        ("Cargo.toml", "[package]"),
        ("src/lib.rs", "mod a;"),
        ("src/a/mod.rs", "fn a() {}"),
        ("python/a.py", "a = 1"),
    ];

    #[test]
    fn every_change_to_the_sources_is_another_fingerprint() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &CRATE);
        let first = of(folder.path(), &["python"]).unwrap();
        assert_eq!(first.len(), 32);
        assert_ne!(first, of(folder.path(), &[]).unwrap());
        for (name, text) in CRATE {
            write(folder.path(), &[(name, &format!("{text}\n"))]);
            assert_ne!(of(folder.path(), &["python"]).unwrap(), first, "{name} was changed");
            write(folder.path(), &[(name, text)]);
            assert_eq!(of(folder.path(), &["python"]).unwrap(), first);
        }
        fs::rename(folder.path().join("src/a"), folder.path().join("src/b")).unwrap();
        assert_ne!(of(folder.path(), &["python"]).unwrap(), first, "a module was renamed");
        assert!(of(&folder.path().join("nowhere"), &[]).is_err());
    }

    #[test]
    fn the_same_sources_elsewhere_have_the_same_fingerprint() {
        let [here, there] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        write(here.path(), &CRATE);
        // Write the same sources in another order, next to files that are not sources, and with a
        // packaged manifest. The fingerprint must be the same.
        let mut reversed = CRATE;
        reversed.reverse();
        write(there.path(), &reversed);
        write(there.path(), &[("python/__pycache__/a.pyc", "x"), ("src/.a.rs.swp", "x"), ("target/a", "x")]);
        write(there.path(), &[("Cargo.toml", "# written by cargo\n[package]"), ("Cargo.toml.orig", "[package]")]);
        assert_eq!(of(here.path(), &["python"]).unwrap(), of(there.path(), &["python"]).unwrap());
    }
}
