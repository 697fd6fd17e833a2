//! Files of a web page, which are held in memory under relative paths.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{self, Cursor, ErrorKind};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// A file, open for reading.
pub type File = Cursor<Arc<[u8]>>;

thread_local! {
    static FILES: RefCell<BTreeMap<PathBuf, Arc<[u8]>>> = const { RefCell::new(BTreeMap::new()) };
}

/// Replaces all files in memory by `files`.
pub fn hold(files: impl IntoIterator<Item = (String, Vec<u8>)>) {
    let files = files.into_iter().map(|(path, bytes)| (plain(Path::new(&path)), bytes.into())).collect();
    FILES.set(files);
}

/// Returns the path without `.` and `..`. Only those `..` stay that lead above the path's first
/// folder.
pub(crate) fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if plain.pop() => {}
            other => plain.push(other),
        }
    }
    plain
}

fn missing() -> io::Error {
    io::Error::new(
        ErrorKind::NotFound,
        "the file is not among the opened files; open the folder that contains the file",
    )
}

pub(crate) fn open(path: &Path) -> io::Result<File> {
    FILES.with_borrow(|files| files.get(&plain(path)).cloned()).map(Cursor::new).ok_or_else(missing)
}

pub(crate) fn length(file: &File) -> io::Result<u64> {
    Ok(file.get_ref().len() as u64)
}

pub(crate) fn canonical(path: &Path) -> io::Result<PathBuf> {
    if is_file(path) || is_folder(path)? { Ok(plain(path)) } else { Err(missing()) }
}

pub(crate) fn is_file(path: &Path) -> bool {
    FILES.with_borrow(|files| files.contains_key(&plain(path)))
}

pub(crate) fn is_folder(path: &Path) -> io::Result<bool> {
    let path = plain(path);
    FILES.with_borrow(|files| match files.keys().any(|file| *file != path && file.starts_with(&path)) {
        true => Ok(true),
        false if files.contains_key(&path) => Ok(false),
        false => Err(missing()),
    })
}

pub(crate) fn list(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let within = plain(folder);
    let mut names: Vec<PathBuf> = FILES.with_borrow(|files| {
        let below = files.keys().filter_map(|file| file.strip_prefix(&within).ok());
        below.filter_map(|rest| rest.components().next()).map(|name| folder.join(name)).collect()
    });
    // names are sorted, so a subfolder with several files gives equal names in a row; keep one of
    // them
    names.dedup();
    Ok(names)
}
