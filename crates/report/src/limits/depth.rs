//! Depth of a view's content, by its disparity to a neighbouring view.
//!
//! Block matching searches, for every pixel, the shift along the row for which a square around the
//! pixel matches best. The measure is the sum of absolute differences of √luminance over the
//! square. A parabola refines the shift. Between oblique views, content at depth z is shifted by
//! −z·Δs/p pixels. Here Δs is the difference of the views' slopes, and p the pixel pitch. Between
//! pinholes at distance D, content is shifted by q = −z·Δs/(1 − z/D) millimetres.
//!
//! The best shift of a pixel is accepted if it is clearly better than the mean over all shifts. A
//! pixel without an accepted shift takes the nearest accepted shift of its row. A row without
//! accepted shifts gets the depth of the display plane. A median over squares removes outliers.

use lumistack_core::colour::luminance;
use lumistack_display::{FieldGeometry, LightField, Projection};

/// Depth of every pixel of one view. The resolution may be lower than the view's resolution.
#[derive(Clone, Debug)]
pub(crate) struct DepthMap {
    /// Factor by which the rows and columns of the view are reduced.
    factor: usize,
    cols: usize,
    /// Depth, millimetres towards the viewer.
    z_mm: Vec<f32>,
    /// True for pixels near a depth discontinuity.
    edge: Vec<bool>,
    /// Depth that corresponds to a shift of half a map pixel, millimetres.
    pub(crate) resolution_mm: f64,
}

/// Row length up to which views are matched at full resolution, pixels.
const LARGEST_COLS: usize = 480;
/// Half the side of the compared squares, in pixels: the number of columns divided by
/// `RADIUS_SHARE`, limited to [`RADIUS`].
const RADIUS_SHARE: usize = 80;
const RADIUS: std::ops::RangeInclusive<usize> = 3..=6;
/// The largest shift that the matching tries, in pixels: the number of columns divided by
/// `REACH_SHARE`, limited to [`REACH`].
const REACH_SHARE: usize = 16;
const REACH: std::ops::RangeInclusive<usize> = 3..=40;
/// The best shift is rejected unless it is clearly better than the mean. Its sum of differences
/// must be below the mean sum over all shifts by at least this much per pixel. Pixels have values
/// of 0 to 4095.
const BETTER_BY: u32 = 40;
/// An edge is where the shift changes by more than this fraction of the number of columns, and by
/// more than one pixel. Pixels up to `NEAR` away belong to the edge.
const JUMP_SHARE: f32 = 1.0 / 240.0;
const NEAR: usize = 2;

impl DepthMap {
    /// Computes the depth of `view` by matching it with `neighbour`, a view in the same row of
    /// views. `None` if both views have the same slope, or a view has fewer pixel columns than the
    /// smallest compared square.
    pub(crate) fn new(field: &LightField, view: [usize; 2], neighbour: [usize; 2]) -> Option<Self> {
        let geometry = field.geometry();
        let step = geometry.grid.slope_x[neighbour[1]] - geometry.grid.slope_x[view[1]];
        if step == 0.0 || geometry.cols < 2 * *RADIUS.start() + 1 {
            return None;
        }
        let factor = geometry.cols.div_ceil(LARGEST_COLS);
        let [first, second] = [view, neighbour].map(|view| Levels::new(field.view(view), geometry, factor));
        let shifts = first.median(&filled(first.shifts(&second), first.cols));
        let pitch_mm = geometry.pitch_mm * factor as f64;
        let z_mm = shifts.iter().map(|shift| depth(f64::from(*shift) * pitch_mm, step, geometry) as f32).collect();
        let resolution_mm = (0.5 * pitch_mm / step).abs();
        Some(Self { factor, cols: first.cols, z_mm, edge: edges(&shifts, first.rows, first.cols), resolution_mm })
    }

    /// Returns the depth at a pixel of the view, millimetres.
    pub(crate) fn z_mm(&self, row: usize, col: usize) -> f64 {
        f64::from(self.z_mm[row / self.factor * self.cols + col / self.factor])
    }

    /// Returns true for a pixel near a depth discontinuity.
    pub(crate) fn is_edge(&self, row: usize, col: usize) -> bool {
        self.edge[row / self.factor * self.cols + col / self.factor]
    }
}

/// Returns the depth of content, millimetres, from its positions on z = 0 in two views. The
/// positions differ by `shift_mm`, and the slopes of the views by `step`.
fn depth(shift_mm: f64, step: f64, geometry: &FieldGeometry) -> f64 {
    match geometry.grid.projection {
        Projection::Oblique => -shift_mm / step,
        Projection::Perspective { distance_mm } => -shift_mm / (step - shift_mm / distance_mm),
    }
}

/// Values of √luminance in a view, 0..4095. They are integers, so that running sums are exact.
struct Levels {
    rows: usize,
    cols: usize,
    values: Vec<i32>,
}

