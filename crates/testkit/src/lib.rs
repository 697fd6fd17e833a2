//! Development only: tests with requirements that a machine may lack, statistical assertions, and
//! photographs of displays.

pub mod camera;
pub mod skip;
pub mod statistics;
