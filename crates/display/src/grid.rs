//! View grids: the directions that a light field samples.

use thiserror::Error;

/// Projection of the rays of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Every view is a parallel projection, as in the paper: all its rays have one slope.
    Oblique,
    /// Every view of slope s is a pinhole at eye position e = D·s. Its ray through position x on z
    /// = 0 has slope (e − x)/D.
    Perspective {
        /// Viewing distance D from z = 0, millimetres, > 0.
        distance_mm: f64,
    },
}

/// A separable grid of views: the product of view columns and view rows.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewGrid {
    /// Projection of the rays of one view.
    pub projection: Projection,
    /// Slope of each view column at the centre of the field; increases from left to right in grids
    /// that Lumistack makes.
    pub slope_x: Vec<f64>,
    /// Slope of each view row, y up; decreases from top to bottom in grids that Lumistack makes.
    pub slope_y: Vec<f64>,
}

/// The error of an invalid view grid, geometry or light field.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{what}: expected {expected}, found {found}")]
pub struct GridError {
    /// Name of the wrong value.
    pub what: &'static str,
    /// The expected value or range.
    pub expected: &'static str,
    /// The invalid value.
    pub found: String,
}

impl GridError {
    fn new(what: &'static str, expected: &'static str, found: impl ToString) -> Self {
        Self { what, expected, found: found.to_string() }
    }
}

impl ViewGrid {
    /// Makes a grid of `views` = [horizontal, vertical] views over the full angles `fov_deg`, at
    /// the centres of equal bins of slopes. View column a of A_x columns over the angle α_x has the
    /// slope
    ///
    /// ```text
    /// s_x(a) = (a − (A_x−1)/2)·(2/A_x)·tan(α_x/2)
    /// ```
    ///
    /// Rows have the same form, with the topmost view first. The spacing is Δv of eq. 23.
    ///
    /// # Errors
    /// If there are no views, or an angle is outside 0..180°, or the viewing distance is not above
    /// 0.
    pub fn uniform(projection: Projection, views: [usize; 2], fov_deg: [f64; 2]) -> Result<Self, GridError> {
        if views.contains(&0) {
            return Err(GridError::new("views", "at least 1 × 1", format!("{} × {}", views[0], views[1])));
        }
        if fov_deg.iter().any(|fov| !(*fov >= 0.0 && *fov < 180.0)) {
            return Err(GridError::new("fov_deg", "full angles from 0 to less than 180", format!("{fov_deg:?}")));
        }
        let slope = |axis: usize, view: usize| {
            let count = views[axis] as f64;
            (view as f64 - (count - 1.0) / 2.0) * (2.0 / count) * (0.5 * fov_deg[axis].to_radians()).tan()
        };
        let grid = Self {
            projection,
            slope_x: (0..views[0]).map(|view| slope(0, view)).collect(),
            slope_y: (0..views[1]).map(|view| -slope(1, view)).collect(),
        };
        grid.check()?;
        Ok(grid)
    }

    /// Makes a grid of one view.
    pub fn single(projection: Projection, slope: [f64; 2]) -> Self {
        Self { projection, slope_x: vec![slope[0]], slope_y: vec![slope[1]] }
    }

    /// Checks a grid that may come from a file or a caller.
    ///
    /// # Errors
    /// If it has no views, a slope that is not finite, or a viewing distance that is not above 0.
    pub fn check(&self) -> Result<(), GridError> {
        if self.slope_x.is_empty() || self.slope_y.is_empty() {
            return Err(GridError::new(
                "views",
                "at least 1 × 1",
                format!("{} × {}", self.slope_x.len(), self.slope_y.len()),
            ));
        }
        if let Some(slope) = self.slope_x.iter().chain(&self.slope_y).find(|slope| !slope.is_finite()) {
            return Err(GridError::new("slope", "finite tangents", slope));
        }
        match self.projection {
            Projection::Perspective { distance_mm } if !(distance_mm.is_finite() && distance_mm > 0.0) => {
                Err(GridError::new("distance_mm", "a viewing distance above 0", distance_mm))
            }
            _ => Ok(()),
        }
    }

