//! All plugins of the program.

use lumistack_core::config::nearest;
use lumistack_plugin::serve::{Plugin, PluginInfo};
use serde_json::{Map, Value};

use crate::HostError;

/// Plugins by id.
#[derive(Clone, Debug, Default)]
pub struct Registry {
    plugins: Vec<Plugin>,
}

impl Registry {
    /// The plugins that are compiled in: an explicit list, since registration by linker section silently drops crates that nobody
    /// references.
    ///
    /// # Errors
    /// If a plugin describes itself badly, a mistake in the plugin.
    pub fn built_in() -> Result<Self, HostError> {
        let mut registry = Self::default();
        #[cfg(feature = "images")]
        registry.add(Plugin::compiled_in(&lumistack_plugin_images::PLUGIN).map_err(HostError::BadPlugin)?)?;
        registry.plugins.sort_by(|a, b| a.info().id.cmp(&b.info().id));
        Ok(registry)
    }

    /// Adds a plugin.
    ///
    /// # Errors
    /// If another has its id.
    pub fn add(&mut self, plugin: Plugin) -> Result<(), HostError> {
        if self.plugins.iter().any(|other| other.info().id == plugin.info().id) {
            return Err(HostError::DuplicatePlugin(plugin.info().id.clone()));
        }
        self.plugins.push(plugin);
        Ok(())
    }

    /// The plugin with this id.
    ///
    /// # Errors
    /// If there is none; the error names the id that is spelled most like it.
    pub fn get(&self, id: &str) -> Result<&Plugin, HostError> {
        self.plugins.iter().find(|plugin| plugin.info().id == id).ok_or_else(|| {
            let known = || self.plugins.iter().map(|plugin| plugin.info().id.as_str());
            HostError::UnknownPlugin {
                id: id.into(),
                nearest: nearest(id, known()).map(String::from),
                known: known().map(String::from).collect(),
            }
        })
    }

    /// What all plugins say about themselves; for listings, serializable.
    pub fn infos(&self) -> impl Iterator<Item = &PluginInfo> {
        self.plugins.iter().map(Plugin::info)
    }

    /// Checks parameters before the work that leads to the output begins, and fills in the defaults.
    ///
    /// # Errors
    /// If there is no such plugin, or it does not take the parameters.
    pub fn check_params(&self, id: &str, params: &Value) -> Result<Map<String, Value>, HostError> {
        let resolved = self.get(id)?.info().schema.resolve(params);
        resolved.map_err(|error| HostError::Refused { plugin: id.into(), reason: error.to_string() })
    }
}

#[cfg(all(test, feature = "images"))]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_built_in_plugins_are_listed_with_their_parameters() {
        let registry = Registry::built_in().unwrap();
        let listing = serde_json::to_value(registry.infos().collect::<Vec<_>>()).unwrap();
        assert_eq!(listing[0]["id"], "images");
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
        assert_eq!(error.to_string(), "unknown plugin `zzz`; expected one of images");
        let error = registry.check_params("images", &json!({"png6": true})).unwrap_err();
        assert!(
            error.to_string().starts_with("output `images`: unknown parameter `png6`; did you mean `png"),
            "{error}"
        );
        assert_eq!(registry.check_params("images", &json!({"png16": true})).unwrap()["png16"], true);
    }

    #[test]
    fn ids_are_unique() {
        let mut registry = Registry::built_in().unwrap();
        let again = registry.get("images").unwrap().clone();
        assert!(matches!(registry.add(again), Err(HostError::DuplicatePlugin(id)) if id == "images"));
    }
}
