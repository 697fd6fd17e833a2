//! The order in time of a frame's colours: together, or one after another.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The order in time of the colours of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ColourSequence {
    /// Panels with colour filters show all colours together, in one refresh per frame.
    #[default]
    Simultaneous,
    /// Panels without colour filters show red, green and blue light in turn, in three refreshes per
    /// frame. Each colour has its own pattern, so layers keep
    /// [`LayerColour::Rgb`](crate::LayerColour::Rgb).
    Field,
}

impl ColourSequence {
    /// Returns the number of refreshes of the panels that one frame takes.
    pub fn fields(self) -> usize {
        match self {
            Self::Simultaneous => 1,
            Self::Field => 3,
        }
    }
}

/// The colour that each of a frame's three refreshes shows, if colours are shown one after another:
/// a text such as `"rgb"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(extend("enum" = ["rgb", "rbg", "grb", "gbr", "brg", "bgr"]))]
pub struct ColourOrder(pub [usize; 3]);

impl Default for ColourOrder {
    fn default() -> Self {
        Self([0, 1, 2])
    }
}

impl ColourOrder {
    /// Returns true if the order is red, green, blue.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

impl TryFrom<String> for ColourOrder {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let channels: Vec<usize> = text.chars().filter_map(|c| "rgb".find(c)).collect();
        match <[usize; 3]>::try_from(channels) {
            Ok(order) if (0..3).all(|channel| order.contains(&channel)) && text.len() == 3 => Ok(Self(order)),
            _ => Err(format!("expected r, g and b in some order, such as \"rgb\", found \"{text}\"")),
        }
    }
}

impl From<ColourOrder> for String {
    fn from(order: ColourOrder) -> Self {
        order.0.iter().map(|channel| ['r', 'g', 'b'][*channel]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_come_in_any_order_but_each_once() {
        for text in ["rgb", "gbr", "bgr"] {
            let order = ColourOrder::try_from(text.to_string()).unwrap();
            assert_eq!(String::from(order), text);
        }
        assert_eq!(ColourOrder::try_from("brg".to_string()).unwrap().0, [2, 0, 1]);
        for text in ["", "rg", "rrb", "rgbr", "xrgb", "RGB"] {
            assert!(ColourOrder::try_from(text.to_string()).is_err(), "{text}");
        }
    }
}
