//! Tables for the shader that state where rays hit the layers. The shader reads them as textures
//! and computes no geometry.
//!
//! If the eye's pupil is a pinhole, a pixel of the picture is the mean over the pixel's area. For
//! this, [`AreaMap`] splits each pixel into parts, so that all rays of a part read the same pixels
//! of the layers. With a larger pupil, a pixel is a mean over the pupil's points, with one ray for
//! each point. Then every pixel is a single part.
//!
//! Table `x` has a row for every combination of a point of the pupil along x, a part, and a layer
//! or the backlight. A row has one texel per column of the light field. Let `place` be the number
//! of the point, `part` the number of the part, and N the number of layers. `parts` and
//! `rows_per_part` are fields of [`Tables`]:
//!
//! ```text
//! row = (place · parts + part) · rows_per_part
//! x[row + n][col] = first, second, t, share   layer n; first = −1: the ray misses it
//! x[row + N][col] = lenslet, bin, 0, share    backlight; lenslet = −1: dark, −2: the ray misses it
//! ```
//!
//! Table `y` has the same form, for the rows of the light field. A ray hits a layer between the
//! columns (or rows) `first` and `second`, and reads their values with the weights 1 − t and t.
//! `share` is the part's fraction of the pixel's width (or height). Every pixel has room for the
//! largest number of parts; `share` is 0 for the parts that a pixel does not use. Indices below 2²⁴
//! are exact in single precision.

use lumistack_display::{AreaMap, BacklightTap, Display, FieldGeometry, Part, Projection, RayMap, Tap, ViewGrid};

use crate::Pupil;

/// Tables of one view; the module's documentation describes their texels.
#[derive(Clone, Debug, PartialEq)]
pub struct Tables {
    /// Points of the pupil along each axis.
    pub places: usize,
    /// True for every point `[y][x]` of the pupil's grid, row by row, that lies on the pupil's
    /// disc.
    pub on_disc: Vec<bool>,
    /// Largest number of parts of a pixel along x, and along y.
    pub parts: [usize; 2],
    /// Number of layers, plus one for a directional backlight.
    pub rows_per_part: usize,
    /// Table `x`: four numbers for every point, part, layer (or backlight), and column of the light
    /// field.
    pub x: Vec<f32>,
    /// Table `y`: four numbers for every point, part, layer (or backlight), and row of the light
    /// field.
    pub y: Vec<f32>,
}

impl Tables {
    /// Computes the tables of a view.
    pub(crate) fn new(
        display: &Display,
        geometry: &FieldGeometry,
        pupil: &Pupil,
        slope: [f64; 2],
        projection: Projection,
    ) -> Self {
        // Compute the rays of one view per point of the pupil.
        let places = pupil.offsets.len();
        let slopes = |centre: f64| pupil.offsets.iter().map(|offset| centre + offset).collect();
        let grid = ViewGrid { projection, slope_x: slopes(slope[0]), slope_y: slopes(slope[1]) };
        let geometry = geometry.with_grid(grid);
        let map = if places == 1 {
            AreaMap::new(display, &geometry, [0, 0])
        } else {
            let whole = |count: usize| (0..count as u32).map(|pixel| Part { pixel, share: 1.0 }).collect();
            AreaMap { map: RayMap::new(display, &geometry), x: whole(geometry.cols), y: whole(geometry.rows) }
        };
        // Write a texel for every layer and one for the backlight. A texel states the pixels or the
        // lenslet that a ray reads.
        let rows_per_part = map.map.layers.len() + usize::from(map.map.backlight.is_some());
        let axes = [(&map.x, geometry.cols), (&map.y, geometry.rows)].map(|(list, width)| Cut::new(list, width));
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for place in 0..places {
            for (axis, table) in [&mut x, &mut y].into_iter().enumerate() {
                let start = table.len();
                table.resize(start + axes[axis].parts * rows_per_part * axes[axis].width * 4, 0.0);
                let table = &mut table[start..];
                for (n, layer) in map.map.layers.iter().enumerate() {
                    let taps = [&layer.x, &layer.y][axis].of_view(place);
                    axes[axis].fill(table, [rows_per_part, n], |i| tap_texel(&taps[i]));
                }
                if let Some(backlight) = &map.map.backlight {
                    let taps = if axis == 0 { backlight.x(place) } else { backlight.y(place) };
                    axes[axis].fill(table, [rows_per_part, map.map.layers.len()], |i| backlight_texel(&taps[i]));
                }
            }
        }
        let parts = [axes[0].parts, axes[1].parts];
        Self { places, on_disc: pupil.on_disc.clone(), parts, rows_per_part, x, y }
    }
}

/// The parts of all pixels along an axis.
struct Cut<'a> {
    list: &'a [Part],
    /// Index of each part of `list` within its pixel.
    numbers: Vec<usize>,
    /// Number of pixels.
    width: usize,
    /// Largest number of parts of a pixel.
    parts: usize,
}

impl<'a> Cut<'a> {
    fn new(list: &'a [Part], width: usize) -> Self {
        let mut counts = vec![0; width];
        let number = |part: &Part| {
            let count = &mut counts[part.pixel as usize];
            *count += 1;
            *count - 1
        };
        let numbers = list.iter().map(number).collect();
        Self { list, numbers, width, parts: counts.into_iter().max().unwrap_or(0) }
    }

    /// Writes one row of every part, the row with the number `row`. A part has `rows` rows, each
    /// for a layer or for the backlight. `rays(i)` returns the first three numbers of the texel for
    /// part i of the list.
    fn fill(&self, table: &mut [f32], [rows, row]: [usize; 2], rays: impl Fn(usize) -> [f32; 3]) {
        for (i, (part, number)) in self.list.iter().zip(&self.numbers).enumerate() {
            let at = 4 * ((number * rows + row) * self.width + part.pixel as usize);
            table[at..at + 3].copy_from_slice(&rays(i));
            table[at + 3] = part.share as f32;
        }
    }
}

fn tap_texel(tap: &Tap) -> [f32; 3] {
    if tap.is_missed() { [-1.0, -1.0, 0.0] } else { [tap.first as f32, tap.second as f32, tap.t] }
}

fn backlight_texel(tap: &BacklightTap) -> [f32; 3] {
    match *tap {
        BacklightTap::Lit { lenslet, bin } => [lenslet as f32, bin as f32, 0.0],
        BacklightTap::Dark => [-1.0, 0.0, 0.0],
        BacklightTap::Missed => [-2.0, 0.0, 0.0],
    }
}
