//! Tests calls across the C interface, with a plugin and a host in one program. Also tests that the
//! kit detects plugins that violate the rules of the interface.

use std::sync::{LazyLock, Mutex};

use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{
    Display, Export, Host, Input, OutputPlugin, Param, PluginError, Port, Schema, Time, ViewPoint, abi, export_plugin,
};
use lumistack_plugin_testkit::serve::{Output, OutputData, Plugin};
use lumistack_plugin_testkit::{Broken, MemoryHost, Sample, conformance, samples};
use serde_json::{Value, json};

/// An output that writes its input as text, but only the first frame of the backlight. Its
/// parameter `fault` selects a violation of the rules.
struct Probe {
    host: Host,
    fault: String,
    scale: f64,
    kept: Mutex<Vec<u64>>,
}

#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct ProbeParams {
    fault: String,
    scale: f64,
}

/// The host of an output, kept after the output was closed.
static STOLEN: Mutex<Option<Host>> = Mutex::new(None);

impl OutputPlugin for Probe {
    const DOC: &'static str = "Writes all its input as text.";
    const PORTS: &'static [Port] = &[Port::LayerStack, Port::LightField];
    type Params = ProbeParams;

    fn schema() -> Schema {
        Schema::new([
            Param::text("fault", "", "Fault to commit."),
            Param::float("scale", 1.0, 0.0..=2.0, "Factor.").unit("1"),
        ])
    }

    fn open(host: Host, params: ProbeParams, display: Display) -> Result<Self, PluginError> {
        assert!(params.fault != "panic in open", "panic in open of {}", display.name);
        if params.fault == "steal host" {
            *STOLEN.lock().unwrap() = Some(host.clone());
        }
        Ok(Self { host, fault: params.fault, scale: params.scale, kept: Mutex::default() })
    }

    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        self.host.check_cancelled()?;
        match self.fault.as_str() {
            "panic in submit" => panic!("panic at {}", time.index),
            "outside" => return self.host.write("../outside.txt", b"x"),
            "twice" => self.host.write("twice.txt", b"1").and_then(|()| self.host.write("twice.txt", b"2"))?,
            _ => {}
        }
        self.kept.lock().unwrap().push(time.index);
        let mut file = self.host.create(&format!("t{}/values.txt", time.index))?;
        for (label, mut values) in planes(data)? {
            values.iter_mut().for_each(|value| *value *= self.scale as f32);
            file.append(format!("{label}: {values:?}\n").as_bytes())?;
        }
        file.commit()
    }

    fn finish(self) -> Result<(), PluginError> {
        assert!(self.fault != "panic in finish", "panic in finish");
        self.host.check_cancelled()?;
        let mut times = self.kept.lock().unwrap().clone();
        times.sort_unstable();
        self.host.write("times.txt", format!("{times:?}").as_bytes())
    }
}

impl Drop for Probe {
    fn drop(&mut self) {
        assert!(self.fault != "panic in drop", "panic in drop");
    }
}

export_plugin!("probe", Probe);

/// Returns all planes of an input with their names, in order.
fn planes(data: &Input<'_>) -> Result<Vec<(String, Vec<f32>)>, PluginError> {
    let mut all = Vec::new();
    match data {
        Input::LayerStack(stack) => {
            for (layer, frame) in (0..stack.layer_count()).flat_map(|l| (0..stack.frames()).map(move |f| (l, f))) {
                let plane = stack.layer(layer, frame)?;
                assert_eq!([plane.rows(), plane.cols()], stack.layer_size(layer).unwrap());
                all.push((format!("layer {layer} {frame}"), plane.to_vec()));
            }
            let [bins_y, bins_x, ..] = stack.emission_shape().unwrap_or_default();
            for (y, x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
                all.push((format!("bin {y} {x}"), stack.emission(0, y, x)?.to_vec()));
            }
            let view = stack.simulate(ViewPoint::Slope([0.05, -0.02]))?;
            all.push(("simulated".into(), view.to_vec()));
            let error = stack.layer(stack.layer_count(), 0).unwrap_err();
            assert_eq!(
                error,
                PluginError::Refused(format!("layer: expected an index below {0}, found {0}", stack.layer_count()))
            );
            assert!(stack.layer(0, stack.frames()).is_err() && stack.simulate(ViewPoint::Eye([0.0; 3])).is_err());
        }
        Input::LightField(field) => {
            for view in field.geometry().grid.iter() {
                all.push((format!("view {view:?}"), field.view(view)?.to_vec()));
            }
            assert!(field.view([99, 0]).is_err());
        }
        other => return Err(PluginError::unexpected(other)),
    }
    Ok(all)
}

fn write(fault: &str, host: &MemoryHost, sample: &Sample) -> Result<(), PluginError> {
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    let output = Output::open(&plugin, host, &json!({"fault": fault}), &sample.display)?;
    output.submit(Time::default(), sample.data())?;
    output.finish()
}

#[test]
fn the_probe_conforms() {
    conformance(&PLUGIN).unwrap();
}

