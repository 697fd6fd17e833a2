//! An open output of a plugin.

use std::ffi::c_void;
use std::marker::PhantomData;
use std::rc::Rc;
use std::sync::Arc;

use lumistack_display::Display;
use lumistack_plugin::abi::{HostServices, Str};
use lumistack_plugin::wire::call;
use lumistack_plugin::{PluginError, Port, Time};
use serde_json::Value;

use crate::serve::functions::Functions;
use crate::serve::lend::{Lent, OutputData};
use crate::serve::plugin::{Plugin, PluginKind};
use crate::serve::services::{Services, table};

/// An open output of a plugin. Dropping the output closes it. An output that was not finished is
/// discarded.
pub struct Output<'a> {
    functions: Arc<dyn Functions>,
    instance: *mut c_void,
    id: String,
    ports: Vec<Port>,
    display: &'a Display,
    /// The plugin keeps a pointer to this table.
    _table: Rc<HostServices>,
    _services: PhantomData<&'a ()>,
}

// SAFETY: the interface allows calls of an output's functions from any thread.
unsafe impl Send for Output<'_> {}
// SAFETY: a shared output offers `submit`, `command` and `run`, which may be called concurrently.
unsafe impl Sync for Output<'_> {}

impl<'a> Output<'a> {
    /// Opens an output. `params` is an object with any of the plugin's parameters.
    ///
    /// # Errors
    /// [`PluginError::Refused`] for parameters that the plugin's schema refuses; otherwise as
    /// [`open_unresolved`](Self::open_unresolved).
    pub fn open<S: Services>(
        plugin: &Plugin,
        services: &'a S,
        params: &Value,
        display: &'a Display,
    ) -> Result<Self, PluginError> {
        let resolved = plugin.info().schema.resolve(params)?;
        Self::open_unresolved(plugin, services, &Value::Object(resolved).to_string(), display)
    }

    /// Opens an output as [`open`](Self::open) does, but leaves all checks of the parameters to the
    /// plugin. A host in another language may do the same.
    ///
    /// # Errors
    /// If the plugin is no output; otherwise the plugin's error.
    pub fn open_unresolved<S: Services>(
        plugin: &Plugin,
        services: &'a S,
        params_json: &str,
        display: &'a Display,
    ) -> Result<Self, PluginError> {
        let display_json = serde_json::to_string(display).map_err(|error| PluginError::failed("display", error))?;
        // This is no `Box`, since a move of a `Box` would invalidate the plugin's pointer by Rust's
        // rules of aliasing.
        let table = Rc::new(table(services));
        let functions = plugin.of_kind(PluginKind::Output)?.clone();
        let mut instance = std::ptr::null_mut();
        // SAFETY: the table lives until `close` has returned (fields are dropped after `drop`); the
        // other arguments are lent for the call.
        call(|error| unsafe {
            functions.open(Rc::as_ptr(&table), Str::new(params_json), Str::new(&display_json), &mut instance, error)
        })?;
        Ok(Self {
            functions,
            instance,
            id: plugin.info().id.clone(),
            ports: plugin.info().ports.clone(),
            display,
            _table: table,
            _services: PhantomData,
        })
    }

    /// Submits one time step, from any thread.
    ///
    /// # Errors
    /// If the plugin does not accept the port, the data do not match the display, or the plugin
    /// fails.
    pub fn submit(&self, time: Time, data: OutputData<'_>) -> Result<(), PluginError> {
        if !self.ports.contains(&data.port()) {
            let accepted = self.ports.iter().map(Port::to_string).collect::<Vec<_>>().join(", ");
            return Err(PluginError::Refused(format!(
                "expected data that `{}` accepts ({accepted}), found {}",
                self.id,
                data.port()
            )));
        }
        let lent = Lent::new(self.display, data)?;
        let data = lent.to_abi();
        let time = time.to_abi();
        // SAFETY: the handle is the plugin's own; time and data are lent for the call.
        call(|error| unsafe { self.functions.submit(self.instance, &time, &data, error) })
    }

    /// Runs a presenter until the user closes it. Callers call this function on the main thread.
    ///
    /// # Errors
    /// If the plugin is no presenter, or fails.
    pub fn run(&self) -> Result<(), PluginError> {
        // SAFETY: the handle is the plugin's own.
        call(|error| unsafe { self.functions.run(self.instance, error) })
    }

    /// Sends a command to a presenter while [`run`](Self::run) runs, from any thread.
    ///
    /// # Errors
    /// If the plugin accepts no commands, or if this command is refused or fails.
    pub fn command(&self, command: &Value) -> Result<(), PluginError> {
        let json = command.to_string();
        // SAFETY: the handle is the plugin's own; the text is lent for the call.
        call(|error| unsafe { self.functions.command(self.instance, Str::new(&json), error) })
    }

    /// Finishes the output: no more data follow.
    ///
    /// # Errors
    /// The plugin's error.
    pub fn finish(self) -> Result<(), PluginError> {
        // SAFETY: the handle is the plugin's own; `self` is consumed, so no submit is running.
        call(|error| unsafe { self.functions.finish(self.instance, error) })
    }
}

impl Drop for Output<'_> {
    fn drop(&mut self) {
        // SAFETY: the handle is released once; the table is dropped after this.
        unsafe { self.functions.close(self.instance) };
    }
}
