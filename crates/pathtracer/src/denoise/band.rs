//! The filter of a few rows of one view.
//!
//! Neighbouring views are first resampled into the view's own frame, pixel by pixel. A window
//! around a pixel is a set of shifts, and each shift is computed for all pixels together. A shift
//! gives a picture of colour distances, whose sums over 3 × 3 pixels are the distances of patches.
//! So all loops run along rows.

use std::ops::Range;

use super::frame::{ALBEDO, ALPHA, COVERED, Frame, GLOSS, HALVES, NORMAL, PLACE, PLANES, THERE, VARIANCE};
use super::view::Window;

/// Half width of a patch: patches are squares of 3 × 3 pixels.
const PATCH: usize = 1;
/// Difference of two patches, less its expected noise, that lowers a weight to about a third. The
/// unit is the standard deviation of the noise of the difference.
const COLOUR_SCALE: f32 = 0.8;
/// Difference of normals that lowers a weight to about a third. The scales of the other guides
/// below have the same meaning.
const NORMAL_SCALE: f32 = 0.2;
/// Distance of a point from the plane of another point, in pixels, that lowers a weight to about a
/// third.
const PLANE_SCALE: f32 = 1.5;
const ALBEDO_SCALE: f32 = 0.2;
const GLOSS_SCALE: f32 = 0.2;
const COVERED_SCALE: f32 = 0.2;
/// Number of answers: ways to filter the radiance of a pixel. Each is computed for both halves of
/// the samples. The first uses colours and guides, with weights from the other half. The second
/// uses guides alone. The third uses colours and guides, with weights from the half itself; it
/// serves only to estimate errors.
pub(super) const ANSWERS: usize = 3;

/// Filtered radiance of a few rows, divided by the albedo, for each answer and each half of the
/// samples: `[row][col][rgb]`.
pub(super) type Answers = [[Vec<[f32; 3]>; 2]; ANSWERS];

/// A region of a view, with the margin that [`cut`](Self::cut) adds. Values outside of the picture
/// are 0.
struct Block {
    planes: [Vec<f32>; PLANES],
    width: usize,
}

/// For each half of the samples, the sums of weighted radiance and of the weights, for every pixel.
struct Sums {
    values: [[Vec<f32>; 3]; 2],
    weights: [Vec<f32>; 2],
}

/// Filters the rows of a view.
pub(super) fn filter(
    frames: &[Frame],
    index: usize,
    neighbours: &[usize],
    rows: Range<usize>,
    window: Window,
) -> Answers {
    let own = &frames[index];
    let (height, cols) = (rows.len(), own.cols);
    let margin = window.radius.max(window.radius_in_views) + PATCH;
    let centre = Block::cut(own, own, &rows, margin, |row, col| Some(row * cols + col));
    let mut sums: [Sums; ANSWERS] = std::array::from_fn(|_| Sums::new(height * cols));
    let mut scratch = Scratch::new(height, cols);
    let shifts = |radius: usize| {
        let radius = radius as isize;
        (-radius..=radius).flat_map(move |y| (-radius..=radius).map(move |x| [y, x]))
    };
    let steady = vec![1.0; height * cols];
    for shift in shifts(window.radius) {
        scratch.add(&centre, &centre, shift, margin, &steady, &mut sums);
    }
    for &neighbour in neighbours {
        let other = &frames[neighbour];
        let block = Block::cut(own, other, &rows, margin, |row, col| own.seen_in(other, row, col));
        let steady = centre.steady(own.slope_to(other), height, cols, margin);
        for shift in shifts(window.radius_in_views) {
            scratch.add(&centre, &block, shift, margin, &steady, &mut sums);
        }
    }
    sums.map(|sums| sums.finish(&centre, height, cols, margin))
}

impl Block {
    /// Collects one pixel of `other` for each pixel of the rows `rows` of `frame`, and of a margin
    /// around these rows. `place` returns the index in `other` for a row and a column of `frame`.
    fn cut(
        frame: &Frame,
        other: &Frame,
        rows: &Range<usize>,
        margin: usize,
        place: impl Fn(usize, usize) -> Option<usize>,
    ) -> Self {
        let width = frame.cols + 2 * margin;
        let height = rows.len() + 2 * margin;
        let mut found = vec![usize::MAX; width * height];
        for y in 0..height {
            let Some(row) = (rows.start + y).checked_sub(margin).filter(|&row| row < frame.rows) else { continue };
            for col in 0..frame.cols {
                found[y * width + margin + col] = place(row, col).unwrap_or(usize::MAX);
            }
        }
        let planes = std::array::from_fn(|plane| {
            let source = other.plane(plane);
            found.iter().map(|&i| source.get(i).copied().unwrap_or(0.0)).collect()
        });
        Self { planes, width }
    }

