//! Foundations of every other crate: labelled tensors, colour, image metrics, seeds, large pages,
//! and the [`Task`] handle that carries progress, cancellation and warnings.
//!
//! No file system, no clock, no threads: the crate also compiles to wasm32.

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

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that
/// this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
