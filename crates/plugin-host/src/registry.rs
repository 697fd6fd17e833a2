//! All plugins of the program, and where each came from.

use std::fmt;
use std::path::PathBuf;

use lumistack_core::config::nearest;
use lumistack_plugin::serve::{Plugin, PluginInfo, PluginKind};
use serde_json::{Map, Value};

use crate::{HostError, LoadError};

/// Plugins by id.
#[derive(Debug, Default)]
pub struct Registry {
    plugins: Vec<(Plugin, Origin)>,
    pub(crate) failed: Vec<LoadError>,
}

/// Where a plugin came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// It is part of the program.
    CompiledIn,
    /// This shared library.
    Library(PathBuf),
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CompiledIn => f.write_str("compiled in"),
            Self::Library(path) => write!(f, "{}", path.display()),
        }
    }
}

impl Registry {
    /// The plugins that are compiled in: an explicit list, since registration by linker section silently drops crates that nobody
    /// references.
    ///
    /// # Errors
    /// If a plugin describes itself badly, a mistake in the plugin.
    pub fn built_in() -> Result<Self, HostError> {
        let mut registry = Self::default();
        #[cfg(feature = "directional-sequence")]
        registry
            .add(Plugin::compiled_in(&lumistack_plugin_directional_sequence::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "images")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_images::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "integral-imaging")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_integral_imaging::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "log-tomography")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_log_tomography::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "obj")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_obj::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "parallax-barrier")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_parallax_barrier::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "quilt")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_quilt::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "test-views")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_test_views::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "transparencies")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_transparencies::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "two-layer-nmf")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_two_layer_nmf::PLUGIN).map_err(HostError::BadPlugin)?)?;
        #[cfg(feature = "web-simulator")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_web_simulator::PLUGIN).map_err(HostError::BadPlugin)?)?;
        Ok(registry)
    }

    /// Adds a plugin that is compiled in.
    ///
    /// # Errors
    /// If another has its id.
    pub fn add(&mut self, plugin: Plugin) -> Result<(), HostError> {
        self.add_from(plugin, Origin::CompiledIn)
            .map_err(|(plugin, _)| HostError::DuplicatePlugin(plugin.info().id.clone()))
    }

    /// Adds a plugin in its place by id, or gives it back with the origin of the one that has its id already.
    pub(crate) fn add_from(&mut self, plugin: Plugin, origin: Origin) -> Result<(), (Plugin, Origin)> {
        match self.plugins.binary_search_by(|(other, _)| other.info().id.cmp(&plugin.info().id)) {
            Ok(found) => Err((plugin, self.plugins[found].1.clone())),
            Err(place) => {
                self.plugins.insert(place, (plugin, origin));
                Ok(())
            }
        }
    }

    /// The plugin with this id.
    ///
    /// # Errors
    /// If there is none; the error names the id that is spelled most like it.
    pub fn get(&self, id: &str) -> Result<&Plugin, HostError> {
        self.plugins.iter().map(|(plugin, _)| plugin).find(|plugin| plugin.info().id == id).ok_or_else(|| {
            let known = || self.infos().map(|info| info.id.as_str());
            HostError::UnknownPlugin {
                id: id.into(),
                nearest: nearest(id, known()).map(String::from),
                known: known().map(String::from).collect(),
            }
        })
    }

    /// The plugin with this id, which must be of this kind.
    ///
    /// # Errors
    /// If there is none, or it is of another kind.
    pub fn get_kind(&self, id: &str, kind: PluginKind) -> Result<&Plugin, HostError> {
        let plugin = self.get(id)?;
        let found = plugin.info().kind;
        if found != kind {
            return Err(HostError::OtherKind { id: id.into(), expected: kind, found });
        }
        Ok(plugin)
    }

    /// Where a plugin came from.
    pub fn origin(&self, id: &str) -> Option<&Origin> {
        self.entries().find(|(info, _)| info.id == id).map(|(_, origin)| origin)
    }

    /// The importer of files with this extension; of several the first by id.
    pub fn importer_of(&self, extension: &str) -> Option<&PluginInfo> {
        self.infos().find(|info| info.kind == PluginKind::Importer && info.extensions.iter().any(|e| e == extension))
    }

    /// What all plugins say about themselves; for listings, serializable.
    pub fn infos(&self) -> impl Iterator<Item = &PluginInfo> {
        self.entries().map(|(info, _)| info)
    }

    /// The same with where each came from, by id.
    pub fn entries(&self) -> impl Iterator<Item = (&PluginInfo, &Origin)> {
        self.plugins.iter().map(|(plugin, origin)| (plugin.info(), origin))
    }

    /// Libraries and folders that gave no plugin, and why. The program does without them.
    pub fn failed(&self) -> &[LoadError] {
        &self.failed
    }

    /// Checks parameters before the work that leads to the output begins, and fills in the defaults.
    ///
    /// # Errors
    /// If there is no such plugin, or it does not take the parameters.
    pub fn check_params(&self, id: &str, params: &Value) -> Result<Map<String, Value>, HostError> {
        let info = self.get(id)?.info();
        let resolved = info.schema.resolve(params);
        resolved.map_err(|error| HostError::Refused { kind: info.kind, plugin: id.into(), reason: error.to_string() })
    }
}

#[cfg(all(test, feature = "images", feature = "obj"))]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_built_in_plugins_are_listed_with_their_parameters() {
        let registry = Registry::built_in().unwrap();
        let listing =
            serde_json::to_value(registry.infos().filter(|info| info.id == "images").collect::<Vec<_>>()).unwrap();
        assert_eq!(listing[0]["kind"], "output");
        assert_eq!(listing[0]["ports"], json!(["light_field", "layer_stack"]));
        assert_eq!(listing[0]["version"], env!("CARGO_PKG_VERSION"));
        let png8 = &listing[0]["params"][0];
        assert_eq!((&png8["name"], &png8["kind"], &png8["default"]), (&json!("png8"), &json!("bool"), &json!(true)));
    }

    #[test]
    fn misspelled_plugins_and_parameters_name_the_nearest() {
        let registry = Registry::built_in().unwrap();
        let error = registry.get("imagse").unwrap_err();
        assert_eq!(error.to_string(), "unknown plugin `imagse`; did you mean `images`?");
        let error = registry.get("zzz").unwrap_err();
        assert!(
            error.to_string().starts_with("unknown plugin `zzz`; expected one of directional_sequence, images, "),
            "{error}"
        );
        let error = registry.check_params("images", &json!({"png6": true})).unwrap_err();
        assert!(
            error.to_string().starts_with("output `images`: unknown parameter `png6`; did you mean `png"),
            "{error}"
        );
        assert_eq!(registry.check_params("images", &json!({"png16": true})).unwrap()["png16"], true);
    }

    #[test]
    fn kinds_are_checked_and_importers_found_by_extension() {
        let registry = Registry::built_in().unwrap();
        let error = registry.get_kind("obj", PluginKind::Output).unwrap_err();
        assert_eq!(error.to_string(), "plugin `obj`: expected an output, found an importer");
        assert_eq!(registry.importer_of("obj").unwrap().id, "obj");
        assert!(registry.importer_of("docx").is_none());
        assert_eq!(registry.origin("obj"), Some(&Origin::CompiledIn));
    }

    #[test]
    fn ids_are_unique() {
        let mut registry = Registry::built_in().unwrap();
        let again = registry.get("images").unwrap().clone();
        assert!(matches!(registry.add(again), Err(HostError::DuplicatePlugin(id)) if id == "images"));
    }
}
