//! Results beside the views' figures.

use crate::light::Light;
use crate::limits::Limit;

/// Brightness, limits and masks of a run.
pub(crate) struct Found {
    pub(crate) light: Light,
    pub(crate) limits: Vec<Limit>,
}
