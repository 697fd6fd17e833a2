//! Values that threads exchange: light fields to show, and patterns that show them.

use std::sync::Arc;

use lumistack_display::{Display, LayerStack, LightField, Weights};

use crate::track::Boxes;

/// A light field that a display should show.
#[derive(Clone, Debug)]
pub struct Target {
    /// The display that should show the light field.
    pub display: Arc<Display>,
    /// The light field, linear, 0..1.
    pub field: LightField,
    /// Weights of the light field's rays while no viewer is tracked.
    pub weights: Weights,
    /// Number of the content. Light fields with the same number differ only in their noise.
    pub content: u64,
    /// Number of passes, each of which added paths to all views; 1 for a given light field.
    pub passes: u32,
}

/// Patterns that show a light field. A state is complete and never changes, so a display always
/// shows matching patterns.
#[derive(Clone, Debug)]
pub struct State {
    /// The patterns as a layer stack.
    pub stack: LayerStack,
    /// The light field for which the patterns were solved.
    pub target: Arc<Target>,
    /// The viewers for whom the patterns were solved.
    pub boxes: Boxes,
    /// PSNR in dB of the emitted light field L̃/β against the target L, over the rays that were
    /// solved and have a weight above 0.
    pub psnr_view: f64,
    /// Number of iterations since the content changed.
    pub updates: u32,
}
