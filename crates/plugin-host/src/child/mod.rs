//! Plugins in libraries run in a child process, so that their faults cannot end the program.
//!
//! ```text
//! program                                               child
//!    │ Functions::submit(Time, Data)                      │
//!    ├── Call(submit, time, description) ────────────────▶│ the library's `submit`
//!    │◀────────────── Request(file_append) + bytes ───────│
//!    │   the program's own file_append                    │
//!    ├── Answer ─────────────────────────────────────────▶│
//!    │◀──────────────────────────────── Done(status) ─────│
//! ```
//!
//! Every open output has its own child process. Every call that makes a scene, a light field or a
//! layer stack also has its own child process.
//!
//! Program and child implement the two sides of the C interface. So the code of the host and of the
//! plugin is the same with a child and without. Planes are sent through the pipe one by one, when
//! the plugin requests them. Shared memory would save one copy. However, if the child truncated the
//! file of the shared memory, a bus error would end the program.
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
