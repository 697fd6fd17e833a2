//! Checks that every output plugin must pass, and what they need: a host that keeps files in memory, and sample data.
//!
//! ```ignore
//! #[test]
//! fn conforms() {
//!     lumistack_plugin::testkit::conformance(&crate::PLUGIN).unwrap();
//! }
//! ```

mod conformance;
mod memory_host;
mod samples;

pub use conformance::{Broken, conformance};
pub use memory_host::MemoryHost;
pub use samples::{Sample, samples};
