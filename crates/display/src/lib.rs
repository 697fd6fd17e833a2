//! The display: its description, the view grids it is made for, where rays meet its layers, and what it emits.
//!
//! Display space is right-handed millimetres: origin at the centre of the light field's rectangle, x right, y up, z to the
//! viewer; z = 0 is the zero-parallax plane. Array indices count down and right from the top left. A ray is a point on z = 0 and a
//! slope s = tangent of its direction (the paper's v/d_r, eq. 1).
//!
//! ```text
//! Display + FieldGeometry ──▶ RayMap ──▶ forward::simulate(LayerStack) ──▶ views ──▶ score against a LightField
//! ```

mod config;
mod field;
pub mod forward;
mod grid;
mod raymap;
mod score;
mod stack;
mod weights;

pub use config::{
    Backlight, Display, DisplayError, FieldConfig, Layer, LensletBacklight, Missing, OutsideBins, ProjectionKind,
    Sampling, Transfer,
};
pub use field::LightField;
pub use grid::{FieldGeometry, GridError, Projection, ViewGrid};
pub use raymap::{AxisTaps, BacklightMap, BacklightTap, LayerMap, RayMap, Tap};
pub use score::{Score, ViewScore, score, view_error};
pub use stack::{LayerStack, StackError};
pub use weights::{WeightError, Weights};
