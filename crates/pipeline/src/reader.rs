//! Selects the reader of a scene's file: glTF, USD, Blender or an importer plugin.

use std::path::Path;

use lumistack_plugin_host::{PluginKind, Registry};

use crate::error::PipelineError;
use crate::job::ImporterJob;

/// The reader of a scene's file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Reader {
    Gltf,
    Usd,
    Blend,
    /// An importer plugin, by its id.
    Plugin(String),
}

/// Returns true if a file has an extension of USD.
pub fn is_usd(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    lumistack_usd::EXTENSIONS.contains(&extension.as_str())
}

/// Returns true if a file has the extension or the name of a capture, which contains only
/// Gaussian splats.
pub(crate) fn is_capture(path: &Path) -> bool {
    let has = |known: &&str| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(known));
    ["ply", "spz", "sog"].iter().any(has) || path.file_name().is_some_and(|name| name == "meta.json")
}

/// Returns true if a file has the extension of Blender's files.
pub fn is_blend(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(lumistack_usd::BLEND_EXTENSION))
}

/// Returns the built-in reader of a file, by the file's extension; `None` if no built-in reader
/// reads this extension.
pub(crate) fn own_reader(path: &Path) -> Option<Reader> {
    let is_gltf = |extension: &std::ffi::OsStr| ["gltf", "glb"].iter().any(|own| extension.eq_ignore_ascii_case(own));
    if path.extension().is_some_and(is_gltf) {
        return Some(Reader::Gltf);
    }
    if is_usd(path) {
        return Some(Reader::Usd);
    }
    is_blend(path).then_some(Reader::Blend)
}

/// Returns the reader of a job's scene: the job's importer, or else the built-in reader or the
/// plugin for the file's extension.
///
/// # Errors
/// If the importer does not exist, or no reader reads files with this extension.
pub(crate) fn reader_of(path: &Path, importer: &ImporterJob, registry: &Registry) -> Result<Reader, PipelineError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if let Some(id) = &importer.plugin {
        registry.get_kind(id, PluginKind::Importer).map_err(PipelineError::Output)?;
        return Ok(Reader::Plugin(id.clone()));
    }
    if let Some(reader) = own_reader(path) {
        return Ok(reader);
    }
    let found = registry.importer_of(&extension).map(|info| info.id.clone());
    found.map(Reader::Plugin).ok_or_else(|| {
        let known = registry.infos().flat_map(|info| info.extensions.iter().map(|extension| format!(", .{extension}")));
        let usd = lumistack_usd::EXTENSIONS.map(|extension| format!(", .{extension}")).concat();
        let expected = format!("a file with the extension .gltf, .glb, .blend{usd}{}", known.collect::<String>());
        let found = if extension.is_empty() { "no extension".into() } else { format!("extension `{extension}`") };
        PipelineError::value(path, "scene", expected, found)
    })
}
