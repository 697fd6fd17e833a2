//! Layers whose stored values f differ from the values F = A f that rays read. The reasons are
//! blur, crosstalk, colour filters or tied channels ([`lumistack_display::Response`]).
//!
//! G_i is the Gram matrix and r_i the residual sums of pixel i as rays read it. A change d of the
//! stored values changes the objective by
//!
//! ```text
//! Σ_i −2 r_iᵀ (Σ_j A_ij d_j) + (Σ_j A_ij d_j)ᵀ G_i (Σ_j A_ij d_j)
//!     ≤ Σ_j −2 (Σ_i A_ij r_i)ᵀ d_j + d_jᵀ (Σ_i A_ij ρ_i G_i) d_j
//!
//! ρ_i = Σ_j A_ij,  by Jensen's inequality for A ≥ 0
//! ```
//!
//! The bound equals the change at d = 0 and is separable over the stored pixels. So the usual step
//! on Aᵀr and Aᵀ(ρG) never raises the objective. The bound is exact if channels are only tied or
//! filtered, without blur and crosstalk. For the multiplicative rule, Aᵀ is applied to its sums n
//! and d, which `step.rs` defines.

use lumistack_display::Response;

use crate::aligned::Aligned;
use crate::bands;
use crate::factor::{Factor, Layout};
use crate::line::{LineStep, Outcome, StepFunctions};
use crate::step::{Block, Sums};

/// The sums of a factor's stored pixels, as planes: `[quantity][channel][line · cols + col]`.
pub(crate) struct AdjointSums {
    planes: Vec<[Vec<f32>; 3]>,
}

impl AdjointSums {
    /// Applies Aᵀ to the sums of the pixels that rays read. `sums` is `[channel and stored
    /// line][quantity][x]`.
    pub(crate) fn of(response: &Response, layout: &Layout, needed: Sums, sums: &[f32]) -> Self {
        let (rows, cols) = (layout.lines(), layout.cols());
        let quantities = needed.count(layout.frames);
        let line_len = quantities * layout.stride;
        let filters: Vec<[f32; 3]> = (0..cols).map(|col| response.filter(col)).collect();
        let mix = response.mix();
        let mut scratch = Vec::new();
        // Blur the filter of each channel; a filter is the same in every row. Mixed over channels,
        // the blurred filters give ρ_i of the file's head: the sum of row i of A.
        let passed = [0, 1, 2].map(|c: usize| {
            let filter: Vec<f32> = filters.iter().map(|filter| filter[c]).collect();
            let mut blurred = vec![0.0; cols];
            response.blur(1, cols, &filter, &mut blurred, &mut scratch);
            blurred
        });
        // Apply Aᵀ: mix the channels, blur by the adjoint, then filter. Entries of the Gram matrix
        // are also multiplied by ρ.
        let plane_of = |quantity: usize| -> [Vec<f32>; 3] {
            let bounded = needed != Sums::Ratio && quantity >= layout.frames;
            let (mut mixed, mut plane, mut scratch) = (vec![0.0; rows * cols], vec![0.0; rows * cols], Vec::new());
            let mut stored = [0, 1, 2].map(|to: usize| {
                mixed.fill(0.0);
                for (channel, row) in mix.iter().enumerate().filter(|(_, row)| row[to] != 0.0) {
                    for line in 0..rows {
                        let at =
                            (channel * layout.stored_lines() + line) * line_len + quantity * layout.stride + layout.pad;
                        let values = &sums[at..at + cols];
                        for (col, (mixed, &value)) in mixed[line * cols..][..cols].iter_mut().zip(values).enumerate() {
                            let reach: f32 = if bounded { (0..3).map(|c| row[c] * passed[c][col]).sum() } else { 1.0 };
                            *mixed += row[to] * reach * value;
                        }
                    }
                }
                response.blur_adjoint(rows, cols, &mixed, &mut plane, &mut scratch);
                let columns = filters.iter().cycle();
                plane.iter().zip(columns).map(|(&value, filter)| value * filter[to]).collect::<Vec<f32>>()
            });
            // tied channels share one value, so their sums are added
            if response.is_tied() {
                let [red, green, blue] = &stored;
                let sum: Vec<f32> = red.iter().zip(green).zip(blue).map(|((r, g), b)| r + g + b).collect();
                stored = [sum.clone(), sum.clone(), sum];
            }
            stored
        };
        Self { planes: bands::map(quantities, || (), |(), quantity| plane_of(quantity)) }
    }
}

