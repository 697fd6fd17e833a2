//! Runs importers, sources and nodes, and checks their results.

use std::ffi::c_void;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use lumistack_core::Tensor;
use lumistack_display::{Display, FieldGeometry, LayerStack, LightField};
use lumistack_plugin::abi::{self as abi, Assets, ByteSink, ErrorSink, FieldSink, Plane, StackSink, Status, Str};
use lumistack_plugin::wire::{Geometry, answer, append, call, lent_text};
use lumistack_plugin::{PlaneView, PluginError, Solution, Step, Time};
use serde_json::Value;

use crate::serve::lend::{Lent, NodeData};
use crate::serve::plugin::{Plugin, PluginKind};
use crate::serve::services::{Services, table};

/// Largest number of values in a plugin's light field; as `f32` they take 16 GiB.
const MAX_VALUES: usize = 1 << 32;

/// Reads files for an importer: takes a path relative to the folder of the imported file, and
/// returns the file's bytes.
pub type ReadAsset<'a> = dyn Fn(&str) -> Result<Vec<u8>, PluginError> + Sync + 'a;

/// Runs an importer, which converts `file` into a glTF document. The document is not yet validated.
///
/// # Errors
/// If the plugin is no importer; otherwise the plugin's error.
pub fn import<S: Services>(
    plugin: &Plugin,
    services: &S,
    params_json: &str,
    file: &str,
    read: &ReadAsset<'_>,
) -> Result<Vec<u8>, PluginError> {
    let functions = plugin.of_kind(PluginKind::Importer)?;
    let assets = Assets { size: size_of::<Assets>(), context: (&raw const read).cast(), read: read_asset };
    let mut bytes: Vec<u8> = Vec::new();
    let sink = ByteSink { size: size_of::<ByteSink>(), context: (&raw mut bytes).cast(), write: append };
    let host = table(services);
    // SAFETY: all arguments are lent for the call.
    call(|error| unsafe { functions.import(&host, Str::new(params_json), Str::new(file), &assets, &sink, error) })?;
    Ok(bytes)
}

unsafe extern "C" fn read_asset(
    context: *const c_void,
    path: Str,
    bytes: *const ByteSink,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the plugin passes on the context of `import`: a reference that is valid until
    // `import` returns. The plugin also lends text and sink.
    unsafe {
        answer(error, || {
            let read = *context.cast::<&ReadAsset<'_>>();
            let content = read(lent_text(path, "file name")?)?;
            let sink = &*bytes;
            call(|error| (sink.write)(sink.context, abi::Bytes::new(&content), error))
        })
    }
}

/// Runs a source and returns the light field of one time step.
///
/// # Errors
/// If the plugin is no source or fails, or its light field is invalid.
pub fn make_field<S: Services>(
    plugin: &Plugin,
    services: &S,
    params_json: &str,
    display: &Display,
    time: Time,
) -> Result<LightField, PluginError> {
    let functions = plugin.of_kind(PluginKind::Source)?;
    let display_json = display_json(display)?;
    let builder = Builder::<Field>::new(Field { made: None });
    let sink = FieldSink {
        size: size_of::<FieldSink>(),
        context: (&raw const builder).cast_mut().cast(),
        geometry: field_geometry,
        view_plane: field_view,
    };
    let (host, time) = (table(services), time.to_abi());
    // SAFETY: all arguments are lent for the call.
    call(|error| unsafe {
        functions.make_field(&host, Str::new(params_json), Str::new(&display_json), &time, &sink, error)
    })?;
    let Field { made } = builder.into_inner();
    let (field, given) = made.ok_or_else(|| PluginError::Failed("the plugin made no light field".into()))?;
    let views = field.geometry().grid.views();
    all_given(&given, |i| format!("view {}, {}", i / views[1], i % views[1]))?;
    Ok(field)
}

/// A node's layer stack, and its reports on the solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    /// The layer stack that the node made.
    pub stack: LayerStack,
    /// Steps of an iterative solver. Each has the time in seconds between the call of the node and
    /// the report of the step.
    pub steps: Vec<(Step, f64)>,
    /// The solver's summary, if the node reported one.
    pub solution: Option<Solution>,
}

