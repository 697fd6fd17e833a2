//! Presenters through the plugin interface, compiled in and loaded: layer stacks and commands
//! arrive while one runs, and events return.

use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::LayerStack;
use lumistack_plugin_host::{
    Asked, HostError, OutputContext, Plugin, PresentContext, Registry, Time, Told, present, run_output,
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

/// Events and warnings of a sample's presentation.
fn presented(
    registry: &Registry,
    id: &str,
    stack: &LayerStack,
    asked: Receiver<Asked>,
    cancel: &Cancel,
) -> Result<(Vec<Value>, Vec<String>), HostError> {
    let (events, warnings) = (Mutex::new(Vec::new()), Mutex::new(Vec::new()));
    let told = |told: Told<'_>| match told {
        Told::Event(event) => events.lock().unwrap().push(event.clone()),
        Told::Warning(text) => warnings.lock().unwrap().push(text.to_string()),
    };
    let (sample, collected) = (samples().swap_remove(0), Collector::default());
    let task = Task::quiet(&collected, cancel);
    let context = PresentContext { display: &sample.display, first: Some(stack), asked, told: &told, task };
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
        let (send, asked) = channel();
        for ask in [Asked::Command(json!("dance")), Asked::Stack(next.clone()), Asked::Command(json!("quit"))] {
            send.send(ask).unwrap();
        }
        let (events, warnings) = presented(&registry, "echo", &first, asked, &Cancel::default()).unwrap();
        let event = |time: u64, stack: &LayerStack| json!({"time": time, "brightness": stack.brightness});
        assert_eq!(events, [event(0, &first), event(1, &next)]);
        assert_eq!(warnings, ["expected \"quit\", found \"dance\"", "nobody listens any more"]);
    }
}

#[test]
fn a_presentation_ends_when_asked() {
    for registry in registries() {
        let (_send, asked) = channel();
        let cancel = Cancel::default();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(std::time::Duration::from_millis(100));
                cancel.cancel();
            });
            let (_, warnings) = presented(&registry, "echo", &stacks()[0], asked, &cancel).unwrap();
            assert_eq!(warnings, ["nobody listens any more"]);
        });
    }
}

#[test]
fn what_presents_and_what_writes_are_told_apart() {
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
    assert!(error.contains("expected a plugin that writes files, found one that presents"), "{error}");
    assert!(!folder.path().join("out").exists());
    let (_send, asked) = channel();
    let error = presented(&registry, "images", &stacks()[0], asked, &cancel).unwrap_err().to_string();
    assert!(error.contains("expected a plugin that presents, found one that writes files"), "{error}");
}
