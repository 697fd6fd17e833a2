//! Plans: which stages a job is made of, in which folders, and who feeds whom.
//!
//! ```text
//! still      ingest ▶ place ▶ trace ▶ denoise ▶ expose ─┬▶ factorize ▶ output ... ▶ report
//!            read, source ──────────────────────────────┘
//! graph      a still's light field ─┬▶ nodes/A: factorize or node ▶ output ... ▶ report
//!                                   └▶ nodes/B: ...
//! sequence   t0001: a still or a graph ▶ t0002: the same, each node from its own patterns of the time before ▶ ... ▶ report
//! sweep      fields/1: the light fields of a still or a sequence ▶ a design each ▶ table
//! ```
//!
//! A plan is data. It can be printed with what is known before the work ([`estimate`]), executed here ([`execute`]), or elsewhere: a step that finds its inputs in no
//! memory reads them back from the run folder, as a rerun does.

pub(crate) mod estimate;
pub(crate) mod execute;
pub(crate) mod graph;
pub(crate) mod sequence;
pub(crate) mod steps;
pub(crate) mod still;
pub(crate) mod sweep;
pub(crate) mod times;
pub(crate) mod units;
