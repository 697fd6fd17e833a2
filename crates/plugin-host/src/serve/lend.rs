//! Lends layer stacks and light fields to plugins, plane by plane.

use std::ffi::c_void;
use std::sync::OnceLock;

use lumistack_display::{Display, FieldGeometry, LayerStack, LightField, Projection, Simulator, ViewGrid, Weights};
use lumistack_plugin::abi::{Data, ErrorSink, Plane, Status, Str, View, view};
use lumistack_plugin::wire::{Depth, Description, Geometry, RayWeights, Start, answer, dense};
use lumistack_plugin::{PluginError, Port, Time};

/// Input data of an output at one time step.
#[derive(Clone, Copy, Debug)]
pub enum OutputData<'a> {
    /// The layer stack of a tensor display, and the light field for which it was solved. The views
    /// of this light field are lent as well. Without a light field, the plugin receives the
    /// display's geometry instead.
    LayerStack(&'a LayerStack, Option<&'a LightField>),
    /// Linear radiance of many views.
    LightField(&'a LightField),
}

impl OutputData<'_> {
    /// Returns the port of these data.
    pub fn port(&self) -> Port {
        match self {
            Self::LayerStack(..) => Port::LayerStack,
            Self::LightField(_) => Port::LightField,
        }
    }
}

/// Input data of a node.
#[derive(Clone, Copy, Debug)]
pub struct NodeData<'a> {
    /// The display for which the node makes a layer stack.
    pub display: &'a Display,
    /// Time step; the default for a still.
    pub time: Time,
    /// The light field, in the display's geometry.
    pub field: &'a LightField,
    /// Weights of the light field's rays.
    pub weights: &'a Weights,
    /// A layer stack from which the node may start; it matches the display.
    pub start: Option<&'a LayerStack>,
    /// The seed of the node's random numbers.
    pub seed: u64,
}

impl<'a> NodeData<'a> {
    /// Makes the input of a node with uniform weights, seed 1 and no start.
    pub fn new(display: &'a Display, field: &'a LightField) -> Self {
        Self { display, time: Time::default(), field, weights: &Weights::Uniform, start: None, seed: 1 }
    }
}

/// Data on loan. The member `context` of the C struct [`Data`] points to this struct.
pub(crate) struct Lent<'a> {
    data: OutputData<'a>,
    display: &'a Display,
    /// Geometry of the lent light field, or of the lent stack's target. If the target is unknown,
    /// this is the display's geometry.
    geometry: FieldGeometry,
    /// Simulates views of a lent stack. The simulator is made at the first request for a view.
    simulator: OnceLock<Simulator<'a>>,
    /// Weights of the rays, for nodes.
    weights: Option<&'a Weights>,
    start: Option<&'a LayerStack>,
    description: String,
}

impl<'a> Lent<'a> {
    /// Lends the data of an output for `display`.
    ///
    /// # Errors
    /// If a stack does not match its display, or the geometry of its target is invalid.
    pub(crate) fn new(display: &'a Display, data: OutputData<'a>) -> Result<Self, PluginError> {
        let refused = |error: String| PluginError::Refused(error);
        let (geometry, description) = match data {
            OutputData::LayerStack(stack, target) => {
                // Plugins rely on this check, so a stack that fails it is not lent.
                stack.check(display).map_err(|error| refused(format!("layer stack: {error}")))?;
                let geometry = match target {
                    Some(field) => field.geometry().clone(),
                    None => display.geometry().map_err(|error| refused(error.to_string()))?,
                };
                geometry.check().map_err(|error| refused(format!("target: {error}")))?;
                let description = Description::LayerStack {
                    brightness: stack.brightness,
                    frames: stack.frames(),
                    layers: stack.layers.iter().map(|layer| [layer.shape()[1], layer.shape()[2]]).collect(),
                    emission: stack.emission.as_ref().map(|emission| {
                        let [_, bins_y, bins_x, rows, cols, _] = emission.shape();
                        [bins_y, bins_x, rows, cols]
                    }),
                    target: Geometry::from(&geometry),
                    target_views: target.is_some(),
                    target_depth: target.and_then(LightField::depth).map(Depth::from),
                };
                (geometry, description)
            }
            OutputData::LightField(field) => {
                let geometry = field.geometry().clone();
                (geometry, of_field(field))
            }
        };
        Self::described(display, data, geometry, &description)
    }