    /// Returns the number of views as [vertical, horizontal], which is the order of array indices.
    pub fn views(&self) -> [usize; 2] {
        [self.slope_y.len(), self.slope_x.len()]
    }

    /// Iterates over all views [view_y, view_x], row by row.
    pub fn iter(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let [rows, cols] = self.views();
        (0..rows).flat_map(move |y| (0..cols).map(move |x| [y, x]))
    }

    /// Returns the slope (s_x, s_y) of the ray of `view` = [view_y, view_x] through the point (x,
    /// y) on z = 0.
    pub fn slope_at(&self, view: [usize; 2], point_mm: [f64; 2]) -> [f64; 2] {
        [
            self.projection.slope(self.slope_x[view[1]], point_mm[0]),
            self.projection.slope(self.slope_y[view[0]], point_mm[1]),
        ]
    }

    /// Returns the grid of the midpoints between neighbouring views. A display is not optimized for
    /// these views. An axis with one view keeps its view.
    pub fn in_between(&self) -> Self {
        let midpoints = |slopes: &[f64]| match slopes {
            [only] => vec![*only],
            _ => slopes.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect(),
        };
        Self { projection: self.projection, slope_x: midpoints(&self.slope_x), slope_y: midpoints(&self.slope_y) }
    }

    /// Returns views outside the zone, in the middle row: `steps` views on the left of the leftmost
    /// column and `steps` views on the right of the rightmost one. Neighbouring views are one mean
    /// spacing apart. If the grid has one column, the views are above and below it instead. `None`
    /// if `steps` is 0 or all slopes are equal.
    pub fn outside(&self, steps: usize) -> Option<Self> {
        let beyond = |slopes: &[f64]| {
            let (low, high) = slopes.iter().fold((f64::MAX, f64::MIN), |(low, high), s| (low.min(*s), high.max(*s)));
            let step = (high - low) / (slopes.len() as f64 - 1.0);
            let below = (1..=steps).rev().map(|k| low - k as f64 * step);
            let above = (1..=steps).map(|k| high + k as f64 * step);
            (steps > 0 && step > 0.0).then(|| below.chain(above).collect::<Vec<f64>>())
        };
        let middle = |slopes: &[f64]| vec![slopes[slopes.len() / 2]];
        if let Some(slope_x) = beyond(&self.slope_x) {
            return Some(Self { projection: self.projection, slope_x, slope_y: middle(&self.slope_y) });
        }
        let mut slope_y = beyond(&self.slope_y)?;
        slope_y.reverse();
        Some(Self { projection: self.projection, slope_x: middle(&self.slope_x), slope_y })
    }

    /// Returns the grid with all slopes multiplied by `factor`. Between the new views content moves
    /// `factor` times as far as between the old views, as if its depth were
    /// [scaled](Projection::scaled_depth).
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let scaled = |slopes: &[f64]| slopes.iter().map(|slope| slope * factor).collect();
        Self { projection: self.projection, slope_x: scaled(&self.slope_x), slope_y: scaled(&self.slope_y) }
    }

    /// Returns the mean spacing of the views' slopes per axis (x, y); 0 for an axis with one view.
    pub fn bin_width(&self) -> [f64; 2] {
        [&self.slope_x, &self.slope_y].map(|slopes| match slopes.as_slice() {
            [first, .., last] => (last - first).abs() / (slopes.len() - 1) as f64,
            _ => 0.0,
        })
    }
}

impl Projection {
    /// Returns the slope, along one axis, of a view's ray through position `x_mm` on z = 0. The
    /// view's ray through the field's centre has slope `view_slope`.
    #[inline]
    pub fn slope(self, view_slope: f64, x_mm: f64) -> f64 {
        match self {
            Self::Oblique => view_slope,
            Self::Perspective { distance_mm } => view_slope - x_mm / distance_mm,
        }
    }

