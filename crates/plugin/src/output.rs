//! Output plugins: the trait, and the C functions that hosts call.

use std::ffi::c_void;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{PoisonError, RwLock};

use lumistack_display::Display;
use lumistack_plugin_abi::{self as abi, Data, ErrorSink, HostServices, OutputVtable, Status, Str};
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::given::params_of;
use crate::host::CloseHost;
use crate::input::Input;
use crate::time::Time;
use crate::wire::{answer, display_from_json, lent_text, needs, panic_text};
use crate::{Host, PluginError, Port, Schema};

/// A plugin that writes or shows results. A host calls [`open`](Self::open), then
/// [`submit`](Self::submit) for every time step, and at the end [`finish`](Self::finish). For a
/// presenter, the host calls [`run`](Self::run) before `finish`, and also calls `submit` while
/// `run` runs. If the host abandons the output, the output is dropped without `finish`.
pub trait OutputPlugin: Sized + Send + Sync + 'static {
    /// Description for users; listings show its first sentence.
    const DOC: &'static str;
    /// The ports that the plugin accepts.
    const PORTS: &'static [Port];
    /// True for a presenter, which runs until the user closes it; see [`run`](Self::run).
    const PRESENTS: bool = false;

    /// A struct with one field per parameter of the schema; a field has its parameter's name.
    type Params: DeserializeOwned;

    /// Describes the plugin's parameters. They are checked before `open`, which receives a value of
    /// the right type and in range for each parameter.
    fn schema() -> Schema;

    /// Opens an output. As a check, a host may open and drop an output before it begins to make the
    /// data. Therefore refuse unsupported parameters and displays here, and write or show nothing
    /// yet.
    ///
    /// # Errors
    /// [`PluginError::Refused`] if parameters contradict one another or the display is not
    /// supported.
    fn open(host: Host, params: Self::Params, display: Display) -> Result<Self, PluginError>;

    /// Submits one time step. The host calls this function from any thread, also concurrently, and
    /// in any order of time steps.
    ///
    /// # Errors
    /// If the data are refused, or cannot be written or shown; [`PluginError::Cancelled`] if the
    /// user cancelled.
    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError>;

    /// Runs a presenter on the main thread until the user closes the presentation or cancels. In
    /// the meantime, every [`submit`](Self::submit) replaces the presented data. [`Host::tell`]
    /// sends events to the program.
    ///
    /// # Errors
    /// If the presentation fails.
    fn run(&self) -> Result<(), PluginError> {
        Ok(())
    }

    /// Executes a command for a presenter while [`run`](Self::run) runs. The command is JSON that
    /// the plugin defines. The host calls this function from any thread.
    ///
    /// # Errors
    /// [`PluginError::Refused`] if the plugin has no such command.
    fn command(&self, command: &Value) -> Result<(), PluginError> {
        Err(PluginError::Refused(format!("expected no command, since the plugin has none, found {command}")))
    }

    /// Finishes the output: no more data follow.
    ///
    /// # Errors
    /// If the remaining data cannot be written.
    fn finish(self) -> Result<(), PluginError>;
}

/// Returns the C functions of a plugin type.
pub(crate) const fn vtable_of<P: OutputPlugin>() -> &'static OutputVtable {
    &Instance::<P>::VTABLE
}

/// The object to which the C handle points.
struct Instance<P> {
    /// `None` after the plugin has finished. A running `submit` holds the read lock.
    plugin: RwLock<Option<P>>,
    host: Host,
    /// True after a panic. The plugin may then be inconsistent, so it is not called again.
    panicked: AtomicBool,
}

impl<P: OutputPlugin> Instance<P> {
    const VTABLE: OutputVtable = OutputVtable {
        size: size_of::<OutputVtable>(),
        open: Some(open::<P>),
        submit: Some(submit::<P>),
        run: if P::PRESENTS { Some(run::<P>) } else { None },
        finish: Some(finish::<P>),
        close: Some(close::<P>),
        command: if P::PRESENTS { Some(command::<P>) } else { None },
    };

