//! Gaussian splats: readers of the files in which captures are kept, and a renderer that makes many views of them at once.
//!
//! ```text
//! .ply .spz SOG ──read──▶ Cloud ──Scene──▶ Renderer (window, slopes) ──▶ light and depth of every view
//! ```
//!
//! No file system, no clock: the crate compiles to wasm32, without the feature `parallel` on one thread.

mod glb;
pub mod read;
mod render;
mod scene;
pub mod write;

pub use glb::glb;
pub use lumistack_scene::Cloud;
pub use render::{Renderer, Space, SplatView, Surfaces, Wanted};
pub use scene::{LoadError, scene};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
