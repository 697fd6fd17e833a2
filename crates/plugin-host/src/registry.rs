//! All plugins of the program and their origins.

use std::sync::OnceLock;

use crate::origin::Origin;
use crate::serve::{Plugin, PluginInfo, PluginKind};
use lumistack_core::config::nearest;
use lumistack_plugin::PluginError;
use serde_json::{Map, Value};

use crate::built_in::{BUILT_IN, same_id};
use crate::{HostError, LoadError};

/// Plugins by id: compiled-in plugins, and plugins in libraries. A library is loaded at the first
/// use of one of its plugins.
#[derive(Debug, Default)]
pub struct Registry {
    plugins: Vec<Plugin>,
    pub(crate) libraries: Vec<Library>,
    pub(crate) failed: Vec<LoadError>,
}

/// One plugin of a library. The library is loaded at the first use of the plugin.
#[derive(Debug)]
pub(crate) struct Library {
    id: String,
    origin: Origin,
    #[cfg(feature = "dynamic")]
    launcher: Option<crate::Launcher>,
    #[cfg(feature = "dynamic")]
    limits: crate::Limits,
    loaded: OnceLock<Result<Plugin, LoadError>>,
}

impl Library {
    #[cfg(feature = "dynamic")]
    pub(crate) fn new(id: String, origin: Origin, launcher: Option<crate::Launcher>, limits: crate::Limits) -> Self {
        Self { id, origin, launcher, limits, loaded: OnceLock::new() }
    }

    /// Returns the plugin. The first call loads the library in a child process.
    fn plugin(&self) -> Result<&Plugin, &LoadError> {
        self.loaded.get_or_init(|| self.load()).as_ref()
    }

    #[cfg(feature = "dynamic")]
    fn load(&self) -> Result<Plugin, LoadError> {
        let Origin::Library(path) = &self.origin else { unreachable!("the origin of a library is its file") };
        let launcher = self.launcher.clone().ok_or_else(|| LoadError::NoLauncher { path: path.clone() })?;
        crate::child::probe(path, &self.id, launcher, self.limits)
    }

    #[cfg(not(feature = "dynamic"))]
    fn load(&self) -> Result<Plugin, LoadError> {
        unreachable!("without the feature `dynamic` no library is added")
    }
}

impl Registry {
    /// Makes a registry of the compiled-in plugins.
    ///
    /// # Errors
    /// If a plugin's description is invalid, or two plugins have the same id.
    pub fn built_in() -> Result<Self, HostError> {
        let mut registry = Self::default();
        for (export, _) in BUILT_IN {
            registry.add(Plugin::compiled_in(export).map_err(HostError::BadPlugin)?)?;
        }
        Ok(registry)
    }

    /// Adds a compiled-in plugin.
    ///
    /// # Errors
    /// If another compiled-in plugin has its id.
    pub fn add(&mut self, plugin: Plugin) -> Result<(), HostError> {
        match self.plugins.binary_search_by(|other| other.info().id.cmp(&plugin.info().id)) {
            Ok(_) => Err(HostError::DuplicatePlugin(plugin.info().id.clone())),
            Err(place) => {
                self.plugins.insert(place, plugin);
                Ok(())
            }
        }
    }

    /// Returns the plugin with this id. Hyphens in `id` are read as underscores. For a plugin in a
    /// library, the first call loads the library in a child process.
    ///
    /// # Errors
    /// If no plugin has this id, or if its library cannot be used. For an unknown id, the message
    /// states the most similar id. If no id is similar, it lists all ids.
    pub fn get(&self, id: &str) -> Result<&Plugin, HostError> {
        if let Some(plugin) = self.plugins.iter().find(|plugin| same_id(&plugin.info().id, id)) {
            return Ok(plugin);
        }
        if let Some(library) = self.libraries.iter().find(|library| same_id(&library.id, id)) {
            return library.plugin().map_err(|error| HostError::NotLoaded { id: id.into(), reason: error.to_string() });
        }
        let mut known: Vec<&str> = self.plugins.iter().map(|plugin| plugin.info().id.as_str()).collect();
        known.extend(self.libraries.iter().map(|library| library.id.as_str()));
        known.sort_unstable();
        Err(HostError::UnknownPlugin {
            id: id.into(),
            nearest: nearest(id, known.iter().copied()).map(String::from),
            known: known.into_iter().map(String::from).collect(),
        })
    }

