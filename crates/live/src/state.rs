//! Values that go from thread to thread: light fields to show, and patterns that show them.

use std::sync::Arc;

use lumistack_display::{Display, LayerStack, LightField, Weights};

/// A light field that a display shall show.
#[derive(Clone, Debug)]
pub struct Target {
    /// The display.
    pub display: Arc<Display>,
    /// Its rays, linear, 0..1.
    pub field: LightField,
    /// Weights of its rays while no viewer is tracked.
    pub weights: Weights,
    /// Raised whenever the content changes; a light field of the same content differs by its noise alone.
    pub content: u64,
    /// Passes over all views so far; 1 of a light field that was given.
    pub passes: u32,
}

/// Patterns that show a light field. A state is made whole and never changed; whoever shows it shows all of it.
#[derive(Clone, Debug)]
pub struct State {
    /// The patterns.
    pub stack: LayerStack,
    /// The light field that they were solved for.
    pub target: Arc<Target>,
    /// Number of that light field in its mailbox.
    pub target_number: u64,
    /// Weights that they were solved with.
    pub weights: Arc<Weights>,
    /// PSNR in dB of L̃/β against L over all rays with a weight.
    pub psnr_view: f64,
    /// Updates since the content changed.
    pub updates: u32,
}
