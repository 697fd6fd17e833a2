//! [`AreaMap`] as numbers for textures: the shader looks up where a ray goes and computes nothing.
//!
//! The picture from one place is a seen one, the mean over every pixel's area: pixels are cut into parts whose rays read the same ([`AreaMap`]). Through a
//! pupil, which averages over places, it is put together from one ray per pixel and place. One row of `x` for every place along x, every part and everything that a ray meets,
//! one texel for every field column:
//!
//! ```text
//! row = (place · parts + part) · rows_per_part
//! x[row + n][col] = first, second, t, share      layer n; first = −1 where it is missed
//! x[row + N][col] = lenslet, bin, 0, share       backlight; lenslet = −1 where it is dark, −2 where it is missed
//! ```
//!
//! and `y` alike. `share` of the pixel's width is 0 of parts that a pixel does not have. Indices below 2²⁴ are exact in single precision.

use lumistack_display::{AreaMap, BacklightTap, Display, FieldGeometry, Part, Projection, RayMap, Tap, ViewGrid};

use crate::Pupil;

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct Tables {
    /// Places on the pupil along either axis.
    pub places: usize,
    /// Which places `[y][x]` count, row by row.
    pub on_disc: Vec<bool>,
    /// Parts of a pixel along x and along y, of the one that has most.
    pub parts: [usize; 2],
    /// Layers, and one more where the backlight is directional.
    pub rows_per_part: usize,
    /// Four numbers for every place, part, layer and field column.
    pub x: Vec<f32>,
    /// Four numbers for every place, part, layer and field row.
    pub y: Vec<f32>,
}

impl Tables {
    /// Tables of a view.
    pub(crate) fn new(
        display: &Display,
        geometry: &FieldGeometry,
        pupil: &Pupil,
        slope: [f64; 2],
        projection: Projection,
    ) -> Self {
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

/// The parts of an axis, each with its number within its pixel.
struct Cut<'a> {
    list: &'a [Part],
    numbers: Vec<usize>,
    /// Pixels.
    width: usize,
    /// Most of a pixel.
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

    /// Writes texels of row `row` of every part; `rays` gives the first three numbers of the ray of a part.
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
