//! Node plugin `log_tomography`: computes static masks by tomography (Wetzstein et al. 2011). This
//! is the baseline without time multiplexing.
//!
//! A ray's light is the product of the layers' values along the ray, so its logarithm is a sum over
//! the layers. Thus the logarithms of a light field are projections of a volume, whose slices are
//! the layers. Tomography finds this volume:
//!
//! ```text
//! minimize Σ_r (Σ_n x_n[j_n(r)] − a_r)²
//! x = −log f,   a_r = −log(β clamp(L(r), darkest, 1)),   −log f_max ≤ x ≤ −log f_min
//! ```
//!
//! Here f is a pixel's mask value, and j_n(r) is the pixel of layer n that ray r hits. `darkest` is
//! a parameter. Projected gradient steps with Nesterov's extrapolation solve the problem. Their
//! step sizes follow from the row and column sums of the projection (SIRT; Gregor and Benson 2008).
//! All frames are equal, and channels are independent.

use lumistack_plugin::core::Tensor;
use lumistack_plugin::display::{LayerMap, LayerStack, RayMap};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Display, NodeInput, NodePlugin, Param, PluginError, Schema, expects, export_plugin};

/// The plugin `log_tomography`.
pub struct LogTomography;

/// Parameters; see [`LogTomography::schema`](NodePlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct TomographyParams {
    iterations: u32,
    darkest: f64,
}

impl NodePlugin for LogTomography {
    const DOC: &'static str = "Computes static masks by tomography of logarithms, for any number of layers in front of a uniform backlight. All frames are \
        equal: this is the baseline without time multiplexing.";
    type Params = TomographyParams;

    fn schema() -> Schema {
        Schema::new([
            Param::int("iterations", 100, 1..=10_000, "Steps of the solver.").unit("1"),
            Param::float(
                "darkest",
                0.01,
                1e-6..=0.5,
                "Smallest target value: lower values are raised to this value, since their logarithms would dominate the objective.",
            )
            .unit("1"),
        ])
    }

    fn make(params: TomographyParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let (host, display, field) = (input.host(), input.display(), input.field());
        expects::attenuating(display)?;
        expects::uniform_backlight(display)?;
        let geometry = field.geometry();
        let map = RayMap::new(display, geometry);
        let mut volume = Volume::new(display, &map)?;
        let [rows, cols] = [geometry.rows, geometry.cols];
        let views: Vec<[usize; 2]> = geometry.grid.iter().collect();
        // Collect the attenuation a_r that each ray r should have, [view][row][col][rgb].
        let mut wanted = Vec::new();
        for &view in &views {
            let lent = field.view(view)?;
            for values in lent.iter_rows() {
                wanted.extend(values[..3 * cols].iter().map(|value| {
                    let shown = f64::from(*value).clamp(params.darkest, 1.0) * display.brightness;
                    -shown.ln() as f32
                }));
            }
        }
        // Take projected gradient steps with Nesterov's extrapolation.
        let stage = host.stage("log tomography", u64::from(params.iterations), "steps");
        let (mut momentum, mut before) = (1.0f32, volume.values.clone());
        let mut at = volume.values.clone();
        for _ in 0..params.iterations {
            host.check_cancelled()?;
            volume.back_project(&map, &views, [rows, cols], &at, &wanted);
            volume.step(&at);
            let next = 0.5 * (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt());
            let ahead = (momentum - 1.0) / next;
            for ((at, values), before) in at.iter_mut().zip(&volume.values).zip(&mut before) {
                for ((at, &value), before) in at.iter_mut().zip(values).zip(before) {
                    *at = value + ahead * (value - *before);
                    *before = value;
                }
            }
            momentum = next;
            stage.advance(1, "");
        }
        // Convert x = −log f to mask values, which are the same in all frames.
        let mut stack = LayerStack::filled(display, 0.0);
        for (n, layer) in display.layers.iter().enumerate() {
            let [darkest, brightest] = layer.range();
            for frame in 0..display.frames {
                let patterns = stack.layers[n].block_mut([frame]).iter_mut();
                patterns.zip(&volume.values[n]).for_each(|(f, x)| *f = (-x).exp().clamp(darkest, brightest));
            }
        }
        Ok(stack)
    }
}

/// The unknowns x = −log f of every layer, `[layer][row][col][rgb]`, and the data of a step.
struct Volume {
    values: Vec<Vec<f32>>,
    gradient: Vec<Vec<f32>>,
    /// Number of rays through each pixel of each layer.
    rays: Vec<Vec<f32>>,
    /// [smallest, largest] x of each layer.
    range: Vec<[f32; 2]>,
}

