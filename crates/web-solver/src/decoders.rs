//! The decoders of packed content and the zip: a module of their own in a page, a crate elsewhere.

#[cfg(target_arch = "wasm32")]
pub(crate) use page::{pack, unpack};

#[cfg(not(target_arch = "wasm32"))]
pub(crate) use beside::{pack, unpack};

#[cfg(not(target_arch = "wasm32"))]
mod beside {
    pub(crate) use lumistack_web_decoders::unpack;

    /// Packs files as a zip, after `display.toml` with the display that is given as JSON.
    pub(crate) fn pack(display: &str, files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, String> {
        lumistack_web_decoders::pack(display, files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())))
    }
}

#[cfg(target_arch = "wasm32")]
mod page {
    use js_sys::{Error, Uint8Array};
    use lumistack_gltf::unpack::{Packed, Unpacked, Unsound, answered};
    use wasm_bindgen::prelude::*;

    // the worker loads the module at the first call
    #[wasm_bindgen]
    extern "C" {
        #[wasm_bindgen(catch, js_namespace = lumistack_decoders)]
        fn answer(request: &[u8]) -> Result<Option<Vec<u8>>, JsValue>;
        #[wasm_bindgen(catch, js_namespace = lumistack_decoders, js_name = pack)]
        fn pack_files(display: &str, names: Vec<String>, contents: Vec<Uint8Array>) -> Result<Vec<u8>, JsValue>;
    }

    fn message(error: &JsValue) -> String {
        error.dyn_ref::<Error>().map_or_else(|| format!("{error:?}"), |error| error.message().into())
    }

    pub(crate) fn unpack(packed: &Packed<'_>) -> Result<Unpacked, Unsound> {
        let unreachable = |error: JsValue| Unsound {
            place: String::new(),
            expected: "the decoders of this page, lumistack_web_decoders_bg.wasm".into(),
            found: message(&error),
        };
        // without an answer the module stopped on the content
        let found = answer(&packed.to_bytes()).map_err(unreachable)?;
        found.as_deref().and_then(answered).unwrap_or_else(|| Err(packed.stopped()))
    }

    pub(crate) fn pack(display: &str, files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, String> {
        let names = files.iter().map(|(name, _)| name.clone()).collect();
        let contents = files.iter().map(|(_, bytes)| Uint8Array::from(bytes.as_slice())).collect();
        pack_files(display, names, contents).map_err(|error| message(&error))
    }
}
