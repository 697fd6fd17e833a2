//! The C functions of a plugin, which run in this process or in another process.

use std::ffi::c_void;

use lumistack_plugin::PluginError;
use lumistack_plugin::abi::{
    Assets, ByteSink, Data, ErrorSink, FieldSink, HostServices, ImporterVtable, NodeVtable, OutputVtable, SourceVtable,
    StackSink, Status, Str, Time,
};
use lumistack_plugin::wire::answer;

/// The functions of the interface's tables, for every kind of plugin. An implementation calls a
/// plugin in this process, or forwards the calls to another process. Functions that do not belong
/// to the plugin's kind return [`Status::REFUSED`].
///
/// # Safety
/// An implementation follows the interface's rules for a plugin. It does not use borrowed arguments
/// after the call has returned; `host` of [`open`](Self::open) may be used until
/// [`close`](Self::close). Callers follow the rules for a host in the documentation of the tables.
#[expect(
    clippy::missing_safety_doc,
    reason = "the documentation of the tables states the safety rules of each function"
)]
pub unsafe trait Functions: Send + Sync {
    /// Calls [`ImporterVtable::import`].
    unsafe fn import(
        &self,
        host: *const HostServices,
        params_json: Str,
        file: Str,
        assets: *const Assets,
        scene: *const ByteSink,
        error: *const ErrorSink,
    ) -> Status;

    /// Calls [`SourceVtable::make`].
    unsafe fn make_field(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const Time,
        field: *const FieldSink,
        error: *const ErrorSink,
    ) -> Status;

    /// Calls [`NodeVtable::make`].
    unsafe fn make_stack(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const Time,
        data: *const Data,
        stack: *const StackSink,
        error: *const ErrorSink,
    ) -> Status;

    /// Calls [`OutputVtable::open`].
    unsafe fn open(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        instance: *mut *mut c_void,
        error: *const ErrorSink,
    ) -> Status;

    /// Calls [`OutputVtable::submit`].
    unsafe fn submit(
        &self,
        instance: *mut c_void,
        time: *const Time,
        data: *const Data,
        error: *const ErrorSink,
    ) -> Status;

    /// Calls [`OutputVtable::run`].
    unsafe fn run(&self, instance: *mut c_void, error: *const ErrorSink) -> Status;

    /// Calls [`OutputVtable::command`].
    unsafe fn command(&self, instance: *mut c_void, command_json: Str, error: *const ErrorSink) -> Status;

    /// Calls [`OutputVtable::finish`].
    unsafe fn finish(&self, instance: *mut c_void, error: *const ErrorSink) -> Status;

    /// Calls [`OutputVtable::close`].
    unsafe fn close(&self, instance: *mut c_void);
}

/// The table of C functions of a plugin in this process.
#[derive(Clone, Copy)]
pub(crate) enum Vtable {
    Importer(&'static ImporterVtable),
    Source(&'static SourceVtable),
    Node(&'static NodeVtable),
    Output(&'static OutputVtable),
}

impl Vtable {
    fn output<F>(&self, function: impl FnOnce(&OutputVtable) -> Option<F>) -> Option<F> {
        match self {
            Self::Output(table) => function(table),
            _ => None,
        }
    }
}

/// Reports a function that the plugin lacks.
///
/// # Safety
/// `error` is null or a valid sink.
unsafe fn missing(error: *const ErrorSink) -> Status {
    // SAFETY: guaranteed by the caller.
    unsafe { answer(error, || Err(PluginError::Refused("the plugin does not have the called function".into()))) }
}

// SAFETY: each call is forwarded to the plugin's function with the caller's arguments, and nothing
// is kept.
#[expect(
    clippy::undocumented_unsafe_blocks,
    reason = "every function relies on its caller, as the comment above the impl states"
)]
unsafe impl Functions for Vtable {
    unsafe fn import(
        &self,
        host: *const HostServices,
        params_json: Str,
        file: Str,
        assets: *const Assets,
        scene: *const ByteSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: guaranteed by the caller, here and in the other functions.
        match self {
            Self::Importer(ImporterVtable { import: Some(import), .. }) => unsafe {
                import(host, params_json, file, assets, scene, error)
            },
            _ => unsafe { missing(error) },
        }
    }

    unsafe fn make_field(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const Time,
        field: *const FieldSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        match self {
            Self::Source(SourceVtable { make: Some(make), .. }) => unsafe {
                make(host, params_json, display_json, time, field, error)
            },
            _ => unsafe { missing(error) },
        }
    }

    unsafe fn make_stack(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const Time,
        data: *const Data,
        stack: *const StackSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        match self {
            Self::Node(NodeVtable { make: Some(make), .. }) => unsafe {
                make(host, params_json, display_json, time, data, stack, error)
            },
            _ => unsafe { missing(error) },
        }
    }

    unsafe fn open(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        instance: *mut *mut c_void,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        match self.output(|table| table.open) {
            Some(open) => unsafe { open(host, params_json, display_json, instance, error) },
            None => unsafe { missing(error) },
        }
    }

    unsafe fn submit(
        &self,
        instance: *mut c_void,
        time: *const Time,
        data: *const Data,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        match self.output(|table| table.submit) {
            Some(submit) => unsafe { submit(instance, time, data, error) },
            None => unsafe { missing(error) },
        }
    }

    unsafe fn run(&self, instance: *mut c_void, error: *const ErrorSink) -> Status {
        // SAFETY: as in `import`.
        match self.output(|table| table.run) {
            Some(run) => unsafe { run(instance, error) },
            None => unsafe { missing(error) },
        }
    }

    unsafe fn command(&self, instance: *mut c_void, command_json: Str, error: *const ErrorSink) -> Status {
        // SAFETY: as in `import`.
        match self.output(|table| table.command) {
            Some(command) => unsafe { command(instance, command_json, error) },
            None => unsafe { missing(error) },
        }
    }

    unsafe fn finish(&self, instance: *mut c_void, error: *const ErrorSink) -> Status {
        // SAFETY: as in `import`.
        match self.output(|table| table.finish) {
            Some(finish) => unsafe { finish(instance, error) },
            None => unsafe { missing(error) },
        }
    }

    unsafe fn close(&self, instance: *mut c_void) {
        if let Some(close) = self.output(|table| table.close) {
            // SAFETY: as in `import`.
            unsafe { close(instance) };
        }
    }
}
