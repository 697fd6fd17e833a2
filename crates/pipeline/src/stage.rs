//! The stages between a job and its outputs, one file each.

pub(crate) mod denoise;
pub(crate) mod depth;
pub(crate) mod expose;
pub(crate) mod fields;
pub(crate) mod flicker;
pub(crate) mod given;
pub(crate) mod ingest;
pub(crate) mod layers;
pub(crate) mod look;
pub(crate) mod place;
pub(crate) mod score;
pub(crate) mod trace;
