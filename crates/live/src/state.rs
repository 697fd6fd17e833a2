//! Values that threads exchange: light fields to show, and patterns that show them.

use std::sync::Arc;

use lumistack_display::{Display, LayerStack, LightField, Weights};

/// A light field that a display should show.
#[derive(Clone, Debug)]
pub struct Target {
    /// The display.
    pub display: Arc<Display>,
    /// The light field, linear, 0..1.
    pub field: LightField,
    /// Weights of its rays while no viewer is tracked.
    pub weights: Weights,
    /// Number of the content. Light fields of the same content differ by their noise alone.
    pub content: u64,
    /// Renderings of all views so far; 1 for a given light field.
    pub passes: u32,
}

/// Patterns that show a light field. A state is complete and never changes, so a display always
/// shows matching patterns.
#[derive(Clone, Debug)]
pub struct State {
    /// The patterns.
    pub stack: LayerStack,
    /// The light field that they were solved for.
    pub target: Arc<Target>,
    /// Weights that they were solved with.
    pub weights: Arc<Weights>,
    /// PSNR in dB of L̃/β against L over all rays with a weight.
    pub psnr_view: f64,
    /// Updates since the content changed.
    pub updates: u32,
}
