//! The parameter `up`, the upward axis of a file.

use lumistack_plugin::serde::Deserialize;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub(crate) enum Up {
    Y,
    Z,
}
