//! Files of the operating system.

use std::fs::{self, FileType};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// A file, open for reading.
pub use std::fs::File;

pub(crate) fn open(path: &Path) -> io::Result<File> {
    // check before opening: opening a pipe would wait for a writer, and opening a device may have
    // effects
    check_kind(fs::metadata(path)?.file_type())?;
    let file = File::open(path)?;
    // check again, since the path may lead to another file by now
    check_kind(file.metadata()?.file_type())?;
    Ok(file)
}

pub(crate) fn length(file: &File) -> io::Result<u64> {
    Ok(file.metadata()?.len())
}

pub(crate) fn canonical(path: &Path) -> io::Result<PathBuf> {
    path.canonicalize()
}

pub(crate) fn is_file(path: &Path) -> bool {
    path.is_file()
}

pub(crate) fn is_folder(path: &Path) -> io::Result<bool> {
    Ok(fs::metadata(path)?.is_dir())
}

pub(crate) fn list(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
    found.sort();
    Ok(found)
}

fn check_kind(kind: FileType) -> io::Result<()> {
    if kind.is_file() {
        return Ok(());
    }
    let (error, found) =
        if kind.is_dir() { (ErrorKind::IsADirectory, "a folder") } else { (ErrorKind::InvalidInput, special(kind)) };
    Err(io::Error::new(error, format!("expected a regular file, found {found}")))
}

#[cfg(unix)]
fn special(kind: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    match kind {
        _ if kind.is_fifo() => "a pipe",
        _ if kind.is_char_device() || kind.is_block_device() => "a device",
        _ if kind.is_socket() => "a socket",
        _ => "another kind of file",
    }
}

#[cfg(not(unix))]
fn special(_kind: FileType) -> &'static str {
    "another kind of file"
}
