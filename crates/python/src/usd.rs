//! Reads USD in the caller's own Python. For this, the module runs the walker of `lumistack-usd`
//! (Python code that traverses a stage), and reads the walker's arrays without a copy.

use std::ffi::CString;
use std::path::Path;

use lumistack_pipeline::{PipelineError, PoseJob};
use lumistack_usd::{Header, MODULES, Package, UsdError};
use pyo3::buffer::PyUntypedBuffer;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyModule};

use crate::error::{exception, raised, setting};

/// A scene as the walker returns it.
pub(crate) struct Walked {
    pub(crate) header: Header,
    text: Vec<u8>,
    buffers: Vec<PyUntypedBuffer>,
}

impl Walked {
    /// Returns the input of [`lumistack_usd::scene_from_package`].
    pub(crate) fn package(&self) -> Package<'_> {
        Package { header: self.header.clone(), buffers: self.buffers.iter().map(bytes).collect() }
    }

    /// Returns all bytes that the walker made. Their hash is part of the scene's key, which
    /// distinguishes cached results.
    pub(crate) fn content(&self) -> Vec<&[u8]> {
        std::iter::once(&*self.text).chain(self.buffers.iter().map(bytes)).collect()
    }
}

fn bytes(buffer: &PyUntypedBuffer) -> &[u8] {
    if buffer.len_bytes() == 0 {
        return &[];
    }
    // SAFETY: the exporter keeps memory and size of a buffer while it is held, and `walk` keeps
    // only row-major buffers. Nothing writes to them: they belong to the walker, or to OpenUSD,
    // which copies values before it writes.
    unsafe { std::slice::from_raw_parts(buffer.buf_ptr().cast::<u8>(), buffer.len_bytes()) }
}

/// Returns true if this Python has OpenUSD.
pub(crate) fn is_here(py: Python<'_>) -> bool {
    py.import("pxr.Usd").is_ok()
}

/// Returns true if an object is a stage of OpenUSD.
pub(crate) fn is_stage(object: &Bound<'_, PyAny>) -> bool {
    // If `pxr.Usd` is not loaded, no stage exists. The function does not import `pxr.Usd`, since
    // the import is slow.
    let modules = object.py().import("sys").and_then(|sys| sys.getattr("modules"));
    let stage = modules.and_then(|modules| modules.get_item("pxr.Usd")).and_then(|usd| usd.getattr("Stage"));
    stage.and_then(|stage| object.is_instance(&stage)).unwrap_or(false)
}

/// Traverses a stage of the caller, or a file.
pub(crate) fn walk(py: Python<'_>, stage: Option<&Bound<'_, PyAny>>, path: &Path, pose: &PoseJob) -> PyResult<Walked> {
    // Refuse settings that have no effect on this stage or file.
    if stage.is_some() && !pose.variants.is_empty() {
        let message =
            "variants: expected no variants with a stage, since the stage's own selections are used, found some";
        return Err(setting(py, message));
    }
    let unused = [
        ("animation", "a USD stage has only one timeline", &pose.animation),
        ("variant", "USD scenes use the key `variants`", &pose.variant),
    ];
    for (name, reason, value) in unused {
        if let Some(value) = value {
            return Err(setting(py, format!("{name}: expected no value, since {reason}, found {value}")));
        }
    }
    if stage.is_none() && !path.exists() {
        let source = std::io::Error::from(std::io::ErrorKind::NotFound);
        return Err(raised(py, &PipelineError::Read { path: path.into(), source }));
    }
    // Run the walker. If it refuses the file, raise an error of the scene. Raise all other
    // exceptions unchanged.
    let modules = modules(py)?;
    let request = PyDict::new(py);
    request.set_item("path", path.to_string_lossy())?;
    request.set_item("time_s", pose.time_s)?;
    request.set_item("variants", &pose.variants)?;
    let writer = modules.getattr("walk")?.call_method1("walk", (request, stage)).map_err(|error| {
        let refused = modules.getattr("writer").and_then(|writer| writer.getattr("Refused"));
        match refused {
            Ok(refused) if error.matches(py, &refused).unwrap_or(false) => {
                let message = error.value(py).to_string();
                raised(py, &UsdError::Refused { file: path.display().to_string(), message }.into())
            }
            _ => error,
        }
    })?;
    let text = writer.call_method0("header_text")?;
    let text = text.cast::<PyBytes>()?.as_bytes().to_vec();
    let header = Header::parse(&text).map_err(|error| {
        exception(
            py,
            "InternalError",
            &format!(
                "{}: internal error, a bug in Lumistack: {error}; please report the error with the file",
                path.display()
            ),
        )
    })?;
    // Keep the arrays; arrays with gaps are copied.
    let mut buffers = Vec::new();
    for view in writer.getattr("buffers")?.try_iter()? {
        let view = view?;
        let buffer = PyUntypedBuffer::get(&view)?;
        buffers.push(if buffer.is_c_contiguous() {
            buffer
        } else {
            PyUntypedBuffer::get(&view.call_method0("tobytes")?)?
        });
    }
    Ok(Walked { header, text, buffers })
}

/// Imports the walker as the Python package `lumistack_usd`. Its sources are part of the crate of
/// the same name.
fn modules(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    const PACKAGE: &str = "lumistack_usd";
    let known = py.import("sys")?.getattr("modules")?;
    if let Ok(package) = known.get_item(PACKAGE) {
        return Ok(package);
    }
    let package = PyModule::new(py, PACKAGE)?;
    package.setattr("__path__", Vec::<String>::new())?;
    known.set_item(PACKAGE, &package)?;
    let made = || -> PyResult<()> {
        for (name, source) in MODULES {
            let text = |text: String| CString::new(text).expect("no file of ours holds a zero");
            let (code, file) = (text(source.into()), text(format!("{PACKAGE}/{name}.py")));
            let module = PyModule::from_code(py, &code, &file, &text(format!("{PACKAGE}.{name}")))?;
            package.setattr(name, module)?;
        }
        Ok(())
    };
    if let Err(error) = made() {
        known.del_item(PACKAGE)?;
        return Err(error);
    }
    Ok(package.into_any())
}
