//! The crate for plugin authors: safe traits over the C interface of `lumistack-plugin-abi`, a
//! parameter schema, and the export macro.
//!
//! An output plugin is a type that implements [`OutputPlugin`]. The plugin's file ends with
//! `export_plugin!`:
//!
//! ```
//! use lumistack_plugin::{Display, Host, Input, OutputPlugin, Param, PluginError, Port, Schema};
//! use lumistack_plugin::{Time, export_plugin};
//! use lumistack_plugin::serde::Deserialize;
//!
//! /// Writes the mean transmittance of every layer and frame as text.
//! pub struct Means {
//!     host: Host,
//!     params: MeansParams,
//! }
//!
//! #[derive(Deserialize)]
//! #[serde(crate = "lumistack_plugin::serde")]
//! pub struct MeansParams {
//!     digits: usize,
//! }
//!
//! impl OutputPlugin for Means {
//!     const DOC: &'static str = "Writes the mean transmittance of every layer and frame as text.";
//!     const PORTS: &'static [Port] = &[Port::LayerStack];
//!     type Params = MeansParams;
//!
//!     fn schema() -> Schema {
//!         Schema::new([Param::int("digits", 3, 1..=9, "Digits after the point.").unit("digits")])
//!     }
//!
//!     fn open(host: Host, params: MeansParams, _display: Display) -> Result<Self, PluginError> {
//!         Ok(Self { host, params })
//!     }
//!
//!     fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
//!         let Input::LayerStack(stack) = data else { return Err(PluginError::unexpected(data)) };
//!         let mut text = String::new();
//!         for layer in 0..stack.layer_count() {
//!             for frame in 0..stack.frames() {
//!                 self.host.check_cancelled()?;
//!                 let values = stack.layer(layer, frame)?.to_vec();
//!                 let mean = values.iter().sum::<f32>() / values.len() as f32;
//!                 text += &format!("{layer} {frame} {mean:.*}\n", self.params.digits);
//!             }
//!         }
//!         self.host.write(&format!("means_{}.txt", time.index), text.as_bytes())
//!     }
//!
//!     fn finish(self) -> Result<(), PluginError> {
//!         Ok(())
//!     }
//! }
//!
//! export_plugin!("means", Means);
//! # fn main() {}
//! ```
//!
//! An importer, a source or a node implements [`ImporterPlugin`], [`SourcePlugin`] or
//! [`NodePlugin`]. Each of these traits has one function that does the work. The plugin's file ends
//! with `export_plugin!("id", Type as importer)` (`as source`, `as node`).
//!
//! A crate of plugins is an ordinary library crate. If it has several plugins, each has its own
//! module. A host with the plugins compiled in lists the `PLUGIN` of each module. A host that loads
//! the library's file `lumistack_plugin_<name>` finds the symbols `lumistack_plugin_entry_<id>` in
//! the file. Both kinds of host call the same C functions, and a panic of the plugin becomes an
//! error.
//!
//! The host's side is `lumistack-plugin-host`; tests of a plugin use it through
//! `lumistack-plugin-testkit`. [`wire`] contains the code shared by both sides.

// the example of README.md is a test
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

pub mod encoding;
mod error;
pub mod expects;
mod export;
mod given;
mod host;
mod input;
pub mod lenslets;
mod makers;
mod node;
mod output;
mod plane;
mod port;
mod schema;
mod time;
mod viewpoint;
pub mod wire;

pub use error::PluginError;
pub use export::{Export, entry_of, is_plugin_id};
pub use host::{Host, OutputFile, Stage};
pub use input::{FieldInput, Input, StackInput};
pub use makers::{Assets, ImporterPlugin, NodePlugin, SourcePlugin};
pub use node::{NodeInput, Solution, Step};
pub use output::OutputPlugin;
pub use plane::PlaneView;
pub use port::Port;
pub use schema::{Choice, Kind, Param, ParamError, Schema};
pub use time::Time;
pub use viewpoint::ViewPoint;

pub use lumistack_core as core;
pub use lumistack_display as display;
pub use lumistack_display::Display;
#[cfg(feature = "field-io")]
pub use lumistack_field_io as field_io;
pub use lumistack_plugin_abi as abi;
pub use serde;
pub use serde_json;

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