impl Levels {
    fn new(rgb: &[f32], geometry: &FieldGeometry, factor: usize) -> Self {
        let (rows, cols) = (geometry.rows.div_ceil(factor), geometry.cols.div_ceil(factor));
        let mut values = Vec::with_capacity(rows * cols);
        for row in 0..rows {
            for col in 0..cols {
                let (mut sum, mut count) = (0.0, 0.0);
                for r in row * factor..((row + 1) * factor).min(geometry.rows) {
                    for c in col * factor..((col + 1) * factor).min(geometry.cols) {
                        let pixel = &rgb[3 * (r * geometry.cols + c)..][..3];
                        sum += luminance([pixel[0], pixel[1], pixel[2]]).max(0.0);
                        count += 1.0;
                    }
                }
                values.push((4095.0 * (sum / count).min(1.0).sqrt()) as i32);
            }
        }
        Self { rows, cols, values }
    }

    /// Returns the shift of each pixel's content to the right in `other`, pixels; NaN if several
    /// shifts match about equally well.
    fn shifts(&self, other: &Self) -> Vec<f32> {
        let (rows, cols, radius) = (self.rows, self.cols, self.radius());
        let reach = (cols / REACH_SHARE).clamp(*REACH.start(), *REACH.end());
        let candidates = 2 * reach + 1;
        let difference = |row: usize, shift: usize, col: usize| {
            // If the shift goes past the border, read the outermost pixel.
            let to = (col + shift).saturating_sub(reach).min(cols - 1);
            self.values[row * cols + col].abs_diff(other.values[row * cols + to])
        };
        // `sums` has the sums of the differences over the rows of a square, [shift][column]. For
        // each row of the view, one row of pixels is added and one is removed.
        let mut sums = vec![0u32; candidates * cols];
        let include = |sums: &mut [u32], row: usize| {
            let places = sums.iter_mut().enumerate();
            places.for_each(|(i, sum)| *sum += difference(row, i / cols, i % cols));
        };
        let exclude = |sums: &mut [u32], row: usize| {
            let places = sums.iter_mut().enumerate();
            places.for_each(|(i, sum)| *sum -= difference(row, i / cols, i % cols));
        };
        (0..radius.min(rows)).for_each(|row| include(&mut sums, row));
        let mut shifts = Vec::with_capacity(rows * cols);
        let mut costs = vec![0u32; candidates * cols];
        for row in 0..rows {
            if row + radius < rows {
                include(&mut sums, row + radius);
            }
            if row > radius {
                exclude(&mut sums, row - radius - 1);
            }
            for (line, costs) in sums.chunks_exact(cols).zip(costs.chunks_exact_mut(cols)) {
                for (col, cost) in costs.iter_mut().enumerate() {
                    *cost = line[col.saturating_sub(radius)..(col + radius + 1).min(cols)].iter().sum();
                }
            }
            let lines = (row + radius + 1).min(rows) - row.saturating_sub(radius);
            shifts.extend((0..cols).map(|col| {
                let across = (col + radius + 1).min(cols) - col.saturating_sub(radius);
                best(|shift| costs[shift * cols + col], reach, (lines * across) as u32)
            }));
        }
        shifts
    }

    /// Returns half the side of the compared squares, pixels.
    fn radius(&self) -> usize {
        (self.cols / RADIUS_SHARE).clamp(*RADIUS.start(), *RADIUS.end())
    }

    /// Replaces each shift by the median over a square, which is cut at the border of the picture.
    fn median(&self, shifts: &[f32]) -> Vec<f32> {
        let (rows, cols, radius) = (self.rows, self.cols, self.radius().div_ceil(2));
        let mut square = Vec::with_capacity((2 * radius + 1).pow(2));
        let mut result = Vec::with_capacity(shifts.len());
        for row in 0..rows {
            for col in 0..cols {
                square.clear();
                for r in row.saturating_sub(radius)..(row + radius + 1).min(rows) {
                    let from = r * cols + col.saturating_sub(radius);
                    square.extend_from_slice(&shifts[from..r * cols + (col + radius + 1).min(cols)]);
                }
                let middle = square.len() / 2;
                result.push(*square.select_nth_unstable_by(middle, f32::total_cmp).1);
            }
        }
        result
    }
}

