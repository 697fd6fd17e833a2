//! Output plugin `quilt`: writes pictures for lenticular displays.
//!
//! | file | content |
//! |---|---|
//! | `NAME_qs<C>x<R>a<A>.png` | quilt of C × R tiles, for views that a viewer sees with the aspect ratio A. The tiles are the views of one row of the light field, from left to right; view 0 is in the bottom-left tile. See [`layout`] |
//! | `NAME_native.png` | with a calibration, the screen's native picture: every subpixel shows the view for the direction into which the lens sends the subpixel's light; see [`weave`] |
//! | `quilt.json` | sizes, the slope of every view, and the way in which each view was made |
//!
//! Pictures are 8-bit sRGB without alpha. The second time step of a sequence is `NAME_f0001_qs…`,
//! the third `NAME_f0002_qs…`, and so on. With the parameter `sequence` the first time step is
//! `NAME_f0000_qs…`, so that video encoders can read all files. Memory holds at most one quilt, one
//! native picture and a few views.

pub mod devices;
pub mod layout;
pub mod views;
pub mod weave;

use std::io::{BufWriter, Write};
use std::sync::{Mutex, PoisonError};

use lumistack_plugin::display::{FieldGeometry, Transfer};
use lumistack_plugin::encoding::codes8;
use lumistack_plugin::serde::{Deserialize, Serialize};
use lumistack_plugin::{
    Display, Host, Input, OutputPlugin, Param, PluginError, Port, Schema, Time, export_plugin, serde_json,
};

use devices::{Device, devices};
use layout::{Given, Layout};
use views::{Fit, Made, Missing, Source, black_share, fitted, places};
use weave::Calibration;

/// Value of the parameter `device` that selects no device.
const CUSTOM: &str = "custom";
/// Smallest black fraction of a tile that causes a warning.
const LEAST_BLACK: f64 = 0.01;
/// Longest side of pictures that H.264 encoders accept, pixels.
const H264_SIDE: usize = 6000;

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin `quilt`.
#[derive(Debug)]
pub struct Quilt {
    host: Host,
    params: QuiltParams,
    device: Option<&'static Device>,
    calibration: Option<Calibration>,
    written: Mutex<Vec<Entry>>,
}

/// Parameters; see [`Quilt::schema`](OutputPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct QuiltParams {
    name: String,
    device: String,
    columns: usize,
    rows: usize,
    width: usize,
    height: usize,
    aspect: f64,
    fit: Fit,
    view_row: i64,
    missing_views: Missing,
    sequence: bool,
    calibration: String,
    write_quilt: bool,
}

/// The content of `quilt.json`.
#[derive(Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Manifest {
    schema: &'static str,
    version: u32,
    files: Vec<Entry>,
}

/// The entry of one time step in `quilt.json`.
#[derive(Clone, Debug, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Entry {
    time: u64,
    time_seconds: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    quilt: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    native: Option<String>,
    width: usize,
    height: usize,
    columns: usize,
    rows: usize,
    tile: [usize; 2],
    aspect: f64,
    /// Name of a video encoder that accepts pictures of this size.
    video: &'static str,
    /// The views from left to right; the first is the tile at the bottom left.
    views: Vec<ViewEntry>,
}

#[derive(Clone, Debug, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct ViewEntry {
    slope: [f64; 2],
    made: Made,
}

impl OutputPlugin for Quilt {
    const DOC: &'static str = "Writes quilts for lenticular displays and, with a display's calibration, its native picture. \
        The file quilt.json states the slope of every view.";
    const PORTS: &'static [Port] = &[Port::LightField, Port::LayerStack];
    type Params = QuiltParams;

    fn schema() -> Schema {
        let known = devices().iter().map(|device| (device.id.as_str(), device.name.as_str()));
        Schema::new([
            Param::text("name", "quilt", "Prefix of the files' names."),
            Param::choice(
                "device",
                CUSTOM,
                [(CUSTOM, "No device: tiles have the views' own pixels.")].into_iter().chain(known),
                "Device whose default quilt is written; the parameters columns, rows, width, height and aspect override its values.",
            ),
            Param::int("columns", 0, 0..=100, "Number of columns of views. 0, which requires rows = 0, uses the device's number, or without a device the number with which the quilt is nearest to a square.")
                .unit("views"),
            Param::int("rows", 0, 0..=100, "Number of rows of views. 0, which requires columns = 0, uses the device's number, or without a device the number with which the quilt is nearest to a square.").unit("views"),
            Param::int(
                "width",
                0,
                0..=16384,
                "Width of the quilt. 0 uses the device's width, or without a device the sum of the views' widths.",
            )
            .unit("px"),
            Param::int(
                "height",
                0,
                0..=16384,
                "Height of the quilt. 0 uses the device's height, or without a device the sum of the views' heights.",
            )
            .unit("px"),
            Param::float(
                "aspect",
                0.0,
                0.0..=10.0,
                "Width over height of one view on the screen, independent of its tile. 0 uses the aspect of the calibration's screen; without a calibration the aspect of the device; without a device the aspect of the views.",
            )
            .unit("1"),
            Param::choice(
                "fit",
                "contain",
                [
                    ("contain", "The whole view, with black bars."),
                    ("cover", "No bars; the view is cropped."),
                    ("stretch", "Stretched to the tile."),
                ],
                "Fit of a view to a tile of another aspect.",
            ),
            Param::int(
                "view_row",
                -1,
                -1..=9999,
                "Row of views to use. 0 is the topmost row and -1 the central row; of two central rows the upper row is used.",
            )
            .unit("rows"),
            Param::choice(
                "missing_views",
                "nearest",
                [
                    ("nearest", "The nearest view, with a warning."),
                    ("blend", "A blend of the two neighbouring views, which shows double edges, with a warning."),
                    ("refuse", "An error that states the number of views to render."),
                ],
                "Handling of tiles at whose position a light field has no view. Layer stacks are simulated at every position.",
            ),
            Param::bool(
                "sequence",
                false,
                "Also number the files of the first time step (NAME_f0000_qs...). The files of later time steps always have numbers.",
            ),
            Param::file(
                "calibration",
                "The display's calibration (visual.json), or its text. With a calibration, the native picture is also written: the woven picture in the screen's own pixels.",
            ),
            Param::bool("write_quilt", true, "Write the quilt itself."),
        ])
    }

