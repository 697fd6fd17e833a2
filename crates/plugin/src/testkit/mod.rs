//! Checks that every plugin must pass, and what they need: a host that keeps files in memory, and sample data.
//!
//! ```ignore
//! #[test]
//! fn conforms() {
//!     lumistack_plugin::testkit::conformance(&crate::PLUGIN).unwrap();
//! }
//! ```
//!
//! Tests of what a node makes begin with [`random_field`] and [`made_by`].

mod conformance;
mod makers;
mod memory_host;
mod samples;

pub use conformance::{Broken, conformance, conformance_but_for, conformance_of, same_outputs};
pub use makers::{import_conformance, made_by, random_field};
pub use memory_host::MemoryHost;
pub use samples::{Sample, samples};