/// Returns the shift of least cost; NaN if this cost is not clearly below the mean cost. `pixels`
/// is the number of pixels over which a cost is summed.
fn best(cost: impl Fn(usize) -> u32, reach: usize, pixels: u32) -> f32 {
    let place = (0..=2 * reach).min_by_key(|&shift| (cost(shift), shift.abs_diff(reach))).unwrap_or(reach);
    let mean = (0..=2 * reach).map(|shift| u64::from(cost(shift))).sum::<u64>() / (2 * reach as u64 + 1);
    if u64::from(cost(place) + BETTER_BY * pixels) > mean {
        return f32::NAN;
    }
    let whole = place as f32 - reach as f32;
    if place == 0 || place == 2 * reach {
        return whole;
    }
    let [left, middle, right] = [place - 1, place, place + 1].map(|shift| cost(shift) as f32);
    let curvature = left - 2.0 * middle + right;
    whole + if curvature > 0.0 { (0.5 * (left - right) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Replaces NaN by the nearest value of its row, or by 0 in rows without any value.
fn filled(mut shifts: Vec<f32>, cols: usize) -> Vec<f32> {
    for row in shifts.chunks_exact_mut(cols) {
        let known: Vec<(usize, f32)> = row.iter().copied().enumerate().filter(|(_, shift)| !shift.is_nan()).collect();
        let mut next = 0;
        for (col, shift) in row.iter_mut().enumerate() {
            while next + 1 < known.len() && known[next + 1].0.abs_diff(col) <= known[next].0.abs_diff(col) {
                next += 1;
            }
            *shift = known.get(next).map_or(0.0, |(_, shift)| *shift);
        }
    }
    shifts
}

/// Returns, for each pixel, true if the pixel is near a discontinuity of the shift.
fn edges(shifts: &[f32], rows: usize, cols: usize) -> Vec<bool> {
    let mut near = vec![false; rows * cols];
    let jump = (JUMP_SHARE * cols as f32).max(1.0);
    for row in 0..rows {
        for col in 0..cols {
            let here = shifts[row * cols + col];
            let jumps = |other: usize| (shifts[other] - here).abs() > jump;
            if (col + 1 < cols && jumps(row * cols + col + 1)) || (row + 1 < rows && jumps((row + 1) * cols + col)) {
                for r in row.saturating_sub(NEAR)..(row + NEAR + 1).min(rows) {
                    near[r * cols + col.saturating_sub(NEAR)..r * cols + (col + NEAR + 1).min(cols)].fill(true);
                }
            }
        }
    }
    near
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;
    use lumistack_display::ViewGrid;

    use super::*;

    /// Returns two views of a textured plane at −60 mm, with a textured card at 45 mm in front of
    /// its centre.
    fn two_planes(projection: Projection) -> LightField {
        let grid = ViewGrid { projection, slope_x: vec![0.0, 0.1], slope_y: vec![0.0] };
        let geometry = FieldGeometry { rows: 40, cols: 120, pitch_mm: 1.5, grid };
        let texture = |point: f64, row: usize, seed: u64| {
            // The texture is noise at multiples of three millimetres, interpolated linearly.
            let noise = |i: f64| Stream::new(seed + 1000 * row as u64 + (i as i64 + 500) as u64).next_f32();
            let (place, t) = ((point / 3.0).floor(), (point / 3.0).rem_euclid(1.0) as f32);
            noise(place) * (1.0 - t) + noise(place + 1.0) * t
        };
        let mut field = LightField::black(geometry.clone()).unwrap();
        for view in geometry.grid.iter() {
            let pixels = field.view_mut(view).chunks_exact_mut(3).enumerate();
            for (i, pixel) in pixels {
                let (row, x) = (i / geometry.cols, geometry.x_mm(i % geometry.cols));
                let slope = geometry.grid.slope_at(view, [x, 0.0])[0];
                let (near, far) = (x + 45.0 * slope, x - 60.0 * slope);
                let card = near.abs() < 30.0;
                pixel.fill(if card { texture(near, row, 1) } else { texture(far, row, 7) });
            }
        }
        field
    }

    #[test]
    fn planes_are_found_where_they_stand() {
        for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 500.0 }] {
            let field = two_planes(projection);
            let map = DepthMap::new(&field, [0, 0], [0, 1]).unwrap();
            let mut right = 0;
            for row in 5..35 {
                for col in 30..110 {
                    let x = field.geometry().x_mm(col);
                    let slope = field.geometry().grid.slope_at([0, 0], [x, 0.0])[0];
                    let expected = if (x + 45.0 * slope).abs() < 30.0 { 45.0 } else { -60.0 };
                    right += usize::from((map.z_mm(row, col) - expected).abs() < map.resolution_mm);
                }
            }
            assert!(right > 30 * 80 * 85 / 100, "{projection:?}: {right} of {}", 30 * 80);
            let rim = (34..46).filter(|col| map.is_edge(20, *col)).count();
            assert!(rim > 2 && !map.is_edge(20, 60), "the card's rim is an edge, its middle is none: {rim}");
        }
        let field = two_planes(Projection::Oblique);
        assert!(DepthMap::new(&field, [0, 0], [0, 0]).is_none());
    }

    #[test]
    fn content_without_texture_lies_on_the_display() {
        let mut field = two_planes(Projection::Oblique);
        field.radiance_mut().data_mut().fill(0.3);
        let map = DepthMap::new(&field, [0, 0], [0, 1]).unwrap();
        assert!((0..40).all(|row| (0..120).all(|col| map.z_mm(row, col) == 0.0 && !map.is_edge(row, col))));
    }
}
