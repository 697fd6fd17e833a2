//! Makes tarballs, zips and Debian packages. Their bytes depend only on their content, and on the
//! time of the commit. A Debian package is an `ar` archive of three files: the version of the
//! package format, and two tarballs.

use std::collections::BTreeSet;
use std::io::Write as _;

use flate2::{Compression, GzBuilder};

use super::tree::File;
use crate::tools::{Outcome, command, output_of};

/// Makes a tarball of files, which are put into one folder.
pub fn tarball(folder: &str, files: &[File]) -> Outcome<Vec<u8>> {
    let entries: Vec<_> = files.iter().map(|file| (format!("{folder}/{}", file.path), file.clone())).collect();
    packed(&entries)
}

/// Makes a zip of files, which are put into one folder. Entries of the zip have no time.
pub fn zip(folder: &str, files: &[File]) -> Outcome<Vec<u8>> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for file in files {
        let mode = if file.runs { 0o755 } else { 0o644 };
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Deflated)
            .unix_permissions(mode);
        archive.start_file(format!("{folder}/{}", file.path), options).map_err(|error| format!("a zip: {error}"))?;
        archive.write_all(&file.bytes).map_err(|error| format!("a zip: {error}"))?;
    }
    Ok(archive.finish().map_err(|error| format!("a zip: {error}"))?.into_inner())
}

/// Makes a Debian package for a processor, which is given by Debian's name.
pub fn deb(architecture: &str, files: &[File]) -> Outcome<Vec<u8>> {
    let mut entries = Vec::new();
    for file in files {
        // Debian's policy: manual pages are compressed, and the licences are in `copyright`
        let (path, bytes) = match file.path.as_str() {
            path if path.starts_with("share/man/") => (format!("{path}.gz"), gzipped(&file.bytes)?),
            "share/doc/lumistack/THIRD-PARTY.txt" => ("share/doc/lumistack/copyright".into(), copyright(files, file)),
            path => (path.to_owned(), file.bytes.clone()),
        };
        let path = format!("usr/{path}");
        entries.push((format!("./{path}"), File { path, bytes, runs: file.runs }));
    }
    let size = entries.iter().map(|(_, file)| file.bytes.len().div_ceil(1024)).sum::<usize>();
    let control = format!(
        "Package: lumistack\nVersion: {}\nArchitecture: {architecture}\nMaintainer: Lumistack <lumistack@localhost>\nInstalled-Size: {size}\n\
         Depends: libc6 (>= 2.17)\nRecommends: libvulkan1, libwayland-client0, libxkbcommon0\nSuggests: blender, python3 (>= 3.9)\n\
         Section: graphics\nPriority: optional\nDescription: 3D scenes to patterns for layered glasses-free displays\n \
         Path-traces the light field that a viewer should see and factorizes it into\n the layer patterns of a tensor display.\n",
        env!("CARGO_PKG_VERSION")
    );
    let control = File { path: "control".into(), runs: false, bytes: control.into_bytes() };
    let mut archive = b"!<arch>\n".to_vec();
    member(&mut archive, "debian-binary", b"2.0\n");
    member(&mut archive, "control.tar.gz", &packed(&[("./control".into(), control)])?);
    member(&mut archive, "data.tar.gz", &packed(&entries)?);
    Ok(archive)
}

/// Returns the text of `copyright`: Lumistack's licences, then the licences of its dependencies.
fn copyright(files: &[File], parts: &File) -> Vec<u8> {
    let own =
        ["LICENSE-MIT", "LICENSE-APACHE"].iter().filter_map(|name| files.iter().find(|file| file.path.ends_with(name)));
    let mut text = b"Lumistack: MIT OR Apache-2.0\n\n".to_vec();
    for file in own.chain([parts]) {
        text.extend_from_slice(&file.bytes);
        text.push(b'\n');
    }
    text
}

/// Appends a file to an `ar` archive.
fn member(archive: &mut Vec<u8>, name: &str, bytes: &[u8]) {
    let header = format!("{name:<16}{:<12}{:<6}{:<6}{:<8}{:<10}`\n", time(), 0, 0, 100_644, bytes.len());
    archive.extend_from_slice(header.as_bytes());
    archive.extend_from_slice(bytes);
    if bytes.len() % 2 == 1 {
        archive.push(b'\n');
    }
}

/// Returns the time that all files get, in seconds since 1970: `SOURCE_DATE_EPOCH` if it is set,
/// else the time of the commit.
fn time() -> u64 {
    let asked = std::env::var("SOURCE_DATE_EPOCH").ok();
    let commit = || output_of(command("git").args(["log", "-1", "--format=%ct"]));
    asked.or_else(commit).and_then(|text| text.trim().parse().ok()).unwrap_or(0)
}

