//! Motion of content across layers, and patterns that move with it.
//!
//! ```text
//! P_n(x) = mean of L over the rays through pixel x of layer n
//! v_n(x) = arg min over v of Σ [(P_n(x') − P_n_before(x' − v))² + λ |v|]
//! f_n(x) ← f_n(x − v_n(x))
//! ```
//!
//! L is the light field. P_n is a picture of L that is focused on layer n: content near the layer
//! is sharp. P_n_before is P_n of the previous light field. The factor λ penalizes long motions.
//! The motion v_n is found for each block of pixels, and is interpolated between blocks. The sum
//! runs over the pixels x' in and around the block. Then the patterns f_n of every frame are moved.
//! A pixel whose source x − v_n is outside the layer gets its value from patterns of a fresh start.
//!
//! The method needs only light fields, so it works for scenes and for given light fields. Content
//! that turns or moves in depth has a different motion on every layer and at every place.

use lumistack_core::{Cancel, Cancelled};
use lumistack_display::{BacklightTap, Display, FieldGeometry, LayerStack, LightField, RayMap, Region, spread};
use rayon::prelude::*;

/// Largest number of views per axis whose rays are averaged.
const VIEWS: usize = 5;
/// Edge of a block, pixels.
const BLOCK: usize = 16;
/// Width of the border around a block, pixels. Pixels of the border are compared together with the
/// pixels of the block. Without the border, a block that contains a single straight edge would show
/// no motion along this edge.
const AROUND: usize = 4;
/// Longest motion along an axis in the first search, pixels. It is a multiple of [`COARSE`].
const FARTHEST: i32 = 32;
/// Step of the first search, pixels.
const COARSE: i32 = 2;
/// Width of the border of [`Padded`] planes, pixels. The second search tests motions that are up to
/// [`COARSE`] − 1 pixels longer than those of the first search.
const PADDING: usize = (FARTHEST + COARSE - 1) as usize;
/// Number of best matches of the first search that the second search refines.
const KEPT: usize = 8;
/// The factor λ of the penalty on long motions: each pixel of motion must reduce the mean squared
/// difference by at least this value.
const COST: f32 = 2e-6;

/// For each layer, the mean of a light field over the rays through each pixel. If the backlight is
/// directional, the last plane has the means over the rays through each lenslet.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes(Vec<Plane>);

#[derive(Clone, Debug, PartialEq)]
struct Plane {
    rows: usize,
    cols: usize,
    /// Mean of red, green and blue.
    grey: Vec<f32>,
}

/// Motion of the content on one plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    rows: usize,
    cols: usize,
    /// Number of blocks along a column and along a row.
    blocks: [usize; 2],
    /// [right, down] in pixels, per block.
    shifts: Vec<[i32; 2]>,
}

