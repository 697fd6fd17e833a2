//! The parameters that a host gives to a plugin.

use serde::de::DeserializeOwned;
use serde_json::Value;

use lumistack_plugin_abi::Str;

use crate::wire::lent_text;
use crate::{PluginError, Schema};

/// The parameters that were given, checked, with the defaults of the others.
///
/// # Safety
/// The text is lent for the call.
pub(crate) unsafe fn params_of<T: DeserializeOwned>(schema: Schema, params_json: Str) -> Result<T, PluginError> {
    // SAFETY: the caller's promise.
    let text = unsafe { lent_text(params_json, "parameters")? };
    let given: Value = serde_json::from_str(text).map_err(|error| PluginError::failed("parameters", error))?;
    let resolved = schema.resolve(&given)?;
    serde_json::from_value(Value::Object(resolved))
        .map_err(|error| PluginError::failed("parameters differ from the plugin's schema", error))
}
