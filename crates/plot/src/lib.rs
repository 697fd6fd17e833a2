//! Plots: one SVG each, and PNGs made of the same SVG.
//!
//! [`curves`], [`areas`] and [`map`] stand alone, black on white, with headline and legend: the
//! files of design tools. The plots of [`page`] are parts of an HTML page and take its text colour.

mod chart;
pub mod page;
mod raster;
mod sheet;

use thiserror::Error;

pub use chart::FAMILY;
pub use raster::{codes, png};
pub use sheet::{Area, Axes, CAP_DB, COLOURS, Curve, Map, areas, curves, map};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that
/// this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// A plot that cannot be drawn.
#[derive(Debug, Error)]
#[error("plot: {0}")]
pub struct PlotError(String);

impl PlotError {
    /// Wraps the error of a library.
    pub fn new(error: impl std::fmt::Display) -> Self {
        Self(error.to_string())
    }
}
