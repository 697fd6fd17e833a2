//! `preview.json`: the description of a preview, and the list of its files.

use lumistack_display::{Backlight, Display, FieldGeometry, LayerStack, Projection, ViewGrid};
use serde::{Deserialize, Serialize};

use crate::{Error, err, json};

/// Content of `preview.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Preview {
    /// Name of the format, [`Preview::SCHEMA`].
    pub schema: String,
    /// Version of the format, [`Preview::VERSION`].
    pub version: u32,
    /// Title that the viewer shows.
    #[serde(default)]
    pub title: String,
    /// The display.
    pub display: Display,
    /// β: the display emits β times the target.
    pub brightness: f64,
    /// Number of frames M.
    pub frames: usize,
    /// The light field for which the patterns were made.
    pub target: Target,
    /// The files, in the order in which they are loaded.
    pub files: Vec<File>,
    /// Effect of the rounding to 8 bits, dB: PSNR of views of the patterns in the files against
    /// views of the unrounded patterns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rounding_db: Option<f64>,
}

/// The keys that every version of preview.json has.
#[derive(Deserialize)]
struct Head {
    #[serde(default)]
    schema: String,
    #[serde(default)]
    version: u32,
}

/// Pixels and views of the light field.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Target {
    /// Pixel rows.
    pub rows: usize,
    /// Pixel columns.
    pub cols: usize,
    /// Pixel pitch on z = 0, millimetres.
    pub pitch_mm: f64,
    /// `oblique` or `perspective`.
    pub projection: String,
    /// Viewing distance of perspective views, millimetres.
    #[serde(default)]
    pub distance_mm: Option<f64>,
    /// Slope of each view column.
    pub slope_x: Vec<f64>,
    /// Slope of each view row, from top to bottom; a slope above 0 points up.
    pub slope_y: Vec<f64>,
}

/// The entry of one picture file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(into = "Entry", try_from = "Entry")]
pub struct File {
    /// Path relative to the parent of the folder that contains preview.json.
    pub path: String,
    /// The picture's content.
    pub part: Part,
    /// Pixel rows.
    pub rows: usize,
    /// Pixel columns.
    pub cols: usize,
    /// Length of the file, bytes.
    pub bytes: u64,
}

/// The form of a [`File`] in preview.json: a flat table whose key `kind` names the variant of
/// [`Part`]. If `Part` were a flattened enum, serde would make ten times as much code, which every
/// visitor loads.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
struct Entry {
    path: String,
    kind: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    layer: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    frame: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    view: Option<[usize; 2]>,
    rows: usize,
    cols: usize,
    bytes: u64,
}

impl From<File> for Entry {
    fn from(file: File) -> Self {
        let File { path, part, rows, cols, bytes } = file;
        let entry = Self { path, rows, cols, bytes, ..Self::default() };
        match part {
            Part::Layer { layer, frame } => {
                Self { kind: "layer".into(), layer: Some(layer), frame: Some(frame), ..entry }
            }
            Part::Emission { frame } => Self { kind: "emission".into(), frame: Some(frame), ..entry },
            Part::Target { view } => Self { kind: "target".into(), view: Some(view), ..entry },
        }
    }
}

impl TryFrom<Entry> for File {
    type Error = String;

    fn try_from(entry: Entry) -> Result<Self, String> {
        let part = match (entry.kind.as_str(), entry.layer, entry.frame, entry.view) {
            ("layer", Some(layer), Some(frame), _) => Part::Layer { layer, frame },
            ("emission", _, Some(frame), _) => Part::Emission { frame },
            ("target", _, _, Some(view)) => Part::Target { view },
            (kind, ..) => {
                let path = &entry.path;
                return Err(format!(
                    "file `{path}`: expected a known kind, and the layer, frame or view that the kind requires, found the kind `{kind}`"
                ));
            }
        };
        let Entry { path, rows, cols, bytes, .. } = entry;
        Ok(Self { path, part, rows, cols, bytes })
    }
}

/// Content of a picture with 8 bits per channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// A layer's mask in one frame: value = code / 255.
    Layer {
        /// Number of the layer; 0 is the rearmost.
        layer: usize,
        /// Number of the frame.
        frame: usize,
    },
    /// The backlight's emission in one frame: value = code / 255. The picture's axes are
    /// `[bin_y][lenslet_row][bin_x][lenslet_col]`, so the angular bins are side by side.
    Emission {
        /// Number of the frame.
        frame: usize,
    },
    /// A view of the light field, sRGB-encoded.
    Target {
        /// [view_y, view_x].
        view: [usize; 2],
    },
}

impl Preview {
    /// Value of the key `schema`.
    pub const SCHEMA: &'static str = "lumistack-preview";
    /// The version that this program reads.
    pub const VERSION: u32 = 1;
    /// Largest number of pixels of a picture; a file with more is treated as damaged.
    const PIXEL_LIMIT: usize = 1 << 26;

    /// Reads and checks a preview.
    ///
    /// # Errors
    /// If the text is malformed, has another schema or version or values out of range, or if files
    /// do not fit the display.
    pub fn from_json(text: &str) -> Result<Self, Error> {
        let malformed = |error: String| err(format!("preview.json: expected a preview, found an error: {error}"));
        // Another version may have other keys, so check the version before the other keys.
        let Head { schema, version } = json::parse(text).map_err(malformed)?;
        if schema != Self::SCHEMA {
            return Err(err(format!("preview.json: schema: expected {:?}, found {schema:?}", Self::SCHEMA)));
        }
        if version != Self::VERSION {
            let advice = "another version of Lumistack wrote this preview; write it again";
            return Err(err(format!("preview.json: version: expected {}, found {version} ({advice})", Self::VERSION)));
        }
        let preview: Self = json::parse(text).map_err(malformed)?;
        preview.check()?;
        Ok(preview)
    }

