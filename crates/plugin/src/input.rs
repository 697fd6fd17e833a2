//! The data that a host lends: to an output in `submit`, and to a node.

use std::marker::PhantomData;

use lumistack_core::Tensor;
use lumistack_display::{Display, FieldGeometry, LayerStack, LightField, Projection, SeenDepth, Weights};
use lumistack_plugin_abi::{Data, ErrorSink, Plane, Status, view};

use crate::viewpoint::ViewPoint;
use crate::wire::{Description, RayWeights, Start, call, lent_text};
use crate::{Host, PlaneView, PluginError, Port};

/// Data from the host, for one `submit` of an output or for a node. Later versions may add ports.
#[derive(Debug)]
#[non_exhaustive]
pub enum Input<'a> {
    /// The layer stack of a tensor display.
    LayerStack(StackInput<'a>),
    /// Linear radiance of many views.
    LightField(FieldInput<'a>),
}

/// A pointer to data that the host lends until `submit` or `make` returns.
#[derive(Debug)]
struct Lent<'a> {
    data: *const Data,
    host: Host,
    _submit: PhantomData<&'a Data>,
}

// SAFETY: the host allows data to be read from several threads.
unsafe impl Send for Lent<'_> {}
// SAFETY: as above.
unsafe impl Sync for Lent<'_> {}

/// The layer stack of a tensor display: layers rearmost first, values linear in 0..1.
#[derive(Debug)]
pub struct StackInput<'a> {
    lent: Lent<'a>,
    brightness: f64,
    frames: usize,
    layers: Vec<[usize; 2]>,
    emission: Option<[usize; 4]>,
    target: FieldGeometry,
    target_views: bool,
    depth: Option<SeenDepth>,
}

/// A light field: linear radiance of many views after exposure, at least 0. Values above 1 are
/// rare.
#[derive(Debug)]
pub struct FieldInput<'a> {
    lent: Lent<'a>,
    geometry: FieldGeometry,
    depth: Option<SeenDepth>,
    seed: Option<u64>,
    weights: Option<RayWeights>,
    start: Option<Start>,
}

impl<'a> Input<'a> {
    /// # Safety
    /// `data` and all that it lends are valid for the lifetime.
    pub(crate) unsafe fn new(data: *const Data, host: Host) -> Result<Self, PluginError> {
        let lent = Lent { data, host, _submit: PhantomData };
        // SAFETY: guaranteed by the caller.
        let text = unsafe { lent_text((*data).description_json, "description of the data")? };
        let description =
            serde_json::from_str(text).map_err(|error| PluginError::failed("description of the data", error))?;
        Ok(match description {
            Description::LayerStack { brightness, frames, layers, emission, target, target_views, target_depth } => {
                let (target, depth) = (target.try_into()?, target_depth.map(SeenDepth::try_from).transpose()?);
                Self::LayerStack(StackInput { lent, brightness, frames, layers, emission, target, target_views, depth })
            }
            Description::LightField { geometry, depth, seed, weights, start } => {
                let depth = depth.map(SeenDepth::try_from).transpose()?;
                Self::LightField(FieldInput { lent, geometry: geometry.try_into()?, depth, seed, weights, start })
            }
        })
    }

    /// Returns the port of the data.
    pub fn port(&self) -> Port {
        match self {
            Self::LayerStack(_) => Port::LayerStack,
            Self::LightField(_) => Port::LightField,
        }
    }
}

impl PluginError {
    /// Makes the error for data of a port that the plugin does not accept.
    pub fn unexpected(data: &Input<'_>) -> Self {
        Self::Refused(format!("expected data that the plugin accepts, found {}", data.port()))
    }
}

