//! Simulates a preview whose pictures arrive one by one.

use std::sync::OnceLock;

use lumistack_core::Tensor;
use lumistack_core::metrics::SquaredError;
use lumistack_display::{
    Display, EmittedView, FieldGeometry, Layer, LayerColour, LayerStack, Projection, RayMap, Response, Simulator,
    ViewGrid, view_error,
};

use crate::colour::{DECODED, heat, to_rgba};
use crate::decode::decode;
use crate::preview::{File, Part, Preview};
use crate::tables::Tables;
use crate::{Error, Options, err};

/// A preview and the current options.
#[derive(Debug)]
pub struct Model {
    preview: Preview,
    geometry: FieldGeometry,
    options: Options,
    /// Codes `[row][col][rgb]` of every file that has arrived.
    codes: Vec<Option<Vec<u8>>>,
    /// Numbers of the complete frames, in the order of their completion.
    complete: Vec<usize>,
    /// Input of the simulation on the CPU, computed at its first use and again after a change.
    built: OnceLock<Built>,
}

/// The simulated display, with the construction errors that the options set, and the layers' values
/// after the hardware's response.
#[derive(Debug)]
struct Built {
    display: Display,
    stack: LayerStack,
}

/// A range of slices of the texture arrays, whose mean the shader draws. Slice i contains the i-th
/// frame that was completed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slots {
    /// The first drawn slice.
    pub first: usize,
    /// The number of drawn slices.
    pub count: usize,
}

impl Model {
    /// Makes a model without pictures; [`Self::put`] adds pictures.
    ///
    /// # Errors
    /// If the text is no valid preview; see [`Preview::from_json`].
    pub fn new(preview_json: &str) -> Result<Self, Error> {
        let preview = Preview::from_json(preview_json)?;
        let geometry = preview.geometry()?;
        let codes = vec![None; preview.files.len()];
        let (options, complete, built) = (Options::default(), Vec::new(), OnceLock::new());
        Ok(Self { preview, geometry, options, codes, complete, built })
    }

    /// Returns the preview.
    pub fn preview(&self) -> &Preview {
        &self.preview
    }

    /// Returns the pixels and views of the light field for which the patterns were made.
    pub fn geometry(&self) -> &FieldGeometry {
        &self.geometry
    }

    /// Returns the current options.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Adds the bytes of file `index`. Returns the part of the preview that the file contains. Also
    /// returns the slice of the part's frame, if all files of this frame are present.
    ///
    /// # Errors
    /// If there is no such file or it is damaged; the model stays unchanged.
    pub fn put(&mut self, index: usize, bytes: &[u8]) -> Result<(Part, Option<usize>), Error> {
        let file = self.preview.files.get(index).ok_or_else(|| {
            err(format!(
                "files: expected a file number from 0 to {}, found {index}",
                self.preview.files.len() as i64 - 1
            ))
        })?;
        let part = file.part;
        self.codes[index] = Some(decode(file, bytes)?);
        let frame = match part {
            Part::Layer { frame, .. } | Part::Emission { frame } => frame,
            Part::Target { .. } => return Ok((part, None)),
        };
        self.built.take();
        // if the frame was already complete, the new file replaces an earlier file
        if let Some(slot) = self.complete.iter().position(|complete| *complete == frame) {
            return Ok((part, Some(slot)));
        }
        let whole = self.preview.files.iter().zip(&self.codes).all(|(file, codes)| match file.part {
            Part::Layer { frame: of, .. } | Part::Emission { frame: of } => of != frame || codes.is_some(),
            Part::Target { .. } => true,
        });
        let slot = self.complete.len();
        if whole {
            self.complete.push(frame);
        }
        Ok((part, whole.then_some(slot)))
    }

    /// Replaces the codes of all files. `codes` contains `[row][col][rgb]` of every file, in the
    /// preview's order.
    ///
    /// # Errors
    /// If the length of `codes` is wrong; the model stays unchanged.
    pub fn exchange(&mut self, codes: &[u8]) -> Result<(), Error> {
        let length = |file: &File| 3 * file.rows * file.cols;
        let expected: usize = self.preview.files.iter().map(length).sum();
        if codes.len() != expected {
            return Err(err(format!("codes: expected {expected} bytes, found {}", codes.len())));
        }
        let mut rest = codes;
        for (place, file) in self.codes.iter_mut().zip(&self.preview.files) {
            let (own, others) = rest.split_at(length(file));
            *place = Some(own.to_vec());
            rest = others;
        }
        self.complete = (0..self.preview.frames).collect();
        self.built.take();
        Ok(())
    }