#[test]
fn planes_arrive_unchanged_and_in_their_places() {
    for sample in samples() {
        let host = MemoryHost::new();
        write("", &host, &sample).unwrap();
        let text = String::from_utf8(host.files().remove("t0/values.txt").unwrap()).unwrap();
        let mut expected = Vec::new();
        if let Some(stack) = sample.stack() {
            for (l, layer) in stack.layers.iter().enumerate() {
                expected.extend((0..stack.frames()).map(|f| format!("layer {l} {f}: {:?}", layer.block([f]))));
            }
            if let Some(emission) = &stack.emission {
                let [_, bins_y, bins_x, ..] = emission.shape();
                for (y, x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
                    expected.push(format!("bin {y} {x}: {:?}", emission.block([0, y, x])));
                }
            }
            let view = lumistack_display::forward::view_from_slope(&sample.display, stack, [0.05, -0.02]);
            assert!(view.radiance.data().iter().any(|v| *v > 0.0), "{}", sample.name);
            expected.push(format!("simulated: {:?}", view.radiance.data()));
        }
        if let Some(field) = sample.field() {
            expected.extend(field.geometry().grid.iter().map(|view| format!("view {view:?}: {:?}", field.view(view))));
        }
        assert_eq!(text.lines().collect::<Vec<_>>(), expected, "{}", sample.name);
    }
}

#[test]
fn panics_come_back_as_errors_and_the_plugin_can_be_opened_again() {
    let sample = &samples()[0];
    for (fault, message) in [
        ("panic in open", "panic in open of three layers"),
        ("panic in submit", "panic at 0"),
        ("panic in finish", "panic in finish"),
    ] {
        let host = MemoryHost::new();
        assert_eq!(write(fault, &host, sample), Err(PluginError::Panicked(message.into())));
        assert!(host.open_files().is_empty());
    }
    let host = MemoryHost::new();
    assert_eq!(write("panic in drop", &host, sample), Err(PluginError::Panicked("panic in drop".into())));
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    drop(Output::open(&plugin, &host, &json!({"fault": "panic in drop"}), &sample.display).unwrap());
    assert_eq!(host.messages()[0].1, "the plugin panicked when it was closed: panic in drop");
    write("", &MemoryHost::new(), sample).unwrap();
}

#[test]
fn a_plugin_that_panicked_is_not_called_again() {
    let sample = &samples()[0];
    let (host, plugin) = (MemoryHost::new(), Plugin::compiled_in(&PLUGIN).unwrap());
    let output = Output::open(&plugin, &host, &json!({"fault": "panic in submit"}), &sample.display).unwrap();
    output.submit(Time::default(), sample.data()).unwrap_err();
    let error = output.submit(Time::default(), sample.data()).unwrap_err();
    assert_eq!(error, PluginError::Failed("the plugin panicked in an earlier call".into()));
    assert!(output.finish().is_err() && host.files().is_empty());
}

#[test]
fn files_outside_or_written_twice_are_refused() {
    let sample = &samples()[0];
    for (fault, word) in [("outside", "outside.txt"), ("twice", "already")] {
        let host = MemoryHost::new();
        let error = write(fault, &host, sample).unwrap_err();
        assert!(matches!(&error, PluginError::Refused(text) if text.contains(word)), "{error:?}");
    }
}

#[test]
fn a_host_that_is_kept_after_the_end_gives_errors() {
    write("steal host", &MemoryHost::new(), &samples()[0]).unwrap();
    let host = STOLEN.lock().unwrap().take().unwrap();
    let late = "the plugin called the host after the host's services had ended";
    assert_eq!(host.write("late.txt", b"x"), Err(PluginError::Failed(late.into())));
    assert!(host.is_cancelled());
    host.warn("a warning after the end");
}

#[test]
fn data_that_do_not_fit_the_display_never_reach_the_plugin() {
    let (plugin, host, all) = (Plugin::compiled_in(&PLUGIN).unwrap(), MemoryHost::new(), samples());
    let output = Output::open(&plugin, &host, &Value::Null, &all[0].display).unwrap();
    let other = OutputData::LayerStack(all[1].stack().unwrap(), None);
    let error = output.submit(Time::default(), other).unwrap_err();
    assert_eq!(error.to_string(), "layer stack: number of layers: expected 3, found 1");
}

#[test]
fn descriptors_of_other_versions_are_refused() {
    // SAFETY: the entry returns a static descriptor.
    let descriptor = unsafe { *lumistack_plugin_entry() };
    let refused = |descriptor: abi::Descriptor| {
        // SAFETY: the descriptor is a copy of a valid one, with changed numbers.
        unsafe { Plugin::from_descriptor(&descriptor) }.unwrap_err().to_string()
    };
    assert!(refused(abi::Descriptor { abi_major: 9, ..descriptor }).contains("version 9."));
    assert!(refused(abi::Descriptor { size: 8, ..descriptor }).contains("version"));
    assert!(refused(abi::Descriptor { kind: 9, ..descriptor }).contains("found 9"));
    assert!(refused(abi::Descriptor { id: abi::Str::new("a b"), ..descriptor }).contains("`a b`"));
    assert!(refused(abi::Descriptor { ports: 0, ..descriptor }).contains("found no input port"));
    assert!(refused(abi::Descriptor { schema_json: abi::Str::new("{}"), ..descriptor }).contains("parameters"));
    assert!(
        refused(abi::Descriptor { vtable: std::ptr::null(), ..descriptor }).contains("found a table that lacks one")
    );
    // SAFETY: null is allowed.
    assert!(unsafe { Plugin::from_descriptor(std::ptr::null()) }.is_err());
}

