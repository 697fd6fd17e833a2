//! Errors of plugins and their outputs.

use std::io;
use std::path::{Path, PathBuf};

use crate::serve::PluginKind;
use lumistack_plugin::PluginError;
use thiserror::Error;

/// A plugin failed or cannot be used. If it is an output, its folder contains no new files.
#[derive(Debug, Error)]
pub enum HostError {
    /// No plugin has this id.
    #[error("unknown plugin `{id}`{}", nearest.as_ref().map_or_else(|| format!("; expected one of {}, or a plugin in a library that --plugin-path names", known.join(", ")), |n| format!("; did you mean `{n}`?")))]
    UnknownPlugin {
        /// The requested id, which no plugin has.
        id: String,
        /// The id of a plugin that is most similar to the requested id.
        nearest: Option<String>,
        /// The ids of all plugins.
        known: Vec<String>,
    },
    /// The plugin is of another kind.
    #[error("plugin `{id}`: expected {expected}, found {found}")]
    OtherKind {
        /// The plugin's id.
        id: String,
        /// The kind of plugin that the caller needs.
        expected: PluginKind,
        /// The kind of the plugin with this id.
        found: PluginKind,
    },
    /// A compiled-in plugin cannot be used.
    #[error("a built-in plugin cannot be used: {0}")]
    BadPlugin(PluginError),
    /// The plugin's library cannot be used.
    #[error("plugin `{id}` cannot be used: {reason}")]
    NotLoaded {
        /// The plugin's id.
        id: String,
        /// The library and its error.
        reason: String,
    },
    /// Two plugins have the same id.
    #[error("plugin `{0}`: expected an id that no other built-in plugin has, found two plugins with this id")]
    DuplicatePlugin(String),
    /// The plugin refuses these parameters or data.
    #[error("{} `{plugin}`: {reason}", kind.name())]
    Refused {
        /// The plugin's kind.
        kind: PluginKind,
        /// The plugin's id.
        plugin: String,
        /// The refused value and the reason.
        reason: String,
    },
    /// The plugin failed.
    #[error("{} `{plugin}` failed: {reason}", kind.name())]
    Failed {
        /// The plugin's kind.
        kind: PluginKind,
        /// The plugin's id.
        plugin: String,
        /// The error message of the plugin.
        reason: String,
    },
    /// The plugin panicked.
    #[error("{} `{plugin}` panicked, which is a mistake in the plugin: {reason}", kind.name())]
    Panicked {
        /// The plugin's kind.
        kind: PluginKind,
        /// The plugin's id.
        plugin: String,
        /// The message of the panic.
        reason: String,
    },
    /// The plugin finished while files were incomplete.
    #[error("output `{plugin}` finished, but did not complete the files {}", files.join(", "))]
    Uncommitted {
        /// The plugin's id.
        plugin: String,
        /// Files that were neither committed nor aborted.
        files: Vec<String>,
    },
    /// The user cancelled.
    #[error("cancelled")]
    Cancelled,
    /// The output's path cannot be a folder.
    #[error("{}: expected a folder, or a name for a new folder, found {found}", path.display())]
    NotAFolder {
        /// The path where the output's folder should be.
        path: PathBuf,
        /// The kind of file that exists at this path.
        found: &'static str,
    },
    /// The file system returned an error.
    #[error("{}: cannot {doing}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The operation that failed, for example `replace`.
        doing: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// A library, a search path or a limit that cannot be used. The program continues without the
/// library or path, or with the default limits.
#[derive(Debug, Error)]
pub enum LoadError {
    /// There is no such file or folder, or it cannot be read.
    #[error("{}: cannot read this plugin library, or folder of plugin libraries: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A folder that the user named contains no plugin library.
    #[error("{}: expected files named like `{expected}`, found none; `cargo build --release` writes a plugin's library to `target/release`", path.display())]
    NoLibraries {
        /// The folder.
        path: PathBuf,
        /// The expected form of file names.
        expected: String,
    },
    /// The file does not have the name of a plugin library.
    #[error("{}: expected a file named like `{expected}`, with NAME of lower-case letters, digits and underscores, beginning with a letter, found another name", path.display())]
    Name {
        /// The path of the file.
        path: PathBuf,
        /// The expected file name.
        expected: String,
    },
    /// The file is of another kind.
    #[error("{}: expected a shared library, found {found}", path.display())]
    NotALibrary {
        /// The path of the file.
        path: PathBuf,
        /// A description of the file that was found.
        found: String,
    },
    /// The library is for another machine.
    #[error("{}: expected a library for {expected}, found a library for {found}", path.display())]
    Machine {
        /// The path of the file.
        path: PathBuf,
        /// The machine on which the program runs.
        expected: String,
        /// The machine for which the library was built.
        found: String,
    },
    /// The system's loader refuses the library.
    #[error("{}: cannot be loaded: {reason}", path.display())]
    Open {
        /// The path of the file.
        path: PathBuf,
        /// The message of the system's loader.
        reason: String,
    },
    /// The entry function is missing.
    #[error("{}: expected the exported function `{symbol}`, found no function of that name", path.display())]
    NoEntry {
        /// The path of the file.
        path: PathBuf,
        /// The name of the missing function.
        symbol: String,
    },
    /// The descriptor is missing, of another major version, or invalid.
    #[error("{}: {reason}", path.display())]
    Descriptor {
        /// The path of the file.
        path: PathBuf,
        /// The mismatch or the invalid part.
        reason: PluginError,
    },
    /// The name of the entry function and the descriptor differ.
    #[error("{}: expected the id `{expected}`, from the name of the entry function, found the id `{found}` in the descriptor", path.display())]
    OtherId {
        /// The path of the file.
        path: PathBuf,
        /// The id in the entry function's name.
        expected: String,
        /// The id in the descriptor.
        found: String,
    },
    /// The process that loads the library could not be started, ended, or was ended.
    #[error("{}: {cause}", path.display())]
    Ended {
        /// The path of the file.
        path: PathBuf,
        /// The cause. If the process was started, also the operation that ran.
        cause: String,
    },
    /// Neither the program nor the search paths set a launcher of plugin processes.
    #[error("{}: expected a program that sets a `Launcher`, since plugin libraries run in processes of their own, found a program without a `Launcher`", path.display())]
    NoLauncher {
        /// The path of the file.
        path: PathBuf,
    },
    /// A limit in the environment is invalid.
    #[error("{variable}: expected a number of seconds, 0 for no limit, found `{found}`")]
    Setting {
        /// The name of the environment variable.
        variable: &'static str,
        /// The value of the environment variable.
        found: String,
    },
    /// The id is in use; the first plugin is kept.
    #[error("{}: expected an id that no other plugin has, found `{id}`, the id of another plugin ({first})", path.display())]
    Duplicate {
        /// The path of the file.
        path: PathBuf,
        /// The id that both plugins have.
        id: String,
        /// Origin of the first plugin.
        first: crate::Origin,
    },
}

impl HostError {
    /// Makes a function for `map_err` that converts the error of a file system call.
    pub(crate) fn io(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, doing, source }
    }

    /// Converts an error that the plugin `id` returned.
    pub(crate) fn of_plugin(kind: PluginKind, id: &str, error: PluginError) -> Self {
        let plugin = id.to_string();
        match error {
            PluginError::Cancelled => Self::Cancelled,
            PluginError::Refused(reason) => Self::Refused { kind, plugin, reason },
            PluginError::Failed(reason) => Self::Failed { kind, plugin, reason },
            PluginError::Panicked(reason) => Self::Panicked { kind, plugin, reason },
        }
    }
}
