//! What can go wrong with plugins and their outputs.

use std::io;
use std::path::{Path, PathBuf};

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
    /// A plugin that cannot be used.
    #[error("plugin cannot be used: {0}")]
    BadPlugin(PluginError),
    /// Two plugins of one id.
    #[error("two plugins have the id `{0}`")]
    DuplicatePlugin(String),
    /// The plugin does not take these parameters or data.
    #[error("output `{plugin}`: {reason}")]
    Refused {
        /// The plugin.
        plugin: String,
        /// What it does not take.
        reason: String,
    },
    /// The plugin failed.
    #[error("output `{plugin}` failed: {reason}")]
    Failed {
        /// The plugin.
        plugin: String,
        /// Why.
        reason: String,
    },
    /// The plugin panicked.
    #[error("output `{plugin}` panicked, which is a mistake in the plugin: {reason}")]
    Panicked {
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

impl HostError {
    /// For `map_err` on file system calls.
    pub(crate) fn io(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, doing, source }
    }

    /// An error that the plugin with this id returned.
    pub(crate) fn of_plugin(id: &str, error: PluginError) -> Self {
        let plugin = id.to_string();
        match error {
            PluginError::Cancelled => Self::Cancelled,
            PluginError::Refused(reason) => Self::Refused { plugin, reason },
            PluginError::Failed(reason) => Self::Failed { plugin, reason },
            PluginError::Panicked(reason) => Self::Panicked { plugin, reason },
        }
    }
}
