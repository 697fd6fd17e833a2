//! Where the tests find libraries.

#![allow(dead_code, reason = "each test uses a part")]

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::PathBuf;

/// What a plugin's library is called.
pub fn file_name(id: &str) -> String {
    format!("{DLL_PREFIX}lumistack_plugin_{id}{DLL_SUFFIX}")
}

/// A plugin of the folder `examples`, which cargo builds with the tests.
pub fn example(id: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let folder = test.parent().and_then(|deps| deps.parent()).unwrap().join("examples");
    let library = folder.join(file_name(id));
    assert!(library.exists(), "{}: cargo builds it unless a single test target is asked for", library.display());
    library
}