impl Planes {
    /// Averages a light field over the rays through each pixel of each layer.
    ///
    /// # Errors
    /// When cancelled.
    pub fn of(display: &Display, field: &LightField, cancel: &Cancel) -> Result<Self, Cancelled> {
        let map = RayMap::new(display, field.geometry());
        let layer = |n: usize| {
            let of = &map.layers[n];
            let index = |taps: &[lumistack_display::Tap]| taps.iter().map(|tap| pixel(tap.first)).collect();
            Plane::of(field, [of.rows, of.cols], [&|y| index(of.y.of_view(y)), &|x| index(of.x.of_view(x))], cancel)
        };
        let mut planes = (0..map.layers.len()).map(layer).collect::<Result<Vec<_>, _>>()?;
        if let (Some(backlight), Some([_, _, _, rows, cols, _])) = (&map.backlight, LayerStack::emission_shape(display))
        {
            let index = |taps: &[BacklightTap]| taps.iter().map(|tap| lenslet(*tap)).collect();
            let along: [Along<'_>; 2] = [&|y| index(backlight.y(y)), &|x| index(backlight.x(x))];
            planes.push(Plane::of(field, [rows, cols], along, cancel)?);
        }
        Ok(Self(planes))
    }

    /// Computes the motion from these planes to later planes of the same display. `None` if nothing
    /// moves, or if the planes have different sizes.
    ///
    /// # Errors
    /// When cancelled.
    pub fn flows_to(&self, later: &Self, cancel: &Cancel) -> Result<Option<Vec<Flow>>, Cancelled> {
        let sizes = |planes: &Self| planes.0.iter().map(|plane| [plane.rows, plane.cols]).collect::<Vec<_>>();
        if sizes(self) != sizes(later) {
            return Ok(None);
        }
        let flows = self.0.iter().zip(&later.0).map(|(before, after)| Flow::between(before, after, cancel));
        let flows = flows.collect::<Result<Vec<_>, _>>()?;
        Ok(flows.iter().any(Flow::moves).then_some(flows))
    }
}

/// For a row (or column) of views, returns the plane's row (or column) that the rays through each
/// row (or column) of the light field hit. `None` if the rays miss the plane.
type Along<'a> = &'a dyn Fn(usize) -> Vec<Option<usize>>;

/// Returns the index of the pixel that a ray hits; `None` if the ray misses the layer.
fn pixel(first: u32) -> Option<usize> {
    (first != lumistack_display::Tap::MISSED).then_some(first as usize)
}

fn lenslet(tap: BacklightTap) -> Option<usize> {
    match tap {
        BacklightTap::Lit { lenslet, .. } => Some(lenslet as usize),
        BacklightTap::Dark | BacklightTap::Missed => None,
    }
}

impl Plane {
    /// Averages a light field on a plane of [rows, columns]. The rows of the plane are computed in
    /// parallel. One thread adds all rays of a row of the plane, always in the same order.
    fn of(
        field: &LightField,
        [rows, cols]: [usize; 2],
        [along_y, along_x]: [Along<'_>; 2],
        cancel: &Cancel,
    ) -> Result<Self, Cancelled> {
        let FieldGeometry { grid, cols: field_cols, .. } = field.geometry();
        let [view_rows, view_cols] = grid.views().map(|count| spread(count, VIEWS));
        // For every row of the plane, list the lines of rays that hit the row. A line of rays is
        // [row of views, row of pixels in each view].
        let mut lines = vec![Vec::new(); rows];
        for &view_y in &view_rows {
            for (line, row) in along_y(view_y).into_iter().enumerate() {
                if let Some(row) = row {
                    lines[row].push([view_y, line]);
                }
            }
        }
        let to_cols: Vec<_> = view_cols.iter().map(|&view_x| (view_x, along_x(view_x))).collect();
        let mut grey = vec![0.0f32; rows * cols];
        grey.par_chunks_exact_mut(cols.max(1)).zip(&lines).try_for_each_init(
            || vec![0u32; cols],
            |counts, (sums, lines)| {
                cancel.check()?;
                counts.fill(0);
                for lines in lines.chunk_by(|a, b| a[0] == b[0]) {
                    for (view_x, to_col) in &to_cols {
                        for &[view_y, line] in lines {
                            let line = &field.view([view_y, *view_x])[3 * field_cols * line..][..3 * field_cols];
                            for (rgb, col) in line.chunks_exact(3).zip(to_col) {
                                let Some(col) = *col else { continue };
                                sums[col] += rgb.iter().sum::<f32>() / 3.0;
                                counts[col] += 1;
                            }
                        }
                    }
                }
                sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum /= (*count).max(1) as f32);
                Ok(())
            },
        )?;
        Ok(Self { rows, cols, grey })
    }

    fn row(&self, row: usize) -> &[f32] {
        &self.grey[row * self.cols..][..self.cols]
    }
}

/// A plane with a border of [`PADDING`] pixels on each side. Pixels of the border have the value of
/// the nearest pixel of the plane.
struct Padded(Plane);

impl Padded {
    fn new(plane: &Plane) -> Self {
        let inside = |at: usize, count: usize| at.saturating_sub(PADDING).min(count - 1);
        let [rows, cols] = [plane.rows, plane.cols].map(|count| count + 2 * PADDING);
        let mut grey = Vec::with_capacity(rows * cols);
        for row in 0..rows {
            let from = plane.row(inside(row, plane.rows));
            grey.extend((0..cols).map(|col| from[inside(col, plane.cols)]));
        }
        Self(Plane { rows, cols, grey })
    }

