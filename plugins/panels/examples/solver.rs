//! Runs panels in parallel with a thread that submits new stacks, as a solver does. The thread
//! stalls for a while, and the panels must continue.
//!
//! `cargo run -p lumistack-plugin-panels --features window --example solver -- 8` shows three
//! layers on the first three outputs for eight seconds. The thread submits a stack every 0.3 s and
//! stalls from the third to the fifth second (not with `steady` as the second argument). The
//! program prints a line per refresh: number of the refresh, position in the cycle of frames,
//! number of the stack, seconds.

use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use lumistack_plugin::core::{Cancel, Collector, Task};
use lumistack_plugin::display::{Display, LayerStack};
use lumistack_plugin::serde_json::{from_value, json};
use lumistack_plugin_host::{HostError, PresentContext, PresenterInput, PresenterOutput, Registry, present};
use lumistack_plugin_panels::presentation::Event;

/// Makes stack `number`. Each layer is uniform, and its shade differs from frame to frame.
fn stack(display: &Display, number: usize) -> LayerStack {
    let mut stack = LayerStack::filled(display, 1.0);
    for layer in &mut stack.layers {
        for frame in 0..display.frames {
            layer.block_mut([frame]).fill(((number + frame) % 5) as f32 / 4.0);
        }
    }
    stack
}

fn main() -> Result<(), HostError> {
    let seconds: u64 = std::env::args().nth(1).and_then(|word| word.parse().ok()).unwrap_or(8);
    let steady = std::env::args().nth(2).is_some_and(|word| word == "steady");
    let display = Display::uniform([320, 240], 0.5, [3, 3], [10.0, 10.0], &[-10.0, 0.0, 10.0], 3);
    let (send, input) = channel();
    let solver = {
        let display = display.clone();
        move || {
            let begun = Instant::now();
            for number in 1.. {
                std::thread::sleep(Duration::from_millis(300));
                let stalls = !steady && (3.0..3.3).contains(&begun.elapsed().as_secs_f64());
                if stalls {
                    // Stall for two seconds, as a slow solver would.
                    std::thread::sleep(Duration::from_secs(2));
                }
                if send.send(PresenterInput::Stack(stack(&display, number))).is_err() {
                    return;
                }
            }
        }
    };
    std::thread::spawn(solver);
    let on_output = |output: PresenterOutput<'_>| match output {
        PresenterOutput::Warning(text) => eprintln!("warning: {text}"),
        PresenterOutput::Event(event) => {
            if let Ok(Event::Report(report)) = from_value(event.clone()) {
                for (refresh, place, pictures, seconds) in report.log {
                    println!("{refresh},{place},{pictures},{seconds:.6}");
                }
            }
        }
    };
    let first = stack(&display, 0);
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let context = PresentContext { display: &display, first: Some(&first), input, on_output: &on_output, task };
    present(&Registry::built_in()?, "panels", &json!({"duration_s": seconds, "log": true}), context)
}
