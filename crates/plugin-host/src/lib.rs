//! Plugin registry, and the host proper: outputs that end as files in a folder, and presenters ([`present`]).
//!
//! ```text
//! Registry ──get("images")──▶ Plugin ──run_output──▶ open, submit, finish  through the plugin's C functions
//!                                                       │ file_open / append / commit
//!                                                       ▼
//!                                  .NAME.partial/  ──only after finish succeeded──▶  NAME/
//! ```
//!
//! Importers, sources and nodes write no files; what they make comes back checked ([`import_scene`], [`make_field`], [`make_stack`]).
//!
//! With the feature `dynamic` the registry also loads plugins from shared libraries; see [`PluginPaths`]. They go through the same
//! descriptor and the same functions as those that are compiled in, in a child process; see [`Launcher`].
//!
//! Whatever a plugin does (fails midway, panics, is cancelled, names a file outside its folder), the output's folder keeps what it
//! had, and the program goes on; so it does where a plugin of a library crashes or hangs.

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
pub use present::{Asked, PresentContext, Told, present};
pub use registry::Registry;
pub use run::{OpenOutput, OutputContext, run_output, with_output};

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

pub use lumistack_plugin::{Choice, Kind, Param, ParamError, PluginError, Port, Schema, Solution, Step, Time};
pub use serve::{Made, NodeData, OutputData, Plugin, PluginInfo, PluginKind, ReadAsset};
