//! Pictures of the masks and of the backlight's emission. A layer has pictures of its mean over
//! frames, its change, every frame, and close-ups.

mod place;

use lumistack_core::metrics::percentile;
use lumistack_core::{Task, Tensor};
use lumistack_display::LayerStack;
use rayon::prelude::*;

use crate::picture::{self, Embedded, Encoding, Linear};
use crate::{ReportError, ReportInput};
pub(crate) use place::Window;

/// Pictures of all masks, encoded.
#[derive(Clone, Debug)]
pub(crate) struct Patterns {
    /// The backlight, if it is directional.
    pub(crate) emission: Option<Emission>,
    /// The layers, with the rearmost first.
    pub(crate) layers: Vec<Sheet>,
    /// Factor by which the pictures of a layer's single frames are smaller than the masks.
    pub(crate) shrunk: usize,
    /// Factor by which the pictures `mean` and `change` of a layer are smaller than the masks.
    pub(crate) large_shrunk: usize,
}

/// Pictures of one layer.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    /// Mean over the frames. If there is only one frame, this is the frame itself.
    pub(crate) mean: Embedded,
    /// Standard deviation over the frames times [`CHANGE`], if there are several frames.
    pub(crate) change: Option<Embedded>,
    pub(crate) frames: Vec<Embedded>,
    /// A section with fine changes between frames, at full resolution. `None` if no layer is larger
    /// than a section. A backlight has a section only if its panel is larger than a section.
    pub(crate) closeup: Option<CloseUp>,
}

/// A section of a layer's green channel, shown in grey with stretched contrast. All three channels
/// together would resemble noise, since each channel is solved separately.
#[derive(Clone, Debug)]
pub(crate) struct CloseUp {
    pub(crate) window: Window,
    /// Values of the layer that are shown as black and as white.
    pub(crate) stretch: [f32; 2],
    /// Mean over the frames, if there are several.
    pub(crate) mean: Option<Embedded>,
    pub(crate) frames: Vec<Embedded>,
}

/// Pictures of the backlight, one for each frame.
#[derive(Clone, Debug)]
pub(crate) struct Emission {
    /// The whole backlight. It has a tile for each lenslet; each tile shows the angular bins of its
    /// lenslet.
    pub(crate) panel: Sheet,
    /// One picture per frame: the emission of each lenslet into the central bin, as one pixel.
    pub(crate) central_bin: Vec<Embedded>,
    /// Row and column of the central bin.
    pub(crate) bin: [usize; 2],
}

/// Factor that multiplies the standard deviation over frames. For values in 0..1 the deviation is
/// at most ½, so the product is at most 1.
pub(crate) const CHANGE: f32 = 2.0;

/// Maximum number of pixels of the pictures of all single frames. As JPEG, noise of this size takes
/// about 4 MB of text.
const BUDGET: usize = 2_400_000;
/// Maximum number of pixels of the large pictures.
const LARGE_BUDGET: usize = 1_400_000;

/// Reduction factor and encoding of a group of pictures.
#[derive(Clone, Copy)]
struct Size {
    shrunk: usize,
    encoding: Encoding,
}

impl Size {
    fn within(budget: usize, sizes: &[(usize, usize)]) -> Self {
        let shrunk = picture::shrink_factor(sizes, budget);
        let pixels = sizes.iter().map(|(rows, cols)| rows.div_ceil(shrunk) * cols.div_ceil(shrunk)).sum();
        Self { shrunk, encoding: Encoding::for_pixels(pixels) }
    }

    fn embed(self, picture: &Linear) -> Result<Embedded, ReportError> {
        Ok(picture.shrunk(self.shrunk).encoded().embedded(self.encoding)?)
    }
}

/// Returns the number of progress steps of [`encode`].
pub(crate) fn count(stack: &LayerStack) -> usize {
    (stack.layers.len() + usize::from(stack.emission.is_some())) * stack.frames()
}

pub(crate) fn encode(input: &ReportInput, task: Task) -> Result<Patterns, ReportError> {
    let stack = input.stack;
    let panel = stack.emission.as_ref().map(panel_tensor);
    let sizes = |count: &dyn Fn(usize) -> usize| -> Vec<(usize, usize)> {
        let sheets = stack.layers.iter().chain(&panel).map(Tensor::shape);
        sheets.flat_map(|[frames, rows, cols, _]| vec![(rows, cols); count(frames)]).collect()
    };
    let (frame, large) = (Size::within(BUDGET, &sizes(&|m| m)), Size::within(LARGE_BUDGET, &sizes(&|m| m.min(2))));
    let emission = match (&stack.emission, &panel) {
        (Some(emission), Some(panel)) => Some(encode_emission(emission, panel, frame, large, task)?),
        _ => None,
    };
    let windows = place::on_layers(input.display, &stack.layers);
    let layers = stack.layers.par_iter().enumerate().map(|(n, layer)| {
        let window = windows.as_ref().map(|windows| windows[n]);
        encode_sheet(layer, window, frame, large, task)
    });
    Ok(Patterns {
        emission,
        layers: layers.collect::<Result<_, _>>()?,
        shrunk: frame.shrunk,
        large_shrunk: large.shrunk,
    })
}

