//! Converts patterns to pictures of 8 bits per channel, and measures the effect of the rounding to
//! 8 bits.

use lumistack_plugin::core::Tensor;
use lumistack_plugin::core::colour::srgb_code;
use lumistack_plugin::core::metrics::SquaredError;
use lumistack_plugin::display::{Display, FieldGeometry, LayerStack, RayMap, Simulator, ViewGrid};
use lumistack_plugin::{PlaneView, PluginError, StackInput};

/// A picture with codes `[row][col][rgb]`.
#[derive(Debug)]
pub(crate) struct Picture {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) codes: Vec<u8>,
}

fn linear_code(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Returns the picture of a layer's mask, and the unrounded mask.
pub(crate) fn layer_picture(plane: &PlaneView<'_>) -> (Picture, Vec<f32>) {
    let exact = plane.to_vec();
    let codes = exact.iter().map(|value| linear_code(*value)).collect();
    (Picture { rows: plane.rows(), cols: plane.cols(), codes }, exact)
}

/// Returns the picture of a frame's emission with angular bins side by side, and the unrounded
/// values in the same order.
pub(crate) fn emission_picture(
    stack: &StackInput<'_>,
    frame: usize,
    [bins_y, bins_x, rows, cols]: [usize; 4],
) -> Result<(Picture, Vec<f32>), PluginError> {
    let mut exact = vec![0.0; 3 * bins_y * rows * bins_x * cols];
    for (bin_y, bin_x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
        for (row, line) in stack.emission(frame, bin_y, bin_x)?.iter_rows().enumerate() {
            let place = 3 * (((bin_y * rows + row) * bins_x + bin_x) * cols);
            exact[place..place + line.len()].copy_from_slice(&line);
        }
    }
    let codes = exact.iter().map(|value| linear_code(*value)).collect();
    Ok((Picture { rows: bins_y * rows, cols: bins_x * cols, codes }, exact))
}

/// Encodes a view of the target, `[row][col][rgb]` and linear, as sRGB.
pub(crate) fn target_codes(values: &[f32], [rows, cols]: [usize; 2]) -> Picture {
    Picture { rows, cols, codes: values.iter().map(|value| srgb_code(*value)).collect() }
}

/// Encodes a picture as PNG.
pub(crate) fn png_of(picture: &Picture) -> Result<Vec<u8>, PluginError> {
    let failed = |error: png::EncodingError| PluginError::failed("a picture", error);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, picture.cols as u32, picture.rows as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Balanced);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(&picture.codes).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

/// Compares views of the rounded patterns with views of the unrounded patterns. The views are the
/// target's middle view and two views at opposite corners.
pub(crate) struct Rounding<'a> {
    display: &'a Display,
    geometry: FieldGeometry,
    map: RayMap,
    /// The difference between the light of the rounded and the exact patterns, summed over frames,
    /// `[view][value]`.
    differences: Vec<Vec<f32>>,
    frames: f64,
    brightness: f64,
}

/// The shape of an emission: [bins_y, bins_x, lenslet_rows, lenslet_cols].
type Bins = [usize; 4];

impl<'a> Rounding<'a> {
    pub(crate) fn new(display: &'a Display, target: &FieldGeometry) -> Self {
        let ends = |slopes: &[f64]| vec![slopes[0], slopes[slopes.len() / 2], slopes[slopes.len() - 1]];
        let grid = ViewGrid {
            projection: target.grid.projection,
            slope_x: ends(&target.grid.slope_x),
            slope_y: ends(&target.grid.slope_y),
        };
        let geometry = target.with_grid(grid);
        let map = RayMap::new(display, &geometry);
        let differences = vec![vec![0.0; 3 * geometry.rows * geometry.cols]; 3];
        Self { display, differences, geometry, map, frames: 0.0, brightness: 1.0 }
    }

    /// Adds one frame. The exact patterns are simulated first and the rounded ones afterwards, so
    /// that memory holds only one of them. Returns the frame's middle view.
    pub(crate) fn add(
        &mut self,
        layers: Vec<(Picture, Vec<f32>)>,
        emission: Option<(Picture, Vec<f32>, Bins)>,
        brightness: f64,
    ) -> Vec<f32> {
        let (pictures, exact): (Vec<Picture>, Vec<Vec<f32>>) = layers.into_iter().unzip();
        let (emitted, exact_emission) = emission
            .map_or((None, None), |(picture, values, bins)| (Some((picture, bins)), Some(untiled(&values, bins))));
        let tensors = pictures.iter().zip(exact).map(|(picture, values)| layer(picture, values)).collect();
        let middle = self.add_views(&LayerStack { layers: tensors, emission: exact_emission, brightness }, -1.0);
        let values = |picture: &Picture| picture.codes.iter().map(|code| f32::from(*code) / 255.0).collect::<Vec<_>>();
        let tensors = pictures.iter().map(|picture| layer(picture, values(picture))).collect();
        let emission = emitted.map(|(picture, bins)| untiled(&values(&picture), bins));
        self.add_views(&LayerStack { layers: tensors, emission, brightness }, 1.0);
        self.frames += 1.0;
        self.brightness = brightness;
        middle
    }

    fn add_views(&mut self, stack: &LayerStack, sign: f32) -> Vec<f32> {
        let simulator = Simulator::new(self.display, stack);
        let mut middle = Vec::new();
        for (i, sum) in self.differences.iter_mut().enumerate() {
            let view = simulator.view(&self.map, &self.geometry, [i, i]).radiance;
            sum.iter_mut().zip(view.data()).for_each(|(sum, value)| *sum += sign * value);
            if i == 1 {
                middle = view.into_data();
            }
        }
        middle
    }

    /// Returns the PSNR of L̃/β of the rounded patterns against the exact patterns, dB. It is
    /// infinite if the rounding has no effect.
    pub(crate) fn psnr(&self) -> f64 {
        let scale = 1.0 / (self.frames * self.brightness);
        let mut error = SquaredError::default();
        self.differences.iter().flatten().for_each(|difference| error.add(f64::from(*difference) * scale, 0.0));
        error.psnr()
    }
}

/// Makes a tensor of one frame from a layer's mask.
fn layer(picture: &Picture, values: Vec<f32>) -> Tensor<4> {
    let shape = [1, picture.rows, picture.cols, 3];
    Tensor::from_vec(LayerStack::LAYER_AXES, shape, values).expect("a picture has a value per code")
}

/// Converts the values of an emission's picture, with bins side by side, to a tensor of one frame.
fn untiled(values: &[f32], [bins_y, bins_x, rows, cols]: Bins) -> Tensor<6> {
    let mut emission = Tensor::zeros(LayerStack::EMISSION_AXES, [1, bins_y, bins_x, rows, cols, 3]);
    for (line, values) in values.chunks_exact(3 * bins_x * cols).enumerate() {
        for (bin_x, values) in values.chunks_exact(3 * cols).enumerate() {
            emission.block_mut([0, line / rows, bin_x, line % rows]).copy_from_slice(values);
        }
    }
    emission
}
