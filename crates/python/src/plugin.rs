//! Plugins in libraries: each runs in a process of its own, which is this Python again.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::OnceLock;

use lumistack_cli::Launcher;
use lumistack_pipeline::Registry;
use pyo3::prelude::*;

use crate::error::raised;

/// The child's program; its first argument is the folder in which this package lies, which need not be on the child's
/// own path.
const BOOT: &str = "import sys; sys.path.insert(0, sys.argv[1]); from lumistack._lumistack import _plugin_child; \
                    sys.exit(_plugin_child(sys.argv[2:]))";

/// The plugins, found once.
pub(crate) fn registry(py: Python<'_>) -> PyResult<&'static Registry> {
    static REGISTRY: OnceLock<Registry> = OnceLock::new();
    if let Some(registry) = REGISTRY.get() {
        return Ok(registry);
    }
    set_launcher(py);
    let found = py.detach(|| lumistack_pipeline::plugins(&[])).map_err(|error| raised(py, &error))?;
    Ok(REGISTRY.get_or_init(|| found))
}

/// Says how a process for a plugin is started. Without a Python to start there is none, which is told where a plugin
/// needs it.
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
        return Err(pyo3::exceptions::PyRuntimeError::new_err("Python does not know its own program"));
    }
    Ok(Launcher { program, args: vec!["-c".into(), BOOT.into(), folder] })
}

/// The whole work of a process that runs a plugin for another: its exit code.
#[pyfunction]
pub(crate) fn _plugin_child(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    // the plugin works on this thread, the main one
    py.detach(|| lumistack_cli::plugin_child(&arguments))
}
