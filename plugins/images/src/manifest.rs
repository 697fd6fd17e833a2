//! `images.json`: what each picture is.

use lumistack_plugin::display::Transfer;
use lumistack_plugin::serde::Serialize;
use lumistack_plugin::serde_json;

/// The file.
#[derive(Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Manifest {
    schema: &'static str,
    version: u32,
    files: Vec<Entry>,
}

/// One picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub(crate) struct Entry {
    /// Path from the manifest.
    pub(crate) file: String,
    #[serde(flatten)]
    pub(crate) content: Content,
    #[serde(flatten)]
    pub(crate) format: Format,
    /// Whether stored values are proportional to light.
    pub(crate) linear: bool,
    /// Columns.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// Number of the time in the sequence.
    pub(crate) time: u64,
    /// Time in the scene.
    pub(crate) time_seconds: f64,
}

/// What a picture shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde", tag = "content", rename_all = "snake_case")]
pub(crate) enum Content {
    /// Transmittance; layer 0 is the rearmost.
    Layer { layer: usize, frame: usize, d_mm: f64 },
    /// Emission, lenslet by lenslet.
    Backlight { frame: usize, bins: [usize; 2], lenslets: [usize; 2] },
    /// Emitted radiance divided by β.
    SimulatedView { view: [usize; 2], slope: [f64; 2], divided_by: f64 },
    /// Radiance.
    View { view: [usize; 2], slope: [f64; 2] },
}

/// How a picture is stored.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde", tag = "format", rename_all = "snake_case")]
pub(crate) enum Format {
    /// Code values.
    Png { bits: u32, encoding: Transfer },
    /// Linear values.
    Exr { precision: &'static str },
}

/// The manifest of these pictures, sorted by file.
pub(crate) fn to_json(mut entries: Vec<Entry>) -> String {
    entries.sort_by(|a, b| a.file.cmp(&b.file));
    let manifest = Manifest { schema: "lumistack/images", version: 1, files: entries };
    let text = serde_json::to_string_pretty(&manifest).expect("a manifest holds nothing that JSON cannot");
    format!("{text}\n")
}
