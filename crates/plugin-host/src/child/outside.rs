//! The program's side of a child process: forwards every function of the plugin to a child.

use std::ffi::c_void;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_plugin::abi::{
    Assets, ByteSink, Data, ErrorSink, FieldSink, HostServices, StackSink, Status, Str, level,
};
use lumistack_plugin::wire::{keeping, lent_lossy};
use lumistack_plugin::{PluginError, abi};

use super::launch::{Launcher, Limits};
use super::protocol::{self, Call, Loaded};
use super::requests::{Lent, is_cancelled};
use super::session::{Owner, Stopped};
use crate::LoadError;
use crate::serve::{Functions, Plugin, PluginInfo};

/// Loads a library in a child, and returns the library's plugin `id`. Later, every open output and
/// every call that makes data starts its own child.
pub(crate) fn probe(library: &Path, id: &str, launcher: Launcher, limits: Limits) -> Result<Plugin, LoadError> {
    let path = || library.to_path_buf();
    // The path must be absolute, since the loader searches other folders for a bare name.
    let absolute = std::path::absolute(library).map_err(|source| LoadError::Read { path: path(), source })?;
    let remote = Remote { library: absolute, id: id.into(), launcher, limits };
    let (_session, loaded) = match remote.start(&|| false) {
        Ok(started) => started,
        Err(Stopped::Cancelled) => unreachable!("loading a library is never cancelled"),
        Err(Stopped::Died(cause)) => return Err(LoadError::Ended { path: path(), cause }),
    };
    let info = plugin_of(loaded, library, id)?;
    Plugin::elsewhere(info, Arc::new(remote)).map_err(|reason| LoadError::Descriptor { path: path(), reason })
}

/// Returns the plugin `id` that a child has loaded, or the error of loading the library.
fn plugin_of(loaded: Loaded, library: &Path, id: &str) -> Result<PluginInfo, LoadError> {
    let path = library.to_path_buf();
    match loaded {
        Loaded::Plugin(info) if info.id == id => Ok(info),
        Loaded::Plugin(PluginInfo { id: found, .. }) | Loaded::OtherId(found) => {
            Err(LoadError::OtherId { path, expected: id.into(), found })
        }
        Loaded::Open(reason) => Err(LoadError::Open { path, reason }),
        Loaded::NoEntry(symbol) => Err(LoadError::NoEntry { path, symbol }),
        Loaded::Descriptor(reason) => Err(LoadError::Descriptor { path, reason: PluginError::Refused(reason) }),
    }
}

/// A plugin whose functions run in child processes.
struct Remote {
    library: PathBuf,
    id: String,
    launcher: Launcher,
    limits: Limits,
}

impl Remote {
    /// Starts a child and waits for the result of loading the library.
    fn start(&self, cancelled: &dyn Fn() -> bool) -> Result<(Owner, Loaded), Stopped> {
        Owner::start(&self.library, &self.id, &self.launcher, self.limits, cancelled)
    }

    /// Starts a child for calls. Fails if the library cannot be loaded, since its file may have
    /// changed after [`probe`].
    fn ready(&self, cancelled: &dyn Fn() -> bool) -> Result<Owner, Stopped> {
        let (owner, loaded) = self.start(cancelled)?;
        plugin_of(loaded, &self.library, &self.id).map_err(|error| Stopped::Died(error.to_string()))?;
        Ok(owner)
    }

    /// Runs one function of the plugin in a child that is started for this call.
    ///
    /// # Safety
    /// All borrowed arguments are valid until this returns; `error` is null or a valid sink.
    unsafe fn once(
        &self,
        host: *const HostServices,
        lent: Lent,
        what: Call,
        doing: &str,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: guaranteed by the caller.
        unsafe {
            match self.ready(&|| is_cancelled(host)) {
                Ok(owner) => owner.call(host, lent, what, doing, error),
                Err(stopped) => stopped.report(error),
            }
        }
    }
}

/// Copies a text that the host lends. The host's texts are UTF-8.
///
/// # Safety
/// The text is lent for the call.
unsafe fn text(text: Str) -> String {
    // SAFETY: guaranteed by the caller.
    unsafe { lent_lossy(text) }.into_owned()
}

/// # Safety
/// `time` is valid.
unsafe fn time_of(time: *const abi::Time) -> protocol::Time {
    // SAFETY: guaranteed by the caller.
    unsafe { protocol::Time { index: (*time).index, seconds_bits: (*time).seconds.to_bits() } }
}

