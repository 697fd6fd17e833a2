//! The Python package: scenes, displays, light fields and patterns as objects that read and return
//! arrays, and the command `lumistack`.
//!
//! ```text
//! Python arrays ──array──▶ LightField ─┐                     ┌──▶ arrays (buffer protocol)
//! Scene ──render──────────▶ LightField ─┴─factorize─▶ LayerStack ──▶ simulate, write, report
//! ```
//!
//! The package is a thin layer on top of the pipeline. The types of job files check settings, so
//! names, defaults and ranges are defined once. Long work runs in a separate thread without
//! Python's lock; the calling thread reports progress and warnings and checks for Ctrl-C
//! (`work.rs`).

mod array;
mod display;
mod error;
mod field;
mod field_methods;
mod functions;
mod json;
mod keep;
mod own;
mod plugin;
mod scene;
mod solved;
mod splats;
mod stack;
mod stored;
mod usd;
mod work;

use pyo3::prelude::*;

/// The compiled part of the package `lumistack`.
#[pymodule]
mod _lumistack {
    use super::*;
    #[pymodule_export]
    use crate::array::Array;
    #[pymodule_export]
    use crate::display::Display;
    #[pymodule_export]
    use crate::field::LightField;
    #[pymodule_export]
    use crate::functions::{
        defaults, displays, factorize, info, main, plugins, render, report, run, set_threads, simulate, write,
    };
    #[pymodule_export]
    use crate::keep::_light_field_with;
    #[pymodule_export]
    use crate::plugin::_plugin_child;
    #[pymodule_export]
    use crate::scene::Scene;
    #[pymodule_export]
    use crate::stack::{_layer_stack_with, LayerStack};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("HAS_PANELS", lumistack_cli::HAS_PANELS)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
