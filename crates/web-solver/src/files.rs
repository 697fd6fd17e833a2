//! The dropped files, in memory, and the reader of the scene among them.

use std::collections::BTreeMap;

use lumistack_core::Task;
use lumistack_gltf::unpack::{Packed, Unpacked, Unsound};
use lumistack_gltf::{AssetResolver, LoadOptions};
use lumistack_scene::Scene;

use crate::decoders;
use crate::error::Error;

/// Largest decoded size of a scene without its pictures, bytes. A WebAssembly module has at most
/// 4 GiB of memory.
const MOST_DECODED: u64 = 1 << 30;
/// Largest decoded size of a scene's pictures, bytes.
const MOST_PICTURES: u64 = 512 << 20;

/// Dropped files by path.
#[derive(Clone, Debug, Default)]
pub struct Files(BTreeMap<String, Vec<u8>>);

/// Finds the files to which a file in `folder` refers by paths relative to this folder.
struct Beside<'a> {
    files: &'a Files,
    folder: &'a str,
}

impl Files {
    /// Adds a file.
    pub fn add(&mut self, path: &str, bytes: Vec<u8>) {
        self.0.insert(path.into(), bytes);
    }

    /// Reads the scene from the file `path`. The file is a capture of splats if it has the
    /// extension of such files, otherwise glTF.
    ///
    /// # Errors
    /// The command's errors: they state the place in the file, the expected and the found value.
    pub fn scene(&self, path: &str, task: Task<'_>) -> Result<Scene, Error> {
        let bytes = self.0.get(path).ok_or_else(|| Error::value(path, "a readable file", "none"))?;
        let (folder, name) = path.rsplit_once('/').map_or(("", path), |(folder, name)| (folder, name));
        let beside = Beside { files: self, folder };
        let options =
            LoadOptions { max_decoded_bytes: MOST_DECODED, max_picture_bytes: MOST_PICTURES, ..LoadOptions::default() };
        let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension).to_ascii_lowercase();
        if !matches!(extension.as_str(), "ply" | "spz" | "sog" | "json") {
            return Ok(lumistack_gltf::load_with(name, bytes, &beside, &options, task)?);
        }
        let failed = |error: String| Error(format!("{name}: {error}"));
        // a capture whose file is JSON also consists of pictures beside this file; all other
        // captures are single files
        let near = self.0.iter().filter_map(|(path, bytes)| Some((beside.name(path)?, bytes.as_slice())));
        let near = if extension == "json" { near.collect() } else { Vec::new() };
        let found = match decoders::unpack(&Packed::Capture(bytes, near)) {
            Ok(Unpacked::Splats(found)) => found,
            Ok(_) => return Err(failed("expected splats, found other content".into())),
            Err(Unsound { place, expected, found }) => {
                let place = if place.is_empty() { String::new() } else { format!("{place}: ") };
                return Err(failed(format!("{place}expected {expected}, found {found}")));
            }
        };
        found.left_out.iter().for_each(|message| task.warn(name, message.clone()));
        if found.cloud.is_empty() {
            return Err(failed("expected splats, found none".into()));
        }
        let rotation = found.axes.scene_from_file().to_array();
        let document = lumistack_splats::glb(&found.cloud, rotation, 1.0)
            .ok_or_else(|| failed(format!("expected splats of less than 4 GiB, found {} splats", found.cloud.len())))?;
        Ok(lumistack_gltf::load_with(name, &document, &beside, &options, task)?)
    }
}

impl<'a> Beside<'a> {
    /// Returns the path of a file relative to the folder; `None` if it is outside the folder.
    fn name(&self, path: &'a str) -> Option<&'a str> {
        if self.folder.is_empty() { Some(path) } else { path.strip_prefix(self.folder)?.strip_prefix('/') }
    }
}

impl AssetResolver for Beside<'_> {
    fn unpack(&self, packed: &Packed<'_>) -> Result<Unpacked, Unsound> {
        decoders::unpack(packed)
    }

    fn read(&self, uri: &str, max_bytes: u64) -> Result<Vec<u8>, String> {
        let plain = uri.strip_prefix("./").unwrap_or(uri);
        let path = if self.folder.is_empty() { plain.to_owned() } else { format!("{}/{plain}", self.folder) };
        let missing = "the file is not among the opened files; open the folder that contains the file";
        let bytes = self.files.0.get(&path).ok_or(missing)?;
        if bytes.len() as u64 > max_bytes {
            return Err(format!("expected a file of at most {max_bytes} bytes, found {}", bytes.len()));
        }
        Ok(bytes.clone())
    }
}
