//! The choice between the candidates for a pixel: two filtered answers, and the radiance as
//! rendered.

use lumistack_core::Tensor;

use super::band::{ANSWERS, Answers};
use super::frame::{Frame, HALVES, VARIANCE, box_mean};

/// Half the width of the square of pixels over which errors are averaged, before the candidates'
/// errors are compared.
const ERROR_RADIUS: usize = 4;
/// If the squared errors of two candidates differ by this, the better one gets e ≈ 2.7 times the
/// weight of the other. The unit is the variance of the noise.
const SOFTNESS: f32 = 0.03;
/// Number of candidates for a pixel: filtered by colours and guides, filtered by guides alone, as
/// rendered.
const CHOICES: usize = 3;

/// Blends the candidates of each pixel by weights from their estimated errors. A pixel's estimate
/// leaves out the pixel itself, since otherwise the choice would follow the pixel's noise.
pub(super) fn choose(frame: &Frame, bands: &[Answers]) -> Tensor<3> {
    let count = frame.rows * frame.cols;
    let halves =
        HALVES.map(|first| (0..count).map(|i| [0, 1, 2].map(|c| frame.plane(first + c)[i])).collect::<Vec<[f32; 3]>>());
    let joined = |answer: usize| {
        [0, 1].map(|half| bands.iter().flat_map(|band| band[answer][half].iter().copied()).collect::<Vec<[f32; 3]>>())
    };
    let [with_colours, guides_alone, own_weights]: [_; ANSWERS] = std::array::from_fn(joined);
    let shares = shares(frame, &halves, [&own_weights, &guides_alone, &halves]);
    let answers: [&[Vec<[f32; 3]>; 2]; CHOICES] = [&with_colours, &guides_alone, &halves];
    let mut picture = Tensor::zeros(["row", "col", "rgb"], [frame.rows, frame.cols, 3]);
    for (i, rgb) in picture.data_mut().chunks_exact_mut(3).enumerate() {
        for (c, value) in rgb.iter_mut().enumerate() {
            let mean = |k: usize| 0.5 * (answers[k][0][i][c] + answers[k][1][i][c]);
            *value = frame.modulation[i][c] * (0..CHOICES).map(|k| shares[i][k] * mean(k)).sum::<f32>();
        }
    }
    picture
}

/// Returns the weight of each candidate in every pixel. The weight follows from the candidate's
/// squared error divided by the variance of the noise, averaged over the surrounding pixels.
///
/// F_a is a candidate from one half of the samples, and u_b is the picture of the other half. The
/// mean of (F_a − u_b)² is the squared error of F_a plus the noise of u_b. This noise is equal for
/// all candidates. The filter returns the mean of F_a and F_b. The error of this mean is smaller
/// than the mean error of F_a and F_b, and `gain` is the difference.
fn shares(frame: &Frame, halves: &[Vec<[f32; 3]>; 2], answers: [&[Vec<[f32; 3]>; 2]; CHOICES]) -> Vec<[f32; CHOICES]> {
    let count = halves[0].len();
    let (rows, cols) = (frame.rows, frame.cols);
    let errors = answers.map(|answer| {
        let error = |i: usize| -> f32 {
            let channel = |c: usize| {
                let [a, b] = [0, 1].map(|half| (answer[half][i][c], halves[half][i][c]));
                let across = 0.5 * ((a.0 - b.1).powi(2) + (b.0 - a.1).powi(2));
                let gain = 0.25 * (a.0 - b.0).powi(2);
                (across - gain) / (frame.plane(VARIANCE + c)[i] + 1e-8)
            };
            channel(0) + channel(1) + channel(2)
        };
        let errors: Vec<f32> = (0..count).map(error).collect();
        let mean = box_mean(&errors, rows, cols, ERROR_RADIUS);
        let span = |at: usize, end: usize| (at + ERROR_RADIUS).min(end - 1) + 1 - at.saturating_sub(ERROR_RADIUS);
        let without_itself = |i: usize| {
            let held = (span(i / cols, rows) * span(i % cols, cols)) as f32;
            if held > 1.0 { (mean[i] * held - errors[i]) / (held - 1.0) } else { errors[i] }
        };
        (0..count).map(without_itself).collect::<Vec<f32>>()
    });
    let share = |i: usize| {
        let least = errors.iter().fold(f32::INFINITY, |least, errors| least.min(errors[i]));
        let weights = [0, 1, 2].map(|k| ((least - errors[k][i]) / (3.0 * SOFTNESS)).exp());
        let total: f32 = weights.iter().sum();
        weights.map(|weight| weight / total)
    };
    (0..count).map(share).collect()
}
