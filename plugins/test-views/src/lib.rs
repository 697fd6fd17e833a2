//! Source plugin `test_views`: makes light fields of known radiance, with which a display is
//! checked.
//!
//! | pattern | views | purpose |
//! |---|---|---|
//! | `numbers` | the view's column and row (0,0 at the left and top) on a coloured ground: red at the left, blue at the right, more green upwards | shows the order of views, mirroring and crosstalk |
//! | `cards` | three chequered cards side by side, at z = −depth, 0 and +depth | shows the sign and size of parallax |
//!
//! A ray of slope s through the point p on z = 0 hits the plane of a card at depth z in p + z·s.
//! Positions are in millimetres, y points up, and z points to the viewer. A pixel is the mean over
//! 4 × 4 points.

use lumistack_plugin::display::{FieldGeometry, LightField};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{Display, Host, Param, PluginError, Schema, SourcePlugin, Time, export_plugin};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// Number of sample points per pixel and axis.
const POINTS: usize = 4;
/// Radiance of the wall behind the cards.
const WALL: f32 = 0.05;
/// Gap between cards as a fraction of the field's width, and gap above and below them as a fraction
/// of its height.
const GAP: f64 = 0.08;

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin `test_views`.
pub struct TestViews;

/// Parameters; see [`TestViews::schema`](SourcePlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct TestViewsParams {
    pattern: Pattern,
    depth_mm: f64,
    squares: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(crate = "lumistack_plugin::serde", rename_all = "lowercase")]
enum Pattern {
    Numbers,
    Cards,
}

impl SourcePlugin for TestViews {
    const DOC: &'static str = "Makes light fields of known radiance, to check a display: numbered views, and chequered cards at three depths.";
    type Params = TestViewsParams;

    fn schema() -> Schema {
        Schema::new([
            Param::choice(
                "pattern",
                "numbers",
                [
                    ("numbers", "Every view shows its own column and row, counted from 0 at the left and top."),
                    ("cards", "Three cards side by side, behind the display plane, on it and in front of it."),
                ],
                "Content of the views.",
            ),
            Param::float("depth_mm", 20.0, 0.0..=10000.0, "Distance of the outer cards from the display plane.")
                .unit("mm"),
            Param::int("squares", 8, 1..=1000, "Number of squares across a card.").unit("1"),
        ])
    }

    fn make(host: &Host, params: TestViewsParams, display: &Display, _time: Time) -> Result<LightField, PluginError> {
        let refused = |error: &dyn std::fmt::Display| PluginError::Refused(error.to_string());
        let geometry = display.geometry().map_err(|error| refused(&error))?;
        let mut field = LightField::black(geometry.clone()).map_err(|error| refused(&error))?;
        let views = geometry.grid.views();
        let stage = host.stage("test views", (views[0] * views[1]) as u64, "views");
        for view in geometry.grid.iter() {
            host.check_cancelled()?;
            match params.pattern {
                Pattern::Numbers => number(&geometry, view, field.view_mut(view)),
                Pattern::Cards => cards(&geometry, view, &params, field.view_mut(view)),
            }
            stage.advance(1, "");
        }
        Ok(field)
    }
}

/// Draws column and row of the view, in white.
fn number(geometry: &FieldGeometry, view: [usize; 2], rgb: &mut [f32]) {
    let share = |axis: usize| view[axis] as f32 / (geometry.grid.views()[axis] - 1).max(1) as f32;
    let colour = [0.6 * (1.0 - share(1)), 0.4 * (1.0 - share(0)), 0.6 * share(1)];
    let text: Vec<char> = format!("{},{}", view[1], view[0]).chars().collect();
    let letter = get_raster_width(FontWeight::Bold, RasterHeight::Size32);
    let [width, height] = [text.len() * letter, RasterHeight::Size32.val()].map(|side| side as f64);
    // The text is half as high as the field. It is smaller if it would otherwise be wider than 0.8
    // of the field's width.
    let scale = (0.5 * geometry.rows as f64 / height).min(0.8 * geometry.cols as f64 / width);
    let ink = |x: f64, y: f64| -> f32 {
        if !(0.0..width).contains(&x) || !(0.0..height).contains(&y) {
            return 0.0;
        }
        let (col, row) = (x as usize, y as usize);
        let raster = get_raster(text[col / letter], FontWeight::Bold, RasterHeight::Size32);
        raster.map_or(0.0, |raster| f32::from(raster.pixel(col % letter, row).unwrap_or(0)) / 255.0)
    };
    for (row, line) in rgb.chunks_exact_mut(3 * geometry.cols).enumerate() {
        for (col, pixel) in line.chunks_exact_mut(3).enumerate() {
            let cover = mean(|dx, dy| {
                let x = (col as f64 + dx - 0.5 * geometry.cols as f64) / scale + 0.5 * width;
                let y = (row as f64 + dy - 0.5 * geometry.rows as f64) / scale + 0.5 * height;
                ink(x, y)
            });
            pixel.iter_mut().zip(colour).for_each(|(value, colour)| *value = colour + cover * (1.0 - colour));
        }
    }
}

/// Draws the three chequered cards.
fn cards(geometry: &FieldGeometry, view: [usize; 2], params: &TestViewsParams, rgb: &mut [f32]) {
    let pitch = geometry.pitch_mm;
    let [width, height] = [geometry.cols as f64 * pitch, geometry.rows as f64 * pitch];
    let (side, gap) = ((1.0 - 4.0 * GAP) / 3.0 * width, GAP * width);
    let half_height = (0.5 - GAP) * height;
    let square = side / params.squares as f64;
    // (x of the centre, z, colour) of each card, from front to back, since a front card hides the
    // cards behind it
    let cards = [1.0, 0.0, -1.0].map(|place| {
        let colour = [[1.0, 0.75, 0.5], [1.0, 1.0, 1.0], [0.5, 0.75, 1.0]][(1.0 - place) as usize];
        (place * (side + gap), place * params.depth_mm, colour)
    });
    for row in 0..geometry.rows {
        for col in 0..geometry.cols {
            let shown = |channel: usize| {
                mean(|dx, dy| {
                    let x = (col as f64 + dx) * pitch - 0.5 * width;
                    let y = 0.5 * height - (row as f64 + dy) * pitch;
                    let slope = geometry.grid.slope_at(view, [x, y]);
                    let hit = cards.iter().find_map(|(centre, z, colour)| {
                        let [u, v] = [x + z * slope[0] - centre + 0.5 * side, y + z * slope[1] + half_height];
                        let inside = (0.0..side).contains(&u) && (0.0..2.0 * half_height).contains(&v);
                        let light = ((u / square).floor() + (v / square).floor()) as i64 % 2 == 0;
                        inside.then_some(if light { 0.9 } else { 0.1 } * colour[channel])
                    });
                    hit.unwrap_or(WALL)
                })
            };
            let pixel = 3 * (row * geometry.cols + col);
            (0..3).for_each(|channel| rgb[pixel + channel] = shown(channel));
        }
    }
}

/// Returns the mean of `value` over the sample points of a pixel. `value` receives a point's
/// coordinates in the pixel, 0..1.
fn mean(value: impl Fn(f64, f64) -> f32) -> f32 {
    let at = |i: usize| (i as f64 + 0.5) / POINTS as f64;
    let sum: f32 = (0..POINTS * POINTS).map(|i| value(at(i % POINTS), at(i / POINTS))).sum();
    sum / (POINTS * POINTS) as f32
}

export_plugin!("test_views", TestViews as source);