    /// Returns the values of a range of pixels, whose place is relative to the plane without the
    /// border.
    fn values(&self, row: i32, col: i32, count: usize) -> &[f32] {
        let [row, col] = [row, col].map(|at| (at + PADDING as i32) as usize);
        &self.0.row(row)[col..col + count]
    }
}

impl Flow {
    /// Finds the motion of all blocks, in parallel.
    fn between(before: &Plane, after: &Plane, cancel: &Cancel) -> Result<Self, Cancelled> {
        let blocks = [after.rows, after.cols].map(|count| count.div_ceil(BLOCK));
        let before = Padded::new(before);
        let one = |index: usize| {
            cancel.check()?;
            Ok(best_shift(&before, after, [index / blocks[1], index % blocks[1]].map(|i| i * BLOCK)))
        };
        let shifts = (0..blocks[0] * blocks[1]).into_par_iter().map(one).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { rows: after.rows, cols: after.cols, blocks, shifts: smoothed(blocks, &shifts) })
    }

    fn moves(&self) -> bool {
        self.shifts.iter().any(|shift| *shift != [0, 0])
    }

    /// Returns the motion [right, down] at a pixel, in whole pixels. It is interpolated linearly
    /// between the centres of blocks.
    pub fn at(&self, row: usize, col: usize) -> [i32; 2] {
        let place = |at: usize, blocks: usize| {
            let at = ((at as f32 + 0.5) / BLOCK as f32 - 0.5).clamp(0.0, (blocks - 1) as f32);
            let first = at.floor() as usize;
            (first, (first + 1).min(blocks - 1), at - first as f32)
        };
        let ((top, bottom, down), (left, right, across)) = (place(row, self.blocks[0]), place(col, self.blocks[1]));
        [0, 1].map(|axis| {
            let of = |row: usize, col: usize| self.shifts[row * self.blocks[1] + col][axis] as f32;
            let line = |row: usize| of(row, left) + across * (of(row, right) - of(row, left));
            (line(top) + down * (line(bottom) - line(top))).round() as i32
        })
    }
}

/// Finds the motion [right, down] by which a block of `after` matches `before` best.
fn best_shift(before: &Padded, after: &Plane, [row, col]: [usize; 2]) -> [i32; 2] {
    let span = |from: usize, count: usize| from.saturating_sub(AROUND)..(from + BLOCK + AROUND).min(count);
    let (rows, cols) = (span(row, after.rows), span(col, after.cols));
    let pixels = (rows.len() * cols.len()) as f32;
    let error = |[right, down]: [i32; 2], limit: f32| {
        let cost = COST * (right as f32).hypot(down as f32);
        let mut sum = cost * pixels;
        for row in rows.clone() {
            let source = before.values(row as i32 - down, cols.start as i32 - right, cols.len());
            sum += squared_difference(&after.row(row)[cols.clone()], source);
            if sum >= limit {
                return f32::INFINITY;
            }
        }
        sum
    };
    let every = |far: i32, step: i32| (-far..=far).step_by(step as usize);
    let around = |[right, down]: [i32; 2], far: i32, step: i32| {
        every(far, step).flat_map(move |d| every(far, step).map(move |r| [right + r, down + d]))
    };
    let still = ([0, 0], error([0, 0], f32::INFINITY));
    // Search with coarse steps, and keep several matches. Content that repeats itself matches at
    // several motions. A coarse step next to the true motion may match worse than a wrong motion.
    let mut near = vec![still];
    for shift in around([0, 0], FARTHEST, COARSE) {
        let worst = if near.len() < KEPT { f32::INFINITY } else { near[KEPT - 1].1 };
        let found = error(shift, worst);
        if found < worst {
            near.insert(near.partition_point(|(_, other)| *other <= found), (shift, found));
            near.truncate(KEPT);
        }
    }
    // Search with fine steps around each kept match.
    let mut best = still;
    for shift in near.iter().flat_map(|(shift, _)| around(*shift, COARSE - 1, 1)) {
        let found = error(shift, best.1);
        if found < best.1 {
            best = (shift, found);
        }
    }
    best.0
}

