//! Results of a run that are not scores of views.

use crate::light::Light;
use crate::limits::Limit;

/// Brightness of a run, limits of its result, and pictures of its masks.
pub(crate) struct Found {
    pub(crate) light: Light,
    pub(crate) limits: Vec<Limit>,
}
