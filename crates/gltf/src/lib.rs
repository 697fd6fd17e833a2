//! Reads glTF 2.0 files into a [`Scene`](lumistack_scene::Scene).
//!
//! [`load`] takes the bytes of a `.gltf` or `.glb` file, and an [`AssetResolver`] that reads the
//! files to which the glTF file refers. The crate itself uses no file system. The `gltf` crate
//! defines the types of the JSON. This crate checks every index, count and offset before its use.
//! So no file can cause a panic, and memory is bounded.
//!
//! [`load_with`] also takes a time of an animation, and a variant of materials. `docs/GLTF.md`
//! lists the supported extensions.
//!
//! Meshopt, Draco and Basis Universal streams are decoded by libraries in pure Rust, within the
//! limits of this crate.
//!
//! ```
//! use lumistack_core::{Cancel, Collector, Task};
//! use lumistack_gltf::AssetResolver;
//!
//! /// Reads files in the folder of the glTF file, and no other files.
//! struct Folder(std::path::PathBuf);
//!
//! impl AssetResolver for Folder {
//!     fn read(&self, uri: &str, max_bytes: u64) -> Result<Vec<u8>, String> {
//!         let text = |error: std::io::Error| error.to_string();
//!         // the canonical path has no `..` and no links, so its start shows the folder
//!         let folder = self.0.canonicalize().map_err(text)?;
//!         let path = folder.join(uri).canonicalize().map_err(text)?;
//!         let file = path.metadata().map_err(text)?;
//!         if !path.starts_with(&folder) || !file.is_file() || file.len() > max_bytes {
//!             let folder = folder.display();
//!             return Err(format!("expected a file of at most {max_bytes} bytes in {folder}"));
//!         }
//!         std::fs::read(path).map_err(text)
//!     }
//! }
//!
//! let (warnings, cancel) = (Collector::default(), Cancel::default());
//! let resolver = Folder(".".into());
//! assert!(resolver.read("Cargo.toml", 1 << 20).is_ok());
//! assert!(resolver.read("Cargo.toml", 1).is_err());
//! assert!(resolver.read("../../README.md", 1 << 20).is_err());
//!
//! let text = br#"{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}]}"#;
//! let task = Task::quiet(&warnings, &cancel);
//! let error = lumistack_gltf::load("a.gltf", text, &resolver, task).unwrap_err();
//! let expected = "expected no index, since the file has nothing to which the index could refer";
//! assert_eq!(error.to_string(), format!("a.gltf: /nodes/0/mesh: {expected}, found 0"));
//! ```

// the example of README.md is a test
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

mod accessor;
mod animation;
mod attributes;
mod cause;
mod container;
mod document;
mod draco;
mod error;
mod extensions;
mod fields;
mod glossiness;
mod images;
mod lights_cameras;
mod load;
mod material;
mod material_extensions;
mod mesh;
mod meshopt;
mod nodes;
mod options;
mod quote;
mod skin;
mod splats;
mod textures;
mod typed;
pub mod unpack;
mod variants;
mod view;

pub use error::GltfError;
pub use load::{Contents, contents, load, load_with};
pub use options::LoadOptions;

/// Hash of this crate's sources, computed at build. It is part of the key of every cached result
/// that depends on this code.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// Reads the files to which a glTF file refers.
pub trait AssetResolver {
    /// Returns the content of the file at `uri`, which is relative to the glTF file and already
    /// percent-decoded. The glTF file is not trusted: `uri` may name any file (`../../secret`,
    /// `/dev/zero`), so the resolver decides which files it reads.
    ///
    /// An error is the reason in a few words, for the user ("No such file"). A file larger than
    /// `max_bytes` is an error, too; the resolver must not read such a file.
    fn read(&self, uri: &str, max_bytes: u64) -> Result<Vec<u8>, String>;

    /// Decodes packed content. A web page replaces this function if its decoders are in another
    /// WebAssembly module, to which the page then passes the content.
    ///
    /// # Errors
    /// If the content is broken, not supported or too large, or if its decoder panics.
    fn unpack(&self, packed: &unpack::Packed<'_>) -> Result<unpack::Unpacked, unpack::Unsound> {
        unpack::unpack(packed)
    }
}
