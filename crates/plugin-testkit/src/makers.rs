//! Checks of the rules for importers, sources and nodes.

use std::collections::BTreeMap;

use lumistack_core::Tensor;
use lumistack_core::seed::{Stream, derive};
use lumistack_display::{Display, Layer, LayerStack, LensletBacklight, LightField, Weights};
use lumistack_plugin::{Export, PluginError, Time};
use lumistack_plugin_host::serve::{
    Made as MadeStack, NodeData, Plugin, PluginKind, import, make_field, make_stack, resolved,
};
use serde_json::{Value, json};

use crate::memory_host::MemoryHost;
use crate::rules::{Broken, bad_parameters_are_refused, closed, defaults_and_ends, in_words, is_reason, require, rule};

type Made<T> = Result<T, PluginError>;

/// Returns displays of several kinds. A node or source must accept at least one of them.
fn displays() -> Vec<Display> {
    let of = |layers: &[f64], frames: usize| Display::uniform([8, 6], 1.0, [3, 2], [20.0, 14.0], layers, frames);
    let mut directional = of(&[0.0], 1);
    let lenslets = LensletBacklight::new(-6.0, [4, 3], 2.0, [3, 2], [20.0, 14.0]);
    directional.backlight = lumistack_display::Backlight::Lenslets(lenslets);
    // pixels of layers may differ from the pixels of the light field
    let mut coarse_front = of(&[-3.0, 3.0], 2);
    coarse_front.layers[1] = Layer::new(3.0, [5, 4], 1.6);
    vec![of(&[-3.0, 3.0], 4), of(&[0.0], 2), of(&[-4.0, 0.0, 4.0], 3), directional, coarse_front]
}

/// Returns a light field of random values in a display's geometry. Every call with the same display
/// returns the same values.
///
/// # Errors
/// If the display's geometry is invalid.
pub fn random_field(display: &Display) -> Made<LightField> {
    let geometry = display.geometry().map_err(|error| PluginError::Failed(error.to_string()))?;
    let mut field = LightField::black(geometry).map_err(|error| PluginError::Failed(error.to_string()))?;
    let mut stream = Stream::new(derive(5, &[]));
    field.radiance_mut().data_mut().fill_with(|| stream.next_f32());
    Ok(field)
}

/// Returns the layer stack that a compiled-in node makes for a light field. `params` is the node's
/// parameters as JSON.
///
/// # Errors
/// The node's error.
pub fn made_by(node: &'static Export, params: &str, display: &Display, field: &LightField) -> Made<LayerStack> {
    let made = make_stack(&Plugin::compiled_in(node)?, &MemoryHost::new(), params, &NodeData::new(display, field))?;
    Ok(made.stack)
}

/// A node's layer stack, and its reports as text. The times of the reports are left out, since they
/// differ from run to run.
type Reported = (LayerStack, String);

fn reported(made: MadeStack) -> Reported {
    let steps: Vec<_> = made.steps.into_iter().map(|(step, _)| step).collect();
    (made.stack, format!("{steps:?} {:?}", made.solution))
}

fn stack_of(plugin: &Plugin, host: &MemoryHost, params: &str, display: &Display) -> Made<Reported> {
    make_stack(plugin, host, params, &NodeData::new(display, &random_field(display)?)).map(reported)
}

/// Makes a stack as [`stack_of`] does, but gives the node all optional input: weights per ray, a
/// start and a seed.
fn stack_from_all(plugin: &Plugin, host: &MemoryHost, params: &str, display: &Display) -> Made<Reported> {
    let field = random_field(display)?;
    let [views_y, views_x, rows, cols, _] = field.radiance().shape();
    let mut stream = Stream::new(derive(6, &[]));
    let mut weights = Tensor::zeros(["view_y", "view_x", "row", "col"], [views_y, views_x, rows, cols]);
    weights.data_mut().fill_with(|| stream.next_f32());
    let mut start = LayerStack::filled(display, 0.0);
    let layers = start.layers.iter_mut().map(Tensor::data_mut);
    layers.for_each(|layer| layer.fill_with(|| 0.25 + 0.5 * stream.next_f32()));
    if let Some(emission) = &mut start.emission {
        emission.data_mut().fill_with(|| 0.25 + 0.5 * stream.next_f32());
    }
    let weights = Weights::PerRay(weights);
    let node = NodeData { weights: &weights, start: Some(&start), seed: 7, ..NodeData::new(display, &field) };
    make_stack(plugin, host, params, &node).map(reported)
}

