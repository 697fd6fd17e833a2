//! Development only: tests with requirements that a machine may lack, statistical assertions,
//! photographs of displays, and programs in consoles.

pub mod camera;
#[cfg(any(unix, windows))]
pub mod console;
pub mod skip;
pub mod statistics;
