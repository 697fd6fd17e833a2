//! Tests of presenters through the plugin interface, compiled in and loaded. Layer stacks and
//! commands must reach a running presenter, and its events must reach the program.

use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::LayerStack;
use lumistack_plugin_host::{
    HostError, OutputContext, Plugin, PresentContext, PresenterInput, PresenterOutput, Registry, Time, present,
    run_output,
};
use lumistack_plugin_testkit::{conformance, samples};
use serde_json::{Value, json};

use crate::common;

#[path = "../../examples/lumistack_plugin_echo.rs"]
mod echo;

fn registries() -> [Registry; 2] {
    let mut compiled_in = Registry::built_in().unwrap();
    compiled_in.add(Plugin::compiled_in(&echo::PLUGIN).unwrap()).unwrap();
    let mut loaded = Registry::built_in().unwrap();
    loaded.load(&common::paths(vec![common::example("echo")]));
    assert!(loaded.failed().is_empty(), "{:?}", loaded.failed());
    [compiled_in, loaded]
}

/// Runs a presentation of a sample, and returns its events and warnings.
fn presented(
    registry: &Registry,
    id: &str,
    stack: &LayerStack,
    input: Receiver<PresenterInput>,
    cancel: &Cancel,
) -> Result<(Vec<Value>, Vec<String>), HostError> {
    presented_with(registry, id, stack, input, cancel, &|| {})
}

/// Runs a presentation as [`presented`] does, and calls `on_event` at each event.
fn presented_with(
    registry: &Registry,
    id: &str,
    stack: &LayerStack,
    input: Receiver<PresenterInput>,
    cancel: &Cancel,
    on_event: &(dyn Fn() + Sync),
) -> Result<(Vec<Value>, Vec<String>), HostError> {
    let (events, warnings) = (Mutex::new(Vec::new()), Mutex::new(Vec::new()));
    let on_output = |output: PresenterOutput<'_>| match output {
        PresenterOutput::Event(event) => {
            events.lock().unwrap().push(event.clone());
            on_event();
        }
        PresenterOutput::Warning(text) => warnings.lock().unwrap().push(text.to_string()),
    };
    let (sample, collected) = (samples().swap_remove(0), Collector::default());
    let task = Task::quiet(&collected, cancel);
    let context = PresentContext { display: &sample.display, first: Some(stack), input, on_output: &on_output, task };
    present(registry, id, &json!({}), context)?;
    Ok((events.into_inner().unwrap(), warnings.into_inner().unwrap()))
}

fn stacks() -> [LayerStack; 2] {
    let first = samples().swap_remove(0).stack().unwrap().clone();
    let mut next = first.clone();
    next.brightness = 0.75 * first.brightness;
    [first, next]
}

#[test]
fn conforms() {
    conformance(&echo::PLUGIN).unwrap();
}

#[test]
fn patterns_and_commands_reach_a_presenter_while_it_runs() {
    let [first, next] = stacks();
    for registry in registries() {
        let (send, input) = channel();
        for sent in [
            PresenterInput::Command(json!("dance")),
            PresenterInput::Stack(next.clone()),
            PresenterInput::Command(json!("quit")),
        ] {
            send.send(sent).unwrap();
        }
        let (events, warnings) = presented(&registry, "echo", &first, input, &Cancel::default()).unwrap();
        let event = |time: u64, stack: &LayerStack| json!({"time": time, "brightness": stack.brightness});
        assert_eq!(events, [event(0, &first), event(1, &next)]);
        assert_eq!(warnings, ["expected \"quit\", found \"dance\"", "the presentation has ended"]);
    }
}

#[test]
fn a_presentation_ends_on_request() {
    for registry in registries() {
        let (_send, input) = channel();
        let cancel = Cancel::default();
        // the first event shows that the presentation runs
        let ended = presented_with(&registry, "echo", &stacks()[0], input, &cancel, &|| cancel.cancel());
        assert_eq!(ended.unwrap().1, ["the presentation has ended"]);
    }
}

#[test]
fn presenters_and_writers_are_distinguished() {
    let [registry, _] = registries();
    let (sample, collected, cancel) = (samples().swap_remove(0), Collector::default(), Cancel::default());
    let folder = tempfile::tempdir().unwrap();
    let task = Task::quiet(&collected, &cancel);
    let context = OutputContext {
        display: &sample.display,
        data: sample.data(),
        time: Time::default(),
        out_dir: &folder.path().join("out"),
        task,
    };
    let error = run_output(&registry, "echo", &json!({}), context).unwrap_err().to_string();
    assert!(
        error.contains(
            "expected an output that writes files, found an output that drives panels (for `lumistack show`)"
        ),
        "{error}"
    );
    assert!(!folder.path().join("out").exists());
    let (_send, input) = channel();
    let error = presented(&registry, "images", &stacks()[0], input, &cancel).unwrap_err().to_string();
    assert!(
        error.contains(
            "expected an output that drives panels (for `lumistack show`), found an output that writes files"
        ),
        "{error}"
    );
}