    /// Returns, for each pixel, the fraction of its light that is the same in another view. Diffuse
    /// light is the same. Glossy light is nearly the same if half the angle between the views is
    /// small against the lobe's width α.
    fn steady(&self, slope: f32, height: usize, cols: usize, margin: usize) -> Vec<f32> {
        let mut steady = Vec::with_capacity(height * cols);
        for y in 0..height {
            for x in 0..cols {
                let i = (y + margin) * self.width + margin + x;
                let (gloss, alpha) = (self.planes[GLOSS][i], self.planes[ALPHA][i]);
                let turned = 0.5 * slope / alpha.max(1e-3);
                steady.push(1.0 - gloss + gloss * kernel(turned * turned));
            }
        }
        steady
    }
}

/// Memory for the values of all pixels at one shift of the window.
struct Scratch {
    height: usize,
    cols: usize,
    /// Colour distances for each half of the samples, with the margin of a patch around the pixels.
    distance: [Vec<f32>; 2],
    /// Sums of three neighbouring distances along a row.
    across: [Vec<f32>; 2],
    guides: Vec<f32>,
    /// Weights of a row, from the guides and the colours together.
    colours: Vec<f32>,
}

impl Scratch {
    fn new(height: usize, cols: usize) -> Self {
        let padded = || vec![0.0; (height + 2 * PATCH) * (cols + 2 * PATCH)];
        Self {
            height,
            cols,
            distance: [padded(), padded()],
            across: [padded(), padded()],
            guides: vec![0.0; cols],
            colours: vec![0.0; cols],
        }
    }

    /// Adds weighted pixels of `block` to the sums of all answers. The sums of a pixel of `centre`
    /// get the pixel that is `shift` away from it, [down, right].
    fn add(
        &mut self,
        centre: &Block,
        block: &Block,
        shift: [isize; 2],
        margin: usize,
        steady: &[f32],
        sums: &mut [Sums; ANSWERS],
    ) {
        let (height, cols, width) = (self.height, self.cols, centre.width);
        // Sum the colour distances over three successive pixels of a row, for each half of the
        // samples. Three of these sums give the distance of two patches.
        let wide = cols + 2 * PATCH;
        for y in 0..height + 2 * PATCH {
            let p = (y + margin - PATCH) * width + margin - PATCH;
            let q = (p as isize + shift[0] * width as isize + shift[1]) as usize;
            for half in 0..2 {
                let row = &mut self.distance[half][y * wide..][..wide];
                row.fill(0.0);
                for c in 0..3 {
                    let [u_p, v_p] = [HALVES[half] + c, VARIANCE + c].map(|plane| &centre.planes[plane][p..][..wide]);
                    let [u_q, v_q] = [HALVES[half] + c, VARIANCE + c].map(|plane| &block.planes[plane][q..][..wide]);
                    for x in 0..wide {
                        let d = u_p[x] - u_q[x];
                        let noise = v_p[x] + v_p[x].min(v_q[x]);
                        let scale = COLOUR_SCALE * COLOUR_SCALE * (v_p[x] + v_q[x]);
                        row[x] += (d * d - noise) / (scale + 1e-12);
                    }
                }
                let (across, row) =
                    (&mut self.across[half][y * wide..][..wide], &self.distance[half][y * wide..][..wide]);
                for x in 0..cols {
                    across[x] = row[x] + row[x + 1] + row[x + 2];
                }
            }
        }
        for y in 0..height {
            let p = (y + margin) * width + margin;
            let q = (p as isize + shift[0] * width as isize + shift[1]) as usize;
            // Compute the guide weights. For the answers that use colours, multiply them by the
            // kernel of the patches' colour distances.
            guide_row(centre, block, p, q, &steady[y * cols..][..cols], &mut self.guides);
            let range = y * cols..(y + 1) * cols;
            for half in 0..2 {
                let [above, middle, below] = [0, 1, 2].map(|k| &self.across[half][(y + k) * wide..][..cols]);
                let values = |half: usize, c: usize| &block.planes[HALVES[half] + c][q..][..cols];
                let other = 1 - half;
                let [r, g, b] = [0, 1, 2].map(|c| values(other, c));
                let [with_colour, guides_alone, own_weights] = &mut *sums;
                // The colour distances of one half give the weights for the radiance of the other
                // half. So the noise of the weights is independent of the noise of the radiance.
                let weights = &mut with_colour.weights[other][range.clone()];
                let [sum_r, sum_g, sum_b] = &mut with_colour.values[other];
                let [sum_r, sum_g, sum_b] = [sum_r, sum_g, sum_b].map(|sum| &mut sum[range.clone()]);
                for x in 0..cols {
                    let mean = (above[x] + middle[x] + below[x]) * (1.0 / 27.0);
                    let w = self.guides[x] * kernel(mean.max(0.0));
                    self.colours[x] = w;
                    weights[x] += w;
                    sum_r[x] += w * r[x];
                    sum_g[x] += w * g[x];
                    sum_b[x] += w * b[x];
                }
                // the same weights also average the half that they come from; this answer serves
                // to estimate errors
                let [own_r, own_g, own_b] = [0, 1, 2].map(|c| values(half, c));
                let weights = &mut own_weights.weights[half][range.clone()];
                let [sum_r, sum_g, sum_b] = &mut own_weights.values[half];
                let [sum_r, sum_g, sum_b] = [sum_r, sum_g, sum_b].map(|sum| &mut sum[range.clone()]);
                for x in 0..cols {
                    let w = self.colours[x];
                    weights[x] += w;
                    sum_r[x] += w * own_r[x];
                    sum_g[x] += w * own_g[x];
                    sum_b[x] += w * own_b[x];
                }
                // add to the answer whose weights come from the guides alone
                let weights = &mut guides_alone.weights[other][range.clone()];
                let [sum_r, sum_g, sum_b] = &mut guides_alone.values[other];
                let [sum_r, sum_g, sum_b] = [sum_r, sum_g, sum_b].map(|sum| &mut sum[range.clone()]);
                for x in 0..cols {
                    let w = self.guides[x];
                    weights[x] += w;
                    sum_r[x] += w * r[x];
                    sum_g[x] += w * g[x];
                    sum_b[x] += w * b[x];
                }
            }
        }
    }
}

