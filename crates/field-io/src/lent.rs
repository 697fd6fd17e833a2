//! Tests of arrays that stay in their files (`mapped.rs`).

use std::path::Path;

use lumistack_core::Lender;

use crate::mapped::lend;
use crate::npy::{self, NpyFile};

const VALUES: [f32; 6] = [0.0, 0.25, 0.5, -1.5, f32::MAX, 1e-40];

fn lent(path: &Path) -> Option<Lender> {
    NpyFile::open(path).unwrap().lent(0)
}

#[test]
fn lent_values_are_the_values_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    npy::write(&path, &[2, 3], &VALUES).unwrap();
    assert_eq!(lent(&path).unwrap().values(), VALUES);
    assert!(NpyFile::open(&path).unwrap().lent(25).is_none(), "the file has 24 bytes of values");
    // a part of the file
    let file = lumistack_files::open(&path).unwrap();
    let first = lumistack_files::length(&file).unwrap() - 8;
    assert_eq!(lend(&file, first, 2).unwrap().values(), &VALUES[4..]);
    assert!(lend(&file, first + 8, 0).unwrap().values().is_empty());
}

#[test]
fn short_and_unaligned_files_are_not_lent() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    npy::write(&path, &[6], &VALUES).unwrap();
    let file = lumistack_files::open(&path).unwrap();
    let first = lumistack_files::length(&file).unwrap() - 24;
    assert!(lend(&file, first, 6).is_some() && lend(&file, first, 7).is_none());
    assert!((1..4).all(|by| lend(&file, first - by, 6).is_none()));
    // NumPy's headers end at a multiple of 64 bytes, but headers of other programs may not
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.insert(first as usize - 1, b' ');
    bytes[8] += 1;
    std::fs::write(&path, bytes).unwrap();
    assert!(lent(&path).is_none());
    assert_eq!(npy::read(&path).unwrap().1, VALUES);
    std::fs::write(&path, b"").unwrap();
    assert!(lend(&lumistack_files::open(&path).unwrap(), 0, 1).is_none());
}

#[test]
fn a_lent_file_can_be_replaced_and_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let count = || std::fs::read_dir(folder.path()).unwrap().count();
    npy::write(&path, &[6], &VALUES).unwrap();
    let old = lent(&path).unwrap();
    npy::write(&path, &[1], &[7.0]).unwrap();
    assert_eq!(npy::read(&path).unwrap().1, [7.0]);
    let new = lent(&path).unwrap();
    crate::atomic::remove(&path).unwrap();
    assert!(!path.exists());
    assert_eq!((old.values(), new.values()), (&VALUES[..], &[7.0][..]));
    // on Windows the mapped files still exist, as temporary files that a later run removes
    assert!(count() == 0 || cfg!(windows) && count() <= 2);
    drop((old, new));
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        let file = std::fs::File::options().write(true).open(&path).unwrap();
        file.set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
        drop(file);
        assert!(crate::atomic::is_abandoned(&path), "{}", path.display());
        std::fs::remove_file(path).unwrap();
    }
}
