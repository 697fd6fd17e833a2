//! Parameters of plugins that are files: relative to the job's file, there before any work begins, and part of what a result depends on.

use std::path::Path;

use lumistack_plugin_host::{Kind, Origin, Registry};
use serde_json::{Map, Value};

use super::code;
use super::key::{KeyBuilder, hash};
use crate::error::{PipelineError, read};
use crate::job::Job;
use crate::reader::own_reader;

/// The files among the parameters `params` of the plugin `id`: name and path. A text that begins with `{` is the content itself.
pub(crate) fn of<'a>(
    registry: &'a Registry,
    id: &str,
    params: &'a Map<String, Value>,
) -> impl Iterator<Item = (&'a str, &'a str)> {
    let schema = registry.get(id).ok().map(|plugin| &plugin.info().schema.params);
    let files = schema.into_iter().flatten().filter(|param| param.kind == Kind::File);
    let given = files.filter_map(|param| Some((param.name.as_str(), params.get(&param.name)?.as_str()?)));
    given.filter(|(_, path)| !path.is_empty() && !path.trim_start().starts_with('{'))
}

/// The job with every such path made absolute, and [settled](Job::settled).
///
/// # Errors
/// On a file that cannot be read.
pub(crate) fn resolved(job: &Job, registry: &Registry) -> Result<Job, PipelineError> {
    let mut job = job.settled();
    let folder = job.folder.clone();
    // who reads a file without a plugin needs no look at all libraries
    let foreign = job.scene.as_ref().filter(|scene| own_reader(scene).is_none());
    let extension = foreign.and_then(|scene| scene.extension());
    let extension = extension.map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    let by_extension = extension.and_then(|extension| registry.importer_of(&extension));
    for (place, id, params) in job.plugins_mut() {
        let id = match by_extension {
            Some(importer) if id.is_empty() => &importer.id,
            _ => id,
        };
        let found: Vec<(String, String)> = of(registry, id, params).map(|(n, p)| (n.into(), p.into())).collect();
        for (name, given) in found {
            let path = folder.join(&given);
            if let Err(error) = lumistack_files::open(&path) {
                let (key, found) = (format!("{place}.params.{name}"), format!("{}: {error}", path.display()));
                let expected = "a readable file, or its text, which begins with {";
                return Err(PipelineError::job(key, expected, found));
            }
            let absolute = std::path::absolute(&path).unwrap_or(path);
            let value = match absolute.to_str() {
                Some(text) => text.to_owned(),
                // parameters are JSON, which holds no such path: the content stands for it where that is a text of its own
                None => lumistack_files::read_text(&absolute)
                    .ok()
                    .filter(|text| text.trim_start().starts_with('{'))
                    .ok_or_else(|| {
                        let (key, found) = (format!("{place}.params.{name}"), absolute.display().to_string());
                        PipelineError::job(key, "a path in UTF-8, or a file whose text begins with {", found)
                    })?,
            };
            params.insert(name, value.into());
        }
    }
    Ok(job)
}

/// What the work of a plugin depends on, besides what it is given: its version, its parameters, and its code, which changes while somebody writes
/// it: the library's content, or the sources of one that is compiled in.
pub(crate) fn plugin_key(
    registry: &Registry,
    id: &str,
    params: &serde_json::Map<String, serde_json::Value>,
) -> Result<String, PipelineError> {
    let mut key = KeyBuilder::new(&format!("plugin {id}"), code::PLUGINS);
    key.add("version", registry.get(id).map_err(PipelineError::Output)?.info().version.as_bytes());
    key.add_json("params", params);
    for (name, path) in of(registry, id, params) {
        key.add("file", name.as_bytes()).add("content", hash(&read(Path::new(path))?).as_bytes());
    }
    match registry.origin(id) {
        Some(Origin::Library(library)) => {
            key.add("library", hash(&read(library)?).as_bytes());
        }
        _ => {
            let sources = lumistack_plugin_host::fingerprint_of(id).unwrap_or_default();
            key.add("sources", sources.as_bytes());
        }
    }
    Ok(key.finish())
}
