//! Plots as SVG, and PNGs rasterized from the same SVG.
//!
//! [`curves`], [`areas`] and [`map`] are standalone plots of the design tools: black on white, with
//! title and legend. The plots of [`page`] are embedded in an HTML page and use its text colour.

mod chart;
pub mod page;
mod raster;
mod sheet;

use thiserror::Error;

pub use chart::FAMILY;
pub use raster::{codes, png};
pub use sheet::{Area, Axes, CAP_DB, COLOURS, Curve, Map, areas, curves, map};

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// A plot that cannot be drawn.
#[derive(Debug, Error)]
#[error("plot: {0}")]
pub struct PlotError(String);

impl PlotError {
    /// Makes an error from a text or from the error of a library.
    pub fn new(error: impl std::fmt::Display) -> Self {
        Self(error.to_string())
    }
}
