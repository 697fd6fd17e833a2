//! The traits of importers, sources and nodes. Each trait has one function that does the work. The
//! function's result is sent to the host piece by piece.

use lumistack_display::{Display, LayerStack, LightField};
use lumistack_plugin_abi::{
    self as abi, ByteSink, Bytes, Data, ErrorSink, FieldSink, HostServices, ImporterVtable, NodeVtable, SourceVtable,
    StackSink, Status, Str,
};
use serde::de::DeserializeOwned;

use crate::given::params_of;
use crate::host::CloseHost;
use crate::input::{Input, bins};
use crate::node::NodeInput;
use crate::time::Time;
use crate::wire::{Geometry, answer, append, call, dense, display_from_json, lent_text, needs};
use crate::{Host, PluginError, Schema};

/// A plugin that converts files of a format into scenes.
pub trait ImporterPlugin: 'static {
    /// Description for users; listings show its first sentence.
    const DOC: &'static str;
    /// Extensions of the files that the plugin reads: lower case, without the dot.
    const EXTENSIONS: &'static [&'static str];

    /// A struct with one field per parameter of the schema; a field has its parameter's name.
    type Params: DeserializeOwned;

    /// Describes the plugin's parameters. They are checked before `import`, which receives a value
    /// of the right type and in range for each parameter.
    fn schema() -> Schema;

    /// Reads the file `file`, and others in its folder, through `assets`. Returns a glTF 2.0
    /// document, `.glb` or `.gltf`. The host validates the document. If the document names further
    /// files, the host reads them from the imported file's folder.
    ///
    /// # Errors
    /// If the file is invalid; the message names the position in the file.
    fn import(host: &Host, params: Self::Params, file: &str, assets: &Assets<'_>) -> Result<Vec<u8>, PluginError>;
}

/// A plugin that makes light fields.
pub trait SourcePlugin: 'static {
    /// Description for users; listings show its first sentence.
    const DOC: &'static str;

    /// A struct with one field per parameter of the schema; a field has its parameter's name.
    type Params: DeserializeOwned;

    /// Describes the plugin's parameters. They are checked before `make`, which receives a value of
    /// the right type and in range for each parameter.
    fn schema() -> Schema;

    /// Makes the light field of one time step: linear radiance, finite and at least 0. Its geometry
    /// should be the display's ([`Display::geometry`]), but the host accepts another geometry too.
    ///
    /// # Errors
    /// If the light field cannot be made; [`PluginError::Cancelled`] if the user cancelled.
    fn make(host: &Host, params: Self::Params, display: &Display, time: Time) -> Result<LightField, PluginError>;
}

/// A plugin that makes the layer stacks of a display from light fields.
pub trait NodePlugin: 'static {
    /// Description for users; listings show its first sentence.
    const DOC: &'static str;

    /// A struct with one field per parameter of the schema; a field has its parameter's name.
    type Params: DeserializeOwned;

    /// Describes the plugin's parameters. They are checked before `make`, which receives a value of
    /// the right type and in range for each parameter.
    fn schema() -> Schema;

    /// Solves the layer stack of one time step. The stack must match the display, with values in
    /// 0..1. Its `brightness` is β: the display emits β times the target. Weights and the start are
    /// optional input; a node may ignore them.
    ///
    /// # Errors
    /// [`PluginError::Refused`] if the plugin does not support the display;
    /// [`PluginError::Cancelled`] if the user cancelled.
    fn make(params: Self::Params, input: &NodeInput<'_>) -> Result<LayerStack, PluginError>;
}

/// Files that an importer may read: the imported file and others in its folder.
#[derive(Debug)]
pub struct Assets<'a>(&'a abi::Assets);

impl Assets<'_> {
    /// Reads a whole file; `path` is relative to the folder of the imported file, with `/` between
    /// names.
    ///
    /// # Errors
    /// If there is no such file, or the host does not allow it.
    pub fn read(&self, path: &str) -> Result<Vec<u8>, PluginError> {
        let mut bytes = Vec::new();
        let sink = ByteSink { size: size_of::<ByteSink>(), context: (&raw mut bytes).cast(), write: append };
        // SAFETY: the context belongs to the table; the text and the sink are lent for the call.
        call(|error| unsafe { (self.0.read)(self.0.context, Str::new(path), &sink, error) })?;
        Ok(bytes)
    }
}

/// Returns the C functions of an importer.
pub(crate) fn importer_vtable<P: ImporterPlugin>() -> ImporterVtable {
    let extensions: &'static str = P::EXTENSIONS.join(" ").leak();
    ImporterVtable { size: size_of::<ImporterVtable>(), extensions: Str::new(extensions), import: Some(import::<P>) }
}

/// Returns the C functions of a source.
pub(crate) fn source_vtable<P: SourcePlugin>() -> SourceVtable {
    SourceVtable { size: size_of::<SourceVtable>(), make: Some(make_field::<P>) }
}

/// Returns the C functions of a node.
pub(crate) fn node_vtable<P: NodePlugin>() -> NodeVtable {
    NodeVtable { size: size_of::<NodeVtable>(), make: Some(make_stack::<P>) }
}

