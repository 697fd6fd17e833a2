//! Identifies the panel that an output drives: a layer or the backlight's panel.

use std::str::FromStr;

use lumistack_plugin::display::{Backlight, Display};
use lumistack_plugin::serde::{Deserialize, Serialize};
use thiserror::Error;

/// The panel that an output drives. In JSON it is a text such as `"layer 2"` or `"backlight"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", into = "String", try_from = "String")]
pub enum Shows {
    /// The panel behind the lenslets of a directional backlight.
    Backlight,
    /// A layer; 0 is the rearmost.
    Layer(usize),
}

/// A text that names no panel.
#[derive(Debug, Error)]
#[error("expected the number of a layer or the word `backlight`, found `{0}`")]
pub struct ShowsError(String);

impl std::fmt::Display for Shows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Backlight => f.write_str("backlight"),
            Self::Layer(layer) => write!(f, "layer {layer}"),
        }
    }
}

impl FromStr for Shows {
    type Err = ShowsError;

    /// Reads `backlight`, `layer 2` or `2`.
    fn from_str(text: &str) -> Result<Self, ShowsError> {
        if text == "backlight" {
            return Ok(Self::Backlight);
        }
        let layer = text.strip_prefix("layer ").unwrap_or(text).parse();
        layer.map(Self::Layer).map_err(|_| ShowsError(text.into()))
    }
}

impl From<Shows> for String {
    fn from(shows: Shows) -> Self {
        shows.to_string()
    }
}

impl TryFrom<String> for Shows {
    type Error = ShowsError;

    fn try_from(text: String) -> Result<Self, ShowsError> {
        text.parse()
    }
}

impl Shows {
    /// Returns all panels of a display that need an output, rear to front.
    pub fn all(display: &Display) -> Vec<Self> {
        let backlight = matches!(display.backlight, Backlight::Lenslets(_)).then_some(Self::Backlight);
        backlight.into_iter().chain((0..display.layers.len()).map(Self::Layer)).collect()
    }
}
