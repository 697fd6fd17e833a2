//! Weighted nonnegative tensor factorization of a light field into layer patterns.
//!
//! Minimizes Σ w (βL − L̃)² over 0 ≤ f ≤ 1 with L̃ = (1/M) Σ_m b_m Π_n f_m^(n) (eqs. 18 and 27 of Wetzstein et al. 2012): N layers, M frames,
//! channels independent, a uniform or a directional backlight. Rays are never expanded into a list; the separable tables of
//! [`lumistack_display::RayMap`] describe them all.
//!
//! ```text
//! Problem ──Settings.start or a warm LayerStack──▶ Solver::start ──▶ Run::step × iterations ──▶ LayerStack
//! ```
//!
//! [`factorize`] drives a solver; [`solvers`] lists them. Results are the same bytes on any number of threads, for a given seed and instruction
//! set.

mod bands;
mod expand;
mod factor;
mod factorize;
mod lanes;
mod multiplicative;
mod plan;
mod problem;
mod rows;
mod shifted;
mod solver;
mod start;
mod target;

#[cfg(test)]
mod tests;

pub use factorize::{Factorization, Iteration, Settings, factorize};
pub use multiplicative::Multiplicative;
pub use problem::{FactorizeError, Problem};
pub use solver::{Objective, Run, Solver, solver, solvers};
pub use start::{FLOOR, StartKind, random_start};
