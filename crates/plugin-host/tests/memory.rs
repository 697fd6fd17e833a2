//! Tests the memory of outputs: for a 4K stack of three layers, twelve frames need hardly more
//! memory than four.
//!
//! For each output and each number of frames, a process of its own measures two numbers. `alive` is
//! the peak of the bytes that the output allocates, counted by the allocator; it is exact and
//! reproducible. `resident` is the kernel's `VmHWM` of `/proc/self/status`, which includes memory
//! that the allocator has not returned. Both peaks are reached within the first frames. The layers
//! are black: zeroed memory that is never written is not resident. So `resident` does not contain
//! the stack.

#![cfg(target_os = "linux")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, LayerStack};
use lumistack_plugin_host::serve::OutputData;
use lumistack_plugin_host::{OutputContext, Registry, Time, run_output};
use serde_json::{Value, json};

const FRAMES: &str = "LUMISTACK_TEST_FRAMES";
const OUTPUT: &str = "LUMISTACK_TEST_OUTPUT";
const SIZE: [usize; 2] = [3840, 2160];
/// Size of one plane of floats, mebibytes.
const PLANE_MIB: f64 = (SIZE[0] * SIZE[1] * 3 * 4) as f64 / MIB;
const MIB: f64 = (1 << 20) as f64;
/// Allowed growth of memory by eight more frames, mebibytes. Names of files and entries of lists
/// need this memory.
const LISTS_MIB: f64 = 0.25;

/// Returns the outputs that are measured: name, plugin and parameters. The plugin `images` writes
/// several kinds of files, which are measured alone and all together.
fn outputs() -> [(&'static str, &'static str, Value); 7] {
    let images = |wanted: &[&str]| {
        let chosen = |name: &str| wanted.contains(&name);
        json!({"png8": chosen("png8"), "png16": chosen("png16"), "exr": chosen("exr"), "npz": chosen("npz"), "atlas": chosen("atlas"), "sheet": chosen("sheet"), "views": "none"})
    };
    [
        ("png", "images", images(&["png8", "png16"])),
        ("exr", "images", images(&["exr"])),
        ("npz", "images", images(&["npz"])),
        ("atlas", "images", images(&["atlas"])),
        ("sheet", "images", images(&["sheet"])),
        ("images", "images", images(&["png8", "png16", "exr", "npz", "atlas", "sheet"])),
        ("web_simulator", "web_simulator", json!({})),
    ]
}

/// The system's allocator, with counters.
struct Counting;

static ALIVE: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

fn took(bytes: usize) {
    MOST.fetch_max(ALIVE.fetch_add(bytes, Relaxed) + bytes, Relaxed);
}

// SAFETY: every call is forwarded to the system allocator; the counters do not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        took(layout.size());
        // SAFETY: guaranteed by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        took(layout.size());
        // SAFETY: guaranteed by the caller.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // While the bytes are copied, the old and the new block exist together.
        took(size);
        // SAFETY: guaranteed by the caller.
        let moved = unsafe { System.realloc(block, layout, size) };
        ALIVE.fetch_sub(layout.size(), Relaxed);
        moved
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        ALIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: guaranteed by the caller.
        unsafe { System.dealloc(block, layout) };
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Writes a stack with one output; prints the peaks of `resident` and `alive`.
#[test]
#[ignore = "run by the test below, in processes of its own"]
fn writes_a_4k_stack() {
    let (Ok(frames), Ok(name)) = (std::env::var(FRAMES), std::env::var(OUTPUT)) else { return };
    let display = Display::uniform(SIZE, 0.16, [3, 3], [20.0, 20.0], &[-10.0, 0.0, 10.0], frames.parse().unwrap());
    let stack = LayerStack::filled(&display, 0.0);
    let registry = Registry::built_in().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let context = OutputContext {
        display: &display,
        data: OutputData::LayerStack(&stack, None),
        time: Time::default(),
        out_dir: &folder.path().join("output"),
        task: Task::quiet(&warnings, &cancel),
    };
    let (_, plugin, params) = outputs().into_iter().find(|(own, ..)| *own == name).unwrap();
    let before = ALIVE.load(Relaxed);
    MOST.store(before, Relaxed);
    let files = run_output(&registry, plugin, &params, context).unwrap();
    let alive = MOST.load(Relaxed) - before;
    let per_frame = files.iter().filter(|path| path.to_string_lossy().contains("frame")).count();
    assert_eq!(per_frame % stack.frames(), 0, "{files:?}");
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
    println!("peak {} {alive}", line.split_whitespace().nth(1).unwrap());
}

/// Runs one output in its own process, and returns its peaks [resident, alive] in mebibytes.
fn peaks_mib(output: &str, frames: usize) -> [f64; 2] {
    let run = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "writes_a_4k_stack", "--nocapture"])
        .env(FRAMES, frames.to_string())
        .env(OUTPUT, output)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(run.status.success(), "{text}{}", String::from_utf8_lossy(&run.stderr));
    let words: Vec<&str> = text.split_whitespace().collect();
    let at = words.iter().position(|word| *word == "peak").unwrap_or_else(|| panic!("no peak in {text}"));
    [words[at + 1].parse::<f64>().unwrap() / 1024.0, words[at + 2].parse::<f64>().unwrap() / MIB]
}

#[test]
#[ignore = "slow: writes 112 frames of three 4K layers"]
fn memory_does_not_grow_with_the_number_of_frames() {
    println!(
        "a plane is {PLANE_MIB:.0} MiB; peak memory in MiB:\n{:14} resident: 4 frames, 12    alive: 4 frames, 12",
        ""
    );
    let mut too_much = Vec::new();
    for (name, ..) in outputs() {
        let [few, many] = [4, 12].map(|frames| peaks_mib(name, frames));
        println!("{name:14} {:18.1} {:5.1} {:18.2} {:5.2}", few[0], many[0], few[1], many[1]);
        let grew = many[0] > few[0] + 0.25 * PLANE_MIB || many[1] > few[1] + LISTS_MIB;
        if grew || many[0] > 12.0 * PLANE_MIB {
            too_much.push(name);
        }
    }
    assert!(too_much.is_empty(), "{too_much:?}");
}