/// Runs a node and returns the layer stack of one time step.
///
/// # Errors
/// If the plugin is no node or fails, the weights do not match the light field, the start does not
/// match the display, or the layer stack is invalid.
pub fn make_stack<S: Services>(
    plugin: &Plugin,
    services: &S,
    params_json: &str,
    node: &NodeData<'_>,
) -> Result<Made, PluginError> {
    let functions = plugin.of_kind(PluginKind::Node)?;
    let display = node.display;
    let display_json = display_json(display)?;
    let lent = Lent::for_node(node)?;
    // Make a sink that collects planes in a builder. The builder also records which planes have
    // arrived.
    let stack = LayerStack::filled(display, 0.0);
    let frames = stack.frames();
    let bins = stack.emission.as_ref().map_or([0, 0], |emission| [emission.shape()[1], emission.shape()[2]]);
    let given_layers = vec![false; stack.layers.len() * frames];
    let given_bins = vec![false; frames * bins[0] * bins[1]];
    let (steps, solution, began) = (Vec::new(), None, Instant::now());
    let made = Made { stack, steps, solution };
    let builder = Builder::new(Stack { made, began, frames, bins, given_layers, given_bins });
    let sink = StackSink {
        size: size_of::<StackSink>(),
        context: (&raw const builder).cast_mut().cast(),
        brightness: stack_brightness,
        layer_plane: stack_layer,
        emission_plane: stack_emission,
        step: stack_step,
        solution: stack_solution,
    };
    let (host, time, data) = (table(services), node.time.to_abi(), lent.to_abi());
    // SAFETY: all arguments are lent for the call.
    call(|error| unsafe {
        functions.make_stack(&host, Str::new(params_json), Str::new(&display_json), &time, &data, &sink, error)
    })?;
    // All planes must have arrived, and the stack must match the display.
    let Stack { made, given_layers, given_bins, .. } = builder.into_inner();
    all_given(&given_layers, |i| format!("layer {}, frame {}", i / frames, i % frames))?;
    all_given(&given_bins, |i| {
        format!("emission of frame {}, bin {}, {}", i / (bins[0] * bins[1]), i / bins[1] % bins[0], i % bins[1])
    })?;
    made.stack.check(display).map_err(|error| {
        PluginError::Failed(format!("the plugin made a layer stack that does not fit the display: {error}"))
    })?;
    Ok(made)
}

/// The result that a sink builds; the sink's `context` points to it. Two threads of a plugin must
/// never call a sink at the same time. The lock protects the host from plugins that violate this
/// rule.
struct Builder<T>(Mutex<T>);

/// A light field that is being built, and a flag per view: true if the view was received. `made` is
/// `None` until the geometry was received.
struct Field {
    made: Option<(LightField, Vec<bool>)>,
}

struct Stack {
    made: Made,
    /// Time at which the call began.
    began: Instant,
    frames: usize,
    /// Bins of the emission: [bins_y, bins_x].
    bins: [usize; 2],
    /// True for the layer planes that were received, `[layer][frame]`.
    given_layers: Vec<bool>,
    /// True for the emission planes that were received, `[frame][bin_y][bin_x]`.
    given_bins: Vec<bool>,
}

impl<T> Builder<T> {
    fn new(value: T) -> Self {
        Self(Mutex::new(value))
    }

    fn into_inner(self) -> T {
        self.0.into_inner().unwrap_or_else(PoisonError::into_inner)
    }

