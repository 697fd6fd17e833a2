//! Plugins in libraries run in a child process, so that their faults cannot end the program.
//!
//! ```text
//! program                                               child
//!    │ Functions::open(HostServices, ...)                 │
//!    ├── Call(open, texts) ──────────────────────────────▶│ the library's `open`
//!    │◀────────────── Request(file_append) + bytes ───────│
//!    │   the program's own file_append                    │
//!    ├── Answer ─────────────────────────────────────────▶│
//!    │◀──────────────────────────────── Done(status) ─────│
//! ```
//!
//! Every open output has a child process. So has every call that makes a scene, a light field or a
//! layer stack.
//!
//! Both ends implement the C interface, so neither the host's nor the plugin's code depends on the
//! child. Planes are sent through the pipe one at a time, when the plugin fetches them.
//! Shared memory would save one copy. However, if the child truncated the file behind that memory,
//! a bus error would end the program.
//!
//! [`outside`] forwards the plugin's functions, [`session`] controls the child, [`requests`] serves
//! its requests, and [`inside`] runs in the child.

mod inside;
mod launch;
mod outside;
mod protocol;
mod requests;
mod session;

pub use inside::plugin_child;
pub use launch::{Launcher, Limits};
pub(crate) use outside::probe;
