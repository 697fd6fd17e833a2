//! Parameters of the plugin `transparencies`.

use lumistack_plugin::serde::Deserialize;

/// Parameters; the plugin's schema documents them.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct TransparenciesParams {
    pub(crate) paper: Paper,
    pub(crate) dpi: u32,
    pub(crate) curve: String,
    pub(crate) min_transmittance: f64,
    pub(crate) mirror: bool,
    pub(crate) border_mm: f64,
    pub(crate) film_mm: f64,
    pub(crate) spacer_index: f64,
    pub(crate) chart: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
pub(crate) enum Paper {
    A4,
    A3,
    Letter,
    Tight,
}
