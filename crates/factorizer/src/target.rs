//! The target and the weights in the order in which the inner loops read them: `[channel][view][row][x]`, rows padded on both sides.

use std::ops::Range;

use lumistack_display::Weights;

use crate::factor::PAD;
use crate::{Problem, bands};

/// Target βL and weights w.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    stride: usize,
    rows: usize,
    views: usize,
    values: Vec<f32>,
    weights: RayWeights,
    /// The largest weight; kept weights are divided by it, since only ratios matter to a step.
    pub(crate) weight_scale: f64,
}

#[derive(Clone, Debug)]
enum RayWeights {
    Uniform,
    /// `[view][x]`, constant rows.
    PerView(Vec<f32>),
    /// `[view][row][x]`.
    PerRay(Vec<f32>),
}

impl Target {
    pub(crate) fn new(problem: &Problem) -> Self {
        let geometry = problem.target.geometry();
        let (rows, cols) = (geometry.rows, geometry.cols);
        let [view_rows, view_cols] = geometry.grid.views();
        let views = view_rows * view_cols;
        let stride = PAD + cols + PAD;
        let (radiance, beta) = (problem.target.radiance().data(), problem.display.brightness);
        let mut values = vec![0.0; 3 * views * rows * stride];
        bands::for_each_chunk(
            &mut values,
            stride,
            || (),
            |(), index, row| {
                let (channel, pixels) = (index / (views * rows), index % (views * rows) * cols);
                for (col, value) in row[PAD..PAD + cols].iter_mut().enumerate() {
                    *value = (beta * f64::from(radiance[(pixels + col) * 3 + channel])) as f32;
                }
            },
        );
        let (weights, weight_scale) = ray_weights(problem.weights, [views, rows, cols], stride);
        Self { stride, rows, views, values, weights, weight_scale }
    }

    /// One padded row of βL; column c stands at [`PAD`] + c.
    #[inline(always)]
    pub(crate) fn row(&self, channel: usize, view: usize, row: usize) -> &[f32] {
        let at = ((channel * self.views + view) * self.rows + row) * self.stride;
        &self.values[at..at + self.stride]
    }

    /// One padded row of weights relative to the largest, or `None` where all are 1.
    #[inline(always)]
    pub(crate) fn weights(&self, view: usize, row: usize) -> Option<&[f32]> {
        match &self.weights {
            RayWeights::Uniform => None,
            RayWeights::PerView(values) => Some(&values[view * self.stride..(view + 1) * self.stride]),
            RayWeights::PerRay(values) => {
                let at = (view * self.rows + row) * self.stride;
                Some(&values[at..at + self.stride])
            }
        }
    }

    /// Whether weights differ between rays.
    pub(crate) fn is_weighted(&self) -> bool {
        !matches!(self.weights, RayWeights::Uniform)
    }

    /// Number of rays with w > 0 in a part of a row.
    pub(crate) fn count(&self, view: usize, row: usize, cols: &Range<usize>) -> u64 {
        match self.weights(view, row) {
            None => cols.len() as u64,
            Some(weights) => weights[PAD + cols.start..PAD + cols.end].iter().filter(|w| **w > 0.0).count() as u64,
        }
    }
}

fn ray_weights(weights: &Weights, [views, rows, cols]: [usize; 3], stride: usize) -> (RayWeights, f64) {
    let data = match weights {
        Weights::Uniform => return (RayWeights::Uniform, 1.0),
        Weights::PerView(weights) => weights.data(),
        Weights::PerRay(weights) => weights.data(),
    };
    let largest = data.iter().copied().fold(0.0f32, f32::max);
    let scale = if largest > 0.0 { f64::from(largest) } else { 1.0 };
    // a tiny weight must not become 0: PSNR counts every ray with w > 0
    let relative = |w: f32| if w > 0.0 { ((f64::from(w) / scale) as f32).max(f32::MIN_POSITIVE) } else { 0.0 };
    let ray_weights = match weights {
        Weights::PerRay(_) => {
            let mut values = vec![0.0; views * rows * stride];
            for (row, source) in values.chunks_exact_mut(stride).zip(data.chunks_exact(cols)) {
                row[PAD..PAD + cols].iter_mut().zip(source).for_each(|(value, &w)| *value = relative(w));
            }
            RayWeights::PerRay(values)
        }
        _ => {
            let mut values = vec![0.0; views * stride];
            for (row, &w) in values.chunks_exact_mut(stride).zip(data) {
                row[PAD..PAD + cols].fill(relative(w));
            }
            RayWeights::PerView(values)
        }
    };
    (ray_weights, scale)
}
