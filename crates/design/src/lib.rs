//! Analysis of displays, and comparison of designs.
//!
//! ```text
//! Display ──▶ analysis: bound, depth of field, spectral support, zone, ... ──▶ text, JSON, plots
//! Display ──▶ contrast: gratings at many depths through the solved stack ──▶ achieved contrast
//! results of a sweep ──▶ table: CSV, maps and curves like the paper's Figures 7 and 8
//! pictures ──▶ sheet: pictures next to each other, with text
//! ```
//!
//! Plots are SVG, and PNG rasterized from the same SVG.

mod analysis;
pub mod contrast;
pub mod predict;
pub mod sheet;
mod step;
pub mod table;

pub use analysis::{Analysis, AxisAnalysis, Brightness, Closed, Scene, Timing, Zone};

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