    /// Returns the number of complete frames.
    pub fn frames_ready(&self) -> usize {
        self.complete.len()
    }

    /// Returns the numbers of the complete frames, in the order of their completion.
    pub fn complete(&self) -> &[usize] {
        &self.complete
    }

    /// Returns the number of the target's views that have arrived.
    pub fn targets_ready(&self) -> usize {
        let targets = self.preview.files.iter().zip(&self.codes);
        targets.filter(|(file, codes)| matches!(file.part, Part::Target { .. }) && codes.is_some()).count()
    }

    /// Changes the options; omitted keys return to their defaults.
    ///
    /// # Errors
    /// The errors of [`Options::from_json`]; the options stay unchanged.
    pub fn set_options(&mut self, text: &str) -> Result<(), Error> {
        let options = Options::from_json(text, self.preview.frames)?;
        if options != self.options {
            self.options = options;
            self.built.take();
        }
        Ok(())
    }

    /// Returns the factor on the emitted light; 1/β unless the options set it.
    pub fn gain(&self) -> f32 {
        self.options.gain.unwrap_or(1.0 / self.preview.brightness) as f32
    }

    /// Returns the slices whose mean is the picture: the slice of the selected frame if this frame
    /// is complete, otherwise the slices of all complete frames.
    pub fn slots(&self) -> Slots {
        let chosen = self.options.frame.and_then(|frame| self.complete.iter().position(|&of| of == frame));
        match chosen {
            Some(first) => Slots { first, count: 1 },
            None => Slots { first: 0, count: self.complete.len() },
        }
    }

    /// Returns the codes of a part, `[row][col][rgb]`; `None` until its file has arrived.
    pub fn codes(&self, part: Part) -> Option<&[u8]> {
        let at = self.preview.files.iter().position(|file| file.part == part)?;
        self.codes[at].as_deref()
    }

    /// Returns the response of layer `n`'s hardware; `None` for an identity.
    fn response(&self, n: usize) -> Option<Response> {
        self.preview.display.layers[n].response().filter(|response| !response.is_identity())
    }

    /// Returns true if the hardware of layer `n` does not change its stored values, so that rays
    /// hit exactly these values.
    pub fn is_plain(&self, n: usize) -> bool {
        self.response(n).is_none()
    }

    /// Returns the values of layer `n` that rays hit, in the given frames: the stored values after
    /// the hardware's response, `[frame][row][col][rgb]`. The black level in `options` is not
    /// applied.
    pub fn hit_values(&self, n: usize, frames: &[usize]) -> Tensor<4> {
        let [cols, rows] = self.preview.display.layers[n].resolution;
        let mut values = Tensor::zeros(LayerStack::LAYER_AXES, [frames.len(), rows, cols, 3]);
        for (i, &frame) in frames.iter().enumerate() {
            let codes = self.codes(Part::Layer { layer: n, frame }).unwrap_or_default();
            values.block_mut([i]).iter_mut().zip(codes).for_each(|(value, code)| *value = f32::from(*code) / 255.0);
        }
        match self.response(n) {
            Some(response) => response.apply(&values),
            None => values,
        }
    }

    fn built(&self) -> &Built {
        self.built.get_or_init(|| {
            let slots = self.slots();
            let frames = &self.complete[slots.first..slots.first + slots.count];
            let mut display = self.options.built(&self.preview.display);
            let black = self.options.black_level as f32;
            let layers = (0..display.layers.len()).map(|n| {
                let mut values = self.hit_values(n, frames);
                values.data_mut().iter_mut().for_each(|value| *value = black + (1.0 - black) * *value);
                values
            });
            let stack = LayerStack {
                layers: layers.collect(),
                emission: self.emission(frames),
                brightness: self.preview.brightness,
            };
            // the values include the hardware's response, so the simulated layers have none
            display.layers = display
                .layers
                .iter()
                .map(|layer| Layer {
                    blur_px: 0.0,
                    crosstalk: None,
                    colour: LayerColour::Rgb,
                    filters: Vec::new(),
                    ..layer.clone()
                })
                .collect();
            Built { display, stack }
        })
    }