    /// Runs a call of the plugin and records a panic. Refuses the call after an earlier panic.
    fn guarded(&self, error: *const ErrorSink, function: impl FnOnce() -> Result<(), PluginError>) -> Status {
        // SAFETY: the host passes null or a valid sink to every function.
        let status = unsafe {
            answer(error, || {
                if self.panicked.load(Ordering::SeqCst) {
                    return Err(PluginError::Failed("the plugin panicked in an earlier call".into()));
                }
                function()
            })
        };
        if status == Status::PANICKED {
            self.panicked.store(true, Ordering::SeqCst);
        }
        status
    }

    fn with_plugin(&self, function: impl FnOnce(&P) -> Result<(), PluginError>) -> Result<(), PluginError> {
        let plugin = self.plugin.read().unwrap_or_else(PoisonError::into_inner);
        function(plugin.as_ref().ok_or_else(finished)?)
    }
}

fn finished() -> PluginError {
    PluginError::Failed("the output has already finished".into())
}

unsafe extern "C" fn open<P: OutputPlugin>(
    host: *const HostServices,
    params_json: Str,
    display_json: Str,
    instance: *mut *mut c_void,
    error: *const ErrorSink,
) -> Status {
    let start = || {
        // SAFETY: the host lends the texts for this call, and the table `host` until `close`
        // returns. If `open` fails, `close` is not called, and `CloseHost` ends the use of the
        // table.
        let (params, display, host) = unsafe {
            (params_of(P::schema(), params_json)?, lent_text(display_json, "display")?, CloseHost::checked(host)?)
        };
        let display = display_from_json(display)?;
        let plugin = P::open(host.get(), params, display)?;
        let (plugin, panicked) = (RwLock::new(Some(plugin)), AtomicBool::new(false));
        let boxed = Box::new(Instance { plugin, host: host.keep(), panicked });
        // SAFETY: the host provides memory for the handle.
        unsafe { *instance = Box::into_raw(boxed).cast() };
        Ok(())
    };
    // SAFETY: the host passes null or a valid sink.
    unsafe { answer(error, start) }
}

unsafe extern "C" fn submit<P: OutputPlugin>(
    instance: *mut c_void,
    time: *const abi::Time,
    data: *const Data,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the host passes the handle of `open`.
    let this = unsafe { &*instance.cast::<Instance<P>>() };
    this.guarded(error, || {
        // SAFETY: the host lends time and data until this call returns.
        let (time, input) = unsafe {
            needs((*data).size, size_of::<Data>())?;
            (Time::from_abi(time)?, Input::new(data, this.host.clone())?)
        };
        this.with_plugin(|plugin| plugin.submit(time, &input))
    })
}

unsafe extern "C" fn run<P: OutputPlugin>(instance: *mut c_void, error: *const ErrorSink) -> Status {
    // SAFETY: the host passes the handle of `open`.
    let this = unsafe { &*instance.cast::<Instance<P>>() };
    this.guarded(error, || this.with_plugin(P::run))
}

unsafe extern "C" fn command<P: OutputPlugin>(
    instance: *mut c_void,
    command_json: Str,
    error: *const ErrorSink,
) -> Status {
    // SAFETY: the host passes the handle of `open`.
    let this = unsafe { &*instance.cast::<Instance<P>>() };
    this.guarded(error, || {
        // SAFETY: the host lends the text until this call returns.
        let text = unsafe { lent_text(command_json, "command")? };
        let command = serde_json::from_str(text).map_err(|error| PluginError::Refused(format!("command: {error}")))?;
        this.with_plugin(|plugin| plugin.command(&command))
    })
}

unsafe extern "C" fn finish<P: OutputPlugin>(instance: *mut c_void, error: *const ErrorSink) -> Status {
    // SAFETY: the host passes the handle of `open`.
    let this = unsafe { &*instance.cast::<Instance<P>>() };
    this.guarded(error, || {
        let plugin = this.plugin.write().unwrap_or_else(PoisonError::into_inner).take();
        plugin.ok_or_else(finished)?.finish()
    })
}

unsafe extern "C" fn close<P: OutputPlugin>(instance: *mut c_void) {
    // SAFETY: the handle of `open`, released once.
    let this = unsafe { Box::from_raw(instance.cast::<Instance<P>>()) };
    let host = this.host.clone();
    // A panic of the plugin's destructor must not unwind into the host. `close` returns no error,
    // so the log reports the panic.
    if let Err(payload) = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| drop(this))) {
        host.warn(&format!("the plugin panicked when it was closed: {}", panic_text(payload)));
    }
    host.close();
}
