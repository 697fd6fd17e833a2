//! Runs presenters, which a program controls while they run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use lumistack_core::Task;
use lumistack_display::{Display, LayerStack};
use lumistack_plugin::{PluginError, Time};
use serde_json::Value;

use crate::serve::{Output, OutputData, PluginKind, Services};
use crate::{HostError, Registry};

/// Input of a running presenter.
#[derive(Clone, Debug)]
pub enum PresenterInput {
    /// A new layer stack, which replaces the previous one.
    Stack(LayerStack),
    /// A command, as JSON that the plugin defines.
    Command(Value),
}

/// Output of a presenter. It may arrive on any thread.
#[derive(Clone, Copy, Debug)]
pub enum PresenterOutput<'a> {
    /// A warning for the user.
    Warning(&'a str),
    /// An event, as JSON that the plugin defines.
    Event(&'a Value),
}

/// Inputs and callbacks of a presentation.
pub struct PresentContext<'a> {
    /// The display that the presenter drives.
    pub display: &'a Display,
    /// The layer stack that is submitted before the presenter runs. `None` if the parameters select
    /// the content, such as a test pattern.
    pub first: Option<&'a LayerStack>,
    /// Receives input while the presenter runs.
    pub input: Receiver<PresenterInput>,
    /// Receives the presenter's output. Input that the presenter refuses is reported as a warning.
    pub on_output: &'a (dyn Fn(PresenterOutput<'_>) + Sync),
    /// Progress and cancellation.
    pub task: Task<'a>,
}

/// Interval between the checks for the end of the presentation.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Runs the presenter `id` until the user closes or cancels the presentation. Callers call this
/// function on the main thread, since some systems allow windows only there. A presenter writes no
/// files.
///
/// # Errors
/// If no presenter has this id, or the presenter refuses parameters, display or the first layer
/// stack, or fails.
pub fn present(registry: &Registry, id: &str, params: &Value, context: PresentContext<'_>) -> Result<(), HostError> {
    let PresentContext { display, first, input, on_output, task } = context;
    let plugin = registry.output(id, true)?;
    let resolved = registry.check_params(id, params)?;
    let of_plugin = |error| HostError::of_plugin(PluginKind::Output, id, error);
    let host = ForwardingHost { on_output, task };
    let output = Output::open(plugin, &host, &Value::Object(resolved), display).map_err(of_plugin)?;
    if let Some(stack) = first {
        output.submit(Time::default(), OutputData::LayerStack(stack, None)).map_err(of_plugin)?;
    }
    let ended = AtomicBool::new(false);
    let ran = std::thread::scope(|scope| {
        scope.spawn(|| forward_input(&output, input, on_output, &ended));
        let ran = output.run();
        ended.store(true, Ordering::SeqCst);
        ran
    });
    ran.and_then(|()| output.finish()).map_err(of_plugin)
}

/// Forwards input to the presenter until the presentation has ended.
fn forward_input(
    output: &Output<'_>,
    input: Receiver<PresenterInput>,
    on_output: &(dyn Fn(PresenterOutput<'_>) + Sync),
    ended: &AtomicBool,
) {
    let mut time = Time::default();
    while !ended.load(Ordering::SeqCst) {
        let done = match input.recv_timeout(POLL_INTERVAL) {
            Ok(PresenterInput::Stack(stack)) => {
                time.index += 1;
                output.submit(time, OutputData::LayerStack(&stack, None))
            }
            Ok(PresenterInput::Command(command)) => output.command(&command),
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => return,
        };
        match done {
            Ok(()) | Err(PluginError::Cancelled) => {}
            Err(error) => on_output(PresenterOutput::Warning(&error.to_string())),
        }
    }
}

/// Services for a presenter: they forward events and warnings, and refuse all files.
struct ForwardingHost<'a> {
    on_output: &'a (dyn Fn(PresenterOutput<'_>) + Sync),
    task: Task<'a>,
}

impl Services for ForwardingHost<'_> {
    fn task(&self) -> Task<'_> {
        self.task
    }

    fn warn(&self, message: &str) {
        (self.on_output)(PresenterOutput::Warning(message));
    }

    fn tell(&self, event: &Value) {
        (self.on_output)(PresenterOutput::Event(event));
    }

    fn no_files(&self) -> PluginError {
        PluginError::Refused("a presentation writes no files".into())
    }
}
