//! What can go wrong with plugins and their outputs.

use std::io;
use std::path::{Path, PathBuf};

use crate::serve::PluginKind;
use lumistack_plugin::PluginError;
use thiserror::Error;

/// Why an output was not written. Nothing new is in its folder then.
#[derive(Debug, Error)]
pub enum HostError {
    /// No plugin has this id.
    #[error("unknown plugin `{id}`{}", nearest.as_ref().map_or_else(|| format!("; expected one of {}", known.join(", ")), |n| format!("; did you mean `{n}`?")))]
    UnknownPlugin {
        /// What was asked for.
        id: String,
        /// The id that is spelled most like it.
        nearest: Option<String>,
        /// All ids.
        known: Vec<String>,
    },
    /// A plugin of another kind.
    #[error("plugin `{id}`: expected {expected}, found {found}")]
    OtherKind {
        /// The plugin.
        id: String,
        /// What was needed.
        expected: PluginKind,
        /// What it is.
        found: PluginKind,
    },
    /// A plugin that cannot be used.
    #[error("plugin cannot be used: {0}")]
    BadPlugin(PluginError),
    /// A plugin whose library cannot be used.
    #[error("plugin `{id}` cannot be used: {reason}")]
    NotLoaded {
        /// The plugin.
        id: String,
        /// The library, and what is wrong with it.
        reason: String,
    },
    /// Two plugins of one id.
    #[error("two plugins have the id `{0}`")]
    DuplicatePlugin(String),
    /// The plugin does not take these parameters or data.
    #[error("{} `{plugin}`: {reason}", kind.name())]
    Refused {
        /// Its kind.
        kind: PluginKind,
        /// The plugin.
        plugin: String,
        /// What it does not take.
        reason: String,
    },
    /// The plugin failed.
    #[error("{} `{plugin}` failed: {reason}", kind.name())]
    Failed {
        /// Its kind.
        kind: PluginKind,
        /// The plugin.
        plugin: String,
        /// Why.
        reason: String,
    },
    /// The plugin panicked.
    #[error("{} `{plugin}` panicked, which is a mistake in the plugin: {reason}", kind.name())]
    Panicked {
        /// Its kind.
        kind: PluginKind,
        /// The plugin.
        plugin: String,
        /// The panic's message.
        reason: String,
    },
    /// The plugin said that it is done while files were not.
    #[error("output `{plugin}` finished without completing {}", files.join(", "))]
    Uncommitted {
        /// The plugin.
        plugin: String,
        /// Files that were neither committed nor aborted.
        files: Vec<String>,
    },
    /// The user asked to stop.
    #[error("cancelled")]
    Cancelled,
    /// The output's folder cannot be one.
    #[error("{}: expected a folder or a free name for one, found {found}", path.display())]
    NotAFolder {
        /// The path.
        path: PathBuf,
        /// What is there.
        found: &'static str,
    },
    /// The file system refused something.
    #[error("{}: cannot {doing}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried.
        doing: &'static str,
        /// Why not.
        source: io::Error,
    },
}

/// Why a library gave no plugin. The program does without it.
#[derive(Debug, Error)]
pub enum LoadError {
    /// There is no such file or folder, or it cannot be read.
    #[error("{}: expected a plugin or a folder of plugins, found: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// The name is not that of a library of plugins.
    #[error("{}: expected a file named `{expected}`", path.display())]
    Name {
        /// The file.
        path: PathBuf,
        /// What a plugin's file is called.
        expected: String,
    },
    /// Another kind of file.
    #[error("{}: expected a shared library, found {found}", path.display())]
    NotALibrary {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: String,
    },
    /// A library of another kind of machine.
    #[error("{}: expected a library for {expected}, found one for {found}", path.display())]
    Machine {
        /// The file.
        path: PathBuf,
        /// What this program runs on.
        expected: String,
        /// What the library was built for.
        found: String,
    },
    /// The system's loader does not take it.
    #[error("{}: cannot be loaded: {reason}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The loader's answer.
        reason: String,
    },
    /// No entry function.
    #[error("{}: expected the function `{symbol}`, found none of that name", path.display())]
    NoEntry {
        /// The file.
        path: PathBuf,
        /// The function's name.
        symbol: String,
    },
    /// The descriptor is of another version, or says nothing usable.
    #[error("{}: {reason}", path.display())]
    Descriptor {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: PluginError,
    },
    /// The name of the entry function and the descriptor differ.
    #[error("{}: expected a plugin `{expected}` by the name of its entry function, found `{found}`", path.display())]
    OtherId {
        /// The file.
        path: PathBuf,
        /// By the function's name.
        expected: String,
        /// By the descriptor.
        found: String,
    },
    /// The process that loaded it ended, or had to be ended.
    #[error("{}: {cause}", path.display())]
    Ended {
        /// The file.
        path: PathBuf,
        /// How it ended, and while what.
        cause: String,
    },
    /// The program that uses this crate has not said how a process for a plugin is started.
    #[error("{}: no program is known that loads plugins for this one", path.display())]
    NoLauncher {
        /// The file.
        path: PathBuf,
    },
    /// A limit in the environment makes no sense.
    #[error("{variable}: expected a number of seconds, 0 for any time, found `{found}`")]
    Setting {
        /// The variable.
        variable: &'static str,
        /// Its value.
        found: String,
    },
    /// The id is taken; the plugin that was there first stays.
    #[error("{}: another plugin has the id `{id}` already: {first}", path.display())]
    Duplicate {
        /// The file.
        path: PathBuf,
        /// The id.
        id: String,
        /// Where the plugin comes from that keeps the id.
        first: crate::Origin,
    },
}

impl HostError {
    /// For `map_err` on file system calls.
    pub(crate) fn io(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, doing, source }
    }

    /// An error that the plugin with this id returned.
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