/// Encodes `transmittance[frame][row][col][rgb]` as pictures.
fn encode_sheet(
    layer: &Tensor<4>,
    window: Option<Window>,
    frame_size: Size,
    large: Size,
    task: Task,
) -> Result<Sheet, ReportError> {
    let [frames, rows, cols, _] = layer.shape();
    let pictures = (0..frames).into_par_iter().map(|frame| {
        task.cancel.check()?;
        let picture = frame_size.embed(&Linear::new(rows, cols, layer.block([frame]), 1.0))?;
        task.progress.advance(1, "");
        Ok(picture)
    });
    let pictures = pictures.collect::<Result<_, ReportError>>()?;
    // sum over the frames for their mean and standard deviation
    let (mut sum, mut squares) = (vec![0.0f32; rows * cols * 3], vec![0.0f32; rows * cols * 3]);
    for frame in 0..frames {
        for ((sum, square), value) in sum.iter_mut().zip(&mut squares).zip(layer.block([frame])) {
            *sum += value / frames as f32;
            *square += value * value / frames as f32;
        }
    }
    let mean = Linear { rows, cols, data: sum };
    let change = (frames > 1).then(|| {
        let pairs = squares.iter().zip(&mean.data);
        let data = pairs.map(|(square, mean)| CHANGE * (square - mean * mean).max(0.0).sqrt()).collect();
        large.embed(&Linear { rows, cols, data })
    });
    Ok(Sheet {
        change: change.transpose()?,
        frames: pictures,
        closeup: window.map(|window| close_up(layer, &mean, window)).transpose()?,
        mean: large.embed(&mean)?,
    })
}

/// Makes a close-up of every frame and, if there are several frames, of their mean. All close-ups
/// show the same section with one scale of grey.
fn close_up(layer: &Tensor<4>, mean: &Linear, window: Window) -> Result<CloseUp, ReportError> {
    /// Fraction of the values that may be clipped at each end.
    const CLIPPED: f64 = 0.01;
    /// The contrast is stretched only if the 1st percentile of the section's values is above
    /// `LITTLE`, or the 99th percentile is below 1 − `LITTLE`. Otherwise the stretch would be
    /// invisible.
    const LITTLE: f32 = 0.02;
    let [frames, rows, cols, _] = layer.shape();
    let part = |whole: &Linear| whole.cropped(window.row, window.col, window.rows, window.cols).green();
    let parts: Vec<Linear> =
        (0..frames).map(|frame| part(&Linear::new(rows, cols, layer.block([frame]), 1.0))).collect();
    let mut values: Vec<f32> = parts.iter().flat_map(|part| part.data.iter().copied()).collect();
    let [low, high] = [CLIPPED, 1.0 - CLIPPED].map(|share| percentile(&mut values, share));
    // Do not stretch a section whose values are nearly equal, or already fill the range.
    let worth_it = high - low > 1e-3 && (low > LITTLE || high < 1.0 - LITTLE);
    let stretch = if worth_it { [low, high] } else { [0.0, 1.0] };
    let embed = |part: &Linear| part.stretched(stretch).encoded().embedded(Encoding::Png);
    Ok(CloseUp {
        window,
        stretch,
        mean: (frames > 1).then(|| embed(&part(mean))).transpose()?,
        frames: parts.par_iter().map(embed).collect::<Result<_, _>>()?,
    })
}

fn encode_emission(
    emission: &Tensor<6>,
    panel: &Tensor<4>,
    frame_size: Size,
    large: Size,
    task: Task,
) -> Result<Emission, ReportError> {
    let [frames, bins_y, bins_x, rows, cols, _] = emission.shape();
    let bin = [bins_y / 2, bins_x / 2];
    // If there is only one bin, its picture would equal the picture of the panel, so it is omitted.
    let central = (0..frames).filter(|_| bins_y * bins_x > 1).map(|frame| {
        Ok(Linear::new(rows, cols, emission.block([frame, bin[0], bin[1]]), 1.0).encoded().embedded(Encoding::Png)?)
    });
    let central_bin = central.collect::<Result<_, ReportError>>()?;
    let panel = encode_sheet(panel, place::on_panel(panel), frame_size, large, task)?;
    Ok(Emission { panel, central_bin, bin })
}

/// Arranges `emission[frame][bin_y][bin_x][lenslet_row][lenslet_col][rgb]` as
/// `[frame][lenslet_row·bins_y + bin_y][lenslet_col·bins_x + bin_x][rgb]`.
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
