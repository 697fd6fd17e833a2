//! Findings beside the views.

use crate::light::Light;
use crate::limits::Limit;

/// Findings beside the views' own figures.
pub(crate) struct Found {
    pub(crate) light: Light,
    pub(crate) limits: Vec<Limit>,
}