fn field_of(plugin: &Plugin, host: &MemoryHost, params: &str, display: &Display) -> Made<LightField> {
    make_field(plugin, host, params, display, Time::default())
}

pub(crate) fn node_conformance(plugin: &Plugin, at_default: &[&str]) -> Result<(), Broken> {
    maker_conformance(plugin, at_default, stack_of)?;
    maker_conformance(plugin, at_default, stack_from_all)
}

pub(crate) fn source_conformance(plugin: &Plugin, at_default: &[&str]) -> Result<(), Broken> {
    maker_conformance(plugin, at_default, field_of)
}

fn maker_conformance<T: PartialEq>(
    plugin: &Plugin,
    at_default: &[&str],
    make: impl Fn(&Plugin, &MemoryHost, &str, &Display) -> Made<T>,
) -> Result<(), Broken> {
    let defaults = rule("has default parameters", resolved(plugin, &json!({})))?;
    let mut served = Vec::new();
    // The plugin may refuse a display with a reason, but must support at least one display.
    for display in displays() {
        let host = MemoryHost::new();
        match make(plugin, &host, &defaults, &display) {
            Ok(made) => served.push((display, made)),
            Err(PluginError::Refused(reason)) if is_reason(&reason) => {}
            Err(error) => {
                let found =
                    format!("with a display of {} layers, {}", display.layers.len(), in_words::<()>(&Err(error)));
                return Err(Broken { rule: "accepts a display or refuses it with a reason", found });
            }
        }
        closed(&host, "with default parameters")?;
        let written = host.files();
        require("writes no files", written.is_empty(), || {
            format!("the files {}", written.keys().cloned().collect::<Vec<_>>().join(", "))
        })?;
    }
    require("accepts at least one display", !served.is_empty(), || "the plugin refuses every display".into())?;
    // Check reproducibility, cancellation and all parameter ranges on every supported display.
    for (display, made) in &served {
        let again = rule("works twice", make(plugin, &MemoryHost::new(), &defaults, display))?;
        require("results are reproducible", again == *made, || {
            format!("different results for a display of {} layers", display.layers.len())
        })?;
        let host = MemoryHost::new();
        host.cancel();
        let result = make(plugin, &host, &defaults, display);
        let stopped = matches!(&result, Err(PluginError::Cancelled));
        require("returns `cancelled` if cancelled before it begins", stopped, || in_words(&result))?;
        closed(&host, "after a cancellation before the begin")?;
        for params in defaults_and_ends(plugin, at_default) {
            let result = resolved(plugin, &params).and_then(|p| make(plugin, &MemoryHost::new(), &p, display));
            let fine = match &result {
                Ok(_) => true,
                Err(PluginError::Refused(reason)) => is_reason(reason),
                Err(_) => false,
            };
            require("works with every parameter in its range", fine, || {
                format!("with {params}, {}", in_words(&result))
            })?;
        }
    }
    let display = &served[0].0;
    bad_parameters_are_refused(plugin, |params| make(plugin, &MemoryHost::new(), params, display).err())
}

/// Returns the contents of files that have no known format.
fn garbage() -> [Vec<u8>; 4] {
    let mut stream = Stream::new(9);
    let noise = (0..4096).map(|_| (stream.next_f32() * 256.0) as u8).collect();
    [Vec::new(), vec![0; 100], b"no such format\n\xff\xfe\n1 2 3".to_vec(), noise]
}

pub(crate) fn importer_conformance(plugin: &Plugin) -> Result<(), Broken> {
    let defaults = rule("has default parameters", resolved(plugin, &json!({})))?;
    let file = format!("a.{}", plugin.info().extensions[0]);
    for bytes in garbage() {
        let host = MemoryHost::new();
        let result = import(plugin, &host, &defaults, &file, &|_| Ok(bytes.clone()));
        let contained = !matches!(result, Err(PluginError::Panicked(_)));
        require("does not panic on files of another kind", contained, || in_words(&result))?;
        closed(&host, "after a file of another kind")?;
    }
    let missing = |_: &str| Err(PluginError::Failed("no such file".into()));
    let result = import(plugin, &MemoryHost::new(), &defaults, &file, &missing);
    let reported = matches!(&result, Err(PluginError::Failed(text)) if text.contains("no such file"));
    require("reports why a file cannot be read", reported, || in_words(&result))?;
    bad_parameters_are_refused(plugin, |params| {
        import(plugin, &MemoryHost::new(), params, &file, &|_| Ok(Vec::new())).err()
    })
}

