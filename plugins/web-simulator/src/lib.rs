//! Output plugin `web_simulator`: writes a static site that simulates the display in a browser.
//!
//! | file | content |
//! |---|---|
//! | `index.html`, `app/` | the page; works under any path of any file server |
//! | `preview.html` | the page and its pictures in one file, which opens by a double click, without the code for headsets and lenticular displays |
//! | `stack/preview.json` | title, caption, display, brightness, target, and the list of pictures in the order of loading: first the frames whose mean is nearest to the final picture |
//! | `stack/poster.jpg` | the seen picture from the middle, which the page shows immediately |
//! | `stack/around.jpg` | for large stacks: small views from the whole zone, side by side, which the page shows while the patterns load |
//! | `stack/layerL_frameM.png` | masks: value = code / 255, linear |
//! | `stack/emission_frameM.png` | emission of a directional backlight, bins side by side: value = code / 255, linear |
//! | `stack/target_YY_XX.png` | views of the target, sRGB-encoded, if the host provides them; at most 7 per axis |
//!
//! Later time steps of a sequence have their own sites in `time_0001/`, `time_0002/`, and so on.
//! Memory holds only one frame of patterns at a time.

mod order;
mod page;
mod pictures;
mod poster;
mod words;

use lumistack_plugin::display::{FieldGeometry, Projection, ViewGrid, spread};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin::{
    Display, Host, Input, OutputPlugin, Param, PluginError, Port, Schema, StackInput, Time, export_plugin, serde_json,
};

use rayon::prelude::*;

use page::{About, Site};
use pictures::{Rounding, emission_picture, layer_picture, png_of, target_codes};
use poster::{AROUND, POSTER, Poster};

pub use page::PREVIEW_JSON;

/// Hash of the sources of this crate and of the page that it writes. It belongs in the keys of all
/// cached results that this code affects.
pub const FINGERPRINT: &str = concat!(env!("LUMISTACK_FINGERPRINT"), " ", include_str!("../dist/sources.blake3"));

/// Largest number of the target's views per axis on the site. All views of a display with hundreds
/// of views would take most of the site's size.
const MOST_TARGETS: usize = 7;
/// Smallest size of the pattern files, bytes, for which small views are written. A mobile
/// connection needs about half a second to load files of this size.
const AROUND_FROM: usize = 1_000_000;

/// The plugin `web_simulator`.
#[derive(Debug)]
pub struct WebSimulator {
    host: Host,
    params: SimulatorParams,
    display: Display,
}

/// Parameters; see [`WebSimulator::schema`](OutputPlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct SimulatorParams {
    title: String,
    caption: String,
    address: String,
    target: bool,
    single_file: bool,
    single_file_mb: f64,
}

impl OutputPlugin for WebSimulator {
    const DOC: &'static str = "Writes a static site that simulates the display; mouse, finger or phone move the view. \
        Open preview.html by a double click, or use `lumistack preview` on the run folder.";
    const PORTS: &'static [Port] = &[Port::LayerStack];
    type Params = SimulatorParams;

    fn schema() -> Schema {
        Schema::new([
            Param::text(
                "title",
                "",
                "Title of the page. A job without this parameter uses the job's name. If a job sets an empty title, the page shows the display's name. A title in the form of a file's name is converted to words.",
            ),
            Param::text("caption", "", "Text below the title; empty for two sentences about the scene and display."),
            Param::text(
                "address",
                "",
                "Address at which the site will be, such as https://example.org/still-life/. Previews of links to the site then show its picture; many services require this address.",
            ),
            Param::bool(
                "target",
                true,
                "Also write views of the target for comparison, at most 7 × 7; the views are a large part of the site's size.",
            ),
            Param::bool("single_file", true, "Also write the page and its pictures as one file, preview.html."),
            Param::float(
                "single_file_mb",
                30.0,
                1.0..=2000.0,
                "Largest size of preview.html. A larger file is left out with a message, since browsers open it slowly.",
            )
            .unit("MB"),
        ])
    }

