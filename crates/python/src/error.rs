//! Converts errors of the pipeline to Python exceptions, with the messages of the command. The
//! classes are in `lumistack/_errors.py`.

use std::io::ErrorKind;

use lumistack_factorizer::FactorizeError;
use lumistack_field_io::FieldError;
use lumistack_pipeline::{PipelineError, Place};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

/// Returns the exception for an error of the pipeline.
pub(crate) fn raised(py: Python<'_>, error: &PipelineError) -> PyErr {
    if matches!(error, PipelineError::Cancelled) {
        return PyKeyboardInterrupt::new_err(());
    }
    exception(py, class_of(error), &in_python(&error.to_string()))
}

/// Returns an exception of the package, given the name of its class.
pub(crate) fn exception(py: Python<'_>, class: &str, message: &str) -> PyErr {
    let made = || py.import("lumistack._errors")?.getattr(class)?.call1((message,));
    match made() {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

/// Returns the exception for an invalid value.
pub(crate) fn setting(py: Python<'_>, message: impl AsRef<str>) -> PyErr {
    exception(py, "SettingError", message.as_ref())
}

/// Settings of a job that are arguments of functions.
const ARGUMENTS: [&str; 30] = [
    "angular_filter",
    "brightness",
    "camera",
    "clamp",
    "coarse_iterations",
    "coarse_levels",
    "denoise",
    "depth_scale",
    "exposure_ev",
    "eye_floor",
    "eyes",
    "fit_depth",
    "fov_deg",
    "frames",
    "iterations",
    "lens_deg",
    "levels",
    "look_from",
    "max_bounces",
    "missing",
    "resolution",
    "samples",
    "sampling",
    "seed",
    "solver",
    "start",
    "tone",
    "views",
    "zone_directions",
    "zone_samples",
];

/// Converts an error about a value of a job: its place becomes the function `call`, and its key the
/// argument. Other errors stay unchanged.
pub(crate) fn of_call(call: &str, error: PipelineError) -> PipelineError {
    match error {
        PipelineError::Value(bad) if bad.place == Place::Job => {
            let argument = bad.key.split_once('.').map_or(&*bad.key, |(_, name)| name);
            let key = if ARGUMENTS.contains(&argument) { argument } else { &bad.key };
            PipelineError::value(call, key, bad.expected, bad.found)
        }
        error => error,
    }
}

fn class_of(error: &PipelineError) -> &'static str {
    let file = |kind: ErrorKind| if kind == ErrorKind::NotFound { "MissingFileError" } else { "FileError" };
    match error {
        PipelineError::Read { source, .. } | PipelineError::Write { source, .. } => file(source.kind()),
        PipelineError::Field(FieldError::Io { source, .. }) => file(source.kind()),
        PipelineError::NotAFolder { .. } => "FileError",
        PipelineError::Field(FieldError::Malformed { place, .. }) if place == "output folder" => "FileError",
        PipelineError::Config { .. }
        | PipelineError::Display { .. }
        | PipelineError::UnknownDisplay { .. }
        | PipelineError::Value(_)
        | PipelineError::Weights { .. } => "SettingError",
        PipelineError::Gltf(_) | PipelineError::Usd(_) | PipelineError::Scene { .. } | PipelineError::Window { .. } => {
            "SceneError"
        }
        PipelineError::Field(_) | PipelineError::Grid(_) | PipelineError::Stack { .. } => "DataError",
        PipelineError::Factorize(FactorizeError::UnknownSolver { .. }) => "SettingError",
        PipelineError::Render(_) => "RenderError",
        PipelineError::Factorize(_) => "FactorizeError",
        PipelineError::Output(_) => "PluginError",
        _ => "Error",
    }
}

/// Pairs of a text in error messages of the command line, usually a flag, and the text that
/// replaces it in Python.
const FLAGS: [(&str, &str); 25] = [
    ("--fit-depth=compress", "fit_depth=\"compress\""),
    ("--fit-depth", "fit_depth=\"move\""),
    ("--look-from AZ,EL", "look_from"),
    ("--near=off", "window={\"near\": \"off\"}"),
    ("--camera", "camera"),
    ("--pitch-mm 0.5", "pitch_mm=0.5"),
    ("--fov 20x20", "fov_deg=(20, 20)"),
    ("--distance-mm 600", "distance_mm=600"),
    ("--grid oblique", "grid=\"oblique\""),
    ("--pitch-mm", "pitch_mm"),
    ("--fov", "fov_deg"),
    ("--distance-mm", "distance_mm"),
    ("--grid", "grid"),
    ("--views", "views"),
    ("--view: X,Y", "angle_deg"),
    ("--eye: X,Y,Z", "eye_mm"),
    ("--quilt", "quilt"),
    ("--tiles", "tiles"),
    ("--resolution", "resolution"),
    ("--focus-px", "focus_px"),
    ("--mirror", "mirror"),
    ("--threads: N", "set_threads"),
    ("`light.automatic = false`", "light={\"automatic\": False}"),
    ("weights: weights: ", "weights: "),
    ("`lumistack displays` lists the presets", "lumistack.displays() lists the presets"),
];

/// Replaces flags of the command in a message by Python's arguments.
pub(crate) fn in_python(message: &str) -> String {
    FLAGS.iter().fold(message.into(), |text, (flag, name)| text.replace(flag, name))
}