impl StackInput<'_> {
    /// Returns the number of layers N.
    pub fn layer_count(&self) -> usize {
        self.layers.len()
    }

    /// Returns [rows, cols] of a layer; layer 0 is the rearmost. `None` if there is no such layer.
    pub fn layer_size(&self, layer: usize) -> Option<[usize; 2]> {
        self.layers.get(layer).copied()
    }

    /// Returns the number of time-multiplexed frames M.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Returns the brightness β: the display emits β times the target.
    pub fn brightness(&self) -> f64 {
        self.brightness
    }

    /// Returns [bins_y, bins_x, lenslet_rows, lenslet_cols] of a directional backlight; `None` for
    /// a uniform backlight.
    pub fn emission_shape(&self) -> Option<[usize; 4]> {
        self.emission
    }

    /// Returns the geometry of the target, the light field for which the stack was solved.
    pub fn target(&self) -> &FieldGeometry {
        &self.target
    }

    /// Returns the depth of the target's central view; `None` if the host does not know this depth.
    pub fn target_depth(&self) -> Option<&SeenDepth> {
        self.depth.as_ref()
    }

    /// Returns true if [`target_view`](Self::target_view) can read the target's views.
    pub fn has_target_views(&self) -> bool {
        self.target_views
    }

    /// Returns the radiance `[row][col][rgb]` of one view of the target; `view` is [view_y,
    /// view_x]. `None` if the host has only the target's geometry.
    ///
    /// # Errors
    /// If there is no such view, or the host cannot lend it.
    pub fn target_view(&self, view: [usize; 2]) -> Result<Option<PlaneView<'_>>, PluginError> {
        if !self.target_views {
            return Ok(None);
        }
        let [y, x] = view;
        // SAFETY: the context belongs to the data.
        self.lent.plane(|data, plane, error| unsafe { (data.view_plane)(data.context, y, x, plane, error) }).map(Some)
    }

    /// Returns the transmittance `[row][col][rgb]` of one layer and frame.
    ///
    /// # Errors
    /// If there is no such layer or frame, or the host cannot lend it.
    pub fn layer(&self, layer: usize, frame: usize) -> Result<PlaneView<'_>, PluginError> {
        // SAFETY: the context belongs to the data.
        self.lent.plane(|data, plane, error| unsafe { (data.layer_plane)(data.context, layer, frame, plane, error) })
    }

    /// Returns the emission `[lenslet_row][lenslet_col][rgb]` of one angular bin and frame.
    ///
    /// # Errors
    /// If the backlight is not directional or there is no such bin or frame, or the host cannot
    /// lend it.
    pub fn emission(&self, frame: usize, bin_y: usize, bin_x: usize) -> Result<PlaneView<'_>, PluginError> {
        // SAFETY: the context belongs to the data.
        self.lent.plane(|data, plane, error| unsafe {
            (data.emission_plane)(data.context, frame, bin_y, bin_x, plane, error)
        })
    }

    /// Copies the whole layer stack. `display` is the display of the output.
    ///
    /// # Errors
    /// If the host cannot lend a plane, or the stack does not match the display.
    pub fn to_layer_stack(&self, display: &Display) -> Result<LayerStack, PluginError> {
        self.lent.patterns(display, self.brightness)
    }

    /// Returns the simulated view from a viewpoint: emitted linear radiance `[row][col][rgb]`. Each
    /// value is the mean over the area of a pixel of the target. An adapted viewer sees this
    /// radiance divided by [`brightness`](Self::brightness).
    ///
    /// # Errors
    /// If the viewpoint is invalid, or the host cannot compute the view.
    pub fn simulate(&self, from: ViewPoint) -> Result<PlaneView<'_>, PluginError> {
        // SAFETY: the data belong to the running `submit`.
        unsafe { self.lent.host.simulate(self.lent.data, from) }
    }
}

impl FieldInput<'_> {
    /// Returns the light field's numbers of pixels and views, its pixel pitch, projection and
    /// slopes.
    pub fn geometry(&self) -> &FieldGeometry {
        &self.geometry
    }

    /// Returns the depth of the central view, [view rows / 2, view columns / 2]; `None` if the host
    /// does not know this depth.
    pub fn depth(&self) -> Option<&SeenDepth> {
        self.depth.as_ref()
    }

    /// Returns the radiance `[row][col][rgb]` of `view` = [view_y, view_x].
    ///
    /// # Errors
    /// If there is no such view, or the host cannot lend it.
    pub fn view(&self, view: [usize; 2]) -> Result<PlaneView<'_>, PluginError> {
        // SAFETY: the context belongs to the data.
        self.lent.plane(|data, plane, error| unsafe { (data.view_plane)(data.context, view[0], view[1], plane, error) })
    }

    /// Copies all views.
    ///
    /// # Errors
    /// If the host cannot lend a view, or lends a view with another number of values.
    pub fn to_light_field(&self) -> Result<LightField, PluginError> {
        let geometry = self.geometry.clone();
        let mut whole =
            LightField::black(geometry.clone()).map_err(|error| PluginError::failed("light field", error))?;
        for view in geometry.grid.iter() {
            fill(whole.view_mut(view), &self.view(view)?, || format!("view {}, {}", view[0], view[1]))?;
        }
        Ok(whole.with_depth(self.depth.clone()))
    }

    /// Returns the seed for random numbers. It is 1 if the host sets none.
    pub(crate) fn seed(&self) -> u64 {
        self.seed.unwrap_or(1)
    }

    /// Returns the weights of the light field's rays.
    pub(crate) fn weights(&self) -> Result<Weights, PluginError> {
        let wrong = |error: &dyn std::fmt::Display| PluginError::Failed(format!("data from the host: {error}"));
        let FieldGeometry { rows, cols, grid, .. } = &self.geometry;
        let [views_y, views_x] = grid.views();
        let weights = match &self.weights {
            None => return Ok(Weights::Uniform),
            Some(RayWeights::PerView(rows)) => {
                let values = rows.iter().flatten().map(|weight| *weight as f32).collect();
                let tensor = Tensor::from_vec(["view_y", "view_x"], [views_y, views_x], values);
                Weights::PerView(tensor.map_err(|error| wrong(&error))?)
            }
            Some(RayWeights::PerRay) => {
                let shape = [views_y, views_x, *rows, *cols];
                let mut tensor = Tensor::zeros(["view_y", "view_x", "row", "col"], shape);
                for [y, x] in grid.iter() {
                    // SAFETY: the context belongs to the data.
                    let plane = self
                        .lent
                        .plane(|data, plane, error| unsafe { (data.weight_plane)(data.context, y, x, plane, error) })?;
                    fill(tensor.block_mut([y, x]), &plane, || format!("the weights of view {y}, {x}"))?;
                }
                Weights::PerRay(tensor)
            }
        };
        weights.check(&self.geometry).map_err(|error| wrong(&error))?;
        Ok(weights)
    }

    /// Returns the layer stack that the node may start from; `None` if the host gives none.
    pub(crate) fn start(&self, display: &Display) -> Result<Option<LayerStack>, PluginError> {
        self.start.map(|Start { brightness }| self.lent.patterns(display, brightness)).transpose()
    }
}