/// # Safety
/// `data` is valid.
unsafe fn data_of(data: *const Data) -> protocol::Data {
    // SAFETY: guaranteed by the caller.
    unsafe { protocol::Data { port: (*data).port, description: text((*data).description_json) } }
}

// SAFETY: borrowed data are kept in the session while the call runs, and removed before it returns.
// The host's table of `open` is removed when the session ends. Every use holds the lock that the
// removal takes.
unsafe impl Functions for Remote {
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
        unsafe {
            let (params, file) = (text(params_json), text(file));
            let doing = format!("the plugin read `{file}`");
            let lent = Lent { assets, scene, ..Lent::nothing() };
            self.once(host, lent, Call::Import { params, file }, &doing, error)
        }
    }

    unsafe fn make_field(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const abi::Time,
        field: *const FieldSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        unsafe {
            let lent = Lent { field, ..Lent::nothing() };
            let what = Call::MakeField { params: text(params_json), display: text(display_json), time: time_of(time) };
            self.once(host, lent, what, "the plugin made a light field", error)
        }
    }

    unsafe fn make_stack(
        &self,
        host: *const HostServices,
        params_json: Str,
        display_json: Str,
        time: *const abi::Time,
        data: *const Data,
        stack: *const StackSink,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: as in `import`.
        unsafe {
            let lent = Lent { data, stack, ..Lent::nothing() };
            let (params, display) = (text(params_json), text(display_json));
            let what = Call::MakeStack { params, display, time: time_of(time), data: data_of(data) };
            self.once(host, lent, what, "the plugin made a layer stack", error)
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
        // SAFETY: guaranteed by the caller; the host provides memory for the handle.
        unsafe {
            let owner = match self.ready(&|| is_cancelled(host)) {
                Ok(owner) => owner,
                Err(stopped) => return stopped.report(error),
            };
            let (params, display) = (text(params_json), text(display_json));
            let what = Call::Open { params, display, port: (*host).port };
            let status = owner.call(host, Lent::nothing(), what, "the plugin was opened", error);
            if status == Status::OK {
                *instance = Box::into_raw(Box::new(Opened { owner, host })).cast();
            }
            status
        }
    }

    unsafe fn submit(
        &self,
        instance: *mut c_void,
        time: *const abi::Time,
        data: *const Data,
        error: *const ErrorSink,
    ) -> Status {
        // SAFETY: guaranteed by the caller. `instance` is a handle that `open` returned.
        unsafe {
            let opened = &*instance.cast::<Opened>();
            let lent = Lent { data, ..Lent::nothing() };
            let what = Call::Submit { time: time_of(time), data: data_of(data) };
            let doing = format!("the plugin processed time step {}", (*time).index);
            opened.owner.call(opened.host, lent, what, &doing, error)
        }
    }

    unsafe fn run(&self, instance: *mut c_void, error: *const ErrorSink) -> Status {
        // SAFETY: as in `submit`.
        unsafe {
            let opened = &*instance.cast::<Opened>();
            opened.owner.call(opened.host, Lent::nothing(), Call::Run, "the plugin presented", error)
        }
    }

    unsafe fn command(&self, instance: *mut c_void, command_json: Str, error: *const ErrorSink) -> Status {
        // SAFETY: as in `submit`.
        unsafe {
            let opened = &*instance.cast::<Opened>();
            let what = Call::Command { json: text(command_json) };
            opened.owner.call(opened.host, Lent::nothing(), what, "the plugin executed a command", error)
        }
    }

    unsafe fn finish(&self, instance: *mut c_void, error: *const ErrorSink) -> Status {
        // SAFETY: as in `submit`.
        unsafe {
            let opened = &*instance.cast::<Opened>();
            opened.owner.call(opened.host, Lent::nothing(), Call::Finish, "the plugin finished", error)
        }
    }

    unsafe fn close(&self, instance: *mut c_void) {
        // SAFETY: guaranteed by the caller. `instance` is a handle that `open` returned, and is
        // released once.
        unsafe {
            let Opened { owner, host } = *Box::from_raw(instance.cast::<Opened>());
            // A child that has ended cannot be closed. Any call that the end interrupted has
            // reported the end.
            if owner.0.state().ended {
                return;
            }
            let mut reason = String::new();
            let status = owner.call(host, Lent::nothing(), Call::Close, "the plugin was closed", &keeping(&mut reason));
            if status == Status::FAILED {
                ((*host).log)((*host).context, level::WARN, Str::new(&reason));
            }
        }
    }
}

/// An open output. The handle that `open` returns points to this struct.
struct Opened {
    owner: Owner,
    /// The host's table, valid until `close`.
    host: *const HostServices,
}
