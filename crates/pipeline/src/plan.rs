//! Plans: the stages of a job, their folders, and their dependencies.
//!
//! ```text
//! still      ingest ▶ place ▶ trace ▶ denoise ▶ expose ─┬▶ factorize ▶ output ... ▶ report
//!            read, source ──────────────────────────────┘
//! graph      a still's light field ─┬▶ nodes/A: factorize or node ▶ output ... ▶ report
//!                                   └▶ nodes/B: ...
//! sequence   t0001: a still or a graph ▶ t0002: the same, warm start from t0001 ▶ ... ▶ report
//! sweep      fields/1: the light fields of a still or a sequence ▶ designs ▶ table
//! ```
//!
//! A plan is data: it can be printed with estimates ([`estimate`]) and executed ([`execute`]).
//! Another process can execute a single step, since a step reads its inputs from the run folder if
//! they are not in memory.

mod disk;
pub(crate) mod estimate;
pub(crate) mod execute;
pub(crate) mod graph;
pub(crate) mod sequence;
pub(crate) mod steps;
pub(crate) mod still;
pub(crate) mod sweep;
pub(crate) mod times;
pub(crate) mod units;