/// Checks an importer on a real file: `files` contains `file` and the files that it refers to. The
/// importer must produce an identical glTF document in a second run, stop on cancellation, and not
/// panic if `file` is truncated.
///
/// # Errors
/// The first violated rule.
pub fn import_conformance(plugin: &Plugin, file: &str, files: &[(&str, &[u8])]) -> Result<(), Broken> {
    let files: BTreeMap<&str, &[u8]> = files.iter().copied().collect();
    let read = |path: &str| {
        files.get(path).map(|bytes| bytes.to_vec()).ok_or_else(|| PluginError::Failed(format!("{path}: no such file")))
    };
    // The importer must make the same document twice: with the defaults, and with every parameter
    // at each end of its range.
    for params in defaults_and_ends(plugin, &[]) {
        let params = rule("works with every parameter in its range", resolved(plugin, &params))?;
        let made = rule("reads the sample", import(plugin, &MemoryHost::new(), &params, file, &read))?;
        let gltf = made.starts_with(b"glTF\x02\0\0\0") || serde_json::from_slice::<Value>(&made).is_ok();
        require("makes a glTF document", gltf, || format!("{} bytes of another kind", made.len()))?;
        let again = rule("works twice", import(plugin, &MemoryHost::new(), &params, file, &read))?;
        require("results are reproducible", again == made, || format!("different results with {params}"))?;
    }
    let defaults = rule("has default parameters", resolved(plugin, &json!({})))?;
    let host = MemoryHost::new();
    host.cancel();
    let result = import(plugin, &host, &defaults, file, &read);
    require("returns `cancelled` if cancelled before it begins", result == Err(PluginError::Cancelled), || {
        in_words(&result)
    })?;
    // Truncated files must not cause a panic.
    let whole = rule("reads the sample", read(file))?;
    for length in (0..whole.len()).step_by((whole.len() / 64).max(1)) {
        let short = |path: &str| if path == file { Ok(whole[..length].to_vec()) } else { read(path) };
        let result = import(plugin, &MemoryHost::new(), &defaults, file, &short);
        let contained = !matches!(result, Err(PluginError::Panicked(_)));
        require("does not panic on files that are cut short", contained, || {
            format!("with {length} of {} bytes, {}", whole.len(), in_words(&result))
        })?;
    }
    Ok(())
}

/// Compares the results of two builds of a plugin for these parameters. Returns the number of
/// compared results.
pub(crate) fn same(plugin: &Plugin, other: &Plugin, params: &Value) -> Result<usize, Broken> {
    let params = rule("takes its own parameters", resolved(plugin, params))?;
    let mut count = 0;
    for display in displays() {
        let equal = match plugin.info().kind {
            PluginKind::Node => [stack_of, stack_from_all].into_iter().all(|make| {
                let [a, b] = [plugin, other].map(|p| make(p, &MemoryHost::new(), &params, &display));
                count += usize::from(a.is_ok());
                a == b
            }),
            PluginKind::Source => {
                let [a, b] = [plugin, other].map(|p| field_of(p, &MemoryHost::new(), &params, &display));
                count += usize::from(a.is_ok());
                a == b
            }
            PluginKind::Importer | PluginKind::Output => true,
        };
        require("results are equal", equal, || {
            format!("different results with {params} for a display of {} layers", display.layers.len())
        })?;
    }
    if plugin.info().kind == PluginKind::Importer {
        let file = format!("a.{}", plugin.info().extensions[0]);
        for bytes in garbage() {
            let of = |plugin| import(plugin, &MemoryHost::new(), &params, &file, &|_| Ok(bytes.clone()));
            require("results are equal", of(plugin) == of(other), || {
                format!("different results with {params} for a file of {} bytes", bytes.len())
            })?;
            count += 1;
        }
    }
    Ok(count)
}
