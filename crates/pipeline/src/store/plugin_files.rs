//! Parameters of plugins that depend on the job: files, and the title of an output.
//!
//! The paths of files are relative to the job file. A run checks the files before it renders, and
//! keys of results contain hashes of the files' content.

use std::path::Path;

use lumistack_plugin_host::{Kind, Origin, Param, Registry};
use serde_json::{Map, Value};

use super::code;
use super::key::{KeyBuilder, hash};
use crate::error::{PipelineError, read};
use crate::job::Job;
use crate::reader::own_reader;

/// Returns the files in the parameters of plugin `id`, each as the name of the parameter and the
/// path. A value that begins with `{` is the content of a file and not a path, so it is not
/// returned.
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

/// Name of the parameter that is an output's title. Its default is the job's name.
const TITLE: &str = "title";

/// Returns the job with absolute paths in parameters of plugins, with titles of outputs, and with
/// the defaults of [`with_automatic_settings`](Job::with_automatic_settings).
///
/// # Errors
/// If a file cannot be read.
pub(crate) fn resolved(job: &Job, registry: &Registry) -> Result<Job, PipelineError> {
    let mut job = job.with_automatic_settings();
    add_titles(&mut job, registry);
    let folder = job.folder.clone();
    // A scene with a built-in reader needs no importer, so do not load the libraries of importers.
    let foreign = job.scene.as_ref().filter(|scene| own_reader(scene).is_none());
    let extension = foreign.and_then(|scene| scene.extension());
    let extension = extension.map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    let by_extension = extension.and_then(|extension| registry.importer_of(&extension));
    for (place, id, params) in job.plugins_mut() {
        let id = match by_extension {
            Some(importer) if id.is_empty() => &importer.id,
            _ => id,
        };
        // Check every file before the rendering, which may take hours.
        let found: Vec<(String, String)> = of(registry, id, params).map(|(n, p)| (n.into(), p.into())).collect();
        for (name, given) in found {
            let path = folder.join(&given);
            if let Err(error) = lumistack_files::open(&path) {
                let (key, found) = (format!("{place}.params.{name}"), format!("{}: {error}", path.display()));
                let expected = "a readable file, or the text of a file, which begins with {";
                return Err(PipelineError::job(key, expected, found));
            }
            let absolute = std::path::absolute(&path).unwrap_or(path);
            let value = match absolute.to_str() {
                Some(text) => text.to_owned(),
                // Parameters are JSON, which cannot contain paths that are not UTF-8. If such a
                // path names a JSON file, the parameter becomes the content of the file.
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

/// Sets the parameter `title` of each output that has this parameter, unless the job sets it. The
/// title is the job's name or, without a name, the name of the scene's file. Without a title, an
/// output would show the display's name.
fn add_titles(job: &mut Job, registry: &Registry) {
    let stem = || job.scene.as_ref()?.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let name = Some(job.name.clone()).filter(|name| !name.is_empty()).or_else(stem);
    let Some(name) = name else { return };
    let has_title = |id: &str| {
        let plugin = registry.get(id).ok();
        plugin.is_some_and(|plugin| plugin.info().schema.params.iter().any(is_title))
    };
    for output in job.outputs.iter_mut().filter(|output| has_title(&output.plugin)) {
        output.params.entry(TITLE).or_insert_with(|| name.clone().into());
    }
}

fn is_title(param: &Param) -> bool {
    param.name == TITLE && matches!(param.kind, Kind::Text { .. })
}

/// Returns a key of a plugin: its version, its parameters with the content of their files, and its
/// code. The code is the content of a library, or the fingerprint of compiled-in sources.
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::job::{DisplayJob, OutputJob};

    #[test]
    fn an_output_with_a_title_gets_the_name_of_the_job_or_of_the_scene() {
        let registry = Registry::built_in().unwrap();
        let titles = |name: &str, scene: Option<&str>| {
            let own = OutputJob {
                name: Some("own".into()),
                params: Map::from_iter([("title".into(), json!("My scene"))]),
                ..OutputJob::new("web_simulator")
            };
            let job = Job {
                name: name.into(),
                scene: scene.map(Into::into),
                outputs: vec![OutputJob::new("web_simulator"), OutputJob::new("images"), own],
                ..Job::new(DisplayJob::by_name_or_path("fig7-uniform"))
            };
            let outputs = resolved(&job, &registry).unwrap().outputs;
            outputs.iter().map(|output| json!(output.params)).collect::<Vec<_>>()
        };
        let own = json!({"title": "My scene"});
        assert_eq!(titles("still-life", Some("a/b.glb")), [json!({"title": "still-life"}), json!({}), own.clone()]);
        assert_eq!(titles("", Some("a/helmet.v2.glb")), [json!({"title": "helmet.v2"}), json!({}), own.clone()]);
        assert_eq!(titles("", None), [json!({}), json!({}), own]);
    }
}