    fn open(host: Host, params: QuiltParams, display: Display) -> Result<Self, PluginError> {
        let plain = |c: char| c.is_alphanumeric() || "-_. ".contains(c);
        if params.name.is_empty() || params.name.starts_with('.') || !params.name.chars().all(plain) {
            return Err(PluginError::Refused(format!(
                "parameter `name`: expected one or more letters, digits, spaces, dots, dashes and underscores, without a dot at the beginning, found {:?}",
                params.name
            )));
        }
        let calibration = read_calibration(&params.calibration)?;
        if calibration.is_none() && !params.write_quilt {
            let text = "parameter `write_quilt`: expected true, or a `calibration` for the native picture, found false without a `calibration`";
            return Err(PluginError::Refused(text.into()));
        }
        let device = devices().iter().find(|device| device.id == params.device);
        let output = Self { host, params, device, calibration, written: Mutex::default() };
        // The submitted data will have the views and pixels of the display. So check the layout and
        // the row of views here, before the data are made.
        let geometry = display.geometry().map_err(|error| PluginError::failed("display", error))?;
        let layout = output.layout(&geometry)?;
        views::row_of(geometry.grid.slope_y.len(), output.params.view_row)?;
        if output.host.port() == Some(Port::LightField) {
            views::advice(geometry.grid.slope_x.len(), layout.views(), output.params.missing_views)?;
        }
        Ok(output)
    }

    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        let source = match data {
            Input::LayerStack(stack) => Source::Stack(stack),
            Input::LightField(field) => Source::Field(field),
            other => return Err(PluginError::unexpected(other)),
        };
        let entry = self.write(time, &source)?;
        self.written.lock().unwrap_or_else(PoisonError::into_inner).push(entry);
        Ok(())
    }

    fn finish(self) -> Result<(), PluginError> {
        self.host.check_cancelled()?;
        let mut files = self.written.into_inner().unwrap_or_else(PoisonError::into_inner);
        files.sort_by_key(|entry| entry.time);
        let manifest = Manifest { schema: "lumistack/quilt", version: 1, files };
        let text = serde_json::to_string_pretty(&manifest).expect("JSON can express a manifest");
        self.host.write("quilt.json", format!("{text}\n").as_bytes())
    }
}

impl Quilt {
    fn write(&self, time: Time, source: &Source<'_>) -> Result<Entry, PluginError> {
        let (params, geometry) = (&self.params, source.geometry());
        let size = [geometry.cols, geometry.rows];
        let layout = self.layout(geometry)?;
        let row = source.row(params.view_row)?;
        if matches!(source, Source::Field(_))
            && let Some(advice) = views::advice(geometry.grid.slope_x.len(), layout.views(), params.missing_views)?
        {
            self.host.warn(&advice);
        }
        // Warn of black bars, and of sizes that video encoders refuse.
        let black = black_share(size, layout.aspect, params.fit);
        if black >= LEAST_BLACK {
            self.host.warn(&format!(
                "{:.0} % of the quilt is black, since the views have the aspect {:.3}, but the display has the aspect {:.3}. Render views of the display's aspect (for example {} × {} \
                 pixels), or set fit = \"cover\" to crop the views",
                100.0 * black,
                size[0] as f64 / size[1] as f64,
                layout.aspect,
                size[0],
                (size[0] as f64 / layout.aspect).round(),
            ));
        }
        if params.sequence && layout.size.iter().any(|side| side % 2 == 1) {
            let [width, height] = layout.size;
            self.host.warn(&format!("video encoders require even sizes, but the quilt has {width} × {height} pixels"));
        }
        // Make the quilt, even if it is not written, since the native picture is made from it.
        let (quilt, views) = self.fill(source, &layout, size, row)?;
        let frame = if params.sequence || time.index > 0 { format!("_f{:04}", time.index) } else { String::new() };
        let name = format!("{}{frame}", params.name);
        let quilt_file = params.write_quilt.then(|| format!("{name}{}.png", layout.suffix()));
        if let Some(file) = &quilt_file {
            self.write_png(file, layout.size, &quilt)?;
        }
        let native_file = self.calibration.as_ref().map(|_| format!("{name}_native.png"));
        if let (Some(calibration), Some(file)) = (&self.calibration, &native_file) {
            self.host.check_cancelled()?;
            self.write_png(file, calibration.screen, &calibration.weave(&quilt, &layout))?;
        }
        Ok(Entry {
            time: time.index,
            time_seconds: time.seconds,
            quilt: quilt_file,
            native: native_file,
            width: layout.size[0],
            height: layout.size[1],
            columns: layout.columns,
            rows: layout.rows,
            tile: layout.tile(),
            aspect: layout.aspect,
            video: if layout.size.iter().all(|side| *side <= H264_SIDE) { "h264" } else { "hevc" },
            views,
        })
    }

