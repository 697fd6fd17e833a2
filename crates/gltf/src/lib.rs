//! glTF 2.0 to [`Scene`](lumistack_scene::Scene).
//!
//! [`load`] takes the bytes of a `.gltf` or `.glb` file and an [`AssetResolver`] that reads the files it refers to; the crate itself
//! touches no file system. The `gltf` crate gives the JSON its types; every index, count and offset is checked here before it is
//! used, so that no file can cause a panic, and memory is bounded.
//!
//! # What is read
//!
//! | part | support |
//! |---|---|
//! | buffers | files, data URIs, the binary chunk; sparse and normalized accessors |
//! | meshes | triangle lists, strips and fans, indexed or not; two texture coordinate sets per material; `COLOR_0`; morph targets at their weights in the file |
//! | nodes | matrix or translation, rotation, scale; shared meshes become instances; skins in the pose of the file |
//! | materials | metallic-roughness with all textures but occlusion, normal maps, alpha modes, emission |
//! | images | PNG, JPEG, WebP; 16 bits are kept |
//! | cameras | both kinds; `extras.lumistack.focus_distance` in scene units |
//! | scene | `extras.lumistack.environment = {"image": "sky.hdr", "strength": 1.0, "rotation": [0, 0, 0, 1]}`, an equirectangular Radiance map |
//! | `EXT_mesh_gpu_instancing` | copies become instances |
//! | `EXT_texture_webp` | yes |
//! | `KHR_lights_punctual` | yes; `range` has no effect |
//! | `KHR_materials_emissive_strength`, `_ior`, `_transmission`, `_unlit` | yes |
//! | `KHR_materials_volume` | a thickness above 0 makes a solid, whatever the thickness; attenuation |
//! | `KHR_mesh_quantization` | yes |
//! | `KHR_texture_transform` | yes |
//!
//! A file that *requires* any other extension is refused; one that *uses* it is loaded with a warning. Points, lines and animations are
//! left out with a warning.
//!
//! ```
//! use lumistack_core::{Cancel, Collector, Task};
//! use lumistack_gltf::AssetResolver;
//!
//! /// Files beside the glTF file.
//! struct Folder(std::path::PathBuf);
//!
//! impl AssetResolver for Folder {
//!     fn read(&self, uri: &str) -> Result<Vec<u8>, String> {
//!         std::fs::read(self.0.join(uri)).map_err(|error| error.to_string())
//!     }
//! }
//!
//! let (warnings, cancel) = (Collector::default(), Cancel::default());
//! let resolver = Folder("scenes/none".into());
//! let text = br#"{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}]}"#;
//! let error = lumistack_gltf::load("a.gltf", text, &resolver, Task::quiet(&warnings, &cancel)).unwrap_err();
//! assert_eq!(error.to_string(), "a.gltf: /nodes/0/mesh: expected an index below 0, found 0");
//! ```

mod accessor;
mod container;
mod document;
mod error;
mod extensions;
mod images;
mod lights_cameras;
mod load;
mod material;
mod mesh;
mod nodes;
mod skin;

pub use error::GltfError;
pub use load::load;

/// Reads the files that a glTF file refers to.
pub trait AssetResolver {
    /// The content of the file at `uri`, which is relative to the glTF file and already percent-decoded.
    ///
    /// # Errors
    /// The reason in a few words, for the user ("No such file").
    fn read(&self, uri: &str) -> Result<Vec<u8>, String>;
}
