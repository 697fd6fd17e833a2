//! The glTF reader reads arbitrary bytes. The first bytes of an input select its use: a whole file,
//! or a packed picture, primitive or buffer view in a valid file. A panic, a hang, or memory above
//! the limit is an error of the reader.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_core::{Cancel, Collector, Task};
use lumistack_gltf::{AssetResolver, LoadOptions, contents, load_with};

/// The memory that the reader may use for a scene. libFuzzer's own limit is much larger. A reader
/// exceeds libFuzzer's limit only if it uses much memory that the reader itself does not count.
const MAX_DECODED_BYTES: u64 = 64 << 20;

/// Resolves the name of every other file to the same content.
struct Content<'a>(&'a [u8]);

impl AssetResolver for Content<'_> {
    fn read(&self, _uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        Ok(self.0.to_vec())
    }
}

const TRIANGLE: &str = "data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";

/// Makes a triangle with the content as its texture. With `sky` the content is also the
/// environment.
fn picture(sky: bool) -> String {
    let extras = if sky { r#","extras":{"lumistack":{"environment":{"image":"content"}}}"# } else { "" };
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]{extras}}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
        "materials":[{{"emissiveTexture":{{"index":0}},"extensions":{{"KHR_materials_pbrSpecularGlossiness":
            {{"glossinessFactor":0.5,"specularGlossinessTexture":{{"index":0}}}}}}}}],
        "textures":[{{"source":0}}],"images":[{{"uri":"content"}}],
        "buffers":[{{"byteLength":36,"uri":"{TRIANGLE}"}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}}]}}"#
    )
}

/// Makes a glTF document with a primitive, whose Draco stream is the content.
fn draco(length: usize) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":0,"TEXCOORD_0":0}},"indices":0,
            "extensions":{{"KHR_draco_mesh_compression":{{"bufferView":0,"attributes":{{"POSITION":0,"NORMAL":1,"TEXCOORD_0":2}}}}}}}}]}}],
        "buffers":[{{"byteLength":{length},"uri":"content"}}],"bufferViews":[{{"buffer":0,"byteLength":{length}}}],
        "accessors":[{{"componentType":5126,"type":"VEC3","count":20}}]}}"#
    )
}

/// Makes a glTF document with positions or indices, whose meshopt stream is the content.
fn meshopt(length: usize, mode: &str, filter: &str, stride: usize, count: usize) -> String {
    let (bytes, kind) = (count * stride, if mode == "ATTRIBUTES" { "VEC3" } else { "SCALAR" });
    let (component, attribute) = if mode == "ATTRIBUTES" { (5126, "\"POSITION\":0") } else { (5125, "\"POSITION\":1") };
    let indices = if mode == "ATTRIBUTES" { "" } else { ",\"indices\":0" };
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{{attribute}}}{indices}}}]}}],
        "buffers":[{{"byteLength":{length},"uri":"content"}},{{"byteLength":{bytes}}},{{"byteLength":36,"uri":"{TRIANGLE}"}}],
        "bufferViews":[{{"buffer":1,"byteLength":{bytes},"extensions":{{"EXT_meshopt_compression":{{"buffer":0,
            "byteLength":{length},"byteStride":{stride},"count":{count},"mode":"{mode}","filter":"{filter}"}}}}}},
            {{"buffer":2,"byteLength":36}}],
        "accessors":[{{"bufferView":0,"componentType":{component},"type":"{kind}","count":{count}}},
            {{"bufferView":1,"componentType":5126,"type":"VEC3","count":3}}]}}"#
    )
}

fn load(file: &[u8], content: &[u8]) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let resolver = Content(content);
    let options = LoadOptions {
        time_s: Some(0.5),
        max_decoded_bytes: MAX_DECODED_BYTES,
        max_picture_bytes: MAX_DECODED_BYTES,
        ..LoadOptions::default()
    };
    if let Err(error) = load_with("fuzz.gltf", file, &resolver, &options, task) {
        assert!(!error.to_string().is_empty());
    }
    _ = contents("fuzz.gltf", file, &resolver, task);
}

fuzz_target!(|data: &[u8]| {
    let length = data.len();
    match data {
        [b'{', ..] | [b'g', b'l', b'T', b'F', ..] => load(data, b"a file beside it, of forty-four bytes or so......"),
        [b'D', b'R', b'A', b'C', b'O', ..] => load(draco(length).as_bytes(), data),
        // the first byte of a meshopt stream states its kind, so it selects the document
        [0xA0 | 0xA1, ..] => {
            load(meshopt(length, "ATTRIBUTES", "NONE", 12, 20).as_bytes(), data);
            load(meshopt(length, "ATTRIBUTES", "EXPONENTIAL", 12, 300).as_bytes(), data);
            load(meshopt(length, "ATTRIBUTES", "OCTAHEDRAL", 8, 300).as_bytes(), data);
        }
        [0xE0 | 0xE1, ..] => load(meshopt(length, "TRIANGLES", "NONE", 4, 72).as_bytes(), data),
        [0xD0 | 0xD1, ..] => load(meshopt(length, "INDICES", "NONE", 4, 72).as_bytes(), data),
        _ => {
            load(picture(false).as_bytes(), data);
            if data.starts_with(b"#?") {
                load(picture(true).as_bytes(), data);
            }
        }
    }
});
