//! Tests of USD input. All modules are one program, so that tests share the processors; `cargo test
//! -p lumistack-usd --test usd corpus::` runs one module.

mod common;
mod corpus;
mod materials;
mod packages;
mod shading;
mod splats;
mod stages;