    /// Returns the plugin with this id and kind.
    ///
    /// # Errors
    /// Those of [`get`](Self::get), or if the plugin is of another kind.
    pub fn get_kind(&self, id: &str, kind: PluginKind) -> Result<&Plugin, HostError> {
        let plugin = self.get(id)?;
        let found = plugin.info().kind;
        if found != kind {
            return Err(HostError::OtherKind { id: id.into(), expected: kind, found });
        }
        Ok(plugin)
    }

    /// Returns the output with this id. If `presents`, the output must be a presenter; otherwise it
    /// must write files.
    pub(crate) fn output(&self, id: &str, presents: bool) -> Result<&Plugin, HostError> {
        let plugin = self.get_kind(id, PluginKind::Output)?;
        if plugin.info().presents != presents {
            let does = |presents| if presents { "drives panels (for `lumistack show`)" } else { "writes files" };
            let reason =
                format!("expected an output that {}, found an output that {}", does(presents), does(!presents));
            return Err(HostError::of_plugin(PluginKind::Output, id, PluginError::Refused(reason)));
        }
        Ok(plugin)
    }

    /// Returns the origin of a plugin, without loading a library.
    pub fn origin(&self, id: &str) -> Option<&Origin> {
        if self.plugins.iter().any(|plugin| same_id(&plugin.info().id, id)) {
            return Some(&Origin::CompiledIn);
        }
        self.libraries.iter().find(|library| same_id(&library.id, id)).map(|library| &library.origin)
    }

    /// Returns the importer of files with this extension, without the dot. Compiled-in importers
    /// come first. If none of them reads the extension, all libraries are loaded and searched. If
    /// several importers match, the first by id is returned.
    pub fn importer_of(&self, extension: &str) -> Option<&PluginInfo> {
        let takes = |info: &&PluginInfo| {
            info.kind == PluginKind::Importer && info.extensions.iter().any(|taken| taken == extension)
        };
        self.plugins.iter().map(Plugin::info).find(takes).or_else(|| self.infos().find(takes))
    }

    /// Returns the descriptions of all usable plugins, for listings. Loads all libraries.
    pub fn infos(&self) -> impl Iterator<Item = &PluginInfo> {
        self.entries().map(|(info, _)| info)
    }

    /// Returns the descriptions and origins of all usable plugins, sorted by id. Loads all
    /// libraries.
    pub fn entries(&self) -> impl Iterator<Item = (&PluginInfo, &Origin)> {
        let mut entries: Vec<_> = self.plugins.iter().map(|plugin| (plugin.info(), &Origin::CompiledIn)).collect();
        let loaded = self.libraries.iter().filter_map(|library| Some((library.plugin().ok()?.info(), &library.origin)));
        entries.extend(loaded);
        entries.sort_by(|(a, _), (b, _)| a.id.cmp(&b.id));
        entries.into_iter()
    }

    /// Returns the errors of libraries, search paths and time limits that cannot be used. The
    /// program continues without these plugins. If a time limit is invalid, all limits are the
    /// defaults. Some errors appear only after the attempt to load a library.
    pub fn failed(&self) -> Vec<&LoadError> {
        let loaded = self.libraries.iter().filter_map(|library| library.loaded.get()?.as_ref().err());
        self.failed.iter().chain(loaded).collect()
    }

    /// Checks parameters against the schema of the plugin `id`, and fills in defaults.
    ///
    /// # Errors
    /// Those of [`get`](Self::get), or if the plugin's schema refuses the parameters.
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
