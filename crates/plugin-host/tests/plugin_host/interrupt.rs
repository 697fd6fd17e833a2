//! Ctrl-C must not end the process of a plugin. Only the host receives Ctrl-C, and cancels the
//! plugin.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc::channel;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_plugin_host::{PresentContext, PresenterOutput, Registry, present};
use lumistack_plugin_testkit::samples;
use lumistack_testkit::console::{interrupt, interruptible};
use serde_json::json;

use crate::common;

/// Environment variable of the program that the test starts and interrupts.
const INTERRUPTED: &str = "LUMISTACK_TEST_INTERRUPTED";

/// The test starts its own program a second time, to run the plugin and to be interrupted.
#[test]
fn ctrl_c_leaves_a_plugin_to_its_host() {
    if std::env::var_os(INTERRUPTED).is_some() {
        return presents_until_ctrl_c();
    }
    let mut program = Command::new(std::env::current_exe().unwrap());
    program.args(["--exact", "interrupt::ctrl_c_leaves_a_plugin_to_its_host", "--nocapture"]);
    program.env(INTERRUPTED, "1").stdout(Stdio::piped());
    let mut program = interruptible(&mut program).spawn().unwrap();
    let mut said = Vec::new();
    for line in BufReader::new(program.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        if line.ends_with("the plugin runs") {
            interrupt(&program);
        }
        said.push(line);
    }
    assert!(program.wait().unwrap().success(), "{said:?}");
    assert!(said.iter().any(|line| line == "the plugin said: the presentation has ended"), "{said:?}");
}

fn presents_until_ctrl_c() {
    let cancel = Arc::new(Cancel::default());
    let by_user = cancel.clone();
    ctrlc::set_handler(move || by_user.cancel()).unwrap();
    let mut registry = Registry::default();
    registry.load(&common::paths(vec![common::example("echo")]));
    let (sample, warnings) = (samples().swap_remove(0), Collector::default());
    let on_output = |output: PresenterOutput<'_>| match output {
        PresenterOutput::Event(_) => println!("the plugin runs"),
        PresenterOutput::Warning(text) => println!("the plugin said: {text}"),
    };
    let (_send, input) = channel();
    let context = PresentContext {
        display: &sample.display,
        first: sample.stack(),
        input,
        on_output: &on_output,
        task: Task::quiet(&warnings, &cancel),
    };
    present(&registry, "echo", &json!({}), context).unwrap();
}
