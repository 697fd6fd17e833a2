//! A scene in front of a display: all that lies between a file that was read and display-referred views, as functions of values in memory.
//!
//! ```text
//! Scene ──light──▶ lit Scene ──place──▶ Placement ──Renderer──▶ radiance ──Look──▶ LightField
//! ```
//!
//! The pipeline keeps what it makes in a run folder, the page in memory; both take it from here. No file system, no clock: the crate compiles to wasm32.

mod depth;
mod edit;
mod error;
mod expose;
mod job;
pub mod light;
mod look;
mod place;
mod renderer;
mod subject;
mod surround;

pub use depth::Depths;
pub use edit::edited;
pub use error::{BadValue, Place, ShotError};
pub use expose::{brightest, expose_over};
pub use job::{
    AngularFilter, Background, Denoise, Engine, FitDepth, LightJob, Near, RenderJob, Tone, WindowFrom, WindowJob,
    ZoneSamples, seeded,
};
pub use look::{Look, automatic_look};
pub use place::{Found, Placement, find_window, place};
pub use renderer::{SceneRenderer, put_before, slopes};
pub use subject::Subject;

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
