//! Motion of content across layers, and patterns that move with it.
//!
//! ```text
//! P_n(x) = mean of L over the rays through pixel x of layer n
//! v_n(x) = arg min over v of Σ (P_n(x' ) − P_n_before(x' − v))² + λ |v|
//! f_n(x) ← f_n(x − v_n(x))
//! ```
//!
//! L is the light field, and P_n is its content as layer n sees it: content near the layer is
//! sharp. P_n_before is P_n of the previous light field. The factor λ penalizes long motions. The
//! motion v_n is found for each block of pixels, and is interpolated between blocks. The sum runs
//! over the pixels x' in and around the block. Then the patterns f_n of every frame are moved. A
//! pixel whose source x − v_n is outside the layer gets its value from patterns of a fresh start.
//!
//! The method needs only light fields, so it works for scenes and for given light fields. Content
//! that turns or moves in depth has a different motion on every layer and at every place.

use lumistack_display::{BacklightTap, Display, FieldGeometry, LayerStack, LightField, RayMap, Region, spread};

/// Largest number of views per axis whose rays are averaged.
const VIEWS: usize = 5;
/// Edge of a block, pixels.
const BLOCK: usize = 16;
/// Width of the border around a block, pixels. Pixels of the border are compared together with the
/// pixels of the block. Without the border, a block that contains a single straight edge would show
/// no motion along this edge.
const AROUND: usize = 4;
/// Longest motion along an axis, pixels. It is a multiple of [`COARSE`].
const FARTHEST: i32 = 32;
/// Step of the first search, pixels.
const COARSE: i32 = 2;
/// Number of best matches of the first search that the second search refines.
const KEPT: usize = 8;
/// The factor λ of the penalty on long motions: each pixel of motion must reduce the mean squared
/// difference by at least this value.
const COST: f32 = 2e-6;

/// The content as every layer sees it. If the backlight is directional, the last plane is the
/// content as its lenslets see it.
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
    pub fn of(display: &Display, field: &LightField) -> Self {
        let map = RayMap::new(display, field.geometry());
        let layer = |n: usize| {
            let of = &map.layers[n];
            let index = |taps: &[lumistack_display::Tap]| taps.iter().map(|tap| pixel(tap.first)).collect::<Vec<_>>();
            let along = |view: [usize; 2]| [index(of.y.of_view(view[0])), index(of.x.of_view(view[1]))];
            Plane::of(field, [of.rows, of.cols], along)
        };
        let mut planes: Vec<Plane> = (0..map.layers.len()).map(layer).collect();
        if let (Some(backlight), Some([_, _, _, rows, cols, _])) = (&map.backlight, LayerStack::emission_shape(display))
        {
            let index = |taps: &[BacklightTap]| taps.iter().map(|tap| lenslet(*tap)).collect::<Vec<_>>();
            let along = |view: [usize; 2]| [index(backlight.y(view[0])), index(backlight.x(view[1]))];
            planes.push(Plane::of(field, [rows, cols], along));
        }
        Self(planes)
    }

    /// Computes the motion from these planes to later planes of the same display. `None` if nothing
    /// moves, or if the planes have different sizes.
    pub fn flows_to(&self, later: &Self) -> Option<Vec<Flow>> {
        let sizes = |planes: &Self| planes.0.iter().map(|plane| [plane.rows, plane.cols]).collect::<Vec<_>>();
        if sizes(self) != sizes(later) {
            return None;
        }
        let flows: Vec<Flow> =
            self.0.iter().zip(&later.0).map(|(before, after)| Flow::between(before, after)).collect();
        flows.iter().any(Flow::moves).then_some(flows)
    }
}

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
    /// Averages a light field on a plane. For a view, `along` returns the plane's row for each row
    /// of the field, and the plane's column for each column.
    fn of(field: &LightField, [rows, cols]: [usize; 2], along: impl Fn([usize; 2]) -> [Vec<Option<usize>>; 2]) -> Self {
        let FieldGeometry { grid, cols: field_cols, .. } = field.geometry();
        let [view_rows, view_cols] = grid.views().map(|count| spread(count, VIEWS));
        let (mut sums, mut counts) = (vec![0.0f32; rows * cols], vec![0u32; rows * cols]);
        for view in view_rows.iter().flat_map(|&y| view_cols.iter().map(move |&x| [y, x])) {
            let [to_row, to_col] = along(view);
            for (line, row) in field.view(view).chunks_exact(3 * field_cols).zip(&to_row) {
                let Some(row) = row else { continue };
                for (rgb, col) in line.chunks_exact(3).zip(&to_col) {
                    let Some(col) = col else { continue };
                    sums[row * cols + col] += rgb.iter().sum::<f32>() / 3.0;
                    counts[row * cols + col] += 1;
                }
            }
        }
        let grey = sums.iter().zip(&counts).map(|(sum, &count)| sum / count.max(1) as f32).collect();
        Self { rows, cols, grey }
    }

    /// Returns the value at a pixel. Outside the border, returns the value of the nearest pixel.
    fn at(&self, row: i32, col: i32) -> f32 {
        let row = row.clamp(0, self.rows as i32 - 1) as usize;
        let col = col.clamp(0, self.cols as i32 - 1) as usize;
        self.grey[row * self.cols + col]
    }
}

impl Flow {
    fn between(before: &Plane, after: &Plane) -> Self {
        let blocks = [after.rows, after.cols].map(|count| count.div_ceil(BLOCK));
        let one = |index: usize| best_shift(before, after, [index / blocks[1], index % blocks[1]].map(|i| i * BLOCK));
        let shifts = smoothed(blocks, &(0..blocks[0] * blocks[1]).map(one).collect::<Vec<_>>());
        Self { rows: after.rows, cols: after.cols, blocks, shifts }
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
fn best_shift(before: &Plane, after: &Plane, [row, col]: [usize; 2]) -> [i32; 2] {
    let span =
        |from: usize, count: usize| (from.saturating_sub(AROUND) as i32)..((from + BLOCK + AROUND).min(count) as i32);
    let (rows, cols) = (span(row, after.rows), span(col, after.cols));
    let pixels = (rows.len() * cols.len()) as f32;
    let error = |[right, down]: [i32; 2], limit: f32| {
        let cost = COST * (right as f32).hypot(down as f32);
        let mut sum = cost * pixels;
        for r in rows.clone() {
            for c in cols.clone() {
                let difference = after.at(r, c) - before.at(r - down, c - right);
                sum += difference * difference;
            }
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
/// # Panics
/// If the patterns have different shapes, or the flows do not belong to the patterns' planes.
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
    /// Returns the fraction of a region's pixels whose values enter across the border, 0..1.
    pub(crate) fn new_share(&self, region: &Region) -> f64 {
        let pixels = region.rows.clone().flat_map(|row| region.cols.clone().map(move |col| [row, col]));
        let new = pixels.filter(|[row, col]| self.source(*row, *col).is_none()).count();
        new as f64 / (region.rows.len() * region.cols.len()).max(1) as f64
    }

    /// Returns the index of the pixel from which a pixel takes its value; `None` if this source is
    /// outside the border.
    fn source(&self, row: usize, col: usize) -> Option<usize> {
        let [right, down] = self.at(row, col);
        let back =
            |at: usize, by: i32, count: usize| usize::try_from(at as i32 - by).ok().filter(|&source| source < count);
        Some(back(row, down, self.rows)? * self.cols + back(col, right, self.cols)?)
    }
}
