//! Results of a run that are not scores of views.

use crate::light::Light;
use crate::limits::Limit;

/// Absolute brightness of a display, and limits of its result.
pub(crate) struct Found {
    pub(crate) light: Light,
    pub(crate) limits: Vec<Limit>,
}
