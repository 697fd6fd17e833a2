//! Intersections of the rays of a light field with the layers and the backlight.
//!
//! Column c of the field has its centre at x_c. Layer n has the distance d_n, the offset o_n, the
//! pitch p_n and W_n columns. The ray through x_c at slope s hits layer n at pixel position u:
//!
//! ```text
//! u = (x_c + d_n·s − o_n)/p_n + (W_n−1)/2
//! ```
//!
//! Rows have the same formula, with y down.
//!
//! The map is separable. Let the light field have W × H pixels. Then each layer has a table of W
//! entries per view column, and one of H entries per view row. These tables describe all rays, so
//! no list of rays is made.

use crate::{Backlight, Display, FieldGeometry, Layer, LensletBacklight, OutsideBins, Sampling};

/// Intersection of a ray with a layer, along one axis. The ray reads the value (1 − t)·f(first) +
/// t·f(second), where f is the value of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tap {
    /// Index of the first pixel that the ray reads, or [`Tap::MISSED`].
    pub first: u32,
    /// Index of the next pixel. It equals `first` under nearest sampling, and at the last pixel.
    pub second: u32,
    /// Weight of `second`, 0..1.
    pub t: f32,
}

impl Tap {
    /// Value of `first` if the ray misses the layer.
    pub const MISSED: u32 = u32::MAX;

    /// Returns true if the ray misses the layer.
    #[inline]
    pub fn is_missed(self) -> bool {
        self.first == Self::MISSED
    }

    /// Returns the pixel or the two pixels around position `u` on an axis of `count` pixels. `u` is
    /// in pixels, and is 0 at the centre of the first pixel. The layer ends half a pixel outside
    /// its outermost pixel centres, with any sampling.
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
    /// Returns the taps of all field columns (or rows) for view column (or row) `view`.
    #[inline]
    pub fn of_view(&self, view: usize) -> &[Tap] {
        &self.taps[view * self.rays..(view + 1) * self.rays]
    }

    /// Returns the taps of the rays `rays` of every view, after `change` has been applied to each
    /// tap.
    pub(crate) fn cut(&self, rays: &std::ops::Range<usize>, change: impl Fn(&Tap) -> Tap) -> Self {
        let views = self.taps.chunks_exact(self.rays.max(1));
        let taps = views.flat_map(|view| view[rays.clone()].iter().map(&change));
        Self { rays: rays.len(), taps: taps.collect() }
    }
}

/// Intersections of rays with one layer.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMap {
    /// Layer columns that rays hit, per view column.
    pub x: AxisTaps,
    /// Layer rows that rays hit, per view row.
    pub y: AxisTaps,
    /// Number of rows of the layer.
    pub rows: usize,
    /// Number of columns of the layer.
    pub cols: usize,
}

/// The lenslet and the angular bin that a ray reads along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BacklightTap {
    /// A lenslet and one of its angular bins.
    Lit {
        /// Lenslet column or row.
        lenslet: u32,
        /// Angular bin, from the left or the top.
        bin: u32,
    },
    /// The ray hits a lenslet at a slope outside the lenslet's bins, and reads 0.
    Dark,
    /// The ray misses the lenslet grid.
    Missed,
}

/// Intersections of rays with the directional backlight.
#[derive(Clone, Debug, PartialEq)]
pub struct BacklightMap {
    rays: [usize; 2],
    x: Vec<BacklightTap>,
    y: Vec<BacklightTap>,
}

impl BacklightMap {
    /// Returns the taps of all field columns for a view column.
    #[inline]
    pub fn x(&self, view: usize) -> &[BacklightTap] {
        &self.x[view * self.rays[0]..(view + 1) * self.rays[0]]
    }

    /// Returns the taps of all field rows for a view row.
    #[inline]
    pub fn y(&self, view: usize) -> &[BacklightTap] {
        &self.y[view * self.rays[1]..(view + 1) * self.rays[1]]
    }

    /// Returns the taps of some rays of every view. `rays` has the ranges of these rays along x and
    /// along y, and `first` has the first lenslet that is kept along x and along y. `change`
    /// computes each new tap from the old tap and the entry of `first` for the tap's axis.
    pub(crate) fn cut(
        &self,
        rays: [&std::ops::Range<usize>; 2],
        first: [usize; 2],
        change: impl Fn(&BacklightTap, usize) -> BacklightTap,
    ) -> Self {
        let cut = |taps: &[BacklightTap], axis: usize| {
            let views = taps.chunks_exact(self.rays[axis].max(1));
            views.flat_map(|view| view[rays[axis].clone()].iter().map(|tap| change(tap, first[axis]))).collect()
        };
        Self { rays: rays.map(ExactSizeIterator::len), x: cut(&self.x, 0), y: cut(&self.y, 1) }
    }
}

