//! Weighted nonnegative tensor factorization of a light field into the patterns of a layer stack.
//!
//! The crate minimizes this objective over the box of values that the hardware allows (eqs. 18 and
//! 27 of Wetzstein et al. 2012):
//!
//! ```text
//! Σ_r w (βL − L̃)²,   L̃ = (1/M) Σ_m b_m Π_n f_m^(n)
//! ```
//!
//! for N layers, M frames and a uniform or directional backlight. Other formations replace the
//! product by the sum of the layers or the sin² of that sum ([`lumistack_display::Formation`]).
//! Rays are never listed; the separable tables of [`lumistack_display::RayMap`] describe them all.
//!
//! ```text
//! Problem ──start: warm, of a StartKind, or a solution at half the resolution──▶ Solver::start
//!         ──▶ Run::step × iterations
//!         ──▶ re-optimization on the levels of panels of few bits ──▶ LayerStack
//!
//! Run::step, factor by factor:
//!     gather (constant shifts), between (constant shifts of fractions of a pixel),
//!     scatter (any table) or sums (layers that do not attenuate)
//!     ──▶ respond (blur, crosstalk, tied channels) ──▶ step (the rule)
//! ```
//!
//! [`factorize`] runs a solver; [`solvers`] lists all solvers. [`held_bytes`] bounds the memory
//! that a factorization takes in addition to the caller's target. The target is copied at the start
//! and may be in a mapped file. [`ChannelRun`] solves one colour channel whose target stays in its
//! file. For a given seed and instruction set, results are the same bytes on any number of threads.

// the example of README.md is a test
#![cfg_attr(doctest, doc = include_str!("../README.md"))]

mod aligned;
mod bands;
mod between;
mod block_exact;
mod buffers;
mod coarse;
pub mod device;
mod engine;
mod errors;
mod expand;
mod factor;
mod factorize;
mod gather;
mod line;
mod map;
mod memory;
mod method;
mod multiplicative;
mod plan;
mod prepared;
mod problem;
mod quantize;
mod rays;
mod registers;
mod respond;
mod row;
mod rows;
mod scatter;
mod scratch;
mod solver;
mod solvers;
mod start;
mod step;
mod stream;
mod sums;
mod target;
mod unlit;
mod vector;

/// Items that the crate's own tests use; they may change in any version.
#[doc(hidden)]
pub mod internals {
    pub use crate::engine::Engine;
}

pub use block_exact::{BlockExact, Extrapolated};
pub use engine::Processor;
pub use factorize::{
    Factorization, Iteration, LevelsLoss, Ongoing, Settings, ZONE_ITERATIONS, factorize, factorize_on, factorize_tile,
    warm_start_pays,
};
pub use memory::{held_bytes, paged_bytes, weight_bytes};
pub use multiplicative::Multiplicative;
pub use plan::check_rays;
pub use problem::{FactorizeError, Problem};
pub use quantize::{has_levels, reoptimize_on_levels, round_to_levels};
pub use solver::{AUTO, Objective, Run, Solver};
pub use solvers::{solver, solver_names, solvers, start_on};
pub use start::{FLOOR, StartKind, random_start};
pub use stream::{ChannelRun, Estimate};
pub use target::LentTarget;

/// Hash of this crate's sources, computed by the build script. It is part of the keys of all cached
/// results that this code contributes to.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
