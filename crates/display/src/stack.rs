//! The patterns of a tensor display.

use std::borrow::Cow;

use lumistack_core::Tensor;
use thiserror::Error;

use crate::{Backlight, Display};

/// Patterns for every layer and frame, linear, 0..1, and the brightness that they were made for.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerStack {
    /// The masks of every layer, rearmost first: `transmittance[frame][row][col][rgb]`.
    pub layers: Vec<Tensor<4>>,
    /// Emission of a directional backlight:
    /// `emission[frame][bin_y][bin_x][lenslet_row][lenslet_col][rgb]`.
    pub emission: Option<Tensor<6>>,
    /// β: the display emits β times the target.
    pub brightness: f64,
}

/// A stack that does not fit its display.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{what}: expected {expected}, found {found}")]
pub struct StackError {
    /// Name of the array or value that does not fit.
    pub what: String,
    /// The shape or range that the display needs.
    pub expected: String,
    /// The value of the stack.
    pub found: String,
}

impl LayerStack {
    /// Axis names of each layer.
    pub const LAYER_AXES: [&'static str; 4] = ["frame", "row", "col", "rgb"];
    /// Axis names of the emission.
    pub const EMISSION_AXES: [&'static str; 6] = ["frame", "bin_y", "bin_x", "lenslet_row", "lenslet_col", "rgb"];

    /// Makes a stack in which every value is `value`. Its brightness scale β is the display's. The
    /// patterns must emit β times the light field, since comparisons divide emitted light by β.
    /// Code that makes patterns of another brightness sets `brightness`.
    pub fn filled(display: &Display, value: f32) -> Self {
        Self {
            layers: (0..display.layers.len())
                .map(|n| Tensor::filled(Self::LAYER_AXES, Self::layer_shape(display, n), value))
                .collect(),
            emission: Self::emission_shape(display).map(|shape| Tensor::filled(Self::EMISSION_AXES, shape, value)),
            brightness: display.brightness,
        }
    }

    /// Returns the shape of layer `n` of a display.
    pub fn layer_shape(display: &Display, n: usize) -> [usize; 4] {
        let [cols, rows] = display.layers[n].resolution;
        [display.frames, rows, cols, 3]
    }

    /// Returns the shape of the emission of a display's directional backlight; `None` for a uniform
    /// backlight.
    pub fn emission_shape(display: &Display) -> Option<[usize; 6]> {
        match &display.backlight {
            Backlight::Uniform => None,
            Backlight::Lenslets(b) => Some([display.frames, b.views[1], b.views[0], b.lenslets[1], b.lenslets[0], 3]),
        }
    }

    /// Returns the number of frames M.
    pub fn frames(&self) -> usize {
        self.layers.first().map_or(0, |layer| layer.shape()[0])
    }

    /// Returns the values that rays read: every layer after its [`Response`](crate::Response). The
    /// stack itself is returned, borrowed, if no response changes values.
    pub fn effective(&self, display: &Display) -> Cow<'_, Self> {
        let responses: Vec<_> =
            display.layers.iter().map(|layer| layer.response().filter(|response| !response.is_identity())).collect();
        if responses.iter().all(Option::is_none) {
            return Cow::Borrowed(self);
        }
        let layers = self.layers.iter().zip(&responses).map(|(layer, response)| match response {
            Some(response) => response.apply(layer),
            None => layer.clone(),
        });
        Cow::Owned(Self { layers: layers.collect(), emission: self.emission.clone(), brightness: self.brightness })
    }

    /// Checks that the stack has the shapes of the display and values in 0..1. A layer with limited
    /// hardware has a narrower [range](crate::Layer::range). The values may lie outside of this
    /// range, since other programs may have made the patterns.
    ///
    /// # Errors
    /// On the first array or value that does not fit.
    pub fn check(&self, display: &Display) -> Result<(), StackError> {
        let error = |what: String, expected: String, found: String| Err(StackError { what, expected, found });
        if self.layers.len() != display.layers.len() {
            return error("number of layers".into(), display.layers.len().to_string(), self.layers.len().to_string());
        }
        if !(self.brightness > 0.0 && self.brightness <= 1.0) {
            return error("brightness".into(), "a number above 0 and at most 1".into(), self.brightness.to_string());
        }
        for (n, layer) in self.layers.iter().enumerate() {
            let expected = Self::layer_shape(display, n);
            if layer.shape() != expected {
                return error(
                    format!("shape [frame][row][col][rgb] of layer {n}"),
                    format!("{expected:?}"),
                    format!("{:?}", layer.shape()),
                );
            }
        }
        let expected = Self::emission_shape(display);
        let found = self.emission.as_ref().map(Tensor::shape);
        if expected != found {
            let text =
                |shape: Option<_>| shape.map_or("no emission".to_owned(), |shape: [usize; 6]| format!("{shape:?}"));
            return error("shape of the emission".into(), text(expected), text(found));
        }
        let parts = self.layers.iter().map(Tensor::data).chain(self.emission.as_ref().map(Tensor::data));
        for (i, data) in parts.enumerate() {
            if let Some(value) = data.iter().find(|v| !(0.0..=1.0).contains(*v)) {
                let what = if i < self.layers.len() { format!("layer {i}") } else { "emission".into() };
                return error(what, "values in 0..1".into(), value.to_string());
            }
        }
        Ok(())
    }
}
