//! Buffers of the loops along rows, for one thread.

use crate::factor::PAD;
use crate::plan::Plan;
use crate::step::{Block, Sums};

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// a_m of `step.rs` along a run of columns, `[frame][column of the run]`.
    pub(crate) product: Vec<f32>,
    /// Per frame, the sum of the rotations by all layers; empty if layers attenuate.
    pub(crate) phase: Vec<f32>,
    /// Values of one factor along a run.
    pub(crate) values: Vec<f32>,
    /// L̃ along a run.
    pub(crate) emitted: Vec<f32>,
    /// The error e = βL − L̃ along a run.
    pub(crate) errors: Vec<f32>,
    /// Curvature along a run of columns. It is used only for layers that rotate polarization, since
    /// the Gram matrix does not bound their curvature.
    pub(crate) curvature: Vec<f32>,
    /// Another row of this struct (error, emission, a_m or curvature), times the weights.
    pub(crate) weighted: Vec<f32>,
    /// The sums of `step.rs`: r and G (upper triangle), or the numerator n and the denominator d of
    /// the paper's rule: `[quantity][x]`.
    pub(crate) sums: Vec<f32>,
    /// The sums in f64, if a pixel may get so many rays that f32 is too coarse; otherwise empty.
    pub(crate) long_sums: Vec<f64>,
    pub(crate) block: Block,
}

impl Scratch {
    /// Allocates the buffers for lines of factor `n`.
    pub(crate) fn new(plan: &Plan, n: usize) -> Self {
        let frames = plan.frames;
        let row = || vec![0.0; plan.cols + PAD];
        let sums = Sums::Gram.count(frames).max(2 * frames) * plan.maps[n].layout.stride;
        Self {
            product: vec![0.0; frames * plan.cols],
            phase: if plan.is_product() { Vec::new() } else { vec![0.0; frames * plan.cols] },
            values: row(),
            emitted: row(),
            errors: row(),
            curvature: row(),
            weighted: row(),
            sums: vec![0.0; sums],
            long_sums: vec![0.0; if plan.maps[n].short_sums { 0 } else { sums }],
            block: Block::new(frames),
        }
    }
}
