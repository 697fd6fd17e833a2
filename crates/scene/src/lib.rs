//! The scene in the form that all stages after the import read, and the window: the rectangle of
//! the scene that a display shows.
//!
//! Importers fill [`SceneParts`] and call [`SceneParts::validate`], which returns a [`Scene`]. The
//! scene's indices, numbers and transforms are valid, so renderers need no checks. Lengths are in
//! scene units, angles in radians, and light is in linear sRGB.

mod bounds;
mod error;
mod material;
mod parts;
mod splats;
mod validate;
mod window;

pub use bounds::Bounds;
pub use error::SceneError;
pub use material::{
    AlphaMode, Anisotropy, Clearcoat, Filter, Image, Iridescence, Lamp, Material, Pixels, Sheen, Texture, TextureUse,
    Wrap,
};
pub use parts::{Camera, Environment, Instance, Light, LightKind, Mesh, Projection, SceneParts};
pub use splats::{Cloud, Encoding, MAX_DEGREE, PlacedCloud};
pub use validate::Scene;
pub use window::{Similarity, Window, WindowError};

/// Hash of this crate's sources, made at build. It is part of the key of every cached result to
/// which this code contributes.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
