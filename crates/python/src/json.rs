//! Converts settings from Python to JSON, and results from JSON to Python, so that the types of job
//! files check the settings.

use std::path::PathBuf;

use lumistack_core::config::{nearest_key, plain};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PySequence, PyString};
use serde::de::DeserializeOwned;
use serde_json::{Map, Number, Value};

use crate::error::setting;

/// Arguments of a Python function by name; `None` means that the setting keeps its default.
pub(crate) type Arguments<'a, 'py> = &'a [(&'a str, Option<&'a Bound<'py, PyAny>>)];

pub(crate) fn table<T: DeserializeOwned>(py: Python<'_>, place: &str, arguments: Arguments<'_, '_>) -> PyResult<T> {
    let mut map = Map::new();
    for (name, value) in arguments {
        if let Some(value) = value {
            map.insert((*name).into(), value_of(place, value)?);
        }
    }
    parsed(py, place, map)
}

/// Reads a mapping as a table of settings.
pub(crate) fn table_of<T: DeserializeOwned>(place: &str, mapping: &Bound<'_, PyAny>) -> PyResult<T> {
    parsed(mapping.py(), place, map_of(place, mapping)?)
}

/// Reads a number, or a list of numbers from a sequence or a NumPy array.
pub(crate) fn numbers<T: DeserializeOwned>(place: &str, value: Option<&Bound<'_, PyAny>>) -> PyResult<Option<T>> {
    let Some(value) = value.filter(|value| !value.is_none()) else { return Ok(None) };
    let json = value_of(place, value)?;
    let error = match serde_json::from_value(json.clone()) {
        Ok(numbers) => return Ok(Some(numbers)),
        Err(error) => error.to_string(),
    };
    let fits = |value: Value| serde_json::from_value::<T>(value).is_ok();
    Err(setting(value.py(), format!("{place}: {}", sentence(&error, place, &json, fits))))
}

/// Reads a table; an error names the key of the wrong value.
pub(crate) fn parsed<T: DeserializeOwned>(py: Python<'_>, place: &str, map: Map<String, Value>) -> PyResult<T> {
    let error = match serde_json::from_value::<T>(Value::Object(map.clone())) {
        Ok(table) => return Ok(table),
        Err(error) => error.to_string(),
    };
    // Find the key of the wrong value: for each key, parse a table with this key alone. Most tables
    // have defaults for all other keys, so only the table with the wrong value gives the same
    // error.
    let alone = |(key, value): (String, Value)| {
        let found = serde_json::from_value::<T>(Value::Object(Map::from_iter([(key.clone(), value)]))).err()?;
        (found.to_string() == error && !error.contains(&format!("`{key}`"))).then_some(key)
    };
    // An error about a missing key also occurs for the empty table, and no given key causes it.
    let empty = serde_json::from_value::<T>(Value::Object(Map::new())).err();
    let is_lack = empty.is_some_and(|empty| empty.to_string() == error);
    let key = if is_lack { None } else { map.clone().into_iter().find_map(alone) }.unwrap_or_default();
    let value = map.get(&key).cloned().unwrap_or_default();
    let fits =
        |value: Value| serde_json::from_value::<T>(Value::Object(Map::from_iter([(key.clone(), value)]))).is_ok();
    let plainly = sentence(&error, &key, &value, fits);
    let key = if key.is_empty() { String::new() } else { format!("{key}: ") };
    let near = nearest_key(&error).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
    Err(setting(py, format!("{place}: {key}{plainly}{near}")))
}

/// Translates serde's sentence about a wrong value into terms of Python. `fits` returns true for
/// values that the key accepts.
fn sentence(error: &str, key: &str, value: &Value, fits: impl Fn(Value) -> bool) -> String {
    // If a list is too long, find the accepted length.
    if let (true, Value::Array(items)) = (error.contains("expected fewer elements"), value)
        && let Some(count) = (0..items.len()).rev().find(|count| fits(Value::Array(items[..*count].to_vec())))
    {
        return format!("expected a list of {count} values, found a list of length {}", items.len());
    }
    if let Some((found, names)) =
        error.strip_prefix("unknown variant `").and_then(|rest| rest.split_once("`, expected "))
    {
        return format!("expected {}, found `{found}`", names.replace('`', ""));
    }
    if let Some(name) = error.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        return format!("expected a value for `{name}`, found none");
    }
    // In job files, a table {percent = ...} is a path with unusual bytes.
    if error.ends_with("expected `percent`") {
        return "expected a path, found a mapping".into();
    }
    let plainly = plain(error, key);
    if FROM_ONE.contains(&key) {
        return plainly.replace("a whole number, 0 or more", "a whole number above 0");
    }
    plainly
}

