//! Tests importers, sources and nodes through the C interface, and results that the host refuses.

use lumistack_plugin::abi::{self, ErrorSink, Plane, StackSink, Status};
use lumistack_plugin::core::Tensor;
use lumistack_plugin::display::{Backlight, Display, LayerStack, LensletBacklight, LightField, Weights};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{
    Assets, Host, ImporterPlugin, NodeInput, NodePlugin, Param, PluginError, Schema, Solution, SourcePlugin, Step, Time,
};
use lumistack_plugin_testkit::serve::{NodeData, Output, Plugin, import, make_field, make_stack};
use lumistack_plugin_testkit::{MemoryHost, conformance};

#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct GainParams {
    gain: f32,
    fault: String,
}

fn gain_schema() -> Schema {
    Schema::new([
        Param::float("gain", 0.5, 0.0..=1.0, "Factor.").unit("1"),
        Param::text("fault", "", "Fault to commit."),
    ])
}

/// A node that fills all layers and bins with one value: the mean of the target's first view times
/// the gain.
struct Flat;

impl NodePlugin for Flat {
    const DOC: &'static str = "Shows the mean of the light field.";
    type Params = GainParams;

    fn schema() -> Schema {
        gain_schema()
    }

    fn make(params: GainParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let host = input.host();
        host.check_cancelled()?;
        assert!(params.fault != "panic", "no patterns at time {}", input.time().index);
        if params.fault == "file" {
            host.write("a.txt", b"x")?;
        }
        let values = input.field().view([0, 0])?.to_vec();
        let mean = values.iter().sum::<f32>() / values.len() as f32 * params.gain;
        let mut stack = LayerStack::filled(input.display(), mean);
        stack.brightness = f64::from(params.gain).max(0.01);
        match params.fault.as_str() {
            "bright" => stack.layers[0].data_mut()[0] = 1.5,
            "layers" => drop(stack.layers.pop()),
            "steps" => {
                let step = |iteration| Step { iteration, objective: 1.0, psnr_view: f64::NAN };
                input.step(step(1)).and_then(|()| input.step(step(1)))?;
            }
            _ => {}
        }
        Ok(stack)
    }
}

mod flat {
    lumistack_plugin::export_plugin!("flat", super::Flat as node);
}

/// A source whose views are of one grey value each.
struct Card;

impl SourcePlugin for Card {
    const DOC: &'static str = "Makes views of one grey value each.";
    type Params = GainParams;

    fn schema() -> Schema {
        gain_schema()
    }

    fn make(host: &Host, params: GainParams, display: &Display, time: Time) -> Result<LightField, PluginError> {
        host.check_cancelled()?;
        let geometry = display.geometry().map_err(|error| PluginError::Refused(error.to_string()))?;
        let mut field = LightField::black(geometry).map_err(|error| PluginError::Refused(error.to_string()))?;
        let views: Vec<[usize; 2]> = field.geometry().grid.iter().collect();
        for (i, view) in views.into_iter().enumerate() {
            field.view_mut(view).fill(params.gain * i as f32 + time.seconds as f32);
        }
        if params.fault == "nan" {
            field.view_mut([0, 0])[0] = f32::NAN;
        }
        Ok(field)
    }
}

mod card {
    lumistack_plugin::export_plugin!("card", super::Card as source);
}

/// An importer that returns the file's bytes as the scene.
struct Echo;

impl ImporterPlugin for Echo {
    const DOC: &'static str = "Returns the bytes that it reads.";
    const EXTENSIONS: &'static [&'static str] = &["echo", "twice"];
    type Params = GainParams;

    fn schema() -> Schema {
        gain_schema()
    }

    fn import(host: &Host, _params: GainParams, file: &str, assets: &Assets<'_>) -> Result<Vec<u8>, PluginError> {
        host.check_cancelled()?;
        let mut bytes = assets.read(file)?;
        if file.ends_with("twice") {
            bytes.extend(assets.read("sub/beside.bin")?);
        }
        Ok(bytes)
    }
}

mod echo {
    lumistack_plugin::export_plugin!("echo", super::Echo as importer);
}

/// A node that refuses every display without a reason.
struct Silent;

impl NodePlugin for Silent {
    const DOC: &'static str = "Refuses every display.";
    type Params = GainParams;