/// Returns Σ (a − b)².
fn squared_difference(a: &[f32], b: &[f32]) -> f32 {
    // Eight independent sums let the compiler use vector instructions.
    const SUMS: usize = 8;
    let mut sums = [0.0f32; SUMS];
    let (a, b) = (a.chunks_exact(SUMS), b.chunks_exact(SUMS));
    let rest = a.remainder().iter().zip(b.remainder()).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
    for (a, b) in a.zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += (a - b) * (a - b);
        }
    }
    sums.iter().sum::<f32>() + rest
}

/// Replaces each block's motion by the median over 3 × 3 blocks, which removes single wrong
/// matches.
fn smoothed([rows, cols]: [usize; 2], shifts: &[[i32; 2]]) -> Vec<[i32; 2]> {
    let around = |at: usize, count: usize| at.saturating_sub(1)..(at + 2).min(count);
    let one = |index: usize| {
        [0, 1].map(|axis| {
            let near = around(index / cols, rows).flat_map(|r| around(index % cols, cols).map(move |c| r * cols + c));
            let mut values: Vec<i32> = near.map(|i| shifts[i][axis]).collect();
            values.sort_unstable();
            values[values.len() / 2]
        })
    };
    (0..shifts.len()).map(one).collect()
}

/// Moves patterns along the flows, in every frame. A pixel whose source is outside the layer gets
/// its value from `fresh`.
///
/// Both patterns must have the same shapes, and the flows must belong to the patterns' planes.
pub fn moved(stack: &LayerStack, flows: &[Flow], fresh: &LayerStack) -> LayerStack {
    let mut out = fresh.clone();
    let layers = out.layers.iter_mut().zip(&stack.layers).map(|(to, from)| (to.data_mut(), from.data()));
    let emission = out.emission.iter_mut().zip(&stack.emission).map(|(to, from)| (to.data_mut(), from.data()));
    for ((to, from), flow) in layers.chain(emission).zip(flows) {
        let size = 3 * flow.rows * flow.cols;
        let pixels = (0..flow.rows * flow.cols).map(|i| flow.source(i / flow.cols, i % flow.cols));
        let sources: Vec<Option<usize>> = pixels.collect();
        for (to, from) in to.chunks_exact_mut(size).zip(from.chunks_exact(size)) {
            for (rgb, source) in to.chunks_exact_mut(3).zip(&sources) {
                if let Some(source) = source {
                    rgb.copy_from_slice(&from[3 * source..][..3]);
                }
            }
        }
    }
    out
}

impl Flow {
    /// Returns the fraction of a region's pixels whose source is outside the layer, 0..1.
    pub(crate) fn new_share(&self, region: &Region) -> f64 {
        let pixels = region.rows.clone().flat_map(|row| region.cols.clone().map(move |col| [row, col]));
        let new = pixels.filter(|[row, col]| self.source(*row, *col).is_none()).count();
        new as f64 / (region.rows.len() * region.cols.len()).max(1) as f64
    }

    /// Returns the index of the pixel from which a pixel takes its value; `None` if this source is
    /// outside the layer.
    fn source(&self, row: usize, col: usize) -> Option<usize> {
        let [right, down] = self.at(row, col);
        let back =
            |at: usize, by: i32, count: usize| usize::try_from(at as i32 - by).ok().filter(|&source| source < count);
        Some(back(row, down, self.rows)? * self.cols + back(col, right, self.cols)?)
    }
}
