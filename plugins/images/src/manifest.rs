//! `images.json`, which describes every picture and NumPy archive that the plugin writes.

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

/// The description of one file.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub(crate) struct Entry {
    /// Path relative to the manifest's folder.
    pub(crate) file: String,
    #[serde(flatten)]
    pub(crate) content: Content,
    #[serde(flatten)]
    pub(crate) format: Format,
    /// True if the stored values are linear in light.
    pub(crate) linear: bool,
    /// Columns and rows, if the file is a picture.
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
    /// The mask of a layer in a frame; layer 0 is the rearmost.
    Layer { layer: usize, frame: usize, d_mm: f64 },
    /// The backlight's emission in a frame: one cell of angular bins per lenslet.
    Backlight { frame: usize, bins: [usize; 2], lenslets: [usize; 2] },
    /// A simulated view: the emitted radiance divided by the brightness β (`divided_by`).
    SimulatedView { view: [usize; 2], slope: [f64; 2], divided_by: f64 },
    /// The radiance of a view of the light field.
    View { view: [usize; 2], slope: [f64; 2] },
    /// The picture for the panel behind the lenslets, in the panel's own pixels.
    LensletPanel {
        frame: usize,
        panel_pitch_mm: f64,
        lens_pitch_mm: f64,
        focal_mm: f64,
        rotation_deg: f64,
        offset_mm: [f64; 2],
        pixels_per_lens: f64,
    },
    /// All views of the grid in one file.
    Views { views: Vec<NamedView>, divided_by: f64 },
    /// An animation with the slope of every picture. `nearest` is true for a light field, where
    /// each picture is the view nearest to the viewpoint, with this view's slope. Pictures of a
    /// layer stack are simulated at the viewpoint.
    Animation { slopes: Vec<[f64; 2]>, nearest: bool, pictures_per_second: u16, divided_by: f64 },
    /// All masks on one sheet; the file `index` lists their positions.
    Atlas { index: String },
    /// The contact sheet, with reduced masks and views and their captions.
    Sheet,
    /// An archive with arrays of all masks, or of all views.
    Arrays { names: Vec<String> },
    /// A view in a folder in the format of a public archive.
    ArchiveView { archive: &'static str, view: [usize; 2], slope: [f64; 2], divided_by: f64 },
}

/// A view in a file with several views: its name in the file, its position in the grid and its
/// slope.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub(crate) struct NamedView {
    pub(crate) name: String,
    pub(crate) view: [usize; 2],
    pub(crate) slope: [f64; 2],
}

/// The format of a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(crate = "lumistack_plugin::serde", tag = "format", rename_all = "snake_case")]
pub(crate) enum Format {
    /// PNG with code values. `encoding` is missing if parts of the picture have different transfer
    /// functions. `panel_bits` is stated if the bits of the driven panel are known; in the atlas,
    /// only if all panels share them. `dither` is stated if the codes are dithered.
    Png {
        bits: u32,
        #[serde(skip_serializing_if = "Option::is_none")]
        encoding: Option<Transfer>,
        #[serde(skip_serializing_if = "Option::is_none")]
        panel_bits: Option<u32>,
        #[serde(skip_serializing_if = "Option::is_none")]
        dither: Option<&'static str>,
    },
    /// Animated PNG with code values.
    Apng { bits: u32, encoding: Transfer },
    /// NumPy archive of float32.
    Npz,
    /// OpenEXR with linear values.
    Exr { precision: &'static str },
}

/// Returns the text of `images.json`, which describes `entries`, sorted by path.
pub(crate) fn to_json(mut entries: Vec<Entry>) -> String {
    entries.sort_by(|a, b| a.file.cmp(&b.file));
    let manifest = Manifest { schema: "lumistack/images", version: 1, files: entries };
    let text = serde_json::to_string_pretty(&manifest).expect("JSON can express a manifest");
    format!("{text}\n")
}
