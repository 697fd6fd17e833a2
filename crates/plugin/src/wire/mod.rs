//! The forms in which calls, texts, planes and descriptions cross the C boundary, for both of its sides: this crate's traits on the plugin's, and hosts
//! such as `lumistack-plugin-host`. Authors of plugins need none of it.

mod calls;
mod json;
mod planes;

pub use calls::{answer, append, call, keeping, lent_bytes, lent_lossy, lent_text, tell};
pub(crate) use calls::{needs, panic_text};
pub(crate) use json::display_from_json;
pub use json::{Depth, Description, Geometry, RayWeights, Start};
pub use planes::dense;
