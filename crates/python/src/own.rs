//! Calls functions of the package that are written in Python, for notebooks and other libraries.

use pyo3::call::PyCallArgs;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Calls a function of `lumistack` itself.
pub(crate) fn in_python<'py>(
    py: Python<'py>,
    function: &str,
    arguments: impl PyCallArgs<'py>,
    named: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    py.import("lumistack")?.getattr(function)?.call(arguments, named)
}

/// Calls a function of one of the package's own modules.
pub(crate) fn in_package<'py>(
    py: Python<'py>,
    module: &str,
    function: &str,
    arguments: impl PyCallArgs<'py>,
    named: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    py.import(format!("lumistack.{module}"))?.getattr(function)?.call(arguments, named)
}