    fn schema() -> Schema {
        gain_schema()
    }

    fn make(_: GainParams, _: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        Err(PluginError::Refused(String::new()))
    }
}

mod silent {
    lumistack_plugin::export_plugin!("silent", super::Silent as node);
}

fn display() -> Display {
    let mut display = Display::uniform([4, 3], 1.0, [3, 1], [20.0, 10.0], &[-1.0, 1.0], 2);
    display.backlight = Backlight::Lenslets(LensletBacklight::new(-9.0, [2, 2], 2.0, [3, 2], [20.0, 20.0]));
    display
}

fn target() -> LightField {
    let mut field = LightField::black(display().geometry().unwrap()).unwrap();
    field.radiance_mut().data_mut().fill(0.5);
    field
}

fn flat(params: &str) -> Result<LayerStack, PluginError> {
    let plugin = Plugin::compiled_in(&flat::PLUGIN).unwrap();
    make_stack(&plugin, &MemoryHost::new(), params, &NodeData::new(&display(), &target())).map(|made| made.stack)
}

#[test]
fn they_conform() {
    for plugin in [&flat::PLUGIN, &card::PLUGIN, &echo::PLUGIN] {
        conformance(plugin).unwrap();
    }
}

#[test]
fn a_refusal_without_a_reason_breaks_a_rule() {
    assert_eq!(conformance(&silent::PLUGIN).unwrap_err().rule, "accepts a display or refuses it with a reason");
}

