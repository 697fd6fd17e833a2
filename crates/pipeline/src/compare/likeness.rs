//! How alike two pictures are, and what comparisons read and write.

use std::path::Path;

use lumistack_core::Tensor;
use lumistack_core::metrics::{Flip, Mean, SquaredError, ssim};
use lumistack_display::LightField;
use serde::Serialize;

use crate::error::{PipelineError, field_error};
use crate::simulate::simulate_to_file;

/// How alike two pictures or light fields are.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Likeness {
    /// Peak signal-to-noise ratio, dB; none where they are equal.
    pub psnr_db: Option<f64>,
    /// Structural similarity, at most 1.
    pub ssim: f64,
    /// FLIP error, 0 to 1.
    pub flip: f64,
}

/// Sums of the metrics over views.
pub(super) struct Sums {
    error: SquaredError,
    ssim: Mean,
    flip: Mean,
    filter: Flip,
}

impl Sums {
    pub(super) fn new() -> Self {
        let filter = Flip::new(Flip::DEFAULT_PIXELS_PER_DEGREE);
        Self { error: SquaredError::default(), ssim: Mean::default(), flip: Mean::default(), filter }
    }

    /// Pixels where `valid` says so; the others are given the reference's values.
    pub(super) fn add(&mut self, reference: &[f32], test: &[f32], shape: [usize; 2], valid: &[bool]) {
        let counted = |i: usize| valid[i];
        let mut test = test.to_vec();
        for (i, (test, reference)) in test.chunks_exact_mut(3).zip(reference.chunks_exact(3)).enumerate() {
            if valid[i] {
                for c in 0..3 {
                    self.error.add(f64::from(test[c]), f64::from(reference[c]));
                }
            } else {
                test.copy_from_slice(reference);
            }
        }
        self.ssim = self.ssim.merged(ssim(reference, &test, shape).mean_where(counted));
        self.flip = self.flip.merged(self.filter.compare(reference, &test, shape).mean_where(counted));
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.error = self.error.merged(other.error);
        self.ssim = self.ssim.merged(other.ssim);
        self.flip = self.flip.merged(other.flip);
    }

    pub(super) fn likeness(&self) -> Likeness {
        let psnr = self.error.psnr();
        Likeness { psnr_db: psnr.is_finite().then_some(psnr), ssim: self.ssim.value(), flip: self.flip.value() }
    }
}

/// The target of a run, or of the graph's run that a node's folder lies in.
pub(super) fn target_of(run: &Path) -> Result<Option<LightField>, PipelineError> {
    for folder in [run.join("target"), run.join("../../target")] {
        if folder.join("lightfield.json").is_file() {
            return Ok(Some(lumistack_field_io::read_field_folder(&folder).map_err(field_error)?.0));
        }
    }
    Ok(None)
}

/// ½ + the difference, so that equal is middle grey.
pub(super) fn difference(first: &[f32], second: &[f32]) -> Vec<f32> {
    // middle grey of the encoded picture
    first.iter().zip(second).map(|(a, b)| (0.214 + (b - a)).clamp(0.0, 1.0)).collect()
}

/// Writes pictures of one shape side by side.
pub(super) fn save(path: &Path, panes: Vec<Vec<f32>>, [rows, cols]: [usize; 2]) -> Result<(), PipelineError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
    }
    let mut sheet = Tensor::zeros(["row", "col", "rgb"], [rows, cols * panes.len(), 3]);
    for (number, pane) in panes.iter().enumerate() {
        for row in 0..rows {
            sheet.block_mut([row])[3 * cols * number..][..3 * cols]
                .copy_from_slice(&pane[3 * cols * row..][..3 * cols]);
        }
    }
    simulate_to_file(&sheet, path)
}
