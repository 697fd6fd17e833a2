//! JSON, read by what is there: in the browser its own parser, since another would be a fifth of the module.

use serde::de::DeserializeOwned;

/// What a text says; an error tells what is wrong with it.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_str(text).map_err(|error| error.to_string())
}

/// What a text says; an error tells what is wrong with it. Keys that are not known are stepped over.
#[cfg(target_arch = "wasm32")]
pub(crate) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    use wasm_bindgen::JsCast as _;
    let value = js_sys::JSON::parse(text).map_err(|error| match error.dyn_ref::<js_sys::Error>() {
        Some(error) => String::from(error.message()),
        None => "no JSON".into(),
    })?;
    serde_wasm_bindgen::from_value(value).map_err(|error| error.to_string())
}
