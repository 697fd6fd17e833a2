//! Gaussian splats: readers of capture files, and a renderer that renders many views together.
//!
//! ```text
//! .ply .spz SOG ──read──▶ Cloud ──Scene──▶ Renderer (window, slopes) ──▶ light and depth per view
//! ```
//!
//! The crate uses no file system and no clock, so it compiles to wasm32. Without the feature
//! `parallel` it runs on one thread.

mod glb;
pub mod read;
mod render;
mod scene;
pub mod write;

pub use glb::glb;
pub use lumistack_scene::Cloud;
pub use render::{Renderer, Space, SplatView, Surfaces, Wanted};
pub use scene::{LoadError, scene};

/// Hash of this crate's sources, computed at build. It is part of the key of every cached result
/// that this code contributes to.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
