//! Memory of an output: a 4K stack of three layers takes no more for twelve frames than for two.
//!
//! The peak is the kernel's own figure, `VmHWM` of `/proc/self/status`, of a process of its own per number of frames. Patterns are black: memory that was
//! asked for as zeros and never written is not resident, so the figure holds what the output takes and not the stack.

#![cfg(target_os = "linux")]

use std::process::Command;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, LayerStack};
use lumistack_plugin::serve::OutputData;
use lumistack_plugin_host::{OutputContext, Registry, Time, run_output};
use serde_json::json;

const FRAMES: &str = "LUMISTACK_TEST_FRAMES";
const SIZE: [usize; 2] = [3840, 2160];
/// One plane of floats, mebibytes.
const PLANE_MIB: f64 = (SIZE[0] * SIZE[1] * 3 * 4) as f64 / (1 << 20) as f64;

/// Writes a stack in all formats that have a file per frame or all frames in one file; prints the peak.
#[test]
#[ignore = "run by the test below, in processes of its own"]
fn writes_a_4k_stack() {
    let Ok(frames) = std::env::var(FRAMES) else { return };
    let display = Display::uniform(SIZE, 0.16, [3, 3], [20.0, 20.0], &[-10.0, 0.0, 10.0], frames.parse().unwrap());
    let stack = LayerStack::filled(&display, 0.0);
    let folder = tempfile::tempdir().unwrap();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let context = OutputContext {
        display: &display,
        data: OutputData::LayerStack(&stack, None),
        time: Time::default(),
        out_dir: &folder.path().join("images"),
        task: Task::quiet(&warnings, &cancel),
    };
    let params = json!({"png16": true, "exr": true, "npz": true, "atlas": true, "views": "none"});
    let files = run_output(&Registry::built_in().unwrap(), "images", &params, context).unwrap();
    assert_eq!(files.len(), 3 * stack.frames() * 3 + 4);
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
    println!("peak {}", line.split_whitespace().nth(1).unwrap());
}

#[test]
#[ignore = "slow: writes 14 frames of three 4K layers"]
fn memory_does_not_grow_with_the_number_of_frames() {
    let peak_mib = |frames: usize| -> f64 {
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--ignored", "--exact", "writes_a_4k_stack", "--nocapture"])
            .env(FRAMES, frames.to_string())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
        let words: Vec<&str> = text.split_whitespace().collect();
        let at = words.iter().position(|word| *word == "peak").unwrap_or_else(|| panic!("no peak in {text}"));
        words[at + 1].parse::<f64>().unwrap() / 1024.0
    };
    let [few, many] = [2, 12].map(peak_mib);
    println!("peak with 2 frames {few:.0} MiB, with 12 frames {many:.0} MiB; a plane is {PLANE_MIB:.0} MiB");
    assert!(many < few + 0.25 * PLANE_MIB, "{few} {many}");
    assert!(many < 12.0 * PLANE_MIB, "one plane at a time: {many}");
}
