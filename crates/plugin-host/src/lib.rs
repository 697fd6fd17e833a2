//! Plugin registry, and the host proper: outputs that end as files in a folder.
//!
//! ```text
//! Registry ──get("images")──▶ Plugin ──run_output──▶ open, submit, (run,) finish  through the plugin's C functions
//!                                                       │ file_open / append / commit
//!                                                       ▼
//!                                  .NAME.partial/  ──only after finish succeeded──▶  NAME/
//! ```
//!
//! Whatever a plugin does (fails midway, panics, is cancelled, names a file outside its folder), the output's folder keeps what it
//! had, and the program goes on.

mod disk;
mod error;
mod publish;
mod registry;
mod run;

pub use error::HostError;
pub use registry::Registry;
pub use run::{OpenOutput, OutputContext, run_output, with_output};

pub use lumistack_plugin::serve::{OutputData, Plugin, PluginInfo, PluginKind};
pub use lumistack_plugin::{Choice, Kind, Param, ParamError, PluginError, Port, Schema, Time};
