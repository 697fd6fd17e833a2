//! A scene in front of a display: light, window, depth, exposure and tone curve. Every step is a
//! function of values in memory.
//!
//! ```text
//! Scene ─light─▶ lit Scene ─place─▶ Placement ─Renderer─▶ radiance ─ToneMapping─▶ LightField
//! ```
//!
//! The pipeline keeps the results in a run folder, the browser page in memory. The crate uses no
//! file system and no clock, and compiles to wasm32. `examples/patterns.rs` uses all these steps.

mod depth;
mod edit;
mod error;
mod expose;
mod job;
pub mod light;
mod place;
mod renderer;
mod subject;
mod surround;
mod tone_mapping;

pub use depth::Depths;
pub use edit::edited;
pub use error::{BadValue, Place, ShotError};
pub use expose::{Brightest, expose_over};
pub use job::{
    AngularFilter, Background, Denoise, Engine, FitDepth, LightJob, Near, RenderJob, Tone, WindowFrom, WindowJob,
    ZoneSamples, seeded,
};
pub use place::{Found, Placement, coarser, find_camera, find_window, place};
pub use renderer::{SceneRenderer, put_before, slopes};
pub use subject::{LitScene, Subject};
pub use tone_mapping::{ToneMapping, automatic_tone_mapping};

/// Hash of this crate's sources, computed at build. It is part of the key of every cached result
/// that depends on this code.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
