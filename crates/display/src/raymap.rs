//! Where the rays of a light field meet the layers and the backlight.
//!
//! Column c of the field at slope s meets layer n at pixel u = (x_c + d_n·s − o_n)/p_n + (W_n−1)/2, computed in f64; rows alike with y
//! down. The map is separable, so one table of W entries per view column and one of H entries per view row and layer describe all rays: rays
//! are never expanded into a list.

use crate::{Backlight, Display, FieldGeometry, LensletBacklight, OutsideBins, Sampling};

/// Where one axis of a ray meets a layer: value = (1 − t)·f(first) + t·f(second).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tap {
    /// Pixel index, or [`Tap::MISSED`].
    pub first: u32,
    /// The next pixel; equals `first` under nearest sampling and at the border.
    pub second: u32,
    /// Weight of `second`, 0..1.
    pub t: f32,
}

impl Tap {
    /// Index of a ray that does not meet the layer.
    pub const MISSED: u32 = u32::MAX;

    /// Whether the ray does not meet the layer.
    #[inline]
    pub fn is_missed(self) -> bool {
        self.first == Self::MISSED
    }

    /// The pixel or pixels around position `u` (in pixels, 0 = centre of the first) of an axis of `count` pixels. The layer ends
    /// half a pixel outside its outermost centres, whatever the sampling.
    fn at(u: f64, count: usize, sampling: Sampling) -> Self {
        let nearest = (u + 0.5).floor();
        if !(nearest >= 0.0 && nearest < count as f64) {
            return Self { first: Self::MISSED, second: Self::MISSED, t: 0.0 };
        }
        match sampling {
            Sampling::Nearest => Self { first: nearest as u32, second: nearest as u32, t: 0.0 },
            Sampling::Bilinear => {
                let clamped = u.clamp(0.0, (count - 1) as f64);
                let first = clamped.floor();
                let second = (first as u32 + 1).min(count as u32 - 1);
                Self { first: first as u32, second, t: (clamped - first) as f32 }
            }
        }
    }
}

/// One axis of a layer: a [`Tap`] for every view column (or row) and field column (or row).
#[derive(Clone, Debug, PartialEq)]
pub struct AxisTaps {
    rays: usize,
    taps: Vec<Tap>,
}

impl AxisTaps {
    /// Taps of all field columns (or rows) for view column (or row) `view`.
    #[inline]
    pub fn of_view(&self, view: usize) -> &[Tap] {
        &self.taps[view * self.rays..(view + 1) * self.rays]
    }
}

/// Where rays meet one layer.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMap {
    /// Along columns, per view column.
    pub x: AxisTaps,
    /// Along rows, per view row.
    pub y: AxisTaps,
    /// Layer rows.
    pub rows: usize,
    /// Layer columns.
    pub cols: usize,
}

/// What one axis of a ray reads of a directional backlight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BacklightTap {
    /// A lenslet and one of its angular bins.
    Lit {
        /// Lenslet column or row.
        lenslet: u32,
        /// Angular bin, from the left or the top.
        bin: u32,
    },
    /// Meets the lenslet grid outside the bins: reads 0.
    Dark,
    /// Passes beside the lenslet grid.
    Missed,
}

/// Where rays meet the directional backlight.
#[derive(Clone, Debug, PartialEq)]
pub struct BacklightMap {
    rays: [usize; 2],
    x: Vec<BacklightTap>,
    y: Vec<BacklightTap>,
}

impl BacklightMap {
    /// All field columns for a view column.
    #[inline]
    pub fn x(&self, view: usize) -> &[BacklightTap] {
        &self.x[view * self.rays[0]..(view + 1) * self.rays[0]]
    }

    /// All field rows for a view row.
    #[inline]
    pub fn y(&self, view: usize) -> &[BacklightTap] {
        &self.y[view * self.rays[1]..(view + 1) * self.rays[1]]
    }
}

/// All tables of one display and one field geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct RayMap {
    /// Rearmost layer first.
    pub layers: Vec<LayerMap>,
    /// `None` for a uniform backlight.
    pub backlight: Option<BacklightMap>,
}

impl RayMap {
    /// Computes the tables; sizes A_x·W and A_y·H per layer.
    pub fn new(display: &Display, geometry: &FieldGeometry) -> Self {
        let layers = display
            .layers
            .iter()
            .map(|layer| {
                let [cols, rows] = layer.resolution;
                let taps = |axis: Axis, count: usize| AxisTaps {
                    rays: axis.rays(geometry),
                    taps: axis
                        .positions(geometry, layer.d_mm, layer.offset_mm)
                        .map(|(position, _)| {
                            Tap::at(position / layer.pitch_mm + (count as f64 - 1.0) / 2.0, count, display.sampling)
                        })
                        .collect(),
                };
                LayerMap { x: taps(Axis::X, cols), y: taps(Axis::Y, rows), rows, cols }
            })
            .collect();
        let backlight = match &display.backlight {
            Backlight::Uniform => None,
            Backlight::Lenslets(lenslets) => Some(BacklightMap {
                rays: [geometry.cols, geometry.rows],
                x: backlight_taps(lenslets, geometry, Axis::X),
                y: backlight_taps(lenslets, geometry, Axis::Y),
            }),
        };
        Self { layers, backlight }
    }
}

/// The two axes of the separable map. Positions and slopes of `Y` are negated, so that both axes run the way array indices do.
#[derive(Clone, Copy)]
enum Axis {
    X,
    Y,
}

impl Axis {
    fn rays(self, geometry: &FieldGeometry) -> usize {
        match self {
            Self::X => geometry.cols,
            Self::Y => geometry.rows,
        }
    }