    fn emission(&self, frames: &[usize]) -> Option<Tensor<6>> {
        let mut shape = LayerStack::emission_shape(&self.preview.display)?;
        shape[0] = frames.len();
        let [_, bins_y, bins_x, rows, cols, _] = shape;
        let mut values = Tensor::zeros(LayerStack::EMISSION_AXES, shape);
        for (i, &frame) in frames.iter().enumerate() {
            let codes = self.codes(Part::Emission { frame }).unwrap_or_default();
            // the picture has the layout `[bin_y][lenslet_row][bin_x][lenslet_col]`: a line
            // contains one row of lenslets, for one bin_y and all bin_x
            for (line, codes) in codes.chunks_exact(3 * bins_x * cols).enumerate() {
                let (bin_y, row) = (line / rows, line % rows);
                for (bin_x, codes) in codes.chunks_exact(3 * cols).enumerate() {
                    let place = values.block_mut([i, bin_y, bin_x, row]);
                    place.iter_mut().zip(codes).for_each(|(value, code)| *value = f32::from(*code) / 255.0);
                }
            }
        }
        debug_assert_eq!(bins_y, shape[1]);
        Some(values)
    }

    /// Returns the seen picture from a slope with the current options. If the options set a pupil,
    /// each pixel is the mean over points of the pupil, with one ray for each point.
    fn emitted(&self, slope: [f64; 2], projection: Projection) -> EmittedView {
        let built = self.built();
        if built.stack.frames() == 0 {
            let (rows, cols) = (self.geometry.rows, self.geometry.cols);
            let radiance = Tensor::zeros(["row", "col", "rgb"], [rows, cols, 3]);
            return EmittedView { radiance, valid: vec![false; rows * cols] };
        }
        let pupil = self.options.pupil(&built.display, projection);
        let slopes = |centre: f64| pupil.offsets.iter().map(|offset| centre + offset).collect();
        let grid = ViewGrid { projection, slope_x: slopes(slope[0]), slope_y: slopes(slope[1]) };
        let geometry = self.geometry.with_grid(grid);
        let simulator = Simulator::new(&built.display, &built.stack);
        if pupil.offsets.len() == 1 {
            return simulator.seen(&geometry, [0, 0]).into();
        }
        let map = RayMap::new(&built.display, &geometry);
        let mut views = pupil.places().map(|place| simulator.view(&map, &geometry, place));
        let mut mean = views.next().expect("the middle of a pupil lies on it");
        let mut count = 1.0;
        for view in views {
            mean.radiance.data_mut().iter_mut().zip(view.radiance.data()).for_each(|(sum, value)| *sum += value);
            mean.valid.iter_mut().zip(&view.valid).for_each(|(all, valid)| *all &= valid);
            count += 1.0;
        }
        if count > 1.0 {
            mean.radiance.data_mut().iter_mut().for_each(|value| *value /= count);
        }
        mean
    }

    /// Returns the tables for the shader that draws the view from a slope.
    pub fn tables(&self, slope: [f64; 2], projection: Projection) -> Tables {
        let display = self.options.built(&self.preview.display);
        Tables::new(&display, &self.geometry, &self.options.pupil(&display, projection), slope, projection)
    }

    /// Returns the projection of the drawn views.
    pub fn projection(&self) -> Projection {
        self.options.projection(self.geometry.grid.projection)
    }

    /// Returns the seen picture from a slope times the gain, linear `[row][col][rgb]`.
    pub fn view_linear(&self, slope: [f64; 2]) -> Vec<f32> {
        let gain = self.gain();
        let mut values = self.emitted(slope, self.projection()).radiance.into_data();
        values.iter_mut().for_each(|value| *value *= gain);
        values
    }

    /// Returns the seen picture from a slope times the gain, as sRGB bytes `[row][col][rgba]`.
    pub fn render(&self, slope: [f64; 2]) -> Vec<u8> {
        to_rgba(&self.view_linear(slope))
    }

    /// Returns a view of the target as sRGB bytes `[row][col][rgba]`.
    ///
    /// # Errors
    /// If there is no such view or it has not arrived.
    pub fn render_target(&self, view: [usize; 2]) -> Result<Vec<u8>, Error> {
        Ok(opaque(self.target(view)?))
    }

    /// Returns the mask of a layer in a frame as it looks on a light table: its linear
    /// transmittances, encoded as sRGB bytes `[row][col][rgba]`.
    ///
    /// # Errors
    /// If there is no such layer or frame, or the mask's file has not arrived.
    pub fn render_layer(&self, layer: usize, frame: usize) -> Result<Vec<u8>, Error> {
        let codes = self.codes(Part::Layer { layer, frame });
        Ok(on_light_table(
            codes
                .ok_or_else(|| err(format!("layer {layer}, frame {frame}: the mask is missing, or not loaded yet")))?,
        ))
    }

