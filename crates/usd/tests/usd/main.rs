//! How USD is read. One program for all files, which share the processors; `cargo test -p lumistack-usd --test usd corpus::` runs the tests of one.

mod common;
mod corpus;
mod looks;
mod packages;
mod shading;
mod splats;
mod stages;
