//! What is found out beside the views.

use crate::light::Light;
use crate::limits::Limit;

/// What was found out beside the views' own figures.
pub(crate) struct Found {
    pub(crate) light: Light,
    pub(crate) limits: Vec<Limit>,
}
