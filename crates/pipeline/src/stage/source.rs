//! Requests the light field from a source plugin, or reads it from the cache.

use std::path::PathBuf;

use lumistack_core::Task;
use lumistack_display::{Display, LightField};
use lumistack_plugin_host::{Registry, Time};
use serde::{Deserialize, Serialize};
use serde_json::Map;

use super::field::field_key;
use crate::error::{PipelineError, host_error};
use crate::job::SourceJob;
use crate::store::code;
use crate::store::files::{read_json, write_json};
use crate::store::key::KeyBuilder;
use crate::store::plugin_files::plugin_key;
use crate::store::stamps::Stamps;

/// Keys of a source and of its light field, in the form of their JSON file.
#[derive(Serialize, Deserialize)]
pub(crate) struct SourceRecord {
    key: String,
    target: String,
}

fn path(stamps: &Stamps) -> PathBuf {
    stamps.dir().join("cache/source.json")
}

impl SourceRecord {
    /// Writes the JSON file. The light field must be in its folder already.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn write(&self, stamps: &Stamps) -> Result<(), PipelineError> {
        write_json(&path(stamps), self)
    }
}

/// Returns the light field, the keys to write, and true if the light field was cached.
///
/// # Errors
/// If the source plugin does not exist, fails or is cancelled.
pub(crate) fn run(
    source: &SourceJob,
    display: &Display,
    stamps: &Stamps,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(LightField, SourceRecord, bool), PipelineError> {
    let mut key = KeyBuilder::new("source", code::PLUGINS);
    key.add("plugin", plugin_key(registry, &source.plugin, &source.params)?.as_bytes())
        .add("display", display.without_panels().to_toml().as_bytes())
        .add_json("time", &(source.time, source.time_s));
    let key = key.finish();
    if let Some(kept) = read_json::<SourceRecord>(&path(stamps)).filter(|kept| kept.key == key)
        && stamps.is_current("target", &kept.target)
        && let Ok((field, _)) = lumistack_field_io::read_field_folder(&stamps.dir().join("target"))
        && field_key("target", &field, &Map::new()) == kept.target
    {
        return Ok((field, kept, true));
    }
    let (params, time) = (source.params.clone().into(), Time { index: source.time, seconds: source.time_s });
    let made = lumistack_plugin_host::make_field(registry, &source.plugin, &params, display, time, task);
    let mut field = made.map_err(host_error)?;
    lumistack_field_io::round_to_half(field.radiance_mut().data_mut());
    let target = field_key("target", &field, &Map::new());
    Ok((field, SourceRecord { key, target }, false))
}
