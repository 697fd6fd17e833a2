//! Locations of test libraries, and the program that loads them.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX, EXE_SUFFIX};
use std::path::PathBuf;

use lumistack_plugin_host::{Launcher, PluginPaths};

/// Runs only in a second process of this test program. `lumistack_testkit::console` starts that
/// process to send Ctrl-C to a program, or to read the text that a program writes to a console.
#[cfg(windows)]
#[test]
fn helps() {
    lumistack_testkit::console::help();
}

/// Returns the file name of a plugin's library.
pub fn file_name(id: &str) -> String {
    format!("{DLL_PREFIX}lumistack_plugin_{id}{DLL_SUFFIX}")
}

/// Returns the library of a plugin in the folder `examples`, which cargo builds with the tests.
pub fn example(id: &str) -> PathBuf {
    built(&file_name(id))
}

/// Returns the launcher of the program that runs plugins for these tests.
pub fn child() -> Launcher {
    Launcher { program: built(&format!("plugin_child{EXE_SUFFIX}")), args: Vec::new() }
}

/// Returns search paths with the given files and folders, and with [`child`] as launcher.
pub fn paths(named: Vec<PathBuf>) -> PluginPaths {
    PluginPaths { named, launcher: Some(child()), ..PluginPaths::default() }
}

fn built(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let folder = test.parent().and_then(|deps| deps.parent()).unwrap().join("examples");
    let file = folder.join(name);
    assert!(
        file.exists(),
        "{}: expected this file, which cargo builds unless a single test target is requested",
        file.display()
    );
    file
}