/// An output that violates one rule of the interface, selected by `FAULT`.
struct Faulty<const FAULT: u8> {
    host: Host,
}

const IGNORES_CANCEL: u8 = 0;
const SWALLOWS_ERRORS: u8 = 1;
const DIFFERS: u8 = 2;
const LEAKS_FILES: u8 = 3;
const LEAVES_STAGES: u8 = 4;
const SCHEMA_DIFFERS: u8 = 5;
const WRITES_NOTHING: u8 = 6;
/// Ignores the error of a write before `commit`. Some encoders do this, since they write their last
/// bytes when they are dropped. The rules allow this, since `commit` returns the error.
const LEAVES_ERRORS_TO_COMMIT: u8 = 7;
const REFUSES_WITHOUT_REASON: u8 = 8;
const IGNORES_CANCEL_MIDWAY: u8 = 9;

#[derive(Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct FaultyParams {
    #[allow(dead_code, reason = "only its presence matters")]
    present: bool,
}

impl<const FAULT: u8> OutputPlugin for Faulty<FAULT> {
    const DOC: &'static str = "Breaks a rule.";
    const PORTS: &'static [Port] = &[Port::LayerStack];
    type Params = FaultyParams;

    fn schema() -> Schema {
        Schema::new([Param::bool(if FAULT == SCHEMA_DIFFERS { "absent" } else { "present" }, true, "A switch.")])
    }

    fn open(host: Host, _params: FaultyParams, _display: Display) -> Result<Self, PluginError> {
        Ok(Self { host })
    }

    fn submit(&self, time: Time, _data: &Input<'_>) -> Result<(), PluginError> {
        static CALLS: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
        let calls = CALLS.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
        if FAULT != IGNORES_CANCEL {
            self.host.check_cancelled()?;
        }
        if FAULT == LEAVES_STAGES {
            std::mem::forget(self.host.stage("never ends", 1, "steps"));
        }
        let bytes = if FAULT == DIFFERS { calls.to_string() } else { String::new() };
        if FAULT == WRITES_NOTHING {
            return Ok(());
        }
        if FAULT == REFUSES_WITHOUT_REASON {
            return Err(PluginError::Refused(String::new()));
        }
        if FAULT == IGNORES_CANCEL_MIDWAY {
            self.host.write(&format!("{}-first.txt", time.index), b"")?;
        }
        let mut file = self.host.create(&format!("{}.txt", time.index))?;
        if FAULT == LEAKS_FILES {
            std::mem::forget(file);
            return Ok(());
        }
        match file.append(bytes.as_bytes()) {
            Err(_) if FAULT == SWALLOWS_ERRORS => Ok(()),
            _ if FAULT == LEAVES_ERRORS_TO_COMMIT => file.commit(),
            result => result.and_then(|()| file.commit()),
        }
    }

    fn finish(self) -> Result<(), PluginError> {
        // With `LEAKS_FILES` no other file is completed. This file keeps the rule that an output
        // writes something, so that only the leak is a violation.
        if FAULT == LEAKS_FILES { self.host.write("finished.txt", b"") } else { Ok(()) }
    }
}

#[test]
fn the_kit_notices_broken_rules() {
    fn checked<const FAULT: u8>() -> Result<(), Broken> {
        let export: LazyLock<Export> = LazyLock::new(|| Export::output::<Faulty<FAULT>>("faulty", "0.1.0"));
        conformance(Box::leak(Box::new(export)))
    }
    fn broken<const FAULT: u8>() -> &'static str {
        checked::<FAULT>().unwrap_err().rule
    }
    assert_eq!(broken::<IGNORES_CANCEL>(), "returns `cancelled` if cancelled before it begins");
    assert_eq!(broken::<SWALLOWS_ERRORS>(), "reports why the host cannot write");
    checked::<LEAVES_ERRORS_TO_COMMIT>().unwrap();
    assert_eq!(broken::<DIFFERS>(), "writes the same bytes again");
    assert_eq!(broken::<LEAKS_FILES>(), "no file stays open");
    assert_eq!(broken::<LEAVES_STAGES>(), "every stage of progress ends");
    assert_eq!(broken::<SCHEMA_DIFFERS>(), "works with default parameters");
    assert_eq!(broken::<WRITES_NOTHING>(), "an output that does not present writes something");
    assert_eq!(broken::<REFUSES_WITHOUT_REASON>(), "accepts a sample or refuses it with a reason");
    assert_eq!(broken::<IGNORES_CANCEL_MIDWAY>(), "returns `cancelled` if it opens a file after cancellation");
}