/// The intersections of all rays of one field geometry with one display.
#[derive(Clone, Debug, PartialEq)]
pub struct RayMap {
    /// Maps of the layers, rearmost first.
    pub layers: Vec<LayerMap>,
    /// Map of the directional backlight; `None` for a uniform one.
    pub backlight: Option<BacklightMap>,
}

impl RayMap {
    /// Computes the tables for all rays of a geometry. For A_x × A_y views of W × H pixels, each
    /// layer has A_x·W entries along x and A_y·H entries along y.
    pub fn new(display: &Display, geometry: &FieldGeometry) -> Self {
        let [x, y] = [Axis::X, Axis::Y].map(|axis| axis.centres(geometry));
        Self::of_rays(display, display.sampling, [(&x, geometry.cols), (&y, geometry.rows)])
    }

    /// Computes the tables for any rays. For each axis (x, y), `rays` holds the rays of all views,
    /// and the number of rays per view.
    pub(crate) fn of_rays(display: &Display, sampling: Sampling, rays: [(&[AxisRay], usize); 2]) -> Self {
        let layers = display
            .layers
            .iter()
            .map(|layer| {
                let taps = |axis: Axis| {
                    let (rays, per_view) = rays[axis.index()];
                    let count = layer.resolution[axis.index()];
                    let tap = |ray: &AxisRay| Tap::at(axis.pixel(layer, ray), count, sampling);
                    AxisTaps { rays: per_view, taps: rays.iter().map(tap).collect() }
                };
                let [cols, rows] = layer.resolution;
                LayerMap { x: taps(Axis::X), y: taps(Axis::Y), rows, cols }
            })
            .collect();
        let backlight = match &display.backlight {
            Backlight::Uniform => None,
            Backlight::Lenslets(lenslets) => {
                let taps = |axis: Axis| backlight_taps(lenslets, rays[axis.index()].0, axis);
                Some(BacklightMap { rays: rays.map(|(_, per_view)| per_view), x: taps(Axis::X), y: taps(Axis::Y) })
            }
        };
        Self { layers, backlight }
    }
}

/// One axis of a ray: the position at which it crosses z = 0, in millimetres, and its slope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AxisRay {
    pub(crate) at_mm: f64,
    pub(crate) slope: f64,
}

/// The two axes of the separable map. Array indices rise with x, and fall with y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Axis {
    X,
    Y,
}

impl Axis {
    pub(crate) fn index(self) -> usize {
        self as usize
    }

    fn sign(self) -> f64 {
        match self {
            Self::X => 1.0,
            Self::Y => -1.0,
        }
    }

    /// Returns the number of field pixels along the axis.
    pub(crate) fn count(self, geometry: &FieldGeometry) -> usize {
        match self {
            Self::X => geometry.cols,
            Self::Y => geometry.rows,
        }
    }

    /// Returns the ray of a view that crosses z = 0 at position `at_mm`.
    pub(crate) fn ray(self, geometry: &FieldGeometry, view: usize, at_mm: f64) -> AxisRay {
        let slopes = match self {
            Self::X => &geometry.grid.slope_x,
            Self::Y => &geometry.grid.slope_y,
        };
        AxisRay { at_mm, slope: geometry.grid.projection.slope(slopes[view], at_mm) }
    }

    /// Returns the centre of a field pixel, millimetres.
    pub(crate) fn centre_mm(self, geometry: &FieldGeometry, pixel: usize) -> f64 {
        match self {
            Self::X => geometry.x_mm(pixel),
            Self::Y => geometry.y_mm(pixel),
        }
    }

    /// Returns the rays through the centres of all field pixels, view by view.
    fn centres(self, geometry: &FieldGeometry) -> Vec<AxisRay> {
        let views = match self {
            Self::X => geometry.grid.slope_x.len(),
            Self::Y => geometry.grid.slope_y.len(),
        };
        let pixels = |view| {
            (0..self.count(geometry)).map(move |pixel| self.ray(geometry, view, self.centre_mm(geometry, pixel)))
        };
        (0..views).flat_map(pixels).collect()
    }

