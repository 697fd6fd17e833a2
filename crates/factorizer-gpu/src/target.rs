//! The target and the weights on a device: `[field row][view][field column]`, one buffer per
//! channel of the target.

use lumistack_factorizer::device::{Plan, Row};

use crate::gpu::{CHUNK, Gpu, append};

/// The target light field and the weights of its rays, in buffers of the device.
pub(crate) struct Target {
    pub(crate) channels: Vec<wgpu::Buffer>,
    /// √w; `None` if all are 1.
    pub(crate) weights: Option<wgpu::Buffer>,
    /// Words per field row, over all views.
    pub(crate) row_words: u64,
    pub(crate) weight_words: u64,
}

impl Target {
    /// Returns the words per field row of the target and of the weights.
    fn words(plan: &Plan) -> [u64; 2] {
        let ([views_y, views_x], [_, cols]) = (plan.views(), plan.field());
        let views = (views_y * views_x) as u64;
        let row = if plan.has_half_target() { cols.div_ceil(2) } else { cols } as u64;
        let weighted = plan.weights_row([0, 0], 0).is_some();
        [views * row, if weighted { views * cols as u64 } else { 0 }]
    }

    /// Returns the words of the largest buffer.
    pub(crate) fn largest(plan: &Plan) -> u64 {
        let [row, weights] = Self::words(plan);
        row.max(weights) * plan.field()[0] as u64
    }

    /// Copies target and weights to the device.
    pub(crate) fn upload(gpu: &Gpu, plan: &Plan) -> Self {
        let ([_, views_x], [rows, cols]) = (plan.views(), plan.field());
        let [row_words, weight_words] = Self::words(plan);
        let views = plan.views()[0] * views_x;
        let half_words = cols.div_ceil(2);
        // an odd number of half floats is padded, so that a row begins on a word
        let of_row = |channel: usize, row: usize, to: &mut Vec<u8>| {
            for view in 0..views {
                match plan.target_row(channel, [view / views_x, view % views_x], row) {
                    Row::Half(values) => {
                        let end = to.len() + 4 * half_words;
                        append(to, values, |value| value.to_le_bytes());
                        to.resize(end, 0);
                    }
                    Row::Float(values) => append(to, values, f32::to_le_bytes),
                }
            }
        };
        // Each channel has its own buffer, since a dispatch reads only one channel.
        let channels = (0..plan.channels()).map(|channel| {
            let buffer = gpu.buffer(row_words * rows as u64);
            by_rows(gpu, &buffer, rows, row_words, |row, to| of_row(channel, row, to));
            buffer
        });
        let channels = channels.collect();
        let weights = (weight_words > 0).then(|| {
            let buffer = gpu.buffer(weight_words * rows as u64);
            by_rows(gpu, &buffer, rows, weight_words, |row, to| {
                for view in 0..views {
                    let roots = plan.weights_row([view / views_x, view % views_x], row).unwrap_or_default();
                    append(to, roots, f32::to_le_bytes);
                }
            });
            buffer
        });
        Self { channels, weights, row_words, weight_words }
    }
}

/// Writes a buffer in chunks of rows, so that memory never holds a second copy of the whole buffer.
fn by_rows(gpu: &Gpu, buffer: &wgpu::Buffer, rows: usize, words: u64, fill: impl Fn(usize, &mut Vec<u8>)) {
    let together = (CHUNK / (4 * words)).max(1) as usize;
    let mut bytes = Vec::new();
    for first in (0..rows).step_by(together) {
        bytes.clear();
        (first..(first + together).min(rows)).for_each(|row| fill(row, &mut bytes));
        gpu.queue.write_buffer(buffer, 4 * words * first as u64, &bytes);
        if together < rows {
            gpu.queue.submit([]);
            gpu.wait();
        }
    }
}