    /// Returns the layout of the quilt for data of this geometry.
    fn layout(&self, geometry: &FieldGeometry) -> Result<Layout, PluginError> {
        let QuiltParams { columns, rows, width, height, .. } = self.params;
        let given = Given { views: [columns, rows], size: [width, height], aspect: self.aspect() };
        Layout::new(self.device, given, geometry.grid.slope_x.len(), [geometry.cols, geometry.rows])
    }

    /// Returns the aspect of a view, or 0 if neither the parameter nor a calibration sets it. A
    /// calibrated screen shows every view over its whole area, so by default the aspect is the
    /// screen's.
    fn aspect(&self) -> f64 {
        match &self.calibration {
            Some(calibration) if self.params.aspect == 0.0 => {
                calibration.screen[0] as f64 / calibration.screen[1] as f64
            }
            _ => self.params.aspect,
        }
    }

    /// Computes the quilt's codes `[row][col][rgb]`, and describes its views.
    fn fill(
        &self,
        source: &Source<'_>,
        layout: &Layout,
        size: [usize; 2],
        row: usize,
    ) -> Result<(Vec<u8>, Vec<ViewEntry>), PluginError> {
        let params = &self.params;
        let (tile, width) = (layout.tile(), layout.size[0]);
        let mut quilt = vec![0; 3 * width * layout.size[1]];
        let mut entries = Vec::with_capacity(layout.views());
        let stage = self.host.stage("quilt", layout.views() as u64, "views");
        let all = places(layout.views(), source.geometry().grid.slope_x.len());
        for (view, place) in all.into_iter().enumerate() {
            self.host.check_cancelled()?;
            let (rgb, made, slope) = source.view(place, row, params.missing_views)?;
            let codes = codes8(&Transfer::Srgb, &fitted(&rgb, size, tile, layout.aspect, params.fit));
            let [x, y] = layout.corner(view);
            for (tile_row, line) in codes.chunks_exact(3 * tile[0]).enumerate() {
                quilt[3 * ((y + tile_row) * width + x)..][..line.len()].copy_from_slice(line);
            }
            entries.push(ViewEntry { slope, made });
            stage.advance(1, "");
        }
        Ok((quilt, entries))
    }

    /// Writes a PNG of `size` = [columns, rows].
    fn write_png(&self, path: &str, size: [usize; 2], codes: &[u8]) -> Result<(), PluginError> {
        let failed = |error: png::EncodingError| match error {
            png::EncodingError::IoError(error) => PluginError::from_io(path, error),
            other => PluginError::failed(path, other),
        };
        let mut file = self.host.create(path)?;
        let mut writer = BufWriter::with_capacity(1 << 20, &mut file);
        let mut encoder = png::Encoder::new(&mut writer, size[0] as u32, size[1] as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
        encoder.set_compression(png::Compression::Fast);
        let mut encoder = encoder.write_header().map_err(failed)?;
        let mut lines = encoder.stream_writer().map_err(failed)?;
        for line in codes.chunks_exact(3 * size[0]) {
            lines.write_all(line).map_err(|error| PluginError::from_io(path, error))?;
        }
        lines.finish().map_err(failed)?;
        encoder.finish().map_err(failed)?;
        writer.into_inner().map_err(|error| PluginError::from_io(path, error.into_error()))?;
        file.commit()
    }
}

/// Reads a calibration; `given` is its JSON text, or the path of a file with this text.
fn read_calibration(given: &str) -> Result<Option<Calibration>, PluginError> {
    let refused = |text: String| PluginError::Refused(format!("parameter `calibration`: {text}"));
    if given.is_empty() {
        return Ok(None);
    }
    let text = if given.trim_start().starts_with('{') {
        given.to_string()
    } else {
        std::fs::read_to_string(given).map_err(|error| refused(format!("cannot read {given}: {error}")))?
    };
    let json = serde_json::from_str(&text).map_err(|error| refused(format!("invalid JSON: {error}")))?;
    Calibration::from_json(&json).map(Some).map_err(|error| refused(error.to_string()))
}

export_plugin!("quilt", Quilt);