    /// Returns the depth that content at depth `z_mm` seems to have if its parallax is multiplied
    /// by `factor`. The result is factor · z for parallel projections. For pinholes at distance D,
    /// the result is the z' with z'/(D − z') = factor · z/(D − z).
    pub fn scaled_depth(self, z_mm: f64, factor: f64) -> f64 {
        match self {
            Self::Oblique => factor * z_mm,
            Self::Perspective { distance_mm } => {
                let parallax = factor * z_mm / (distance_mm - z_mm);
                distance_mm * parallax / (1.0 + parallax)
            }
        }
    }
}

/// Sampling of a light field: pixels on z = 0 and views.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldGeometry {
    /// Pixel rows, ≥ 1.
    pub rows: usize,
    /// Pixel columns, ≥ 1.
    pub cols: usize,
    /// Pixel pitch on z = 0, millimetres, > 0.
    pub pitch_mm: f64,
    /// The grid of the views.
    pub grid: ViewGrid,
}

impl FieldGeometry {
    /// Checks a geometry that may come from a file or a caller.
    ///
    /// # Errors
    /// If there are no pixels, the pitch is not above 0, or the grid is invalid.
    pub fn check(&self) -> Result<(), GridError> {
        if self.rows == 0 || self.cols == 0 {
            return Err(GridError::new(
                "resolution",
                "at least 1 × 1 pixels",
                format!("{} × {}", self.cols, self.rows),
            ));
        }
        if !(self.pitch_mm.is_finite() && self.pitch_mm > 0.0) {
            return Err(GridError::new("pitch_mm", "a number above 0", self.pitch_mm));
        }
        self.grid.check()
    }

    /// Returns the centre of column `col` on z = 0, millimetres.
    #[inline]
    pub fn x_mm(&self, col: usize) -> f64 {
        (col as f64 - (self.cols as f64 - 1.0) / 2.0) * self.pitch_mm
    }

    /// Returns the centre of row `row` on z = 0, millimetres; row 0 is the top.
    #[inline]
    pub fn y_mm(&self, row: usize) -> f64 {
        ((self.rows as f64 - 1.0) / 2.0 - row as f64) * self.pitch_mm
    }

    /// Returns the width and the height of the field, in millimetres.
    pub fn size_mm(&self) -> [f64; 2] {
        [self.cols as f64 * self.pitch_mm, self.rows as f64 * self.pitch_mm]
    }

    /// Returns a geometry with the same pixels and the views of `grid`.
    pub fn with_grid(&self, grid: ViewGrid) -> Self {
        Self { grid, ..self.clone() }
    }
}

