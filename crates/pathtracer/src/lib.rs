//! Path tracer: computes radiance from a [`Scene`](lumistack_scene::Scene), a
//! [`Window`](lumistack_scene::Window) and a view grid. By default, the radiance is unbiased except
//! for the limit on bounces.
//!
//! ```text
//! L(x, s) = ∫ over paths of the light that reaches the point x of z = 0 along slope s
//!                                                                        (scene-linear, unexposed)
//! ```
//!
//! Paths start at the viewer's side of the scene and are traced backwards. Each vertex receives
//! light in two ways: from a sampled light, and along the next scattered ray. The power heuristic
//! weights both contributions (Veach, Guibas 1995). A path ends at a miss, at a surface that
//! scatters nothing, by Russian roulette, or after [`Settings::max_bounces`]. Any number of views
//! share one [`Renderer`]. A held-out view takes one more call of [`Renderer::render_view`], with
//! another geometry.
//!
//! ```text
//! Scene ─▶ Geometry ─▶ Bvh             PrimaryRays (window, geometry, view)
//!       ├▶ Materials ─▶ Textures        │
//!       └▶ Lights ─▶ Distribution    Tracer ─▶ Bsdf, Lights, Draws ─▶ radiance[row][col][rgb]
//!                                    (per tile, by Renderer)
//! ```
//!
//! Any number of threads gives the same bytes. The crate uses no file system and no clock, so it
//! compiles to wasm32.

// the example of README.md is a test
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

mod bsdf;
mod bvh;
mod clamp;
pub mod denoise;
mod distribution;
mod geometry;
mod lambert;
mod light;
mod light16;
mod light32;
mod math;
mod normals;
mod primary;
pub mod rays;
mod renderer;
mod sampler;
mod settings;
mod shading;
mod sparse;
mod surface;
mod texture;
mod tracer;

pub use renderer::{Checks, Feature, Features, GuidedSplit, GuidedView, Memory, RenderError, Renderer, SplitView};
pub use settings::{AngularFilter, PixelSet, Settings, SettingsError};

/// Hash of this crate's sources, made at build. It is part of the key of every cached result that
/// this code contributes to.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