    /// Returns the backlight's emission in a frame, with angular bins side by side as in its file:
    /// linear values, encoded as sRGB bytes `[row][col][rgba]`.
    ///
    /// # Errors
    /// If the backlight is uniform, there is no such frame, or the emission's file has not arrived.
    pub fn render_backlight(&self, frame: usize) -> Result<Vec<u8>, Error> {
        let codes = self.codes(Part::Emission { frame });
        Ok(on_light_table(
            codes
                .ok_or_else(|| err(format!("backlight, frame {frame}: the emission is missing, or not loaded yet")))?,
        ))
    }

    /// Returns the error map at a slope, compared with the target's view L nearest to the slope.
    /// The error of a pixel is the largest channel of |gain · L̃ − L|. A ray is dropped if it
    /// misses the lenslets, or a layer that the display's [`Missing`](lumistack_display::Missing)
    /// rule requires. A pixel is black if the rays of more than half of its area are dropped. With
    /// a pupil, a pixel is black if any of its rays is dropped.
    ///
    /// # Errors
    /// If the view has not arrived.
    pub fn render_error(&self, slope: [f64; 2]) -> Result<Vec<u8>, Error> {
        let view = self.nearest_view(slope);
        let target = self.target(view)?;
        let (emitted, gain) = (self.emitted_at(view), self.gain());
        let pixels = emitted.radiance.data().chunks_exact(3).zip(target.chunks_exact(3)).zip(&emitted.valid);
        Ok(pixels
            .flat_map(|((emitted, target), valid)| {
                let error = |c: usize| (gain * emitted[c] - DECODED[usize::from(target[c])]).abs();
                let [r, g, b] = if *valid { heat(error(0).max(error(1)).max(error(2))) } else { [0; 3] };
                [r, g, b, 255]
            })
            .collect())
    }

    /// Returns the PSNR of L̃/β against the target's view nearest to a slope, dB. `None` if this
    /// view has not arrived, if no frame is complete, or if the display drops all rays of the view.
    pub fn psnr(&self, slope: [f64; 2]) -> Option<f64> {
        let view = self.nearest_view(slope);
        let target: Vec<f32> = self.target(view).ok()?.iter().map(|code| DECODED[usize::from(*code)]).collect();
        let error: SquaredError = view_error(&self.emitted_at(view), &target, self.preview.brightness, |_| 1.0);
        (error.count > 0).then(|| error.psnr())
    }

    /// Returns the picture that the display emits towards a view of the target.
    fn emitted_at(&self, view: [usize; 2]) -> EmittedView {
        self.emitted(self.slope_of(view), self.geometry.grid.projection)
    }

    /// Returns the slope of a view of the target: the slope of the view's ray through the centre of
    /// the light field's rectangle.
    pub fn slope_of(&self, view: [usize; 2]) -> [f64; 2] {
        [self.geometry.grid.slope_x[view[1]], self.geometry.grid.slope_y[view[0]]]
    }

    /// Returns the codes of a view of the target.
    ///
    /// # Errors
    /// If there is no such view or it has not arrived.
    pub fn target(&self, view: [usize; 2]) -> Result<&[u8], Error> {
        self.codes(Part::Target { view }).ok_or_else(|| {
            err(format!("target, row {}, column {}: the view is missing, or not loaded yet", view[0], view[1]))
        })
    }

    /// Returns [view_y, view_x] of the target's view nearest to a slope.
    pub fn nearest_view(&self, slope: [f64; 2]) -> [usize; 2] {
        let nearest = |slopes: &[f64], slope: f64| {
            let distance = |i: usize| (slopes[i] - slope).abs();
            (0..slopes.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(0)
        };
        [nearest(&self.geometry.grid.slope_y, slope[1]), nearest(&self.geometry.grid.slope_x, slope[0])]
    }
}

/// Adds an opaque fourth channel to RGB codes.
fn opaque(codes: &[u8]) -> Vec<u8> {
    codes.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect()
}

/// Converts codes of linear values (value = code / 255) to opaque sRGB bytes.
fn on_light_table(codes: &[u8]) -> Vec<u8> {
    let linear: Vec<f32> = codes.iter().map(|code| f32::from(*code) / 255.0).collect();
    to_rgba(&linear)
}