    /// Lends the input of a node.
    ///
    /// # Errors
    /// If the weights do not match the light field, or the start does not match the display.
    pub(crate) fn for_node(node: &NodeData<'a>) -> Result<Self, PluginError> {
        let NodeData { display, field, weights, start, .. } = *node;
        let refused = |what: &str, error: String| PluginError::Refused(format!("{what}: {error}"));
        weights.check(field.geometry()).map_err(|error| refused("light field", error.to_string()))?;
        if let Some(start) = start {
            start.check(display).map_err(|error| refused("patterns to start from", error.to_string()))?;
        }
        let mut description = of_field(field);
        if let Description::LightField { seed, weights: told, start: begins, .. } = &mut description {
            *seed = Some(node.seed);
            *told = match weights {
                Weights::Uniform => None,
                Weights::PerView(weights) => {
                    let rows = weights.data().chunks_exact(weights.shape()[1]);
                    Some(RayWeights::PerView(rows.map(|row| row.iter().map(|w| f64::from(*w)).collect()).collect()))
                }
                Weights::PerRay(_) => Some(RayWeights::PerRay),
            };
            *begins = start.map(|start| Start { brightness: start.brightness });
        }
        let lent = Self::described(display, OutputData::LightField(field), field.geometry().clone(), &description)?;
        Ok(Self { weights: Some(weights), start, ..lent })
    }

    fn described(
        display: &'a Display,
        data: OutputData<'a>,
        geometry: FieldGeometry,
        description: &Description,
    ) -> Result<Self, PluginError> {
        let description =
            serde_json::to_string(description).map_err(|error| PluginError::failed("description", error))?;
        Ok(Self { data, display, geometry, simulator: OnceLock::new(), weights: None, start: None, description })
    }

    /// Returns the layer stack on loan: an output's data, or a node's start.
    fn patterns(&self, what: &str) -> Result<&'a LayerStack, PluginError> {
        match self.data {
            OutputData::LayerStack(stack, _) => Some(stack),
            OutputData::LightField(_) => self.start,
        }
        .ok_or_else(|| wrong_port(what))
    }

    pub(crate) fn port(&self) -> Port {
        self.data.port()
    }

    /// Makes the C struct of the data, which is valid while `self` lives.
    pub(crate) fn to_abi(&self) -> Data {
        Data {
            size: size_of::<Data>(),
            port: self.port().bit(),
            context: (&raw const *self).cast(),
            description_json: Str::new(&self.description),
            layer_plane,
            emission_plane,
            view_plane,
            weight_plane,
        }
    }
}

fn of_field(field: &LightField) -> Description {
    let depth = field.depth().map(Depth::from);
    let geometry = Geometry::from(field.geometry());
    Description::LightField { geometry, depth, seed: None, weights: None, start: None }
}

unsafe extern "C" fn layer_plane(
    context: *const c_void,
    layer: usize,
    frame: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    let lend = || {
        // SAFETY: the plugin passes the context of `to_abi`, during `submit` or `make`.
        let stack = (unsafe { lent(context) }).patterns("layers")?;
        let values = stack.layers.get(layer).ok_or_else(|| beyond("layer", layer, stack.layers.len()))?;
        let [frames, rows, cols, channels] = values.shape();
        within("frame", frame, frames)?;
        // SAFETY: the plugin provides memory for the plane.
        unsafe { give(plane, values.block([frame]), [rows, cols, channels]) }
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, lend) }
}

unsafe extern "C" fn emission_plane(
    context: *const c_void,
    frame: usize,
    bin_y: usize,
    bin_x: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    let lend = || {
        // SAFETY: as in `layer_plane`.
        let stack = (unsafe { lent(context) }).patterns("emission")?;
        let Some(emission) = &stack.emission else {
            return Err(PluginError::Refused(
                "expected a request for masks, since the backlight is uniform, found a request for the backlight's emission".into(),
            ));
        };
        let [frames, bins_y, bins_x, rows, cols, channels] = emission.shape();
        within("frame", frame, frames)?;
        within("bin_y", bin_y, bins_y)?;
        within("bin_x", bin_x, bins_x)?;
        // SAFETY: as in `layer_plane`.
        unsafe { give(plane, emission.block([frame, bin_y, bin_x]), [rows, cols, channels]) }
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, lend) }
}

unsafe extern "C" fn view_plane(
    context: *const c_void,
    view_y: usize,
    view_x: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    let lend = || {
        // SAFETY: as in `layer_plane`.
        let (OutputData::LightField(field) | OutputData::LayerStack(_, Some(field))) = (unsafe { lent(context) }).data
        else {
            return Err(wrong_port("views"));
        };
        let [views_y, views_x, rows, cols, channels] = field.radiance().shape();
        within("view_y", view_y, views_y)?;
        within("view_x", view_x, views_x)?;
        // SAFETY: as in `layer_plane`.
        unsafe { give(plane, field.view([view_y, view_x]), [rows, cols, channels]) }
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, lend) }
}