    /// Position at distance `d_mm` and slope of every ray, view by view, along the index direction.
    fn positions(self, geometry: &FieldGeometry, d_mm: f64, offset_mm: [f64; 2]) -> impl Iterator<Item = (f64, f64)> {
        let (slopes, sign, offset) = match self {
            Self::X => (&geometry.grid.slope_x, 1.0, offset_mm[0]),
            Self::Y => (&geometry.grid.slope_y, -1.0, offset_mm[1]),
        };
        slopes.iter().flat_map(move |&view_slope| {
            (0..self.rays(geometry)).map(move |i| {
                let x = match self {
                    Self::X => geometry.x_mm(i),
                    Self::Y => geometry.y_mm(i),
                };
                let slope = geometry.grid.projection.slope(view_slope, x);
                (sign * (x + d_mm * slope - offset), sign * slope)
            })
        })
    }
}

/// The ray reads the lenslet by its position at d_b and the bin floor(A_b/2·(1 + s/tan(α_b/2))). Under `repeat` a ray beyond the
/// bins sees, as behind a real lens array, the picture of the neighbouring lenslet: bins continue periodically while the lenslet moves by one per
/// zone.
fn backlight_taps(backlight: &LensletBacklight, geometry: &FieldGeometry, axis: Axis) -> Vec<BacklightTap> {
    let i = match axis {
        Axis::X => 0,
        Axis::Y => 1,
    };
    let lenslets = backlight.lenslets[i] as f64;
    let bins = backlight.views[i] as f64;
    let half_width = (0.5 * backlight.fov_deg[i].to_radians()).tan();
    axis.positions(geometry, backlight.d_mm, backlight.offset_mm)
        .map(|(position, slope)| {
            let lenslet = (position / backlight.pitch_mm + lenslets / 2.0).floor();
            if !(lenslet >= 0.0 && lenslet < lenslets) {
                return BacklightTap::Missed;
            }
            let bin = (bins / 2.0 * (1.0 + slope / half_width)).floor();
            let zone = (bin / bins).floor();
            let seen = lenslet - zone;
            if zone != 0.0 && (backlight.outside_bins == OutsideBins::Dark || !(seen >= 0.0 && seen < lenslets)) {
                return BacklightTap::Dark;
            }
            BacklightTap::Lit { lenslet: seen as u32, bin: (bin - zone * bins) as u32 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Projection, ViewGrid, config::tests::small_display};

    #[test]
    fn a_layer_in_front_is_met_on_the_side_the_ray_leans_to() {
        let display = small_display();
        let geometry = display.geometry().unwrap();
        let map = RayMap::new(&display, &geometry);
        let front = map.layers.last().unwrap();
        // rightmost view column: slope > 0, so the front layer (d > 0) is met further right than z = 0
        let view = geometry.grid.slope_x.len() - 1;
        let shift =
            (display.layers.last().unwrap().d_mm * geometry.grid.slope_x[view] / geometry.pitch_mm + 0.5).floor();
        assert!(shift >= 1.0, "the test needs a shift");
        assert_eq!(front.x.of_view(view)[0].first, shift as u32);
        // topmost view row: slope_y > 0, the ray climbs, so the front layer is met further up: a smaller row
        assert!(front.y.of_view(0)[0].is_missed());
        assert!(front.y.of_view(0)[geometry.rows - 1].first < geometry.rows as u32 - 1);
    }

    #[test]
    fn bilinear_taps_lie_around_the_position_and_end_with_the_layer() {
        let tap = Tap::at(2.25, 4, Sampling::Bilinear);
        assert_eq!((tap.first, tap.second, tap.t), (2, 3, 0.25));
        assert_eq!(Tap::at(-0.4, 4, Sampling::Bilinear), Tap { first: 0, second: 1, t: 0.0 });
        assert_eq!(Tap::at(3.4, 4, Sampling::Bilinear).first, 3);
        for sampling in [Sampling::Nearest, Sampling::Bilinear] {
            assert!(Tap::at(-0.51, 4, sampling).is_missed() && Tap::at(3.5, 4, sampling).is_missed());
            assert!(Tap::at(f64::NAN, 4, sampling).is_missed());
        }
    }

    #[test]
    fn a_ray_of_the_target_grid_reads_its_own_view() {
        let mut display = small_display();
        let backlight = LensletBacklight::new(-100.0, [4, 3], 4.0, display.field.views, display.field.fov_deg);
        display.backlight = Backlight::Lenslets(backlight.clone());
        let geometry = display.geometry().unwrap();
        let map = RayMap::new(&display, &geometry).backlight.unwrap();
        for view in 0..geometry.grid.slope_x.len() {
            for tap in map.x(view) {
                assert!(!matches!(tap, BacklightTap::Lit { bin, .. } if *bin != view as u32));
            }
        }
        for view in 0..geometry.grid.slope_y.len() {
            assert!(map.y(view).iter().all(|tap| !matches!(tap, BacklightTap::Lit { bin, .. } if *bin != view as u32)));
        }
        // beyond the bins: dark, or the neighbour's picture
        let steep = geometry.with_grid(ViewGrid::single(Projection::Oblique, [1.1 * (10f64.to_radians()).tan(), 0.0]));
        let near = LensletBacklight { d_mm: -1.0, ..backlight };
        assert_eq!(backlight_taps(&near, &steep, Axis::X)[geometry.cols - 1], BacklightTap::Dark);
        let repeat = LensletBacklight { outside_bins: OutsideBins::Repeat, ..near };
        let tap = backlight_taps(&repeat, &steep, Axis::X)[geometry.cols - 1];
        let own = ((geometry.x_mm(geometry.cols - 1) - 1.1 * (10f64.to_radians()).tan()) / 4.0 + 2.0).floor() as u32;
        assert_eq!(tap, BacklightTap::Lit { lenslet: own - 1, bin: 0 });
    }
}
