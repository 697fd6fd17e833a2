//! Ports: the kinds of data that plugins exchange.

use lumistack_plugin_abi::port;
use serde::{Deserialize, Serialize};

/// A kind of data that a plugin accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Port {
    /// A scene that the host has validated.
    Scene,
    /// Linear radiance of many views.
    LightField,
    /// The layer stack of a tensor display.
    LayerStack,
    /// A file, which an importer reads.
    File,
}

impl Port {
    /// All ports.
    pub const ALL: [Self; 4] = [Self::Scene, Self::LightField, Self::LayerStack, Self::File];

    /// Returns the port's bit in a descriptor.
    pub const fn bit(self) -> u32 {
        match self {
            Self::Scene => port::SCENE,
            Self::LightField => port::LIGHT_FIELD,
            Self::LayerStack => port::LAYER_STACK,
            Self::File => port::FILE,
        }
    }
}

impl std::fmt::Display for Port {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Scene => "scene",
            Self::LightField => "light_field",
            Self::LayerStack => "layer_stack",
            Self::File => "file",
        })
    }
}
