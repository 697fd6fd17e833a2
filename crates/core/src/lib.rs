//! Foundations of every other crate: labelled tensors, colour, image metrics, seeds, large pages,
//! and the [`Task`] handle that carries progress, cancellation and warnings.
//!
//! The crate uses no file system, no clock and no threads, so that it also compiles to wasm32.

// the example of README.md is a test
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

pub mod bytes;
pub mod colour;
pub mod config;
pub mod metrics;
pub mod pages;
pub mod path_text;
pub mod seed;
mod task;
mod tensor;
pub mod tone;

pub use task::{Cancel, Cancelled, Collector, NoProgress, Progress, Task, Warning, Warnings};
pub use tensor::{Lend, Lender, ShapeError, Tensor};

/// Hash of this crate's sources, computed at build. It is part of the key of every cached result
/// that depends on this code.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
