//! Plugin registry and host: outputs that write files into a folder, and presenters ([`present`]).
//!
//! ```text
//! Registry ──get("images")──▶ Plugin ──run_output──▶ open, submit, finish (C functions)
//!                                                     │ file_open / append / commit
//!                                                     ▼
//!                                  .NAME.partial/  ──after finish succeeded──▶  NAME/
//! ```
//!
//! Importers, sources and nodes write no files. Their results are checked and returned
//! ([`import_scene`], [`make_field`], [`make_stack`]).
//!
//! With the feature `dynamic` the registry also loads plugins from shared libraries; see
//! [`PluginPaths`]. Such plugins have the same descriptor and functions as compiled-in plugins, but
//! run in a child process; see [`Launcher`].
//!
//! If a plugin fails, panics, is cancelled or names a file outside its folder, the output's folder
//! stays unchanged and the program continues. A plugin in a library may even crash or hang, with
//! the same result.

mod built_in;
mod check;
#[cfg(feature = "dynamic")]
mod child;
mod disk;
#[cfg(feature = "dynamic")]
mod dynamic;
mod error;
mod make;
mod origin;
mod present;
mod publish;
mod registry;
mod run;
pub mod serve;

pub use built_in::{PLUGIN_FINGERPRINT, fingerprint_of};
pub use check::check_output;
#[cfg(feature = "dynamic")]
pub use child::{Launcher, Limits, plugin_child};
#[cfg(feature = "dynamic")]
pub use dynamic::PluginPaths;
pub use error::{HostError, LoadError};
pub use make::{import_scene, make_field, make_stack};
pub use origin::Origin;
pub use present::{PresentContext, PresenterInput, PresenterOutput, present};
pub use registry::Registry;
pub use run::{OpenOutput, OutputContext, run_output, with_output};

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

pub use lumistack_plugin::{Choice, Kind, Param, ParamError, PluginError, Port, Schema, Solution, Step, Time};
pub use serve::{Made, NodeData, OutputData, Plugin, PluginInfo, PluginKind, ReadAsset};