/// Iterates over every (frame, bin_y, bin_x) of a directional backlight.
pub(crate) fn bins(frames: usize, [bins_y, bins_x]: [usize; 2]) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..frames).flat_map(move |frame| (0..bins_y).flat_map(move |y| (0..bins_x).map(move |x| (frame, y, x))))
}

/// Copies a borrowed plane into a slice of the same length. `what` names the plane in errors.
fn fill(to: &mut [f32], plane: &PlaneView<'_>, what: impl FnOnce() -> String) -> Result<(), PluginError> {
    let values = plane.values();
    if values.len() != to.len() {
        let (expected, found) = (to.len(), values.len());
        let text = format!("{}: expected a plane of {expected} values from the host, found {found}", what());
        return Err(PluginError::Failed(text));
    }
    to.copy_from_slice(&values);
    Ok(())
}

impl Lent<'_> {
    fn plane(
        &self,
        fetch: impl FnOnce(&Data, *mut Plane, *const ErrorSink) -> Status,
    ) -> Result<PlaneView<'_>, PluginError> {
        // SAFETY: guaranteed to `Input::new`.
        let data = unsafe { &*self.data };
        let mut plane = Plane::empty();
        call(|error| fetch(data, &mut plane, error))?;
        // SAFETY: the host filled the plane, and lends it at least until `submit` or `make`
        // returns.
        unsafe { PlaneView::new(plane) }
    }

    /// Copies the layer stack that the host lends: an output's data, or a node's start.
    fn patterns(&self, display: &Display, brightness: f64) -> Result<LayerStack, PluginError> {
        let mut stack = LayerStack::filled(display, 0.0);
        stack.brightness = brightness;
        let frames = stack.frames();
        for (n, layer) in stack.layers.iter_mut().enumerate() {
            for frame in 0..frames {
                // SAFETY: the context belongs to the data.
                let plane = self
                    .plane(|data, plane, error| unsafe { (data.layer_plane)(data.context, n, frame, plane, error) })?;
                fill(layer.block_mut([frame]), &plane, || format!("layer {n}, frame {frame}"))?;
            }
        }
        if let Some(emission) = &mut stack.emission {
            let [_, bins_y, bins_x, ..] = emission.shape();
            for (frame, y, x) in bins(frames, [bins_y, bins_x]) {
                // SAFETY: the context belongs to the data.
                let plane = self.plane(|data, plane, error| unsafe {
                    (data.emission_plane)(data.context, frame, y, x, plane, error)
                })?;
                let what = || format!("the emission of frame {frame}, bin {y}, {x}");
                fill(emission.block_mut([frame, y, x]), &plane, what)?;
            }
        }
        Ok(stack)
    }
}

impl ViewPoint {
    /// Returns the viewpoint of the view `view` = [view_y, view_x] of a geometry.
    ///
    /// # Panics
    /// If there is no such view.
    pub fn of_view(geometry: &FieldGeometry, view: [usize; 2]) -> Self {
        let [x, y] = [geometry.grid.slope_x[view[1]], geometry.grid.slope_y[view[0]]];
        match geometry.grid.projection {
            Projection::Oblique => Self::Slope([x, y]),
            Projection::Perspective { distance_mm } => Self::Eye([x * distance_mm, y * distance_mm, distance_mm]),
        }
    }

    pub(crate) fn to_abi(self) -> (u32, [f64; 3]) {
        match self {
            Self::Slope([x, y]) => (view::SLOPE, [x, y, 0.0]),
            Self::Eye(eye) => (view::EYE, eye),
        }
    }
}
