//! Development only: tests with requirements that a machine may lack, and statistical assertions.

pub mod skip;
pub mod statistics;
