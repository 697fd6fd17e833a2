//! The functions that JavaScript sees.

use js_sys::Uint8Array;
use wasm_bindgen::prelude::*;

/// Decodes packed content that came as bytes; the answer is bytes too.
#[wasm_bindgen]
pub fn answer(request: &[u8]) -> Option<Vec<u8>> {
    crate::answer(request)
}

/// Packs files as a zip, after `display.toml` with the display that is given as JSON.
#[wasm_bindgen]
pub fn pack(display: &str, names: Vec<String>, contents: Vec<Uint8Array>) -> Result<Vec<u8>, JsError> {
    let contents: Vec<Vec<u8>> = contents.iter().map(Uint8Array::to_vec).collect();
    let files = names.iter().map(String::as_str).zip(contents.iter().map(Vec::as_slice));
    crate::pack(display, files).map_err(|error| JsError::new(&error))
}