    /// # Safety
    /// `context` belongs to a sink whose builder has this type and is alive.
    unsafe fn of<'a>(context: *mut c_void) -> MutexGuard<'a, T> {
        // SAFETY: guaranteed by the caller.
        unsafe { &*context.cast_const().cast::<Self>() }.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

unsafe extern "C" fn field_geometry(context: *mut c_void, geometry_json: Str, error: *const ErrorSink) -> Status {
    let take = || {
        // SAFETY: the plugin passes the sink's context on unchanged, and lends the text.
        let (mut field, text) = unsafe { (Builder::<Field>::of(context), lent_text(geometry_json, "geometry")?) };
        if field.made.is_some() {
            return Err(PluginError::Refused("the geometry was already given".into()));
        }
        let geometry: Geometry = serde_json::from_str(text).map_err(|error| PluginError::failed("geometry", error))?;
        let geometry = FieldGeometry::try_from(geometry)?;
        let shape = LightField::shape_of(&geometry);
        if Tensor::<5>::element_count(shape).is_none_or(|count| count > MAX_VALUES) {
            return Err(PluginError::Refused(format!(
                "expected a light field of at most 2^32 values, found the shape {shape:?}"
            )));
        }
        let views = shape[0] * shape[1];
        let black = LightField::black(geometry).map_err(|error| PluginError::Refused(error.to_string()))?;
        field.made = Some((black, vec![false; views]));
        Ok(())
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, take) }
}

unsafe extern "C" fn field_view(
    context: *mut c_void,
    view_y: usize,
    view_x: usize,
    plane: *const Plane,
    error: *const ErrorSink,
) -> Status {
    let take = || {
        // SAFETY: as above.
        let mut field = unsafe { Builder::<Field>::of(context) };
        let Some((field, given)) = &mut field.made else {
            return Err(PluginError::Refused("expected the geometry before the first view, found a view".into()));
        };
        let what = || format!("view {view_y}, {view_x}");
        let [views_y, views_x, rows, cols, channels] = field.radiance().shape();
        if view_y >= views_y || view_x >= views_x {
            return Err(PluginError::Refused(format!(
                "{}: expected a row of views below {views_y} and a column of views below {views_x}",
                what()
            )));
        }
        // SAFETY: the plugin lends the plane for the call.
        let values = unsafe { values_of(plane, [rows, cols, channels], f32::MAX, &what)? };
        mark(given, view_y * views_x + view_x, &what)?;
        field.view_mut([view_y, view_x]).copy_from_slice(&values);
        Ok(())
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, take) }
}

unsafe extern "C" fn stack_brightness(context: *mut c_void, brightness: f64, error: *const ErrorSink) -> Status {
    let take = || {
        if !(brightness > 0.0 && brightness <= 1.0) {
            return Err(PluginError::Refused(format!(
                "brightness: expected a number above 0 and at most 1, found {brightness}"
            )));
        }
        // SAFETY: as above.
        unsafe { Builder::<Stack>::of(context) }.made.stack.brightness = brightness;
        Ok(())
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, take) }
}

unsafe extern "C" fn stack_layer(
    context: *mut c_void,
    layer: usize,
    frame: usize,
    plane: *const Plane,
    error: *const ErrorSink,
) -> Status {
    let take = || {
        // SAFETY: as above.
        let mut built = unsafe { Builder::<Stack>::of(context) };
        let Stack { made: Made { stack, .. }, frames, given_layers, .. } = &mut *built;
        let what = || format!("layer {layer}, frame {frame}");
        if layer >= stack.layers.len() || frame >= *frames {
            let text = format!(
                "{}: expected a layer index below {} and a frame index below {frames}",
                what(),
                stack.layers.len()
            );
            return Err(PluginError::Refused(text));
        }
        let [_, rows, cols, channels] = stack.layers[layer].shape();
        // SAFETY: the plugin lends the plane for the call.
        let values = unsafe { values_of(plane, [rows, cols, channels], 1.0, &what)? };
        mark(given_layers, layer * *frames + frame, &what)?;
        stack.layers[layer].block_mut([frame]).copy_from_slice(&values);
        Ok(())
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, take) }
}

unsafe extern "C" fn stack_emission(
    context: *mut c_void,
    frame: usize,
    bin_y: usize,
    bin_x: usize,
    plane: *const Plane,
    error: *const ErrorSink,
) -> Status {
    let take = || {
        // SAFETY: as above.
        let mut built = unsafe { Builder::<Stack>::of(context) };
        let Stack { made: Made { stack, .. }, frames, bins, given_bins, .. } = &mut *built;
        let what = || format!("emission of frame {frame}, bin {bin_y}, {bin_x}");
        let Some(emission) = &mut stack.emission else {
            return Err(PluginError::Refused(
                "expected no emission, since the display's backlight is uniform, found an emission".into(),
            ));
        };
        if frame >= *frames || bin_y >= bins[0] || bin_x >= bins[1] {
            return Err(PluginError::Refused(format!(
                "{}: expected a frame index below {frames} and bin indices [y, x] below {bins:?}",
                what()
            )));
        }
        let [_, _, _, rows, cols, channels] = emission.shape();
        // SAFETY: the plugin lends the plane for the call.
        let values = unsafe { values_of(plane, [rows, cols, channels], 1.0, &what)? };
        mark(given_bins, (frame * bins[0] + bin_y) * bins[1] + bin_x, &what)?;
        emission.block_mut([frame, bin_y, bin_x]).copy_from_slice(&values);
        Ok(())
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, take) }
}

