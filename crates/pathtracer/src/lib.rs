//! Unbiased path tracer: [`Scene`](lumistack_scene::Scene), [`Window`](lumistack_scene::Window) and
//! view grid to radiance.
//!
//! ```text
//! L(x, s) = ∫ over paths of the light that reaches the point x of z = 0 along slope s
//!                                                                        (scene-linear, unexposed)
//! ```
//!
//! Paths start at the viewer's side of the scene and are traced backwards. Each vertex takes light
//! from a sampled light and from the next scattered ray, weighted by the power heuristic (Veach,
//! Guibas 1995). A path ends by Russian roulette or after [`Settings::max_bounces`]. Any number of
//! views share one [`Renderer`]; a held-out view is one more call with another geometry.
//!
//! ```text
//! Scene ─▶ Geometry ─▶ Bvh             PrimaryRays (window, geometry, view)
//!       ├▶ Materials ─▶ Textures        │
//!       └▶ Lights ─▶ Distribution    Tracer ─▶ Bsdf, Lights, Draws ─▶ radiance[row][col][rgb]
//!                                    (per tile, by Renderer)
//! ```
//!
//! The same bytes come out on any number of threads. No file system, no clock: the crate compiles
//! to wasm32.

mod bsdf;
mod bvh;
mod clamp;
pub mod denoise;
mod distribution;
mod geometry;
mod lambert;
mod light;
mod math;
mod normals;
mod primary;
pub mod rays;
mod renderer;
mod sampler;
mod settings;
mod shading;
mod texture;
mod tracer;

pub use renderer::{Checks, Feature, Features, GuidedSplit, GuidedView, Memory, RenderError, Renderer, SplitView};
pub use settings::{AngularFilter, Settings, SettingsError};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that
/// this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
