//! Limits of a display, and the choice of a display to build.
//!
//! ```text
//! Display ──▶ analysis: bound on depth of field, spectral support, zone, brightness, rate
//!                                                                  ──▶ text, JSON, plots
//! Display ──▶ contrast: gratings at many depths through the solved stack
//!                                                                  ──▶ achieved share of the bound
//! results of a sweep ──▶ table: CSV, maps and curves like the paper's Figures 7 and 8
//! pictures ──▶ sheet: side by side, with words
//! ```
//!
//! Plots are SVG, and PNG made of the same SVG.

mod analysis;
pub mod contrast;
pub mod predict;
pub mod sheet;
pub mod table;

pub use analysis::{Analysis, AxisAnalysis, Brightness, Closed, Scene, Timing, Zone};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that
/// this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
