//! `stack.json`: the description of the arrays next to it.

use serde::{Deserialize, Serialize};

use crate::{Backlight, Display, Layer, LayerStack};

/// The content of `stack.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StackIndex {
    /// Name of the format, `lumistack/stack`.
    pub schema: String,
    /// Version of the format, 1.
    pub version: u32,
    /// Name of the display.
    pub display: String,
    /// Axes of each layer's array.
    pub layer_axes: Vec<String>,
    /// Axes of the backlight's array.
    pub emission_axes: Vec<String>,
    /// True, since values are amounts of light and not code values.
    pub linear: bool,
    /// Number of frames M in one period; the display emits the mean of its frames.
    pub frames: usize,
    /// β: the display emits β times the target.
    pub brightness: f64,
    /// Layers, rear to front.
    pub layers: Vec<LayerEntry>,
    /// The directional backlight, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backlight: Option<BacklightEntry>,
}

/// One layer of `stack.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LayerEntry {
    /// File name of the array, next to the index.
    pub file: String,
    /// Signed distance from z = 0, millimetres.
    pub d_mm: f64,
    /// [columns, rows] of the mask.
    pub resolution: [usize; 2],
    /// Pixel pitch, millimetres.
    pub pitch_mm: f64,
    /// [x, y] of the layer's centre, millimetres.
    #[serde(default)]
    pub offset_mm: [f64; 2],
}

/// The backlight of `stack.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BacklightEntry {
    /// File name of the array, next to the index.
    pub file: String,
    /// Signed distance of the lenslets from z = 0, millimetres.
    pub d_mm: f64,
    /// [columns, rows] of lenslets.
    pub lenslets: [usize; 2],
    /// Lenslet pitch, millimetres.
    pub pitch_mm: f64,
    /// [horizontal, vertical] full angle over which all bins together spread, degrees.
    pub fov_deg: [f64; 2],
    /// [horizontal, vertical] number of angular bins.
    pub views: [usize; 2],
    /// [x, y] of the grid's centre, millimetres.
    #[serde(default)]
    pub offset_mm: [f64; 2],
}

impl StackIndex {
    /// File name of the index.
    pub const FILE: &str = "stack.json";
    /// File name of a directional backlight's array.
    pub const EMISSION: &str = "emission.npy";
    /// Value of the key `schema`.
    pub const SCHEMA: &str = "lumistack/stack";
    /// The version that is written.
    pub const VERSION: u32 = 1;

    /// Returns the index of the patterns of a display.
    pub fn of(display: &Display, stack: &LayerStack) -> Self {
        Self { frames: stack.frames(), brightness: stack.brightness, ..Self::of_display(display) }
    }

    /// Returns the index of patterns that do not exist yet. It has the display's frames and
    /// brightness.
    pub fn of_display(display: &Display) -> Self {
        let digits = (display.layers.len() - 1).to_string().len();
        let layer = |(n, layer): (usize, &Layer)| LayerEntry {
            file: format!("layer_{n:0digits$}.npy"),
            d_mm: layer.d_mm,
            resolution: layer.resolution,
            pitch_mm: layer.pitch_mm,
            offset_mm: layer.offset_mm,
        };
        let backlight = match &display.backlight {
            Backlight::Uniform => None,
            Backlight::Lenslets(b) => Some(BacklightEntry {
                file: Self::EMISSION.into(),
                d_mm: b.d_mm,
                lenslets: b.lenslets,
                pitch_mm: b.pitch_mm,
                fov_deg: b.fov_deg,
                views: b.views,
                offset_mm: b.offset_mm,
            }),
        };
        Self {
            schema: Self::SCHEMA.into(),
            version: Self::VERSION,
            display: display.name.clone(),
            layer_axes: LayerStack::LAYER_AXES.map(String::from).to_vec(),
            emission_axes: LayerStack::EMISSION_AXES.map(String::from).to_vec(),
            linear: true,
            frames: display.frames,
            brightness: display.brightness,
            layers: display.layers.iter().enumerate().map(layer).collect(),
            backlight,
        }
    }
}
