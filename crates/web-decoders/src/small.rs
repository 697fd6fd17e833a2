//! The function of the small module that JavaScript can call.

use wasm_bindgen::prelude::*;

/// Decodes a common picture. Request and answer have the byte format of
/// `lumistack_gltf::unpack::Packed`; the result is `undefined` if the request is malformed.
#[wasm_bindgen]
pub fn answer(request: &[u8]) -> Option<Vec<u8>> {
    lumistack_gltf::unpack::answer_common(request)
}
