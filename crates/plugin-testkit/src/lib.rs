//! Test kit for plugins: checks of the interface's rules, a host that keeps files in memory, and
//! sample data.
//!
//! ```ignore
//! #[test]
//! fn conforms() {
//!     lumistack_plugin_testkit::conformance(&crate::PLUGIN).unwrap();
//! }
//! ```
//!
//! Tests of a node's results start with [`random_field`] and [`made_by`]; [`serve`] runs a plugin
//! as a host does.

mod conformance;
mod makers;
mod memory_host;
mod rules;
mod samples;

pub use conformance::{conformance, conformance_but_for, conformance_of, same_outputs};
pub use makers::{import_conformance, made_by, random_field};
pub use memory_host::MemoryHost;
pub use rules::Broken;
pub use samples::{Sample, samples};

pub use lumistack_plugin_host::serve;
