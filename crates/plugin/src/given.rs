//! Reads the parameters that a host passes to a plugin.

use serde::de::DeserializeOwned;
use serde_json::Value;

use lumistack_plugin_abi::Str;

use crate::wire::lent_text;
use crate::{PluginError, Schema};

/// Parses and checks the parameters, and fills in the schema's defaults.
///
/// # Safety
/// The text is lent for the call.
pub(crate) unsafe fn params_of<T: DeserializeOwned>(schema: Schema, params_json: Str) -> Result<T, PluginError> {
    // SAFETY: guaranteed by the caller.
    let text = unsafe { lent_text(params_json, "parameters")? };
    let given: Value = serde_json::from_str(text).map_err(|error| PluginError::failed("parameters", error))?;
    let resolved = schema.resolve(&given)?;
    serde_json::from_value(Value::Object(resolved))
        .map_err(|error| PluginError::failed("the plugin's type `Params` does not fit the plugin's schema", error))
}
