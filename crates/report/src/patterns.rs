//! Pictures of the patterns: every layer and frame, their mean over frames, and the backlight's emission.

use lumistack_core::{Task, Tensor};
use lumistack_display::LayerStack;

use crate::picture::{self, Embedded, Encoding, Linear};
use crate::{ReportError, ReportInput};

/// All patterns, encoded.
#[derive(Clone, Debug)]
pub(crate) struct Patterns {
    /// Of the backlight, where it is directional.
    pub(crate) emission: Option<Emission>,
    /// Rearmost layer first.
    pub(crate) layers: Vec<Sheet>,
    /// Factor by which all pictures are smaller than the patterns.
    pub(crate) shrunk: usize,
    /// Whether every pixel of the (shrunk) pictures is exact.
    pub(crate) lossless: bool,
}

/// One layer.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    /// Mean over frames, where there are several.
    pub(crate) mean: Option<Embedded>,
    pub(crate) frames: Vec<Embedded>,
    /// The middle of the first frame, every pixel as it is, where the others are shrunk or not lossless.
    pub(crate) closeup: Option<Embedded>,
}

/// The backlight, one picture per frame each.
#[derive(Clone, Debug)]
pub(crate) struct Emission {
    /// Lenslets as tiles, and in every tile its angular bins.
    pub(crate) panel: Sheet,
    /// What the lenslets emit into the central bin: one pixel per lenslet.
    pub(crate) central_bin: Vec<Embedded>,
    /// Row and column of that bin.
    pub(crate) bin: [usize; 2],
}

/// Pixels of all patterns together; as JPEG of noise-like patterns about 5 MB of text.
const BUDGET: usize = 3_000_000;
/// Largest close-up: columns, rows.
const CLOSEUP: [usize; 2] = [160, 100];

/// Number of progress steps of [`encode`].
pub(crate) fn count(stack: &LayerStack) -> usize {
    (stack.layers.len() + usize::from(stack.emission.is_some())) * stack.frames()
}

pub(crate) fn encode(input: &ReportInput, task: Task) -> Result<Patterns, ReportError> {
    let stack = input.stack;
    let panel = stack.emission.as_ref().map(panel_tensor);
    let sheets = stack.layers.iter().chain(&panel);
    let sizes: Vec<_> = sheets.flat_map(|t| vec![(t.shape()[1], t.shape()[2]); t.shape()[0] + 1]).collect();
    let shrunk = picture::shrink_factor(&sizes, BUDGET);
    let pixels = sizes.iter().map(|(rows, cols)| rows.div_ceil(shrunk) * cols.div_ceil(shrunk)).sum();
    let encoding = Encoding::for_pixels(pixels);
    let emission = match (&stack.emission, &panel) {
        (Some(emission), Some(panel)) => Some(encode_emission(emission, panel, shrunk, encoding, task)?),
        _ => None,
    };
    let layers = stack.layers.iter().map(|layer| encode_sheet(layer, shrunk, encoding, task));
    let lossless = encoding == Encoding::Png;
    Ok(Patterns { emission, layers: layers.collect::<Result<_, _>>()?, shrunk, lossless })
}

/// `transmittance[frame][row][col][rgb]` as pictures.
fn encode_sheet(layer: &Tensor<4>, shrunk: usize, encoding: Encoding, task: Task) -> Result<Sheet, ReportError> {
    let [frames, rows, cols, _] = layer.shape();
    let mut mean = vec![0.0f32; rows * cols * 3];
    let mut pictures = Vec::with_capacity(frames);
    for frame in 0..frames {
        task.cancel.check()?;
        let values = layer.block([frame]);
        mean.iter_mut().zip(values).for_each(|(mean, value)| *mean += value / frames as f32);
        let picture = Linear::new(rows, cols, values, 1.0).shrunk(shrunk).encoded();
        pictures.push(picture.embedded(encoding)?);
        task.progress.advance(1, "");
    }
    let mean = (frames > 1).then(|| Linear { rows, cols, data: mean }.shrunk(shrunk).encoded().embedded(encoding));
    let closeup = (shrunk > 1 || encoding == Encoding::Jpeg).then(|| {
        let [width, height] = CLOSEUP;
        let whole = Linear::new(rows, cols, layer.block([0]), 1.0);
        let part = whole.cropped(rows.saturating_sub(height) / 2, cols.saturating_sub(width) / 2, height, width);
        part.encoded().embedded(Encoding::Png)
    });
    Ok(Sheet { mean: mean.transpose()?, frames: pictures, closeup: closeup.transpose()? })
}

fn encode_emission(
    emission: &Tensor<6>,
    panel: &Tensor<4>,
    shrunk: usize,
    encoding: Encoding,
    task: Task,
) -> Result<Emission, ReportError> {
    let [frames, bins_y, bins_x, rows, cols, _] = emission.shape();
    let bin = [bins_y / 2, bins_x / 2];
    // with a single bin the panel is this picture already
    let central = (0..frames).filter(|_| bins_y * bins_x > 1).map(|frame| {
        Ok(Linear::new(rows, cols, emission.block([frame, bin[0], bin[1]]), 1.0).encoded().embedded(Encoding::Png)?)
    });
    let central_bin = central.collect::<Result<_, ReportError>>()?;
    Ok(Emission { panel: encode_sheet(panel, shrunk, encoding, task)?, central_bin, bin })
}

/// `emission[frame][bin_y][bin_x][lenslet_row][lenslet_col][rgb]` as `[frame][lenslet_row·bins_y + bin_y][lenslet_col·bins_x + bin_x][rgb]`.
fn panel_tensor(emission: &Tensor<6>) -> Tensor<4> {
    let [frames, bins_y, bins_x, lenslet_rows, lenslet_cols, _] = emission.shape();
    let mut panel = Tensor::zeros(LayerStack::LAYER_AXES, [frames, lenslet_rows * bins_y, lenslet_cols * bins_x, 3]);
    for frame in 0..frames {
        for bin_y in 0..bins_y {
            for bin_x in 0..bins_x {
                let lenslets = emission.block([frame, bin_y, bin_x]).chunks_exact(3).enumerate();
                for (i, rgb) in lenslets {
                    let (row, col) = (i / lenslet_cols * bins_y + bin_y, i % lenslet_cols * bins_x + bin_x);
                    panel.block_mut([frame, row, col]).copy_from_slice(rgb);
                }
            }
        }
    }
    panel
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_stand_inside_their_lenslet() {
        let mut emission = Tensor::zeros(LayerStack::EMISSION_AXES, [2, 3, 2, 4, 5, 3]);
        emission.block_mut([1, 2, 1, 3, 4]).copy_from_slice(&[0.1, 0.2, 0.3]);
        let panel = panel_tensor(&emission);
        assert_eq!(panel.shape(), [2, 12, 10, 3]);
        assert_eq!(panel.block([1, 3 * 3 + 2, 4 * 2 + 1]), &[0.1, 0.2, 0.3]);
        assert_eq!(panel.data().iter().filter(|v| **v != 0.0).count(), 3);
    }
}