fn packed(entries: &[(String, File)]) -> Outcome<Vec<u8>> {
    let failed = |error: std::io::Error| format!("a tarball: {error}");
    let mut archive = tar::Builder::new(Vec::new());
    let header = |kind, mode: u32, size: usize| {
        let mut header = tar::Header::new_gnu();
        header.set_entry_type(kind);
        header.set_mode(mode);
        header.set_size(size as u64);
        header.set_mtime(time());
        header
    };
    // add every folder before its files, as installers expect
    let folders: BTreeSet<String> =
        entries.iter().flat_map(|(path, _)| path.match_indices('/').map(|(end, _)| path[..=end].to_owned())).collect();
    for folder in folders {
        archive.append_data(&mut header(tar::EntryType::Directory, 0o755, 0), folder, &[][..]).map_err(failed)?;
    }
    for (path, file) in entries {
        let mode = if file.runs { 0o755 } else { 0o644 };
        let mut header = header(tar::EntryType::Regular, mode, file.bytes.len());
        archive.append_data(&mut header, path, file.bytes.as_slice()).map_err(failed)?;
    }
    gzipped(&archive.into_inner().map_err(failed)?)
}

fn gzipped(bytes: &[u8]) -> Outcome<Vec<u8>> {
    let failed = |error: std::io::Error| format!("gzip: {error}");
    let mut gzip = GzBuilder::new().mtime(0).write(Vec::new(), Compression::best());
    gzip.write_all(bytes).map_err(failed)?;
    gzip.finish().map_err(failed)
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    fn files() -> Vec<File> {
        let file = |path: &str, runs, bytes: &[u8]| File { path: path.into(), runs, bytes: bytes.to_vec() };
        vec![
            file("bin/lumistack", true, b"program"),
            file("share/man/man1/lumistack.1", false, b"page"),
            file("share/doc/lumistack/LICENSE-MIT", false, b"MIT text"),
            file("share/doc/lumistack/THIRD-PARTY.txt", false, b"parts"),
        ]
    }

    fn names(gzip: &[u8]) -> Vec<(String, u32)> {
        let mut archive = tar::Archive::new(flate2::read::GzDecoder::new(gzip));
        let entries = archive.entries().unwrap().map(Result::unwrap);
        entries.map(|entry| (entry.path().unwrap().display().to_string(), entry.header().mode().unwrap())).collect()
    }

    #[test]
    fn a_tarball_has_folders_before_files_and_the_same_bytes_again() {
        let bytes = tarball("lumistack-1", &files()).unwrap();
        assert_eq!(bytes, tarball("lumistack-1", &files()).unwrap());
        let names = names(&bytes);
        let at = |name: &str| names.iter().position(|(known, _)| known == name).unwrap_or_else(|| panic!("{names:?}"));
        assert!(at("lumistack-1/bin/") < at("lumistack-1/bin/lumistack"));
        assert_eq!(names[at("lumistack-1/bin/lumistack")].1, 0o755);
    }

    #[test]
    fn a_zip_has_every_file_and_the_same_bytes_again() {
        let bytes = zip("lumistack-1", &files()).unwrap();
        assert_eq!(bytes, zip("lumistack-1", &files()).unwrap());
        let mut archive = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
        assert_eq!(archive.len(), files().len());
        let mut content = String::new();
        archive.by_name("lumistack-1/bin/lumistack").unwrap().read_to_string(&mut content).unwrap();
        assert_eq!(content, "program");
    }

    #[test]
    fn a_package_has_what_debian_requires() {
        let bytes = deb("amd64", &files()).unwrap();
        let mut rest = bytes.strip_prefix(b"!<arch>\n").unwrap();
        let mut members = Vec::new();
        while !rest.is_empty() {
            let size: usize = std::str::from_utf8(&rest[48..58]).unwrap().trim().parse().unwrap();
            members.push((std::str::from_utf8(&rest[..16]).unwrap().trim().to_owned(), rest[60..60 + size].to_vec()));
            rest = &rest[60 + size.next_multiple_of(2)..];
        }
        assert_eq!(
            members.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(),
            ["debian-binary", "control.tar.gz", "data.tar.gz"]
        );
        let names = names(&members[2].1);
        for name in
            ["./usr/bin/lumistack", "./usr/share/man/man1/lumistack.1.gz", "./usr/share/doc/lumistack/copyright"]
        {
            assert!(
                names.iter().any(|(known, _)| known.trim_start_matches("./") == name.trim_start_matches("./")),
                "{names:?}"
            );
        }
        let mut control = String::new();
        let mut archive = tar::Archive::new(flate2::read::GzDecoder::new(members[1].1.as_slice()));
        let mut entries = archive.entries().unwrap().map(Result::unwrap).filter(|entry| entry.size() > 0);
        entries.next().unwrap().read_to_string(&mut control).unwrap();
        assert!(control.contains("\nArchitecture: amd64\n") && control.ends_with(".\n"), "{control}");
    }
}