/// Computes the weights from the guides for a row of pixels. The row starts at index `p` in
/// `centre`, and the pixels that are compared with it start at index `q` in `block`.
fn guide_row(centre: &Block, block: &Block, p: usize, q: usize, steady: &[f32], weights: &mut [f32]) {
    let cols = weights.len();
    let here = |plane: usize| &centre.planes[plane][p..][..cols];
    let there = |plane: usize| &block.planes[plane][q..][..cols];
    let vector = |first: usize| ([0, 1, 2].map(|c| here(first + c)), [0, 1, 2].map(|c| there(first + c)));
    let (normal, other_normal) = vector(NORMAL);
    let (place, other_place) = vector(PLACE);
    let (albedo, other_albedo) = vector(ALBEDO);
    let (gloss, other_gloss) = (here(GLOSS), there(GLOSS));
    let (alpha, other_alpha) = (here(ALPHA), there(ALPHA));
    let (covered, other_covered) = (here(COVERED), there(COVERED));
    let exists = there(THERE);
    for x in 0..cols {
        let (mut turned, mut off, mut coloured) = (0.0, 0.0, 0.0);
        for c in 0..3 {
            let (n, a) = (normal[c][x] - other_normal[c][x], albedo[c][x] - other_albedo[c][x]);
            turned += n * n;
            coloured += a * a;
            off += normal[c][x] * (other_place[c][x] - place[c][x]);
        }
        let (g, r) = (gloss[x] - other_gloss[x], alpha[x] - other_alpha[x]);
        let part = covered[x] - other_covered[x];
        let distance = turned * (1.0 / (NORMAL_SCALE * NORMAL_SCALE))
            + off * off * (1.0 / (PLANE_SCALE * PLANE_SCALE))
            + coloured * (1.0 / (ALBEDO_SCALE * ALBEDO_SCALE))
            + (g * g + r * r) * (1.0 / (GLOSS_SCALE * GLOSS_SCALE))
            + part * part * (1.0 / (COVERED_SCALE * COVERED_SCALE));
        weights[x] = exists[x] * steady[x] * kernel(distance);
    }
}

/// Returns the value at `x` of a falling curve close to exp(−x). It is 0 from x = 4 on, and is
/// computed without a library call.
#[inline(always)]
fn kernel(x: f32) -> f32 {
    let t = (1.0 - 0.25 * x).max(0.0);
    (t * t) * (t * t)
}

impl Sums {
    fn new(count: usize) -> Self {
        let zeros = || vec![0.0; count];
        Self { values: [[zeros(), zeros(), zeros()], [zeros(), zeros(), zeros()]], weights: [zeros(), zeros()] }
    }

    fn finish(self, centre: &Block, height: usize, cols: usize, margin: usize) -> [Vec<[f32; 3]>; 2] {
        [0, 1].map(|half| {
            (0..height * cols)
                .map(|i| {
                    let at = (i / cols + margin) * centre.width + margin + i % cols;
                    let weight = self.weights[half][i];
                    // A pixel that shows only background has almost no noise, so it stays as it is.
                    // A pixel without any weight stays as it is too.
                    let as_is = centre.planes[COVERED][at] <= 0.0 || weight <= 0.0;
                    [0, 1, 2].map(|c| {
                        if as_is { centre.planes[HALVES[half] + c][at] } else { self.values[half][c][i] / weight }
                    })
                })
                .collect()
        })
    }
}
