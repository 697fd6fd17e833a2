//! The update and the objective in `f64`, as loops over an explicit list of rays. Geometry is computed here from the design's formulas,
//! not from the tables under test.

use lumistack_display::{Backlight, LayerStack, Missing, OutsideBins, Projection, Sampling};

use crate::{FLOOR, Problem};

/// What a ray reads of one factor.
enum Read {
    /// Pixels and their weights.
    Pixels(Vec<(usize, f64)>),
    /// A constant.
    Constant(f64),
}

struct Ray {
    weight: f64,
    /// βL per channel.
    wanted: [f64; 3],
    reads: Vec<Read>,
}

/// The problem's rays, and patterns as `[factor][frame][pixel][rgb]`.
pub(crate) struct Oracle {
    rays: Vec<Ray>,
    frames: usize,
    pub(crate) factors: Vec<Vec<f64>>,
}

impl Oracle {
    pub(crate) fn new(problem: &Problem, stack: &LayerStack) -> Self {
        let mut oracle = Self { rays: rays(problem), frames: problem.display.frames, factors: Vec::new() };
        oracle.upload(stack);
        oracle
    }

    pub(crate) fn upload(&mut self, stack: &LayerStack) {
        let tensors = stack.layers.iter().map(|t| t.data()).chain(stack.emission.iter().map(|t| t.data()));
        self.factors = tensors.map(|data| data.iter().map(|&v| f64::from(v).max(f64::from(FLOOR))).collect()).collect();
    }

    /// Value of factor k in frame m along a ray.
    fn value(&self, ray: &Ray, k: usize, m: usize, channel: usize) -> f64 {
        let factor = &self.factors[k];
        let frame = factor.len() / self.frames * m;
        match &ray.reads[k] {
            Read::Constant(value) => *value,
            Read::Pixels(pixels) => pixels.iter().map(|(j, t)| t * factor[frame + 3 * j + channel]).sum(),
        }
    }

    fn emitted(&self, ray: &Ray, channel: usize) -> f64 {
        let product = |m| (0..self.factors.len()).map(|k| self.value(ray, k, m, channel)).product::<f64>();
        (0..self.frames).map(product).sum::<f64>() / self.frames as f64
    }

    /// f_m[j] ← clamp(f_m[j] · Σ w βL P_m / Σ w L̃ P_m) for factor n.
    pub(crate) fn update(&mut self, n: usize) {
        let size = self.factors[n].len() / self.frames;
        let (mut above, mut below) = (vec![0.0; size * self.frames], vec![0.0; size * self.frames]);
        for ray in &self.rays {
            let Read::Pixels(pixels) = &ray.reads[n] else { continue };
            for channel in 0..3 {
                let emitted = self.emitted(ray, channel);
                for m in 0..self.frames {
                    let others = (0..self.factors.len()).filter(|k| *k != n);
                    let p: f64 = others.map(|k| self.value(ray, k, m, channel)).product();
                    for (j, t) in pixels {
                        above[m * size + 3 * j + channel] += t * ray.weight * ray.wanted[channel] * p;
                        below[m * size + 3 * j + channel] += t * ray.weight * emitted * p;
                    }
                }
            }
        }
        for (f, (above, below)) in self.factors[n].iter_mut().zip(above.iter().zip(below)) {
            if below > 0.0 {
                *f = (*f * above / below).clamp(f64::from(FLOOR), 1.0);
            }
        }
    }

    /// Σ w (βL − L̃)².
    pub(crate) fn objective(&self) -> f64 {
        let error = |ray: &Ray, channel| ray.weight * (ray.wanted[channel] - self.emitted(ray, channel)).powi(2);
        self.rays.iter().map(|ray| (0..3).map(|channel| error(ray, channel)).sum::<f64>()).sum()
    }

    pub(crate) fn ray_count(&self) -> usize {
        self.rays.len()
    }

    /// Largest difference to a stack.
    pub(crate) fn distance(&self, stack: &LayerStack) -> f64 {
        let tensors = stack.layers.iter().map(|t| t.data()).chain(stack.emission.iter().map(|t| t.data()));
        let pairs = self.factors.iter().zip(tensors).flat_map(|(a, b)| a.iter().zip(b));
        pairs.map(|(a, &b)| (a - f64::from(b)).abs()).fold(0.0, f64::max)
    }
}

