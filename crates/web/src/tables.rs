//! [`RayMap`] as numbers for textures: the shader looks up where a ray goes and computes nothing.
//!
//! One row of `x` for every place on the pupil (along x) and everything that a ray meets, one texel for every field column:
//!
//! ```text
//! x[(place · rows_per_place + n)][col] = first, second, t, 0      layer n; first = −1 where it is missed
//! x[(place · rows_per_place + N)][col] = lenslet, bin, 0, 0       backlight; lenslet = −1 where it is dark, −2 where it is missed
//! ```
//!
//! and `y` alike. Indices below 2²⁴ are exact in single precision.

use lumistack_display::{BacklightTap, Display, FieldGeometry, Projection, RayMap, Tap, ViewGrid};

use crate::Pupil;

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct Tables {
    /// Places on the pupil along either axis.
    pub places: usize,
    /// Which places `[y][x]` count, row by row.
    pub on_disc: Vec<bool>,
    /// Layers, and one more where the backlight is directional.
    pub rows_per_place: usize,
    /// Four numbers for every place, part and field column.
    pub x: Vec<f32>,
    /// Four numbers for every place, part and field row.
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
        let slopes = |centre: f64| pupil.offsets.iter().map(|offset| centre + offset).collect();
        let grid = ViewGrid { projection, slope_x: slopes(slope[0]), slope_y: slopes(slope[1]) };
        let map = RayMap::new(display, &geometry.with_grid(grid));
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for place in 0..pupil.offsets.len() {
            for layer in &map.layers {
                x.extend(layer.x.of_view(place).iter().flat_map(tap_texel));
                y.extend(layer.y.of_view(place).iter().flat_map(tap_texel));
            }
            if let Some(backlight) = &map.backlight {
                x.extend(backlight.x(place).iter().flat_map(backlight_texel));
                y.extend(backlight.y(place).iter().flat_map(backlight_texel));
            }
        }
        let rows_per_place = map.layers.len() + usize::from(map.backlight.is_some());
        Self { places: pupil.offsets.len(), on_disc: pupil.on_disc.clone(), rows_per_place, x, y }
    }
}

fn tap_texel(tap: &Tap) -> [f32; 4] {
    if tap.is_missed() { [-1.0, -1.0, 0.0, 0.0] } else { [tap.first as f32, tap.second as f32, tap.t, 0.0] }
}

fn backlight_texel(tap: &BacklightTap) -> [f32; 4] {
    match *tap {
        BacklightTap::Lit { lenslet, bin } => [lenslet as f32, bin as f32, 0.0, 0.0],
        BacklightTap::Dark => [-1.0, 0.0, 0.0, 0.0],
        BacklightTap::Missed => [-2.0, 0.0, 0.0, 0.0],
    }
}
