//! Origins of plugins.

use std::fmt;
use std::path::PathBuf;

/// The origin of a plugin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The plugin is compiled into the program.
    CompiledIn,
    /// The plugin is in this shared library.
    Library(PathBuf),
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CompiledIn => f.write_str("compiled in"),
            Self::Library(path) => write!(f, "{}", path.display()),
        }
    }
}
