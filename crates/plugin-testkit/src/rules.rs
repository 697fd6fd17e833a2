//! Rules that apply to plugins of every kind.

use lumistack_plugin::{Kind, Param, PluginError};
use lumistack_plugin_host::serve::Plugin;
use serde_json::{Map, Value, json};
use thiserror::Error;

use crate::memory_host::MemoryHost;

/// A rule of the plugin interface that a plugin violates.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("expected a plugin that keeps the rule \"{rule}\", found: {found}")]
pub struct Broken {
    /// The violated rule.
    pub rule: &'static str,
    /// The plugin's behaviour that violates the rule.
    pub found: String,
}

/// Iterates over sets of parameters: first the defaults, then sets in which one parameter is at an
/// end of its range and all others have their defaults.
pub(crate) fn defaults_and_ends<'a>(plugin: &'a Plugin, at_default: &'a [&str]) -> impl Iterator<Item = Value> + 'a {
    let ends = varied(plugin, at_default).flat_map(allowed);
    std::iter::once(json!({})).chain(ends.map(|(name, value)| Value::Object(Map::from_iter([(name, value)]))))
}

/// Checks that the plugin itself refuses values outside its schema, since a host in another
/// language may pass them unchecked.
pub(crate) fn bad_parameters_are_refused(
    plugin: &Plugin,
    refusal: impl Fn(&str) -> Option<PluginError>,
) -> Result<(), Broken> {
    let params = &plugin.info().schema.params;
    let unknown = [("no_such_parameter".to_string(), json!(1))];
    for (name, value) in unknown.into_iter().chain(params.iter().flat_map(forbidden)) {
        let given = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
        let result = refusal(&given.to_string());
        let named = matches!(&result, Some(PluginError::Refused(text)) if text.contains(&name));
        require("names the parameter when it refuses a bad value", named, || {
            let done = result
                .map_or_else(|| "the plugin accepted the parameters".to_owned(), |error| in_words::<()>(&Err(error)));
            format!("with {given}, {done}")
        })?;
    }
    require("refuses what is not JSON", refusal("{").is_some(), || "the plugin accepted the parameters `{`".into())
}

pub(crate) fn varied<'a>(plugin: &'a Plugin, at_default: &'a [&str]) -> impl Iterator<Item = &'a Param> {
    plugin.info().schema.params.iter().filter(|param| !at_default.contains(&param.name.as_str()))
}

/// Returns both ends of a parameter's range, or all its options, without the default value. For a
/// text this is the empty text, for a file the name of a missing file.
pub(crate) fn allowed(param: &Param) -> Vec<(String, Value)> {
    let values = match &param.kind {
        Kind::Bool { .. } => vec![json!(false), json!(true)],
        Kind::Int { min, max, .. } => vec![json!(min), json!(max)],
        Kind::Float { min, max, .. } => vec![json!(min), json!(max)],
        Kind::Choice { options, .. } => options.iter().map(|option| json!(option.value)).collect(),
        Kind::Text { default } => vec![json!(default), json!("")],
        Kind::File => vec![json!(""), json!("no such file")],
    };
    let others = values.into_iter().filter(|value| *value != param.default_value());
    others.map(|value| (param.name.clone(), value)).collect()
}

/// Returns values that a parameter does not allow: values of the wrong type or outside the range.
fn forbidden(param: &Param) -> Vec<(String, Value)> {
    let values = match &param.kind {
        Kind::Bool { .. } => vec![json!("yes"), json!(1)],
        Kind::Int { min, max, .. } => {
            let beyond = [min.checked_sub(1), max.checked_add(1)].into_iter().flatten().map(|n| json!(n));
            beyond.chain([json!(0.5), json!("1")]).collect()
        }
        Kind::Float { min, max, .. } => vec![json!(min - 1.0 - min.abs()), json!(max + 1.0 + max.abs()), json!("1")],
        Kind::Choice { .. } => vec![json!("no such choice"), json!(0)],
        Kind::Text { .. } | Kind::File => vec![json!(0)],
    };
    values.into_iter().map(|value| (param.name.clone(), value)).collect()
}

pub(crate) fn closed(host: &MemoryHost, when: &str) -> Result<(), Broken> {
    let (stages, open) = host.stages();
    require("no file stays open", host.open_files().is_empty(), || {
        format!("{when}: these files stayed open: {}", host.open_files().join(", "))
    })?;
    require("every stage of progress ends", open == 0, || {
        format!("{when}: {open} stages of progress did not end. All stages that began: {}", stages.join(", "))
    })
}

/// Returns true if a plugin refused with a reason. The host replaces a missing reason by a text
/// that states the status.
pub(crate) fn is_reason(text: &str) -> bool {
    !text.starts_with("expected an error text, found only the status")
}

/// Describes the result of a call for messages.
pub(crate) fn in_words<T>(result: &Result<T, PluginError>) -> String {
    match result {
        Ok(_) => "the plugin succeeded".into(),
        Err(PluginError::Cancelled) => "the plugin returned `cancelled`".into(),
        Err(PluginError::Refused(reason)) => format!("the plugin refused: {reason}"),
        Err(PluginError::Failed(reason)) => format!("the plugin failed: {reason}"),
        Err(PluginError::Panicked(reason)) => format!("the plugin panicked: {reason}"),
    }
}

pub(crate) fn rule<T>(rule: &'static str, result: Result<T, PluginError>) -> Result<T, Broken> {
    result.map_err(|error| Broken { rule, found: in_words::<()>(&Err(error)) })
}

pub(crate) fn require(rule: &'static str, holds: bool, found: impl FnOnce() -> String) -> Result<(), Broken> {
    if holds { Ok(()) } else { Err(Broken { rule, found: found() }) }
}
