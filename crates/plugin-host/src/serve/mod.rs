//! The boundary from the host's side: describes plugins, lends data, offers services, and drives plugins through their C functions, the same way
//! whether they are compiled in or loaded.
//!
//! The rest of this crate adds a registry and files on disk, the test kit files in memory.

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