    fn open(host: Host, params: SimulatorParams, display: Display) -> Result<Self, PluginError> {
        Ok(Self { host, params, display })
    }

    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        let Input::LayerStack(stack) = data else { return Err(PluginError::unexpected(data)) };
        let folder = if time.index == 0 { String::new() } else { format!("time_{:04}/", time.index) };
        let (params, display) = (&self.params, &self.display);
        // Make title, caption and poster, and begin the site.
        let title = words::title_of(if params.title.is_empty() { &display.name } else { &params.title });
        let caption =
            if params.caption.is_empty() { words::caption_of(&title, display) } else { params.caption.clone() };
        let poster = Poster::new(stack)?;
        let about = About { title: &title, caption: &caption, address: &params.address, poster: &poster };
        let most_bytes = params.single_file.then_some((params.single_file_mb * 1e6).round() as usize);
        let mut site = Site::new(&self.host, folder, &about, most_bytes)?;
        let mut files = Vec::new();
        // Choose the views of the target.
        let places = stack.target().grid.views().map(|count| spread(count, MOST_TARGETS));
        let shown = thinned(stack.target(), &places);
        let targets = self.targets(stack, &shown)?;
        let per_frame = stack.layer_count() + usize::from(stack.emission_shape().is_some());
        let stage = self.host.stage("preview", (stack.frames() * per_frame + targets.len()) as u64, "pictures");
        let mut rounding = Rounding::new(display, &shown);
        let mut middles = Vec::with_capacity(stack.frames());
        // Write every frame, and measure the effect of rounding to 8 bits.
        for frame in 0..stack.frames() {
            let mut layers = Vec::with_capacity(stack.layer_count());
            for layer in 0..stack.layer_count() {
                self.host.check_cancelled()?;
                let (picture, exact) = layer_picture(&stack.layer(layer, frame)?);
                let path = format!("stack/layer{layer}_frame{frame}.png");
                let entry = json!({"kind": "layer", "layer": layer, "frame": frame});
                files.push(site.picture(&path, entry, &picture, &png_of(&picture)?)?);
                layers.push((picture, exact));
                stage.advance(1, "");
            }
            let mut emission = None;
            if let Some(shape) = stack.emission_shape() {
                let (picture, exact) = emission_picture(stack, frame, shape)?;
                let path = format!("stack/emission_frame{frame}.png");
                let entry = json!({"kind": "emission", "frame": frame});
                files.push(site.picture(&path, entry, &picture, &png_of(&picture)?)?);
                emission = Some((picture, exact, shape));
                stage.advance(1, "");
            }
            let middle = rounding.add(layers, emission, stack.brightness());
            middles.push(order::coarse(&middle, shown.cols));
        }
        // Sort the files by frame, in an order in which the mean of the first frames is close to
        // the final picture.
        let order = order::by_importance(&middles);
        files.sort_by_key(|file: &Value| order.iter().position(|frame| file["frame"] == *frame));
        let size: u64 = files.iter().filter_map(|file| file["bytes"].as_u64()).sum();
        // Write small views if the pattern files are large. The page shows these views while the
        // patterns load.
        let around = if size >= AROUND_FROM as u64 {
            let (jpeg, entry) = poster::around(stack, display.field.fov_deg)?;
            site.file(AROUND, &jpeg)?;
            Some(entry)
        } else {
            None
        };
        // Write views of the target. The host passes one view at a time. So one view per thread is
        // fetched, then these views are encoded in parallel.
        for some in targets.chunks(rayon::current_num_threads()) {
            self.host.check_cancelled()?;
            let mut views = Vec::with_capacity(some.len());
            for &view in some {
                let plane = stack.target_view([places[0][view[0]], places[1][view[1]]])?;
                views.extend(plane.map(|plane| (view, plane.to_vec(), [plane.rows(), plane.cols()])));
            }
            let encoded = views.into_par_iter().map(|(view, values, size)| {
                let picture = target_codes(&values, size);
                png_of(&picture).map(|png| (view, picture, png))
            });
            for (view, picture, png) in encoded.collect::<Result<Vec<_>, _>>()? {
                let path = format!("stack/target_{:02}_{:02}.png", view[0], view[1]);
                files.push(site.picture(&path, json!({"kind": "target", "view": view}), &picture, &png)?);
                stage.advance(1, "");
            }
        }
        // Write preview.json and the page.
        let rounding_db = rounding.psnr();
        let preview = json!({
            "schema": "lumistack-preview",
            "version": 1,
            "title": title,
            "caption": caption,
            "poster": POSTER,
            "around": around,
            "display": display,
            "brightness": stack.brightness(),
            "frames": stack.frames(),
            "target": geometry_json(&shown),
            "files": files,
            "rounding_db": rounding_db.is_finite().then_some(rounding_db),
        });
        let text = serde_json::to_string(&preview).expect("JSON can express a preview");
        site.finish(&text)
    }

    fn finish(self) -> Result<(), PluginError> {
        Ok(self.host.check_cancelled()?)
    }
}

impl WebSimulator {
    /// Returns the target's views that are written. The views nearest to the middle come first,
    /// since users look there first.
    fn targets(&self, stack: &StackInput<'_>, shown: &FieldGeometry) -> Result<Vec<[usize; 2]>, PluginError> {
        if !self.params.target || !stack.has_target_views() {
            return Ok(Vec::new());
        }
        let [rows, cols] = shown.grid.views();
        let off = |[y, x]: &[usize; 2]| (2 * y + 1).abs_diff(rows).pow(2) + (2 * x + 1).abs_diff(cols).pow(2);
        let mut views: Vec<[usize; 2]> = shown.grid.iter().collect();
        views.sort_by_key(off);
        Ok(views)
    }
}

/// Returns the geometry with the selected rows and columns of views.
fn thinned(geometry: &FieldGeometry, [rows, cols]: &[Vec<usize>; 2]) -> FieldGeometry {
    let pick = |slopes: &[f64], places: &[usize]| places.iter().map(|&place| slopes[place]).collect();
    let grid = &geometry.grid;
    let (slope_x, slope_y) = (pick(&grid.slope_x, cols), pick(&grid.slope_y, rows));
    geometry.with_grid(ViewGrid { projection: grid.projection, slope_x, slope_y })
}

fn geometry_json(geometry: &FieldGeometry) -> Value {
    let (projection, distance_mm) = match geometry.grid.projection {
        Projection::Oblique => ("oblique", None),
        Projection::Perspective { distance_mm } => ("perspective", Some(distance_mm)),
    };
    json!({
        "rows": geometry.rows,
        "cols": geometry.cols,
        "pitch_mm": geometry.pitch_mm,
        "projection": projection,
        "distance_mm": distance_mm,
        "slope_x": geometry.grid.slope_x,
        "slope_y": geometry.grid.slope_y,
    })
}

export_plugin!("web_simulator", WebSimulator);