unsafe extern "C" fn stack_step(
    context: *mut c_void,
    iteration: u32,
    objective: f64,
    psnr_view: f64,
    error: *const ErrorSink,
) -> Status {
    let take = || {
        // SAFETY: as above.
        let mut built = unsafe { Builder::<Stack>::of(context) };
        let seconds = built.began.elapsed().as_secs_f64();
        if built.made.steps.last().is_some_and(|(last, _)| last.iteration >= iteration) {
            return Err(PluginError::Refused(format!(
                "iteration: expected a number above the number of the last report, found {iteration}"
            )));
        }
        built.made.steps.push((Step { iteration, objective, psnr_view }, seconds));
        Ok(())
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, take) }
}

unsafe extern "C" fn stack_solution(context: *mut c_void, solution_json: Str, error: *const ErrorSink) -> Status {
    let take = || {
        // SAFETY: the plugin passes the sink's context on unchanged, and lends the text.
        let (mut built, text) = unsafe { (Builder::<Stack>::of(context), lent_text(solution_json, "solution")?) };
        let told = serde_json::from_str(text).map_err(|error| PluginError::failed("solution", error))?;
        if built.made.solution.is_some() {
            return Err(PluginError::Refused("the solution was already given".into()));
        }
        built.made.solution = Some(told);
        Ok(())
    };
    // SAFETY: `error` is null or a valid sink.
    unsafe { answer(error, take) }
}

/// Returns the values of a plane that a plugin lends. Fails unless the plane has the given shape
/// and all values are in 0..`most`.
///
/// # Safety
/// `plane` points to a plane whose `size` is set, and whose pointer, shape, strides and type
/// describe readable memory.
unsafe fn values_of(
    plane: *const Plane,
    shape: [usize; 3],
    most: f32,
    what: &dyn Fn() -> String,
) -> Result<Vec<f32>, PluginError> {
    let refused = |text: String| Err(PluginError::Refused(format!("{}: {text}", what())));
    // SAFETY: guaranteed by the caller.
    let size = unsafe { (*plane).size };
    if size < size_of::<Plane>() {
        return refused(format!("the plane's `size`: expected at least {} bytes, found {size}", size_of::<Plane>()));
    }
    // SAFETY: guaranteed by the caller; the plugin keeps ownership, so nothing is released.
    let view = unsafe { PlaneView::new(Plane { release: None, ..*plane })? };
    let found = [view.rows(), view.cols(), view.channels()];
    if found != shape {
        return refused(format!("expected a plane of shape {shape:?}, found {found:?}"));
    }
    let values = view.to_vec();
    match values.iter().find(|value| !(0.0..=most).contains(*value)) {
        Some(value) if most == 1.0 => refused(format!("expected values in 0..1, found {value}")),
        Some(value) => refused(format!("expected finite values of at least 0, found {value}")),
        None => Ok(values),
    }
}

fn mark(given: &mut [bool], index: usize, what: &dyn Fn() -> String) -> Result<(), PluginError> {
    if std::mem::replace(&mut given[index], true) {
        return Err(PluginError::Refused(format!("{} was already given", what())));
    }
    Ok(())
}

fn all_given(given: &[bool], name: impl Fn(usize) -> String) -> Result<(), PluginError> {
    match given.iter().position(|given| !given) {
        Some(index) => Err(PluginError::Failed(format!("the plugin did not give {}", name(index)))),
        None => Ok(()),
    }
}

fn display_json(display: &Display) -> Result<String, PluginError> {
    serde_json::to_string(display).map_err(|error| PluginError::failed("display", error))
}

/// Checks parameters, fills in defaults, and returns the result as JSON for the plugin.
///
/// # Errors
/// [`PluginError::Refused`] for parameters that the plugin's schema refuses.
pub fn resolved(plugin: &Plugin, params: &Value) -> Result<String, PluginError> {
    Ok(Value::Object(plugin.info().schema.resolve(params)?).to_string())
}