unsafe extern "C" fn weight_plane(
    context: *const c_void,
    view_y: usize,
    view_x: usize,
    plane: *mut Plane,
    error: *const ErrorSink,
) -> Status {
    let lend = || {
        // SAFETY: as in `layer_plane`.
        let Some(Weights::PerRay(weights)) = (unsafe { lent(context) }).weights else {
            return Err(wrong_port("weights per ray"));
        };
        let [views_y, views_x, rows, cols] = weights.shape();
        within("view_y", view_y, views_y)?;
        within("view_x", view_x, views_x)?;
        // SAFETY: as in `layer_plane`.
        unsafe { give(plane, weights.block([view_y, view_x]), [rows, cols, 1]) }
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, lend) }
}

/// Computes a view of a layer stack on loan; the plane owns its values.
///
/// # Safety
/// `data` comes from [`Lent::to_abi`] and is still on loan; `from` is a valid view, and `plane` is
/// memory for a plane.
pub(crate) unsafe fn simulate(data: *const Data, from: *const View, plane: *mut Plane) -> Result<(), PluginError> {
    // SAFETY: guaranteed by the caller.
    let (lent, kind, value) = unsafe { (lent((*data).context), (*from).kind, (*from).value) };
    let OutputData::LayerStack(stack, _) = lent.data else { return Err(wrong_port("simulated views")) };
    let [x, y, z] = value;
    let grid = match kind {
        view::SLOPE => ViewGrid::single(Projection::Oblique, [x, y]),
        view::EYE => ViewGrid::single(Projection::Perspective { distance_mm: z }, [x / z, y / z]),
        other => {
            return Err(PluginError::Refused(format!(
                "expected a view of kind 1 (slope) or 2 (eye), found kind {other}"
            )));
        }
    };
    let geometry = lent.geometry.with_grid(grid);
    geometry.check().map_err(|error| PluginError::Refused(format!("view: {error}")))?;
    let simulator = lent.simulator.get_or_init(|| Simulator::new(lent.display, stack));
    let owner = Box::new(simulator.seen(&geometry, [0, 0]).radiance.into_data());
    // SAFETY: guaranteed by the caller; on success the plane owns the values. They keep their
    // address when their box becomes a pointer.
    unsafe {
        give(plane, &owner, [geometry.rows, geometry.cols, 3])?;
        (*plane).owner = Box::into_raw(owner).cast();
        (*plane).release = Some(release);
    }
    Ok(())
}

unsafe extern "C" fn release(owner: *mut c_void) {
    // SAFETY: `owner` is the box of `simulate`, and a plane is released once.
    drop(unsafe { Box::from_raw(owner.cast::<Vec<f32>>()) });
}

/// # Safety
/// `context` comes from [`Lent::to_abi`], and the data are still on loan.
unsafe fn lent<'a>(context: *const c_void) -> &'a Lent<'a> {
    // SAFETY: guaranteed by the caller.
    unsafe { &*context.cast::<Lent<'a>>() }
}

/// Fills a plane with dense values.
///
/// # Safety
/// `plane` is memory for a plane whose `size` is set.
unsafe fn give(plane: *mut Plane, values: &[f32], shape: [usize; 3]) -> Result<(), PluginError> {
    // SAFETY: guaranteed by the caller.
    let size = unsafe { (*plane).size };
    if size < size_of::<Plane>() {
        return Err(PluginError::Refused(format!(
            "the plane's `size`: expected at least {} bytes, found {size}",
            size_of::<Plane>()
        )));
    }
    // SAFETY: guaranteed by the caller. A newer plugin's `Plane` is longer; the bytes after this
    // version's members stay unchanged.
    unsafe { *plane = Plane { size, ..dense(values, shape) } };
    Ok(())
}

fn within(what: &str, index: usize, count: usize) -> Result<(), PluginError> {
    if index < count { Ok(()) } else { Err(beyond(what, index, count)) }
}

fn beyond(what: &str, index: usize, count: usize) -> PluginError {
    PluginError::Refused(format!("{what}: expected an index below {count}, found {index}"))
}

fn wrong_port(what: &str) -> PluginError {
    PluginError::Refused(format!("the data of this call have no {what}"))
}
