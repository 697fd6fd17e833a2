//! Tables of a job that describe how a scene is seen.

mod background;
mod light;
mod render;
mod window;

pub use self::background::Background;
pub use self::light::{LightJob, Tone};
pub use self::render::{AngularFilter, Denoise, Engine, RenderJob, ZoneSamples, seeded};
pub use self::window::{FitDepth, Near, WindowFrom, WindowJob};