impl Volume {
    fn new(display: &Display, map: &RayMap) -> Result<Self, PluginError> {
        let mut volume = Self { values: Vec::new(), gradient: Vec::new(), rays: Vec::new(), range: Vec::new() };
        for (layer, map) in display.layers.iter().zip(&map.layers) {
            let shape = [map.rows, map.cols, 3];
            let count = Tensor::<3>::element_count(shape).ok_or_else(|| {
                PluginError::Refused(format!(
                    "a layer has too many values: {} × {} pixels × 3 channels; reduce the resolution",
                    map.rows, map.cols
                ))
            })?;
            let [darkest, brightest] = layer.range();
            // Limit black to 6·10⁻⁶ ≈ e⁻¹², since x = −log f is infinite at 0. Smaller values are
            // invisible.
            let range = [-brightest.ln(), -darkest.max(6e-6).ln()];
            // Start with equal layers that together attenuate light to β: each of N layers has
            // x = −ln β / N.
            let start = (-display.brightness.ln() as f32 / display.layers.len() as f32).clamp(range[0], range[1]);
            volume.values.push(vec![start; count]);
            volume.gradient.push(vec![0.0; count]);
            volume.rays.push(vec![0.0; count / 3]);
            volume.range.push(range);
        }
        Ok(volume)
    }

    /// Computes the gradient: for every pixel, the sum of (Σ_n x_n − a_r) over the rays r through
    /// the pixel. Also counts these rays.
    fn back_project(
        &mut self,
        map: &RayMap,
        views: &[[usize; 2]],
        [rows, cols]: [usize; 2],
        at: &[Vec<f32>],
        wanted: &[f32],
    ) {
        for (gradient, rays) in self.gradient.iter_mut().zip(&mut self.rays) {
            gradient.fill(0.0);
            rays.fill(0.0);
        }
        let mut pixels = vec![0usize; map.layers.len()];
        for (number, &view) in views.iter().enumerate() {
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                // Skip a ray that misses a layer.
                let hits_all =
                    map.layers.iter().zip(&mut pixels).all(|(layer, pixel)| match hit_pixel(layer, view, row, col) {
                        Some(found) => {
                            *pixel = found;
                            true
                        }
                        None => false,
                    });
                if !hits_all {
                    continue;
                }
                // The error of the ray r is Σ_n x_n − a_r: the sum over the layers n minus the
                // wanted attenuation.
                let ray = 3 * ((number * rows + row) * cols + col);
                let mut error = [0, 1, 2].map(|c| -wanted[ray + c]);
                for (values, &pixel) in at.iter().zip(&pixels) {
                    (0..3).for_each(|c| error[c] += values[3 * pixel + c]);
                }
                for ((gradient, rays), &pixel) in self.gradient.iter_mut().zip(&mut self.rays).zip(&pixels) {
                    (0..3).for_each(|c| gradient[3 * pixel + c] += error[c]);
                    rays[pixel] += 1.0;
                }
            }
        }
    }

    /// Takes a gradient step from the extrapolated point `at`. A pixel's gradient is divided by the
    /// number of rays through the pixel and by the number of layers. This is the step size of SIRT.
    fn step(&mut self, at: &[Vec<f32>]) {
        let layers = at.len() as f32;
        for n in 0..at.len() {
            let [least, most] = self.range[n];
            let pixels = self.values[n].chunks_exact_mut(3).zip(at[n].chunks_exact(3));
            for ((value, at), (gradient, &rays)) in pixels.zip(self.gradient[n].chunks_exact(3).zip(&self.rays[n])) {
                for c in 0..3 {
                    let step = if rays > 0.0 { gradient[c] / (layers * rays) } else { 0.0 };
                    value[c] = (at[c] - step).clamp(least, most);
                }
            }
        }
    }
}

/// Returns the index of the layer's pixel that a ray hits; `None` if the ray misses the layer.
fn hit_pixel(layer: &LayerMap, view: [usize; 2], row: usize, col: usize) -> Option<usize> {
    let (y, x) = (layer.y.of_view(view[0])[row], layer.x.of_view(view[1])[col]);
    let nearest = |tap: lumistack_plugin::display::Tap| if tap.t < 0.5 { tap.first } else { tap.second } as usize;
    (!y.is_missed() && !x.is_missed()).then(|| nearest(y) * layer.cols + nearest(x))
}

export_plugin!("log_tomography", LogTomography as node);
