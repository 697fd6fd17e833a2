//! The host's side of the plugin interface. It describes plugins, lends data, provides services,
//! and calls plugins through their C functions. Compiled-in and loaded plugins are called in the
//! same way.
//!
//! The other modules of this crate add a registry and files on disk. The test kit adds files in
//! memory.

mod functions;
mod lend;
mod makers;
mod output;
mod path;
mod plugin;
mod services;

pub use functions::Functions;
pub use lend::{NodeData, OutputData};
pub use makers::{Made, ReadAsset, import, make_field, make_stack, resolved};
pub use output::Output;
pub use path::path_parts;
pub use plugin::{Plugin, PluginInfo, PluginKind};
pub use services::{LogLevel, Services};
