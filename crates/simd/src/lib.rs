//! Vectors of `f32` under one trait, and the instruction sets that implement it.
//!
//! ```text
//! Kernel::run::<V: Lanes>      written once
//!     Backend::function        a pointer to the kernel's function for one instruction set
//!     Backend::call_eight      a direct call, with vectors of exactly eight lanes
//!     Lanes::call              from one kernel to another, out of line
//! ```
//!
//! A kernel is generic over [`Lanes`]. Each function that a [`Backend`] returns is compiled with
//! the right `target_feature`, and the vector operations are inlined into it. The program stays
//! small only if kernels are small: a kernel inlines everything that it does not
//! [`call`](Lanes::call).
//!
//! [`Portable`] is scalar code, which compiles everywhere. The tests compare every backend,
//! operation by operation, with plain numbers.

mod backend;
mod half;
mod lanes;
mod pair;
mod portable;
mod prefetch;

#[cfg(target_arch = "aarch64")]
mod neon;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod wasm;
#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(test)]
mod tests;

pub use backend::Backend;
pub use half::{float_from_half, nearest_half};
pub use lanes::{Function, Kernel, Lanes};
pub use pair::Pair;
pub use portable::Portable;
pub use prefetch::{prefetch, prefetch_far};

#[cfg(target_arch = "aarch64")]
pub use neon::Neon;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
pub use wasm::Simd128;
#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

/// Largest number of lanes of any instruction set. It is a multiple of every set's number of lanes.
pub const MAX_LANES: usize = 16;

/// Hash of this crate's sources, computed at build. It is part of the key of every cached result
/// that depends on this code.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