/// One line of stored values, and the step that updates it.
pub(crate) struct StepLine<'a, 'b> {
    pub(crate) adjoint: &'a AdjointSums,
    pub(crate) channel: usize,
    pub(crate) line: usize,
    pub(crate) step: LineStep<'b>,
    pub(crate) functions: &'a StepFunctions,
    pub(crate) block: &'a mut Block,
    /// Storage for the line's sums, `[quantity][x]`.
    pub(crate) sums: &'a mut [f32],
}

impl StepLine<'_, '_> {
    /// Copies the line's sums from the planes, and updates the line's pixels.
    pub(crate) fn update(self) -> Outcome {
        let Self { adjoint, channel, line, mut step, functions, block, sums } = self;
        let columns = step.columns.clone();
        for (plane, row) in adjoint.planes.iter().zip(sums.chunks_exact_mut(step.stride)) {
            row[columns.clone()].copy_from_slice(&plane[channel][line * columns.len()..][..columns.len()]);
        }
        Outcome { gain: step.by_sums(functions, sums, block), ..Outcome::default() }
    }
}

/// Sets the three channels of a factor to their mean. The display drives them by one value, so they
/// are tied.
pub(crate) fn tie(stored: &mut Factor) {
    let (left, right) = stored.values.split_at_mut(stored.layout.stored_lines() * stored.layout.line_len());
    let (middle, right) = right.split_at_mut(left.len());
    for ((red, green), blue) in left.iter_mut().zip(middle).zip(right) {
        let mean = (*red + *green + *blue) / 3.0;
        (*red, *green, *blue) = (mean, mean, mean);
    }
}

/// Computes the values that rays read from the stored values: filter, blur, then mix the channels.
pub(crate) fn respond(response: &Response, stored: &Factor, effective: &mut Aligned) {
    let layout = &stored.layout;
    let (rows, cols) = (layout.lines(), layout.cols());
    let mix = response.mix();
    // apply A to a frame, except for the mixture of channels: filter each channel, then blur it
    let frame_of = |frame: usize| -> [Vec<f32>; 3] {
        let (mut plane, mut scratch) = (vec![0.0; rows * cols], Vec::new());
        [0, 1, 2].map(|channel: usize| {
            for line in 0..rows {
                let row = &stored.row(channel, line, frame)[layout.pad..layout.pad + cols];
                for (col, (to, &value)) in plane[line * cols..][..cols].iter_mut().zip(row).enumerate() {
                    *to = response.filter(col)[channel] * value;
                }
            }
            let mut blurred = vec![0.0; rows * cols];
            response.blur(rows, cols, &plane, &mut blurred, &mut scratch);
            blurred
        })
    };
    // mix the three channels of each pixel, and write the results to the lines that rays read
    let frames: Vec<[Vec<f32>; 3]> = bands::map(layout.frames, || (), |(), frame| frame_of(frame));
    bands::for_each_chunk(
        effective,
        layout.line_len(),
        || (),
        |(), index, values| {
            let (channel, line) = (index / layout.stored_lines(), index % layout.stored_lines());
            if line == rows {
                return;
            }
            for (frame, planes) in frames.iter().enumerate() {
                let to = &mut values[frame * layout.stride + layout.pad..][..cols];
                for (col, to) in to.iter_mut().enumerate() {
                    let i = line * cols + col;
                    *to = (0..3).map(|c| mix[channel][c] * planes[c][i]).sum();
                }
            }
        },
    );
}
