//! The host's side of the boundary: describes plugins, lends data, offers services, and drives outputs through their C functions,
//! the same way for plugins that are compiled in and that are loaded.
//!
//! The host proper (`lumistack-plugin-host`) adds a registry and files on disk, the test kit files in memory.

mod functions;
mod lend;
mod makers;
mod output;
mod path;
mod plugin;
mod services;

pub use functions::Functions;
pub use lend::OutputData;
pub use makers::{ReadAsset, import, make_field, make_stack, resolved};
pub use output::Output;
pub use path::path_parts;
pub use plugin::{Plugin, PluginInfo, PluginKind};
pub use services::{LogLevel, Services};
