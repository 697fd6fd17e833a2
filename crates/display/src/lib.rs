//! The display: its description, its view grids, the intersections of rays with its layers, and its
//! emission.
//!
//! Display space is right-handed, in millimetres. The origin is at the centre of the light field's
//! rectangle. The x axis points to the right, the y axis up, the z axis to the viewer. The display
//! plane is z = 0, with zero parallax. Array indices count down and right from the top left.
//!
//! A ray is given by its point on the display plane and its slope s, along x and y. The slope is
//! the tangent of the ray's angle to the z axis (v/d_r in eq. 1 of the paper).
//!
//! ```text
//! Display + FieldGeometry ──▶ RayMap ─────────────────┐
//! Display + LayerStack ──▶ effective stack (Response) ─┴─▶ Simulator ─▶ views ─▶ score
//!                                                                       against a LightField
//! ```

// the example of README.md is a test
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

mod adapt;
mod area;
mod backlight;
mod blur;
mod check;
mod closed_form;
mod colour_sequence;
mod config;
mod depth;
mod error;
mod field;
mod formation;
pub mod forward;
mod grid;
mod homography;
mod layer;
mod native;
mod panel;
mod panel_stack;
mod presets;
mod raymap;
mod response;
mod sampling;
mod score;
mod stack;
mod stack_index;
mod support;
#[cfg(test)]
mod tests;
mod tile;
mod time;
mod transfer;
mod variation;
mod views;
mod weights;
mod zone;

/// Hash of this crate's sources, computed at build. It is part of the key of every cached result
/// that depends on this code.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

pub use area::{AreaMap, Part};
pub use backlight::{Backlight, LensletBacklight, OutsideBins};
pub use closed_form::ClosedForm;
pub use colour_sequence::{ColourOrder, ColourSequence};
pub use config::{Display, FieldConfig, ProjectionKind};
pub use error::DisplayError;
pub use field::{LightField, SeenDepth};
pub use formation::Formation;
pub use forward::{EmittedView, LEAST_SHARE, SeenView, Simulator};
pub use grid::{FieldGeometry, GridError, Projection, ViewGrid, spread};
pub use homography::Homography;
pub use layer::{Layer, LayerColour, quantize};
pub use native::native_step;
pub use panel::{Flip, Lens, Panel};
pub use panel_stack::{LensArray, PanelStack};
pub use presets::PRESETS;
pub use raymap::{AxisTaps, BacklightMap, BacklightTap, LayerMap, RayMap, Tap};
pub use response::Response;
pub use sampling::{Missing, Sampling};
pub use score::{Score, ViewScore, score, view_error};
pub use stack::{LayerStack, StackError};
pub use stack_index::{BacklightEntry, LayerEntry, StackIndex};
pub use tile::{Region, Tile, TilePart, Tiling};
pub use transfer::{Channels, Transfer};
pub use variation::Variation;
pub use views::Views;
pub use weights::{EyeBox, WeightError, Weights};
pub use zone::{DirectionScore, LEAST_DIRECTIONS, Zone, ZoneScore};