    /// Returns the position at which a ray hits a layer, in pixels from the centre of the first
    /// pixel.
    pub(crate) fn pixel(self, layer: &Layer, ray: &AxisRay) -> f64 {
        let position = ray.at_mm + layer.d_mm * ray.slope - layer.offset_mm[self.index()];
        self.sign() * position / layer.pitch_mm + (layer.resolution[self.index()] as f64 - 1.0) / 2.0
    }

    /// Returns the position at which a ray hits the lenslet grid, in lenslets from the grid's left
    /// or top edge.
    pub(crate) fn lenslet(self, backlight: &LensletBacklight, ray: &AxisRay) -> f64 {
        let position = ray.at_mm + backlight.d_mm * ray.slope - backlight.offset_mm[self.index()];
        self.sign() * position / backlight.pitch_mm + backlight.lenslets[self.index()] as f64 / 2.0
    }

    /// Returns the angular bin of a ray of slope s, A_b/2·(1 + s/tan(α_b/2)), for A_b bins over the
    /// angle α_b. The unit is bins, counted from the edge of the first bin. Along y, s is negated.
    pub(crate) fn bin(self, backlight: &LensletBacklight, ray: &AxisRay) -> f64 {
        let bins = backlight.views[self.index()] as f64;
        let half_width = (0.5 * backlight.fov_deg[self.index()].to_radians()).tan();
        bins / 2.0 * (1.0 + self.sign() * ray.slope / half_width)
    }
}

/// Returns the lenslet and the bin that each ray reads. The ray's position on the lenslets' plane
/// selects the lenslet, and its slope selects the bin. Under [`OutsideBins::Repeat`] a ray outside
/// the bins reads a bin of another lenslet, as behind a real lens array. Bins then continue
/// periodically, and the lenslet changes by one per period.
fn backlight_taps(backlight: &LensletBacklight, rays: &[AxisRay], axis: Axis) -> Vec<BacklightTap> {
    let lenslets = backlight.lenslets[axis.index()] as f64;
    let bins = backlight.views[axis.index()] as f64;
    let tap = |ray: &AxisRay| {
        let lenslet = axis.lenslet(backlight, ray).floor();
        if !(lenslet >= 0.0 && lenslet < lenslets) {
            return BacklightTap::Missed;
        }
        let bin = axis.bin(backlight, ray).floor();
        let zone = (bin / bins).floor();
        let seen = lenslet - zone;
        if zone != 0.0 && (backlight.outside_bins == OutsideBins::Dark || !(seen >= 0.0 && seen < lenslets)) {
            return BacklightTap::Dark;
        }
        BacklightTap::Lit { lenslet: seen as u32, bin: (bin - zone * bins) as u32 }
    };
    rays.iter().map(tap).collect()
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
        // The rightmost view column has slope > 0. So its rays hit the front layer (d > 0) further
        // right than they cross z = 0.
        let view = geometry.grid.slope_x.len() - 1;
        let shift =
            (display.layers.last().unwrap().d_mm * geometry.grid.slope_x[view] / geometry.pitch_mm + 0.5).floor();
        assert!(shift >= 1.0, "the test needs a shift");
        assert_eq!(front.x.of_view(view)[0].first, shift as u32);
        // The topmost view row has slope_y > 0. So its rays hit the front layer further up, in a
        // smaller row.
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
        let backlight = LensletBacklight::new(-100.0, [4, 3], 4.0, display.views(), display.field.fov_deg);
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
        // Outside the bins a ray is dark, or under `Repeat` it reads a bin of the neighbouring
        // lenslet.
        let steep = geometry.with_grid(ViewGrid::single(Projection::Oblique, [1.1 * (10f64.to_radians()).tan(), 0.0]));
        let near = LensletBacklight { d_mm: -1.0, ..backlight };
        assert_eq!(backlight_taps(&near, &Axis::X.centres(&steep), Axis::X)[geometry.cols - 1], BacklightTap::Dark);
        let repeat = LensletBacklight { outside_bins: OutsideBins::Repeat, ..near };
        let tap = backlight_taps(&repeat, &Axis::X.centres(&steep), Axis::X)[geometry.cols - 1];
        let own = ((geometry.x_mm(geometry.cols - 1) - 1.1 * (10f64.to_radians()).tan()) / 4.0 + 2.0).floor() as u32;
        assert_eq!(tap, BacklightTap::Lit { lenslet: own - 1, bin: 0 });
    }
}