/// All rays that count.
fn rays(problem: &Problem) -> Vec<Ray> {
    let (display, field) = (problem.display, problem.target.geometry());
    let mut rays = Vec::new();
    for [view_y, view_x] in field.grid.iter() {
        for (row, col) in (0..field.rows).flat_map(|row| (0..field.cols).map(move |col| (row, col))) {
            let x = (col as f64 - (field.cols as f64 - 1.0) / 2.0) * field.pitch_mm;
            let y = ((field.rows as f64 - 1.0) / 2.0 - row as f64) * field.pitch_mm;
            let (mut sx, mut sy) = (field.grid.slope_x[view_x], field.grid.slope_y[view_y]);
            if let Projection::Perspective { distance_mm } = field.grid.projection {
                (sx, sy) = ((sx * distance_mm - x) / distance_mm, (sy * distance_mm - y) / distance_mm);
            }
            let mut reads = Vec::new();
            let mut counts = true;
            for layer in &display.layers {
                let [cols, rows] = layer.resolution;
                let u = (x + layer.d_mm * sx - layer.offset_mm[0]) / layer.pitch_mm + (cols as f64 - 1.0) / 2.0;
                let v = (rows as f64 - 1.0) / 2.0 - (y + layer.d_mm * sy - layer.offset_mm[1]) / layer.pitch_mm;
                let (i, j) = ((u + 0.5).floor(), (v + 0.5).floor());
                if i < 0.0 || j < 0.0 || i >= cols as f64 || j >= rows as f64 {
                    counts &= display.missing == Missing::Clear;
                    reads.push(Read::Constant(1.0));
                } else if display.sampling == Sampling::Nearest {
                    reads.push(Read::Pixels(vec![(j as usize * cols + i as usize, 1.0)]));
                } else {
                    let mut pixels = Vec::new();
                    for (j, tv) in neighbours(v, rows) {
                        pixels.extend(neighbours(u, cols).map(|(i, tu)| (j * cols + i, tu * tv)));
                    }
                    reads.push(Read::Pixels(pixels));
                }
            }
            if let Backlight::Lenslets(b) = &display.backlight {
                let ([cols, rows], [bins_x, bins_y]) = (b.lenslets.map(|n| n as f64), b.views.map(|n| n as f64));
                let i = ((x + b.d_mm * sx - b.offset_mm[0]) / b.pitch_mm + (cols - 1.0) / 2.0 + 0.5).floor();
                let j = ((rows - 1.0) / 2.0 - (y + b.d_mm * sy - b.offset_mm[1]) / b.pitch_mm + 0.5).floor();
                counts &= i >= 0.0 && j >= 0.0 && i < cols && j < rows;
                let tan = b.fov_deg.map(|fov| (fov / 2.0).to_radians().tan());
                let bin_x = (bins_x / 2.0 * (1.0 + sx / tan[0])).floor();
                let bin_y = (bins_y / 2.0 * (1.0 - sy / tan[1])).floor();
                // beyond the bins a lens array shows the neighbouring lenslet's picture
                let (zone_x, zone_y) = ((bin_x / bins_x).floor(), (bin_y / bins_y).floor());
                let (i, j) = (i - zone_x, j - zone_y);
                let (bin_x, bin_y) = (bin_x - zone_x * bins_x, bin_y - zone_y * bins_y);
                let lit = (zone_x == 0.0 && zone_y == 0.0)
                    || (b.outside_bins == OutsideBins::Repeat && i >= 0.0 && j >= 0.0 && i < cols && j < rows);
                let pixel = (((bin_y * bins_x) + bin_x) * rows + j) * cols + i;
                reads.push(if lit { Read::Pixels(vec![(pixel as usize, 1.0)]) } else { Read::Constant(0.0) });
            }
            let weight = f64::from(problem.weights.at([view_y, view_x], row, col));
            if counts && weight > 0.0 {
                let at = (row * field.cols + col) * 3;
                let pixel = &problem.target.view([view_y, view_x])[at..at + 3];
                let wanted = [0, 1, 2].map(|channel| display.brightness * f64::from(pixel[channel]));
                rays.push(Ray { weight, wanted, reads });
            }
        }
    }
    rays
}

/// The two pixels around a position and their weights; the outermost pixel alone beyond its centre.
fn neighbours(u: f64, count: usize) -> impl Iterator<Item = (usize, f64)> {
    let u = u.clamp(0.0, count as f64 - 1.0);
    let first = u.floor();
    let pair = [(first as usize, 1.0 - (u - first)), (first as usize + 1, u - first)];
    pair.into_iter().filter(|(_, t)| *t > 0.0)
}
