//! Plugins in libraries. Each plugin runs in a child process: a new process of the same Python
//! interpreter.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::OnceLock;

use lumistack_cli::Launcher;
use lumistack_pipeline::Registry;
use pyo3::prelude::*;

use crate::error::raised;

/// Python program of a child process. Its first argument is the folder that contains this package:
/// this folder may be missing in the child's `sys.path`.
const BOOT: &str = "import sys; sys.path.insert(0, sys.argv[1]); from lumistack._lumistack import _plugin_child; \
                    sys.exit(_plugin_child(sys.argv[2:]))";

/// Returns the plugins. The first call searches for them.
pub(crate) fn registry(py: Python<'_>) -> PyResult<&'static Registry> {
    static REGISTRY: OnceLock<Registry> = OnceLock::new();
    if let Some(registry) = REGISTRY.get() {
        return Ok(registry);
    }
    set_launcher(py);
    let found = py.detach(|| lumistack_pipeline::plugins(&[])).map_err(|error| raised(py, &error))?;
    Ok(REGISTRY.get_or_init(|| found))
}

/// Sets the command that starts a plugin's process. Without this call, plugins in libraries report
/// an error, since they run in processes of their own.
pub(crate) fn set_launcher(py: Python<'_>) {
    if let Ok(launcher) = launcher(py) {
        launcher.set_for_process();
    }
}

fn launcher(py: Python<'_>) -> PyResult<Launcher> {
    let program: PathBuf = py.import("sys")?.getattr("executable")?.extract()?;
    let package: PathBuf = py.import("lumistack")?.getattr("__path__")?.get_item(0)?.extract()?;
    let folder = package.parent().unwrap_or(&package).as_os_str().to_owned();
    if program.as_os_str().is_empty() {
        return Err(pyo3::exceptions::PyRuntimeError::new_err(
            "sys.executable: expected the path of the interpreter, found none",
        ));
    }
    Ok(Launcher { program, args: vec!["-c".into(), BOOT.into(), folder] })
}

/// Runs a plugin in this child process for its parent process; returns the exit code.
#[pyfunction]
pub(crate) fn _plugin_child(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    // release Python's lock, since the plugin runs in this thread and calls no Python code
    py.detach(|| lumistack_cli::plugin_child(&arguments))
}