/// Returns at most `most` ≥ 2 evenly spread indices below `count`. The first and the last index are
/// among them. If `count` and `most` are odd, the middle index is also among them.
pub fn spread(count: usize, most: usize) -> Vec<usize> {
    if count <= most {
        return (0..count).collect();
    }
    (0..most).map(|i| (2 * i * (count - 1) + most - 1) / (2 * (most - 1))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tolerance for the test's expected slopes, which have 17 digits.
    const EXACT: f64 = 1e-15;

    #[test]
    fn five_views_over_twenty_degrees_stand_at_bin_centres() {
        let grid = ViewGrid::uniform(Projection::Oblique, [5, 3], [20.0, 20.0]).unwrap();
        let expected = [-0.141_061_584_566_771_98, -0.070_530_792_283_385_99, 0.0];
        for (slope, expected) in grid.slope_x.iter().zip(expected) {
            assert!((slope - expected).abs() < EXACT);
        }
        assert!((grid.slope_y[0] - 0.117_551_320_472_309_98).abs() < EXACT, "the topmost view comes first");
        assert_eq!(grid.views(), [3, 5]);
        assert_eq!(grid.in_between().views(), [2, 4]);
    }

    #[test]
    fn outside_views_stand_beyond_the_outermost_ones() {
        let grid = ViewGrid::uniform(Projection::Oblique, [5, 3], [20.0, 20.0]).unwrap();
        let outside = grid.outside(2).unwrap();
        assert_eq!((outside.views(), outside.slope_y[0]), ([1, 4], 0.0));
        let step = grid.slope_x[1] - grid.slope_x[0];
        for (slope, steps) in outside.slope_x.iter().zip([-4.0, -3.0, 3.0, 4.0]) {
            assert!((slope - steps * step).abs() < EXACT);
        }
        let column = ViewGrid { slope_x: vec![0.1], ..grid.clone() }.outside(1).unwrap();
        assert!(column.slope_x == [0.1] && column.slope_y[0] > grid.slope_y[0] && column.slope_y[1] < grid.slope_y[2]);
        assert!(grid.outside(0).is_none() && ViewGrid::single(Projection::Oblique, [0.0; 2]).outside(1).is_none());
    }

    #[test]
    fn perspective_rays_meet_at_the_eye() {
        let projection = Projection::Perspective { distance_mm: 600.0 };
        let grid = ViewGrid::uniform(projection, [3, 1], [20.0, 20.0]).unwrap();
        let eye_x = 600.0 * grid.slope_x[2];
        for x in [-100.0, 0.0, 33.0] {
            assert!((x + 600.0 * grid.slope_at([0, 2], [x, 0.0])[0] - eye_x).abs() < 1e-9);
        }
    }

    /// A point, seen along the multiplied slopes, appears at the same positions as a point at the
    /// scaled depth, seen along the original slopes. The second point is chosen so that both appear
    /// at one position along slope 0.
    #[test]
    fn scaled_slopes_are_scaled_depths() {
        for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 400.0 }] {
            let grid = ViewGrid::uniform(projection, [5, 1], [30.0, 30.0]).unwrap();
            let narrow = grid.scaled(0.4);
            for z in [-90.0, 0.0, 25.0, 120.0] {
                let shown = projection.scaled_depth(z, 0.4);
                // Compute the x at which the ray of slope `slope` through the point (x, z) crosses
                // z = 0.
                let seen = |slope: f64, x: f64, z: f64| match projection {
                    Projection::Oblique => x - z * slope,
                    Projection::Perspective { distance_mm } => (x - z * slope) / (1.0 - z / distance_mm),
                };
                let straight = seen(0.0, 17.0, z);
                // Place a second point at depth `shown`. Along slope 0, it appears at the same
                // position `straight` as the point (17, z).
                let x = match projection {
                    Projection::Oblique => straight,
                    Projection::Perspective { distance_mm } => straight * (1.0 - shown / distance_mm),
                };
                for (slope, narrow) in grid.slope_x.iter().zip(&narrow.slope_x) {
                    assert!((seen(*narrow, 17.0, z) - seen(*slope, x, shown)).abs() < 1e-9, "{projection:?} {z}");
                }
            }
        }
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(ViewGrid::uniform(Projection::Oblique, [0, 1], [20.0; 2]).is_err());
        assert!(ViewGrid::uniform(Projection::Oblique, [1, 1], [180.0, 20.0]).is_err());
        assert!(ViewGrid::uniform(Projection::Oblique, [1, 1], [f64::NAN, 20.0]).is_err());
        assert!(ViewGrid::uniform(Projection::Perspective { distance_mm: 0.0 }, [1, 1], [20.0; 2]).is_err());
    }

    #[test]
    fn the_middle_and_the_outermost_views_stay() {
        assert_eq!(spread(13, 7), [0, 2, 4, 6, 8, 10, 12]);
        assert_eq!(spread(7, 7), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(spread(2, 7), [0, 1]);
        for count in (9..120).step_by(2) {
            let places = spread(count, 7);
            assert_eq!((places[0], places[3], places[6]), (0, count / 2, count - 1), "{count}");
        }
    }
}
