//! Presenters that a program drives while they run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use lumistack_core::Task;
use lumistack_display::{Display, LayerStack};
use lumistack_plugin::{PluginError, Time};
use serde_json::Value;

use crate::serve::{Output, OutputData, PluginKind, Services};
use crate::{HostError, Registry};

/// Input of a presenter while it runs.
#[derive(Clone, Debug)]
pub enum Asked {
    /// New patterns, which replace those before.
    Stack(LayerStack),
    /// A command, in JSON of the plugin's own form.
    Command(Value),
}

/// Output of a presenter, from any thread.
#[derive(Clone, Copy, Debug)]
pub enum Told<'a> {
    /// Something that the user should know.
    Warning(&'a str),
    /// An event, in JSON of the plugin's own form.
    Event(&'a Value),
}

/// Subject and surroundings of a presentation.
pub struct PresentContext<'a> {
    /// The display.
    pub display: &'a Display,
    /// Patterns that are there before it runs; none where the parameters say what is shown.
    pub first: Option<&'a LayerStack>,
    /// Input that comes while it runs.
    pub asked: Receiver<Asked>,
    /// Takes its output. Refused input comes back as a warning.
    pub told: &'a (dyn Fn(Told<'_>) + Sync),
    /// Progress and cancellation.
    pub task: Task<'a>,
}

/// Time between two looks whether the presentation has ended.
const LOOK: Duration = Duration::from_millis(50);

/// Runs the presenter `id` until it is closed. Call it on the main thread, where windows want to be. A presenter has no folder and writes no
/// files.
///
/// # Errors
/// If there is no such presenter, it does not take parameters, display or patterns, or it fails.
pub fn present(registry: &Registry, id: &str, params: &Value, context: PresentContext<'_>) -> Result<(), HostError> {
    let PresentContext { display, first, asked, told, task } = context;
    let plugin = registry.output(id, true)?;
    let resolved = registry.check_params(id, params)?;
    let of_plugin = |error| HostError::of_plugin(PluginKind::Output, id, error);
    let host = Audience { told, task };
    let output = Output::open(plugin, &host, &Value::Object(resolved), display).map_err(of_plugin)?;
    if let Some(stack) = first {
        output.submit(Time::default(), OutputData::LayerStack(stack, None)).map_err(of_plugin)?;
    }
    let ended = AtomicBool::new(false);
    let ran = std::thread::scope(|scope| {
        scope.spawn(|| pass_on(&output, asked, told, &ended));
        let ran = output.run();
        ended.store(true, Ordering::SeqCst);
        ran
    });
    ran.and_then(|()| output.finish()).map_err(of_plugin)
}

/// Passes input on until the presentation has ended.
fn pass_on(output: &Output<'_>, asked: Receiver<Asked>, told: &(dyn Fn(Told<'_>) + Sync), ended: &AtomicBool) {
    let mut time = Time::default();
    while !ended.load(Ordering::SeqCst) {
        let done = match asked.recv_timeout(LOOK) {
            Ok(Asked::Stack(stack)) => {
                time.index += 1;
                output.submit(time, OutputData::LayerStack(&stack, None))
            }
            Ok(Asked::Command(command)) => output.command(&command),
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => return,
        };
        match done {
            Ok(()) | Err(PluginError::Cancelled) => {}
            Err(error) => told(Told::Warning(&error.to_string())),
        }
    }
}

/// A host without files, which passes output on.
struct Audience<'a> {
    told: &'a (dyn Fn(Told<'_>) + Sync),
    task: Task<'a>,
}

impl Services for Audience<'_> {
    fn task(&self) -> Task<'_> {
        self.task
    }

    fn warn(&self, message: &str) {
        (self.told)(Told::Warning(message));
    }

    fn tell(&self, event: &Value) {
        (self.told)(Told::Event(event));
    }

    fn no_files(&self) -> PluginError {
        PluginError::Refused("a presentation writes no files".into())
    }
}
