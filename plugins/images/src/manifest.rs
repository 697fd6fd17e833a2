//! `images.json`: a description of each picture.

use lumistack_plugin::display::Transfer;
use lumistack_plugin::serde::Serialize;
use lumistack_plugin::serde_json;

/// The content of `images.json`.
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
    /// Path relative to the manifest's folder.
    pub(crate) file: String,
    #[serde(flatten)]
    pub(crate) content: Content,
    #[serde(flatten)]
    pub(crate) format: Format,
    /// Stored values are linear light.
    pub(crate) linear: bool,
    /// Columns and rows of a picture.
    #[serde(flatten)]
    pub(crate) size: Option<Size>,
    /// Number of the time step in the sequence.
    pub(crate) time: u64,
    /// Time in the scene, seconds.
    pub(crate) time_seconds: f64,
}

/// Pixels of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub(crate) struct Size {
    pub(crate) width: usize,
    pub(crate) height: usize,
}

/// The content of a file.
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
    /// Picture of the panel behind the lenslets, in panel pixels.
    LensletPanel {
        frame: usize,
        panel_pitch_mm: f64,
        lens_pitch_mm: f64,
        focal_mm: f64,
        rotation_deg: f64,
        offset_mm: [f64; 2],
        pixels_per_lens: f64,
    },
    /// All views of the grid in one file. Every view has its name in the file, its position in the
    /// grid and its slope.
    Views { views: Vec<NamedView>, divided_by: f64 },
    /// A viewer's swing through the zone: slope of every picture. `nearest` is true if the pictures
    /// are a light field's nearest views.
    Animation { slopes: Vec<[f64; 2]>, nearest: bool, pictures_per_second: u16, divided_by: f64 },
    /// All masks on one sheet; the file `index` lists their positions.
    Atlas { index: String },
    /// Masks and views, reduced and labelled.
    Sheet,
    /// Arrays of all masks, or of all views.
    Arrays { names: Vec<String> },
    /// A view in a folder of a public archive.
    ArchiveView { archive: &'static str, view: [usize; 2], slope: [f64; 2], divided_by: f64 },
}

/// One of several views of a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub(crate) struct NamedView {
    pub(crate) name: String,
    pub(crate) view: [usize; 2],
    pub(crate) slope: [f64; 2],
}

/// The storage of a picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde", tag = "format", rename_all = "snake_case")]
pub(crate) enum Format {
    /// Code values. For a panel with fewer bits than the file, `panel_bits` and the dithering are
    /// stated.
    Png {
        bits: u32,
        encoding: Transfer,
        #[serde(skip_serializing_if = "Option::is_none")]
        panel_bits: Option<u32>,
        #[serde(skip_serializing_if = "Option::is_none")]
        dither: Option<&'static str>,
    },
    /// Animated PNG of code values.
    Apng { bits: u32, encoding: Transfer },
    /// NumPy archive of float32.
    Npz,
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