unsafe extern "C" fn import<P: ImporterPlugin>(
    host: *const HostServices,
    params_json: Str,
    file: Str,
    assets: *const abi::Assets,
    scene: *const ByteSink,
    error: *const ErrorSink,
) -> Status {
    let work = || {
        // SAFETY: the host lends all arguments until this call returns.
        let (params, host) = unsafe { (params_of(P::schema(), params_json)?, CloseHost::checked(host)?) };
        // SAFETY: as above.
        let (file, assets, scene) = unsafe { (lent_text(file, "file name")?, &*assets, &*scene) };
        needs(scene.size, size_of::<ByteSink>())?;
        needs(assets.size, size_of::<abi::Assets>())?;
        let bytes = P::import(&host.get(), params, file, &Assets(assets))?;
        // SAFETY: the context belongs to the sink; the bytes are lent for the call.
        call(|error| unsafe { (scene.write)(scene.context, Bytes::new(&bytes), error) })
    };
    // SAFETY: the host passes null or a valid sink.
    unsafe { answer(error, work) }
}

unsafe extern "C" fn make_field<P: SourcePlugin>(
    host: *const HostServices,
    params_json: Str,
    display_json: Str,
    time: *const abi::Time,
    field: *const FieldSink,
    error: *const ErrorSink,
) -> Status {
    let work = || {
        // SAFETY: the host lends all arguments until this call returns.
        let (params, host) = unsafe { (params_of(P::schema(), params_json)?, CloseHost::checked(host)?) };
        // SAFETY: as above.
        let (display, time, sink) =
            unsafe { (display_from_json(lent_text(display_json, "display")?)?, Time::from_abi(time)?, &*field) };
        needs(sink.size, size_of::<FieldSink>())?;
        // Make the light field, then send its geometry and each of its views.
        let made = P::make(&host.get(), params, &display, time)?;
        let geometry = serde_json::to_string(&Geometry::from(made.geometry()))
            .map_err(|error| PluginError::failed("geometry", error))?;
        // SAFETY: the context belongs to the sink; the text is lent for the call.
        call(|error| unsafe { (sink.geometry)(sink.context, Str::new(&geometry), error) })?;
        let [_, _, rows, cols, channels] = made.radiance().shape();
        for [y, x] in made.geometry().grid.iter() {
            let plane = dense(made.view([y, x]), [rows, cols, channels]);
            // SAFETY: the context belongs to the sink; the plane is lent for the call.
            call(|error| unsafe { (sink.view_plane)(sink.context, y, x, &plane, error) })?;
        }
        Ok(())
    };
    // SAFETY: the host passes null or a valid sink.
    unsafe { answer(error, work) }
}

unsafe extern "C" fn make_stack<P: NodePlugin>(
    host: *const HostServices,
    params_json: Str,
    display_json: Str,
    time: *const abi::Time,
    data: *const Data,
    stack: *const StackSink,
    error: *const ErrorSink,
) -> Status {
    let work = || {
        // SAFETY: the host lends all arguments until this call returns.
        let (params, host) = unsafe { (params_of(P::schema(), params_json)?, CloseHost::checked(host)?) };
        // SAFETY: as above.
        let (display, time, sink) =
            unsafe { (display_from_json(lent_text(display_json, "display")?)?, Time::from_abi(time)?, &*stack) };
        needs(sink.size, size_of::<StackSink>())?;
        // SAFETY: as above.
        let input = unsafe {
            needs((*data).size, size_of::<Data>())?;
            Input::new(data, host.get())?
        };
        let field = match input {
            Input::LightField(field) => field,
            other => return Err(PluginError::unexpected(&other)),
        };
        let input = NodeInput { host: host.get(), display, time, field, sink };
        // Run the node and check its stack before anything is sent.
        let made = P::make(params, &input)?;
        made.check(&input.display).map_err(|error| {
            PluginError::Failed(format!("the plugin made a layer stack that does not fit the display: {error}"))
        })?;
        // Send brightness, layers and emission, plane by plane.
        // SAFETY: the context belongs to the sink; planes are lent for the call.
        call(|error| unsafe { (sink.brightness)(sink.context, made.brightness, error) })?;
        for (n, layer) in made.layers.iter().enumerate() {
            let [frames, rows, cols, channels] = layer.shape();
            for frame in 0..frames {
                let plane = dense(layer.block([frame]), [rows, cols, channels]);
                // SAFETY: as above.
                call(|error| unsafe { (sink.layer_plane)(sink.context, n, frame, &plane, error) })?;
            }
        }
        if let Some(emission) = &made.emission {
            let [frames, bins_y, bins_x, rows, cols, channels] = emission.shape();
            for (frame, y, x) in bins(frames, [bins_y, bins_x]) {
                let plane = dense(emission.block([frame, y, x]), [rows, cols, channels]);
                // SAFETY: as above.
                call(|error| unsafe { (sink.emission_plane)(sink.context, frame, y, x, &plane, error) })?;
            }
        }
        Ok(())
    };
    // SAFETY: the host passes null or a valid sink.
    unsafe { answer(error, work) }
}