    fn check(&self) -> Result<(), Error> {
        self.display.check().map_err(|error| err(format!("preview.json: display: {error}")))?;
        let expect = |ok: bool, place: &str, expected: String, found: String| {
            let text = || err(format!("preview.json: {place}: expected {expected}, found {found}"));
            if ok { Ok(()) } else { Err(text()) }
        };
        let brightness = self.brightness;
        expect(
            brightness > 0.0 && brightness <= 1.0,
            "brightness",
            "a number above 0 and at most 1".into(),
            brightness.to_string(),
        )?;
        let frames = self.display.frames;
        expect(self.frames == frames, "frames", format!("{frames}, as the display has"), self.frames.to_string())?;
        let [views_y, views_x] = self.geometry()?.grid.views();
        // Check every file: the display has the file's part, and the picture has the part's size.
        for (i, file) in self.files.iter().enumerate() {
            let place = format!("files[{i}]");
            let limit = file.rows.checked_mul(file.cols).is_some_and(|n| (1..=Self::PIXEL_LIMIT).contains(&n));
            let size = format!("{} × {}", file.cols, file.rows);
            expect(limit, &place, format!("1 to {} pixels", Self::PIXEL_LIMIT), size.clone())?;
            let (known, part) = match file.part {
                Part::Layer { layer, frame } => {
                    (layer < self.display.layers.len() && frame < frames, "a layer and a frame of the display")
                }
                Part::Emission { frame } => {
                    let lenslets = LayerStack::emission_shape(&self.display).is_some();
                    (lenslets && frame < frames, "a frame of a directional backlight")
                }
                Part::Target { view: [y, x] } => (y < views_y && x < views_x, "a view of the target"),
            };
            let found = match file.part {
                Part::Layer { layer, frame } => format!("layer {layer}, frame {frame}"),
                Part::Emission { frame } => format!("frame {frame}"),
                Part::Target { view: [y, x] } => format!("row {y}, column {x}"),
            };
            expect(known, &place, part.into(), found)?;
            let [rows, cols] = self.size_of(file.part);
            expect([rows, cols] == [file.rows, file.cols], &place, format!("{cols} × {rows} pixels"), size)?;
        }
        // Check that no part is missing.
        for frame in 0..frames {
            for layer in 0..self.display.layers.len() {
                let part = Part::Layer { layer, frame };
                let there = self.files.iter().any(|file| file.part == part);
                expect(there, "files", format!("layer {layer} of frame {frame}"), "none".into())?;
            }
            let part = Part::Emission { frame };
            let there =
                LayerStack::emission_shape(&self.display).is_none() || self.files.iter().any(|file| file.part == part);
            expect(there, "files", format!("the emission of frame {frame}"), "none".into())?;
        }
        Ok(())
    }

    /// Returns [rows, cols] of a part's picture.
    pub fn size_of(&self, part: Part) -> [usize; 2] {
        match (part, &self.display.backlight) {
            (Part::Layer { layer, .. }, _) => {
                let [cols, rows] = self.display.layers[layer].resolution;
                [rows, cols]
            }
            (Part::Emission { .. }, Backlight::Lenslets(b)) => [b.views[1] * b.lenslets[1], b.views[0] * b.lenslets[0]],
            (Part::Emission { .. }, Backlight::Uniform) => [0, 0],
            (Part::Target { .. }, _) => [self.target.rows, self.target.cols],
        }
    }

    /// Returns the light field's pixels and views.
    ///
    /// # Errors
    /// If the pixels or the views are invalid.
    pub fn geometry(&self) -> Result<FieldGeometry, Error> {
        let target = &self.target;
        let projection = match (target.projection.as_str(), target.distance_mm) {
            ("oblique", _) => Projection::Oblique,
            ("perspective", Some(distance_mm)) => Projection::Perspective { distance_mm },
            (other, _) => {
                let expected = "\"oblique\", or \"perspective\" with distance_mm";
                return Err(err(format!("preview.json: target.projection: expected {expected}, found {other:?}")));
            }
        };
        let grid = ViewGrid { projection, slope_x: target.slope_x.clone(), slope_y: target.slope_y.clone() };
        let geometry = FieldGeometry { rows: target.rows, cols: target.cols, pitch_mm: target.pitch_mm, grid };
        geometry.check().map_err(|error| err(format!("preview.json: target: {error}")))?;
        Ok(geometry)
    }
}

impl From<&FieldGeometry> for Target {
    fn from(geometry: &FieldGeometry) -> Self {
        let (projection, distance_mm) = match geometry.grid.projection {
            Projection::Oblique => ("oblique", None),
            Projection::Perspective { distance_mm } => ("perspective", Some(distance_mm)),
        };
        Self {
            rows: geometry.rows,
            cols: geometry.cols,
            pitch_mm: geometry.pitch_mm,
            projection: projection.into(),
            distance_mm,
            slope_x: geometry.grid.slope_x.clone(),
            slope_y: geometry.grid.slope_y.clone(),
        }
    }
}
