//! Patterns as pictures of 8 bits per channel, and what the rounding costs.

use lumistack_plugin::core::Tensor;
use lumistack_plugin::core::colour::srgb_code;
use lumistack_plugin::core::metrics::SquaredError;
use lumistack_plugin::display::{Display, FieldGeometry, LayerStack, RayMap, Simulator, ViewGrid};
use lumistack_plugin::{PlaneView, PluginError, StackInput};

/// Codes `[row][col][rgb]`.
#[derive(Debug)]
pub(crate) struct Picture {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) codes: Vec<u8>,
}

fn linear_code(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// The picture of a layer's pattern, and the pattern itself.
pub(crate) fn layer_picture(plane: &PlaneView<'_>) -> (Picture, Vec<f32>) {
    let exact = plane.to_vec();
    let codes = exact.iter().map(|value| linear_code(*value)).collect();
    (Picture { rows: plane.rows(), cols: plane.cols(), codes }, exact)
}

/// The picture of a frame's emission, bins side by side, and its values in the same order.
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

/// A view of the target, sRGB-encoded.
pub(crate) fn target_codes(plane: &PlaneView<'_>) -> Picture {
    let codes = plane.to_vec().into_iter().map(srgb_code).collect();
    Picture { rows: plane.rows(), cols: plane.cols(), codes }
}

/// The file.
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

/// Views from rounded patterns against views from the patterns themselves: the middle one and two opposite corners of the target.
pub(crate) struct Rounding<'a> {
    display: &'a Display,
    geometry: FieldGeometry,
    map: RayMap,
    /// Sums over frames, per view.
    rounded: Vec<Vec<f32>>,
    exact: Vec<Vec<f32>>,
    frames: f64,
    brightness: f64,
}

/// Shape [bins_y, bins_x, lenslet_rows, lenslet_cols] of an emission.
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
        let zeros = || vec![vec![0.0; 3 * geometry.rows * geometry.cols]; 3];
        Self { display, rounded: zeros(), exact: zeros(), geometry, map, frames: 0.0, brightness: 1.0 }
    }

    /// One frame.
    pub(crate) fn add(
        &mut self,
        layers: Vec<(Picture, Vec<f32>)>,
        emission: Option<(Picture, Vec<f32>, Bins)>,
        brightness: f64,
    ) {
        let value = |code: &u8| f32::from(*code) / 255.0;
        let layer = |picture: &Picture, values: Vec<f32>| {
            let mut layer = Tensor::zeros(LayerStack::LAYER_AXES, [1, picture.rows, picture.cols, 3]);
            layer.data_mut().copy_from_slice(&values);
            layer
        };
        let rounded_layers = layers.iter().map(|(p, _)| layer(p, p.codes.iter().map(value).collect())).collect();
        let rounded_emission =
            emission.as_ref().map(|(p, _, bins)| untiled(&p.codes.iter().map(value).collect::<Vec<_>>(), *bins));
        let exact_layers = layers.into_iter().map(|(picture, values)| layer(&picture, values)).collect();
        let exact_emission = emission.map(|(_, values, bins)| untiled(&values, bins));
        let rounded = LayerStack { layers: rounded_layers, emission: rounded_emission, brightness };
        let exact = LayerStack { layers: exact_layers, emission: exact_emission, brightness };
        for (stack, sums) in [(&rounded, &mut self.rounded), (&exact, &mut self.exact)] {
            let simulator = Simulator::new(self.display, stack);
            for (i, sum) in sums.iter_mut().enumerate() {
                let view = simulator.view(&self.map, &self.geometry, [i, i]).radiance;
                sum.iter_mut().zip(view.data()).for_each(|(sum, value)| *sum += value);
            }
        }
        self.frames += 1.0;
        self.brightness = brightness;
    }

    /// PSNR of L̃/β, dB; infinite where the rounding costs nothing.
    pub(crate) fn psnr(&self) -> f64 {
        let scale = 1.0 / (self.frames * self.brightness);
        let mut error = SquaredError::default();
        for (rounded, exact) in self.rounded.iter().flatten().zip(self.exact.iter().flatten()) {
            error.add(f64::from(*rounded) * scale, f64::from(*exact) * scale);
        }
        error.psnr()
    }
}

/// Bins that lie side by side, as one frame of emission.
fn untiled(values: &[f32], [bins_y, bins_x, rows, cols]: Bins) -> Tensor<6> {
    let mut emission = Tensor::zeros(LayerStack::EMISSION_AXES, [1, bins_y, bins_x, rows, cols, 3]);
    for (line, values) in values.chunks_exact(3 * bins_x * cols).enumerate() {
        for (bin_x, values) in values.chunks_exact(3 * cols).enumerate() {
            emission.block_mut([0, line / rows, bin_x, line % rows]).copy_from_slice(values);
        }
    }
    emission
}
