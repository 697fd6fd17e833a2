//! Parses JSON. In the browser the module calls the browser's own parser, since a parser in Rust
//! would be a fifth of the module.

use serde::de::DeserializeOwned;

/// Parses JSON; the error states the reason.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_str(text).map_err(|error| error.to_string())
}

/// Parses JSON; the error states the reason. Unknown keys are ignored.
#[cfg(target_arch = "wasm32")]
pub(crate) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    use wasm_bindgen::JsCast as _;
    let value = js_sys::JSON::parse(text).map_err(|error| match error.dyn_ref::<js_sys::Error>() {
        Some(error) => String::from(error.message()),
        None => "no JSON".into(),
    })?;
    serde_wasm_bindgen::from_value(value).map_err(|error| error.to_string())
}
