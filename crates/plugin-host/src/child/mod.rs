//! Plugins in libraries run in a child process, so that nothing they do can end the program.
//!
//! ```text
//! program                                             child: one per open output, and per scene, field or stack
//!  │ Functions::open(HostServices, ...)                 │
//!  ├── Call(open, texts) ─────────────────────────────▶ │ the library's `open`, with a HostServices that asks
//!  │ ◀────────────── Request(file_append) + bytes ───── │
//!  │   the program's own file_append                    │
//!  ├── Answer ────────────────────────────────────────▶ │
//!  │ ◀──────────────────────────────── Done(status) ─── │
//! ```
//!
//! Both ends stand at the C boundary: the host's code above it and the plugin's below are the same as without a child,
//! and so are the bytes. Planes cross one at a time, when the plugin fetches them, as bytes in the pipe. Memory that
//! both processes map would save one copy, but a child that shortens the file under it ends the program by a bus error.
//!
//! [`outside`] passes the plugin's functions on, [`session`] holds the child that runs them, and [`requests`] does what it asks for; [`inside`] is the
//! child's end.

mod inside;
mod launch;
mod outside;
mod protocol;
mod requests;
mod session;

pub use inside::plugin_child;
pub use launch::{Launcher, Limits};
pub(crate) use outside::probe;