#[test]
fn stacks_and_light_fields_arrive_unchanged() {
    let stack = flat(r#"{"gain": 0.25}"#).unwrap();
    assert_eq!(stack.brightness, 0.25);
    let expected = LayerStack { brightness: 0.25, ..LayerStack::filled(&display(), 0.125) };
    assert_eq!(stack, expected);
    let plugin = Plugin::compiled_in(&card::PLUGIN).unwrap();
    let time = Time { index: 3, seconds: 2.0 };
    let field = make_field(&plugin, &MemoryHost::new(), "{}", &display(), time).unwrap();
    assert_eq!(field.geometry(), target().geometry());
    assert_eq!([0, 1, 2].map(|view| field.view([0, view])[5]), [2.0, 2.5, 3.0]);
}

#[test]
fn importers_read_through_the_host() {
    let plugin = Plugin::compiled_in(&echo::PLUGIN).unwrap();
    assert_eq!(plugin.info().extensions, ["echo", "twice"]);
    let read = |path: &str| match path {
        "a.twice" => Ok(b"one ".to_vec()),
        "sub/beside.bin" => Ok(b"two".to_vec()),
        other => Err(PluginError::Failed(format!("{other}: not here"))),
    };
    let import = |file: &str| import(&plugin, &MemoryHost::new(), "{}", file, &read);
    assert_eq!(import("a.twice").unwrap(), b"one two");
    assert_eq!(import("a.echo").unwrap_err(), PluginError::Failed("a.echo: not here".into()));
}

#[test]
fn what_is_wrong_is_said_and_goes_no_further() {
    for (fault, message) in [
        (
            "bright",
            "the plugin made a layer stack that does not fit the display: layer 0: expected values in 0..1, found 1.5",
        ),
        (
            "layers",
            "the plugin made a layer stack that does not fit the display: number of layers: expected 2, found 1",
        ),
        ("panic", "panicked: no patterns at time 0"),
    ] {
        assert_eq!(flat(&format!(r#"{{"fault": "{fault}"}}"#)).unwrap_err().to_string(), message);
    }
    let card = Plugin::compiled_in(&card::PLUGIN).unwrap();
    let error = make_field(&card, &MemoryHost::new(), r#"{"fault": "nan"}"#, &display(), Time::default()).unwrap_err();
    assert_eq!(error.to_string(), "view 0, 0: expected finite values of at least 0, found NaN");
}

#[test]
fn plugins_are_not_taken_for_other_kinds() {
    let (card, host) = (Plugin::compiled_in(&card::PLUGIN).unwrap(), MemoryHost::new());
    let display = display();
    let error = Output::open(&card, &host, &lumistack_plugin::serde_json::json!({}), &display).err().unwrap();
    assert_eq!(error.to_string(), "plugin `card`: expected an output, found a source");
    let error = make_stack(&card, &host, "{}", &NodeData::new(&display, &target())).unwrap_err();
    assert_eq!(error.to_string(), "plugin `card`: expected a node, found a source");
}

/// A node written against the C interface. Its parameters list the planes that it sends: `{"steps":
/// [[layer, frame, rows, value], ...]}`.
mod raw {
    use super::*;
    use lumistack_plugin::serde_json::{Value, from_slice};

    pub unsafe extern "C" fn make(
        _host: *const abi::HostServices,
        params: abi::Str,
        _display: abi::Str,
        _time: *const abi::Time,
        _data: *const abi::Data,
        stack: *const StackSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: the host lends all arguments for the call.
        let (params, sink) = unsafe { (std::slice::from_raw_parts(params.ptr, params.len), &*stack) };
        let params: Value = from_slice(params).unwrap();
        for step in params["steps"].as_array().unwrap() {
            let number = |i: usize| step[i].as_f64().unwrap();
            let (rows, values) = (number(2) as usize, vec![number(3) as f32; 4 * 3 * number(2) as usize]);
            let plane = Plane {
                data: values.as_ptr().cast(),
                ndim: 3,
                shape: [rows, 4, 3, 1],
                strides: [48, 12, 4, 0],
                ..Plane::empty()
            };
            let (layer, frame) = (number(0) as usize, number(1) as usize);
            // SAFETY: the context belongs to the sink; the plane describes `values`.
            let status = unsafe { (sink.layer_plane)(sink.context, layer, frame, &plane, error) };
            if status != Status::OK {
                return status;
            }
        }
        Status::OK
    }
}

#[test]
fn pieces_that_do_not_fit_are_refused_where_they_are_given() {
    let vtable: &'static abi::NodeVtable =
        Box::leak(Box::new(abi::NodeVtable { size: size_of::<abi::NodeVtable>(), make: Some(raw::make) }));
    let descriptor = abi::Descriptor {
        schema_json: abi::Str::new(r#"{"params": []}"#),
        vtable: (&raw const *vtable).cast(),
        ..*Plugin::compiled_in(&flat::PLUGIN).map(|_| flat::PLUGIN.descriptor()).unwrap()
    };
    // SAFETY: the descriptor is a copy of a valid descriptor with another table of the same kind.
    let plugin = unsafe { Plugin::from_descriptor(&descriptor) }.unwrap();
    let display = Display::uniform([4, 3], 1.0, [3, 1], [20.0, 10.0], &[0.0], 2);
    let field = LightField::black(display.geometry().unwrap()).unwrap();
    let made = |steps: &str| {
        let params = format!(r#"{{"steps": {steps}}}"#);
        make_stack(&plugin, &MemoryHost::new(), &params, &NodeData::new(&display, &field)).map(|made| made.stack)
    };
    for (steps, message) in [
        ("[]", "the plugin did not give layer 0, frame 0"),
        ("[[0, 0, 3, 0.5]]", "the plugin did not give layer 0, frame 1"),
        ("[[0, 0, 3, 0.5], [0, 0, 3, 0.5]]", "layer 0, frame 0 was already given"),
        ("[[1, 0, 3, 0.5]]", "layer 1, frame 0: expected a layer index below 1 and a frame index below 2"),
        ("[[0, 2, 3, 0.5]]", "layer 0, frame 2: expected a layer index below 1 and a frame index below 2"),
        ("[[0, 0, 2, 0.5]]", "layer 0, frame 0: expected a plane of shape [3, 4, 3], found [2, 4, 3]"),
        ("[[0, 0, 3, -0.5]]", "layer 0, frame 0: expected values in 0..1, found -0.5"),
    ] {
        assert_eq!(made(steps).unwrap_err().to_string(), message);
    }
    let stack = made("[[0, 1, 3, 1], [0, 0, 3, 0.25]]").unwrap();
    assert_eq!([0, 1].map(|frame| stack.layers[0].block([frame])[7]), [0.25, 1.0]);
}

/// A node that returns its start, with the values of the layers times one weight of the last view.
/// It also reports two steps and a solution.
struct Warm;

impl NodePlugin for Warm {
    const DOC: &'static str = "Returns the layer stack that it may start from.";
    type Params = GainParams;

    fn schema() -> Schema {
        gain_schema()
    }

    fn make(_: GainParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let grid = &input.field().geometry().grid;
        let mean = match input.weights()? {
            Weights::Uniform => 1.0,
            Weights::PerView(weights) => weights.block([0, grid.slope_x.len() - 1])[0],
            Weights::PerRay(weights) => weights.block([0, grid.slope_x.len() - 1, 1])[2],
        };
        let mut stack = input.start()?.unwrap_or_else(|| LayerStack::filled(input.display(), 0.125));
        for value in stack.layers.iter_mut().flat_map(|layer| layer.data_mut()) {
            *value *= mean;
        }
        input.step(Step { iteration: 0, objective: 3.0, psnr_view: 20.5 })?;
        input.step(Step { iteration: 4, objective: 0.1 + 0.2, psnr_view: f64::INFINITY })?;
        input.solution(&Solution {
            solver: format!("seed {}", input.seed()),
            start: "warm".into(),
            coarse_levels: 2,
            kkt_residual: 1e-300,
            levels: Some([1.0, 2.0, 3.0]),
        })?;
        Ok(stack)
    }
}

mod warm {
    lumistack_plugin::export_plugin!("warm", super::Warm as node);
}

#[test]
fn weights_seed_and_patterns_reach_a_node_and_what_it_tells_comes_back() {
    let plugin = Plugin::compiled_in(&warm::PLUGIN).unwrap();
    let (display, field) = (display(), target());
    let made = |node: &NodeData<'_>| make_stack(&plugin, &MemoryHost::new(), "{}", node).unwrap();
    let plain = made(&NodeData::new(&display, &field));
    assert_eq!((plain.stack.layers[0].data()[0], plain.stack.brightness), (0.125, display.brightness));
    let solution = plain.solution.unwrap();
    assert_eq!((solution.solver.as_str(), solution.kkt_residual, solution.coarse_levels), ("seed 1", 1e-300, 2));
    let steps: Vec<Step> = plain.steps.iter().map(|(step, _)| *step).collect();
    let last = Step { iteration: 4, objective: 0.1 + 0.2, psnr_view: f64::INFINITY };
    assert_eq!(steps, [Step { iteration: 0, objective: 3.0, psnr_view: 20.5 }, last]);
    assert!(plain.steps[0].1 >= 0.0 && plain.steps[1].1 >= plain.steps[0].1);

    let mut start = LayerStack::filled(&display, 0.0);
    start.brightness = 0.3;
    let mut counted = 0.0;
    let count = |values: &mut [f32], counted: &mut f32| {
        values.iter_mut().for_each(|value| {
            *counted += 1.0 / 4096.0;
            *value = *counted;
        });
    };
    start.layers.iter_mut().for_each(|layer| count(layer.data_mut(), &mut counted));
    count(start.emission.as_mut().unwrap().data_mut(), &mut counted);
    let seven = NodeData { start: Some(&start), seed: u64::MAX, ..NodeData::new(&display, &field) };
    let same = made(&seven);
    assert_eq!((&same.stack, same.solution.unwrap().solver), (&start, format!("seed {}", u64::MAX)));

    let third = 1.0f32 / 3.0;
    let per_view = Weights::PerView(Tensor::from_vec(["view_y", "view_x"], [1, 3], vec![0.0, 1.0, third]).unwrap());
    let mut per_ray = Tensor::filled(["view_y", "view_x", "row", "col"], [1, 3, 3, 4], 0.5);
    *per_ray.at_mut([0, 2, 1, 2]) = third;
    for weights in [per_view, Weights::PerRay(per_ray)] {
        let scaled = made(&NodeData { weights: &weights, ..seven });
        assert_eq!(scaled.stack.layers[0].data()[5], start.layers[0].data()[5] * third);
    }
    let wrong = Weights::PerView(Tensor::filled(["view_y", "view_x"], [2, 2], 1.0));
    let error = make_stack(&plugin, &MemoryHost::new(), "{}", &NodeData { weights: &wrong, ..seven }).unwrap_err();
    assert!(matches!(error, PluginError::Refused(_)), "{error:?}");
    let error = flat(r#"{"fault": "steps"}"#).unwrap_err();
    assert_eq!(error.to_string(), "iteration: expected a number above the number of the last report, found 1");
}
