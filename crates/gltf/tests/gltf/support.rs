//! Helpers that the tests share: a writer of small glTF files, resolvers, and the folder of files
//! of other projects.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use lumistack_core::{Cancel, Collector, Task};
use lumistack_gltf::unpack::{self, Packed, Unpacked, Unsound};
use lumistack_gltf::{AssetResolver, GltfError, LoadOptions};
use lumistack_scene::Scene;
use serde_json::{Value, json};

/// Reads files next to the glTF file, and records their names.
pub struct Folder {
    root: PathBuf,
    pub read: RefCell<Vec<String>>,
}

impl Folder {
    pub fn of(file: &Path) -> Self {
        Self { root: file.parent().unwrap().to_owned(), read: RefCell::default() }
    }
}

impl AssetResolver for Folder {
    fn read(&self, uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        self.read.borrow_mut().push(uri.to_owned());
        std::fs::read(self.root.join(uri)).map_err(|error| error.to_string())
    }
}

/// Files in memory, by name.
pub struct Memory(pub Vec<(&'static str, Vec<u8>)>);

impl AssetResolver for Memory {
    fn read(&self, uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        let found = self.0.iter().find(|(name, _)| *name == uri);
        found.map(|(_, bytes)| bytes.clone()).ok_or_else(|| "No such file".to_owned())
    }

    /// Converts the content and the result of decoding to bytes and back. A web page does the same
    /// if its decoders are in another WebAssembly module.
    fn unpack(&self, packed: &Packed<'_>) -> Result<Unpacked, Unsound> {
        let answer = unpack::answer(&packed.to_bytes()).expect("a request");
        let answer = unpack::answered(&answer).expect("an answer");
        let direct = unpack::unpack(packed);
        // broken splats hold NaN, which is not equal to itself
        assert!(answer == direct || format!("{answer:?}") == format!("{direct:?}"), "{packed:?}");
        answer
    }
}

/// Loads a file; returns the scene and the warnings as text.
pub fn load_with(bytes: &[u8], resolver: &dyn AssetResolver) -> (Result<Scene, GltfError>, Vec<String>) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let result = lumistack_gltf::load("test.gltf", bytes, resolver, Task::quiet(&warnings, &cancel));
    (result, warnings.take().iter().map(ToString::to_string).collect())
}

/// Loads a file from memory with options: a time, a variant.
pub fn load_choosing(bytes: &[u8], options: &LoadOptions) -> (Result<Scene, GltfError>, Vec<String>) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let result = lumistack_gltf::load_with("test.gltf", bytes, &Memory(Vec::new()), options, task);
    (result, warnings.take().iter().map(ToString::to_string).collect())
}

pub fn load_file_choosing(path: &Path, options: &LoadOptions) -> (Result<Scene, GltfError>, Vec<String>) {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let bytes = std::fs::read(path).unwrap();
    let result = lumistack_gltf::load_with("test.gltf", &bytes, &Folder::of(path), options, task);
    (result, warnings.take().iter().map(ToString::to_string).collect())
}

pub fn load_file(path: &Path) -> (Result<Scene, GltfError>, Vec<String>) {
    load_with(&std::fs::read(path).unwrap(), &Folder::of(path))
}

pub fn load(bytes: &[u8]) -> (Result<Scene, GltfError>, Vec<String>) {
    load_with(bytes, &Memory(Vec::new()))
}

/// Returns the scene of a file that loads without a warning.
pub fn scene(builder: &Builder) -> Scene {
    let (scene, warnings) = load(&builder.glb());
    assert_eq!(warnings, Vec::<String>::new());
    scene.unwrap()
}

/// Returns the error of a file that is refused.
pub fn error(builder: &Builder) -> String {
    load(&builder.glb()).0.unwrap_err().to_string()
}

/// Returns a folder of files of other projects. If it is missing, prints a line that says so and
/// returns `None`.
pub fn assets(folder: &str) -> Option<PathBuf> {
    let path = lumistack_testkit::skip::folder("LUMISTACK_ASSETS", "../shared/scenes")?.join(folder);
    if !path.is_dir() {
        lumistack_testkit::skip::skipped(&format!("{} is missing (set LUMISTACK_ASSETS)", path.display()));
        return None;
    }
    Some(path)
}

pub fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

pub const U8: u32 = 5121;
pub const I8: u32 = 5120;
pub const I16: u32 = 5122;
pub const U16: u32 = 5123;
pub const U32: u32 = 5125;
pub const F32: u32 = 5126;

/// Writes glTF files with one buffer.
#[derive(Clone)]
pub struct Builder {
    pub json: Value,
    pub bin: Vec<u8>,
}

impl Builder {
    pub fn new() -> Self {
        Self { json: json!({"asset": {"version": "2.0"}}), bin: Vec::new() }
    }

    /// Returns one triangle (0,0,0) (1,0,0) (0,1,0) without indices, on node 0 of a scene.
    pub fn triangle() -> Self {
        let mut builder = Self::new();
        let positions = builder.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        builder.push("meshes", json!({"primitives": [{"attributes": {"POSITION": positions}}]}));
        builder.push("nodes", json!({"mesh": 0}));
        builder.push("scenes", json!({"nodes": [0]}));
        builder
    }

    /// Appends `value` to a list of the JSON root, and returns the index of the new object.
    pub fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json.as_object_mut().unwrap().entry(list).or_insert_with(|| json!([]));
        let list = list.as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    pub fn accessor(&mut self, component: u32, kind: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        let accessor = json!({"bufferView": view, "componentType": component, "type": kind, "count": count});
        self.push("accessors", accessor)
    }

    pub fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let dimensions = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(F32, kind, values.len() / dimensions, &bytes)
    }

    /// Sets any member, by JSON pointer; the object or list that holds it must exist.
    pub fn set(&mut self, pointer: &str, value: Value) -> &mut Self {
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        match self.json.pointer_mut(parent).unwrap() {
            Value::Object(members) => {
                members.insert(key.to_owned(), value);
            }
            Value::Array(items) => items[key.parse::<usize>().unwrap()] = value,
            _ => panic!("{parent} is neither object nor array"),
        }
        self
    }

    pub fn remove(&mut self, pointer: &str) -> &mut Self {
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        self.json.pointer_mut(parent).unwrap().as_object_mut().unwrap().remove(key).unwrap();
        self
    }

    /// Returns the file as `.glb`.
    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json.get("buffers").is_none() {
            json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        }
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut file = b"glTF\x02\0\0\0".to_vec();
        file.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &bin)] {
            file.extend((chunk.len() as u32).to_le_bytes());
            file.extend_from_slice(kind);
            file.extend_from_slice(chunk);
        }
        file
    }

    /// Returns the file as `.gltf` with its buffer in a data URI.
    pub fn gltf(&self) -> Vec<u8> {
        let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&self.bin));
        self.gltf_with_buffer(&uri)
    }

    /// Returns the file as `.gltf` with its buffer at a URI.
    pub fn gltf_with_buffer(&self, uri: &str) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bin.len(), "uri": uri}]);
        json.to_string().into_bytes()
    }
}

/// Returns a PNG picture, with one colour per texel.
pub fn png(width: u32, texels: &[[u8; 4]]) -> Vec<u8> {
    let height = texels.len() as u32 / width;
    let image = image::RgbaImage::from_raw(width, height, texels.as_flattened().to_vec()).unwrap();
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}
