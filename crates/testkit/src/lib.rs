//! Development only: statistical assertions, tolerance constants, image comparison with files on
//! failure.

pub mod skip;
pub mod statistics;
