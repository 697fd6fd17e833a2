//! Makes pictures that the page shows while its patterns load. They are the seen picture from the
//! middle, and small views from a few positions in the zone.

use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use lumistack_plugin::core::colour::srgb_code;
use lumistack_plugin::display::{FieldGeometry, Projection};
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin::{PluginError, StackInput, ViewPoint};

use crate::pictures::Picture;

/// Path of the poster.
pub(crate) const POSTER: &str = "stack/poster.jpg";
/// Path of the picture with the small views.
pub(crate) const AROUND: &str = "stack/around.jpg";
/// Longest side of the poster, pixels.
const POSTER_PX: usize = 1200;
/// Longest side of a small view, pixels.
const AROUND_PX: usize = 240;
/// Size limit of the poster's file, bytes; see [`QUALITIES`].
const POSTER_BYTES: usize = 45_000;
/// Size limit of the file with all small views, bytes; see [`QUALITIES`].
const AROUND_BYTES: usize = 110_000;
/// JPEG qualities. The first quality whose file is within its size limit is used. If there is none,
/// the last quality is used, and the file exceeds the limit.
const QUALITIES: [u8; 6] = [88, 80, 72, 64, 56, 48];
/// Numbers of small views over the viewing zone, [horizontal, vertical]. Neighbouring small views
/// are so close that their blend shows no visible double edges.
const PLACES: [usize; 2] = [5, 3];

/// A JPEG picture and its size.
#[derive(Debug)]
pub(crate) struct Poster {
    pub(crate) jpeg: Vec<u8>,
    pub(crate) rows: usize,
    pub(crate) cols: usize,
}

impl Poster {
    /// Makes the seen picture from the middle. Its values are divided by the brightness β, as an
    /// adapted eye sees them.
    ///
    /// # Errors
    /// If the host cannot simulate, or the picture cannot be encoded as JPEG.
    pub(crate) fn new(stack: &StackInput<'_>) -> Result<Self, PluginError> {
        let picture = seen(stack, [0.0; 2], POSTER_PX)?;
        let jpeg = jpeg_of(&picture, POSTER_BYTES)?;
        Ok(Self { jpeg, rows: picture.rows, cols: picture.cols })
    }
}

/// Makes one picture with small views from the whole zone. It is a grid of tiles, with the leftmost
/// and topmost view at the top left. Also returns the entry for preview.json.
///
/// # Errors
/// If the host cannot simulate, or the picture cannot be encoded as JPEG.
pub(crate) fn around(stack: &StackInput<'_>, fov_deg: [f64; 2]) -> Result<(Vec<u8>, Value), PluginError> {
    let views = stack.target().grid.views();
    // An axis with a single view has no viewing zone, so its small views have slope 0.
    let slopes = |axis: usize, views: usize| match (views, PLACES[axis]) {
        (1, _) => vec![0.0],
        (_, count) => {
            let most = (0.5 * fov_deg[axis].to_radians()).tan();
            (0..count).map(|i| most * (2.0 * i as f64 / (count - 1) as f64 - 1.0)).collect::<Vec<_>>()
        }
    };
    let (across, upwards) = (slopes(0, views[1]), slopes(1, views[0]));
    let mut lines: Vec<Vec<u8>> = Vec::new();
    let mut size = [0; 2];
    for y in upwards.iter().rev() {
        let tiles: Vec<Picture> =
            across.iter().map(|x| seen(stack, [*x, *y], AROUND_PX)).collect::<Result<_, PluginError>>()?;
        size = [tiles[0].rows, tiles[0].cols];
        let line = |row: usize| tiles.iter().flat_map(move |tile| &tile.codes[3 * row * size[1]..][..3 * size[1]]);
        lines.extend((0..size[0]).map(|row| line(row).copied().collect::<Vec<u8>>()));
    }
    let quilt = Picture { rows: lines.len(), cols: size[1] * across.len(), codes: lines.concat() };
    let told = json!({
        "path": AROUND, "rows": size[0], "cols": size[1],
        "slope_x": across, "slope_y": upwards.iter().rev().collect::<Vec<_>>(),
    });
    Ok((jpeg_of(&quilt, AROUND_BYTES)?, told))
}

/// Returns the seen picture along a slope at the centre of the field, encoded as sRGB. A box filter
/// reduces the picture so that no side is longer than `most` pixels.
fn seen(stack: &StackInput<'_>, [x, y]: [f64; 2], most: usize) -> Result<Picture, PluginError> {
    let from = match stack.target().grid.projection {
        Projection::Oblique => ViewPoint::Slope([x, y]),
        Projection::Perspective { distance_mm: z } => ViewPoint::Eye([x * z, y * z, z]),
    };
    let plane = stack.simulate(from)?;
    Ok(reduced(&plane.values(), stack.target(), most, (1.0 / stack.brightness()) as f32))
}

/// Multiplies values by `scale`, clips them at 1, averages them over boxes of whole pixels, and
/// encodes the means as sRGB.
fn reduced(linear: &[f32], geometry: &FieldGeometry, most: usize, scale: f32) -> Picture {
    let (rows, cols) = (geometry.rows, geometry.cols);
    let step = rows.max(cols).div_ceil(most);
    let [out_rows, out_cols] = [rows, cols].map(|count| count.div_ceil(step));
    let mut codes = Vec::with_capacity(3 * out_rows * out_cols);
    for (row, col) in (0..out_rows).flat_map(|row| (0..out_cols).map(move |col| (row, col))) {
        let within = |start: usize, count: usize| start * step..((start + 1) * step).min(count);
        let (mut sum, mut count) = ([0.0f32; 3], 0.0);
        for (y, x) in within(row, rows).flat_map(|y| within(col, cols).map(move |x| (y, x))) {
            let pixel = &linear[3 * (y * cols + x)..][..3];
            sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += (scale * value).min(1.0));
            count += 1.0;
        }
        codes.extend(sum.map(|sum| srgb_code(sum / count)));
    }
    Picture { rows: out_rows, cols: out_cols, codes }
}

/// Encodes a picture as JPEG, in the best quality of [`QUALITIES`] whose file has at most
/// `most_bytes`. If no quality gives such a file, the lowest quality is used.
fn jpeg_of(picture: &Picture, most_bytes: usize) -> Result<Vec<u8>, PluginError> {
    let (width, height) = (picture.cols as u32, picture.rows as u32);
    let mut jpeg = Vec::new();
    for quality in QUALITIES {
        jpeg.clear();
        JpegEncoder::new_with_quality(&mut jpeg, quality)
            .encode(&picture.codes, width, height, ExtendedColorType::Rgb8)
            .map_err(|error| PluginError::failed("a picture", error))?;
        if jpeg.len() <= most_bytes {
            break;
        }
    }
    Ok(jpeg)
}