/// Settings that are whole numbers above 0.
const FROM_ONE: [&str; 3] = ["frames", "samples", "zone_samples"];

/// Converts a mapping whose keys are names.
pub(crate) fn map_of(place: &str, mapping: &Bound<'_, PyAny>) -> PyResult<Map<String, Value>> {
    match value_of(place, mapping)? {
        Value::Object(map) => Ok(map),
        _ => {
            let found = mapping.get_type().name()?;
            Err(PyTypeError::new_err(format!("{place}: expected a mapping of settings, found {found}")))
        }
    }
}

/// Converts a value to JSON: numbers, texts, paths, mappings and sequences of such values, and
/// NumPy's numbers and arrays.
pub(crate) fn value_of(place: &str, value: &Bound<'_, PyAny>) -> PyResult<Value> {
    if value.is_none() {
        return Ok(Value::Null);
    }
    if let Ok(yes) = value.cast::<PyBool>() {
        return Ok(yes.is_true().into());
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(text.to_string().into());
    }
    if value.is_instance_of::<PyInt>() {
        return integer(value);
    }
    if value.is_instance_of::<PyFloat>() {
        return float(place, value);
    }
    if let Ok(mapping) = value.cast::<PyMapping>() {
        let mut map = Map::new();
        for item in mapping.items()? {
            let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
            let Ok(key) = key.cast::<PyString>() else {
                let found = key.get_type().name()?;
                return Err(PyTypeError::new_err(format!("{place}: expected strings (str) as keys, found {found}")));
            };
            // None means that the argument is absent
            if !value.is_none() {
                map.insert(key.to_string(), value_of(place, &value)?);
            }
        }
        return Ok(Value::Object(map));
    }
    if value.hasattr("__fspath__")? {
        return Ok(value.extract::<PathBuf>()?.to_string_lossy().into_owned().into());
    }
    // convert NumPy's numbers and arrays by their method `tolist`
    if value.hasattr("tolist")? {
        let plain = value.call_method0("tolist")?;
        if !plain.hasattr("tolist")? {
            return value_of(place, &plain);
        }
    }
    if let Ok(sequence) = value.cast::<PySequence>() {
        let items = sequence.try_iter()?.map(|item| value_of(place, &item?));
        return Ok(Value::Array(items.collect::<PyResult<_>>()?));
    }
    if value.hasattr("__index__")? {
        return integer(&value.call_method0("__index__")?);
    }
    if value.hasattr("__float__")? {
        return float(place, value);
    }
    let found = value.get_type().name()?;
    let text = format!("{place}: expected a number, a text, a path, a mapping or a sequence, found {found}");
    Err(PyTypeError::new_err(text))
}

fn integer(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    if let Ok(number) = value.extract::<i64>() {
        return Ok(number.into());
    }
    Ok(value.extract::<u64>()?.into())
}

fn float(place: &str, value: &Bound<'_, PyAny>) -> PyResult<Value> {
    let number: f64 = value.extract()?;
    Number::from_f64(number)
        .map(Value::Number)
        .ok_or_else(|| setting(value.py(), format!("{place}: expected a finite number, found {number}")))
}

/// Converts JSON to plain Python objects.
pub(crate) fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(yes) => PyBool::new(py, *yes).to_owned().into_any(),
        Value::String(text) => PyString::new(py, text).into_any(),
        Value::Number(number) => match (number.as_i64(), number.as_u64()) {
            (Some(number), _) => number.into_pyobject(py)?.into_any(),
            (_, Some(number)) => number.into_pyobject(py)?.into_any(),
            // The sum makes +0.0 of -0.0.
            _ => PyFloat::new(py, number.as_f64().unwrap_or(f64::NAN) + 0.0).into_any(),
        },
        Value::Array(items) => {
            let list = PyList::empty(py);
            for item in items {
                list.append(to_python(py, item)?)?;
            }
            list.into_any()
        }
        Value::Object(map) => {
            let dict = PyDict::new(py);
            for (key, value) in map {
                dict.set_item(key, to_python(py, value)?)?;
            }
            dict.into_any()
        }
    })
}
