//! Encodes calls, texts, planes and descriptions for the C interface. Both sides use this module:
//! this crate's traits, and hosts such as `lumistack-plugin-host`. Plugin authors do not need it.

mod calls;
mod json;
mod planes;

pub use calls::{answer, append, call, keeping, lent_bytes, lent_lossy, lent_text, write_error};
pub(crate) use calls::{needs, panic_text};
pub(crate) use json::display_from_json;
pub use json::{Depth, Description, Geometry, RayWeights, Start};
pub use planes::dense;
