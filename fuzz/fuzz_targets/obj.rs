//! Imports an OBJ file with its MTL file. The input is the text of the OBJ file, a separator, and
//! the text of the MTL file. The importer must return an error or a valid glTF file.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_fuzz::{parts, reads};
use lumistack_gltf::{AssetResolver, LoadOptions, load_with};
use lumistack_plugin::PluginError;
use lumistack_plugin::serde_json::json;
use lumistack_plugin_testkit::serve::{Plugin, import, resolved};
use lumistack_plugin_testkit::MemoryHost;

/// A PNG of one texel.
const PICTURE: &[u8] = &[
    0x89, b'P', b'N', b'G', 13, 10, 26, 10, 0, 0, 0, 13, b'I', b'H', b'D', b'R', 0, 0, 0, 1, 0, 0, 0, 1, 8, 0, 0, 0, 0,
    0x3a, 0x7e, 0x9b, 0x55, 0, 0, 0, 10, b'I', b'D', b'A', b'T', 0x78, 0x9c, 0x63, 0x60, 0, 0, 0, 2, 0, 1, 0x48, 0xaf,
    0xa4, 0x71, 0, 0, 0, 0, b'I', b'E', b'N', b'D', 0xae, 0x42, 0x60, 0x82,
];

/// Resolves every file name of the document to a picture.
struct Pictures;

impl AssetResolver for Pictures {
    fn read(&self, _uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        Ok(PICTURE.to_vec())
    }
}

fuzz_target!(|data: &[u8]| {
    let [obj, mtl] = parts(data);
    let plugin = Plugin::compiled_in(&lumistack_plugin_obj::PLUGIN).expect("the plugin is sound");
    let params = resolved(&plugin, &json!({})).expect("the defaults are in range");
    let read = |name: &str| match name {
        "a.obj" => Ok(obj.to_vec()),
        _ if mtl.is_empty() => Err(PluginError::Failed("no such file".into())),
        _ => Ok(mtl.to_vec()),
    };
    let Some(document) = reads(|_| import(&plugin, &MemoryHost::new(), &params, "a.obj", &read)) else { return };
    let options = LoadOptions { max_decoded_bytes: 64 << 20, max_picture_bytes: 64 << 20, ..LoadOptions::default() };
    reads(|task| load_with("a.glb", &document, &Pictures, &options, task));
});
