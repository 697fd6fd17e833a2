//! The update and the objective in `f64`, as loops over an explicit list of rays.
//!
//! The geometry is computed here from the display's formulas, not from the tables under test.

use lumistack_display::{
    Backlight, Formation, Layer, LayerColour, LayerStack, Missing, OutsideBins, Projection, Sampling,
};

use lumistack_factorizer::Problem;

/// A stored value that a ray reads.
#[derive(Clone)]
struct Entry {
    /// Pixel and channel, as an offset in one frame.
    at: usize,
    /// Weight of the stored value in the value that the ray reads.
    share: f64,
    /// Weight in the bound of the curvature: `share`, times the sum of the weights with which
    /// stored values are mixed into the hit pixel.
    bound: f64,
}

/// The value of one factor along a ray, per channel.
enum Read {
    Entries([Vec<Entry>; 3]),
    /// A value that does not depend on patterns.
    Constant(f64),
}

struct Ray {
    weight: f64,
    /// βL per channel.
    wanted: [f64; 3],
    reads: Vec<Read>,
}

/// The rays of a problem, and patterns as `[factor][frame][pixel][rgb]`.
pub(crate) struct Oracle {
    rays: Vec<Ray>,
    frames: usize,
    formation: Formation,
    layers: usize,
    ranges: Vec<[f64; 2]>,
    tied: Vec<bool>,
    pub(crate) factors: Vec<Vec<f64>>,
}

impl Oracle {
    pub(crate) fn new(problem: &Problem, stack: &LayerStack, floor: f32) -> Self {
        let display = problem.display;
        let mut ranges: Vec<_> = display.layers.iter().map(|l| [l.black_level * l.peak, l.peak]).collect();
        ranges.push([0.0, 1.0]);
        ranges.iter_mut().for_each(|range| range[0] = range[0].max(f64::from(floor)));
        let mut oracle = Self {
            rays: rays(problem),
            frames: display.frames,
            formation: display.formation,
            layers: display.layers.len(),
            ranges,
            tied: display.layers.iter().map(|l| l.colour == LayerColour::Mono).chain([false]).collect(),
            factors: Vec::new(),
        };
        oracle.upload(stack);
        oracle
    }

    pub(crate) fn upload(&mut self, stack: &LayerStack) {
        let tensors = stack.layers.iter().map(|t| t.data()).chain(stack.emission.iter().map(|t| t.data()));
        let clamped = |v: f32, [low, high]: [f64; 2]| f64::from(v).clamp(low, high);
        let tensors = tensors.zip(&self.ranges);
        self.factors = tensors.map(|(data, range)| data.iter().map(|&v| clamped(v, *range)).collect()).collect();
        for (factor, _) in self.factors.iter_mut().zip(&self.tied).filter(|(_, tied)| **tied) {
            for pixel in factor.chunks_exact_mut(3) {
                let mean = pixel.iter().sum::<f64>() / 3.0;
                pixel.fill(mean);
            }
        }
    }

    /// Returns the value of factor k in frame m along a ray.
    fn value(&self, ray: &Ray, k: usize, m: usize, channel: usize) -> f64 {
        let factor = &self.factors[k];
        let frame = factor.len() / self.frames * m;
        match &ray.reads[k] {
            Read::Constant(value) => *value,
            Read::Entries(entries) => entries[channel].iter().map(|e| e.share * factor[frame + e.at]).sum(),
        }
    }

    /// Returns the emission of frame m along a ray. If `replaced` is (n, value), factor n has this
    /// value instead of its own value.
    fn frame(&self, ray: &Ray, m: usize, channel: usize, replaced: Option<(usize, f64)>) -> f64 {
        let value = |k: usize| match replaced {
            Some((n, value)) if n == k => value,
            _ => self.value(ray, k, m, channel),
        };
        let all = 0..self.factors.len();
        match self.formation {
            Formation::Attenuating => all.map(value).product(),
            Formation::Additive => all.map(value).sum(),
            Formation::Polarization => {
                let light = (self.layers..self.factors.len()).map(value).product::<f64>();
                light * ((0..self.layers).map(value).sum::<f64>() * std::f64::consts::FRAC_PI_2).sin().powi(2)
            }
        }
    }

    fn emitted(&self, ray: &Ray, channel: usize) -> f64 {
        (0..self.frames).map(|m| self.frame(ray, m, channel, None)).sum::<f64>() / self.frames as f64
    }

    /// Returns the derivative of frame m's emission by the value of factor n. It is exact if the
    /// emission is linear in this value, otherwise computed by central differences.
    fn slope(&self, ray: &Ray, n: usize, m: usize, channel: usize) -> f64 {
        let f = self.value(ray, n, m, channel);
        let [low, high] = if self.is_linear(n) { [0.0, 1.0] } else { [f - 1e-5, f + 1e-5] };
        let [below, above] = [low, high].map(|f| self.frame(ray, m, channel, Some((n, f))));
        (above - below) / (high - low)
    }

    fn is_linear(&self, n: usize) -> bool {
        self.formation != Formation::Polarization || n >= self.layers
    }

    /// Updates factor n. Without `sweeps` it applies the paper's rule; otherwise it makes sweeps of
    /// coordinate steps on the bounding quadratic.
    ///
    /// Returns the influence of every value f on the emission. It is an upper bound of
    /// √Σ w (∂L̃/∂f)², summed over the rays that read f.
    pub(crate) fn update(&mut self, n: usize, sweeps: Option<u32>) -> Vec<f64> {
        let frames = self.frames;
        let size = self.factors[n].len() / frames;
        let (mut residual, mut wanted) = (vec![vec![0.0; frames]; size], vec![vec![0.0; frames]; size]);
        let (mut emitted_sum, mut gram) = (vec![vec![0.0; frames]; size], vec![vec![vec![0.0; frames]; frames]; size]);
        // compute the sums of every pixel over all its rays
        for ray in &self.rays {
            let Read::Entries(entries) = &ray.reads[n] else { continue };
            for channel in 0..3 {
                let (emitted, beta_l) = (self.emitted(ray, channel), ray.wanted[channel]);
                // derivatives of the emission L̃ by each frame's value, times the number of frames
                let a: Vec<f64> = (0..frames).map(|m| self.slope(ray, n, m, channel)).collect();
                let quarter = std::f64::consts::FRAC_PI_2.powi(2);
                let most = quarter * frames as f64 * (1.0 + 2.0 * beta_l.abs().max((1.0 - beta_l).abs()));
                for entry in &entries[channel] {
                    for m in 0..frames {
                        residual[entry.at][m] += entry.share * ray.weight * (beta_l - emitted) * a[m];
                        wanted[entry.at][m] += entry.share * ray.weight * beta_l * a[m];
                        emitted_sum[entry.at][m] += entry.share * ray.weight * emitted * a[m];
                        for k in 0..frames {
                            let linear = if self.is_linear(n) {
                                a[m] * a[k]
                            } else if m == k {
                                most
                            } else {
                                0.0
                            };
                            gram[entry.at][m][k] += entry.bound * ray.weight * linear;
                        }
                    }
                }
            }
        }
        // step each pixel by its sums
        let [low, high] = self.ranges[n];
        for at in 0..size {
            let f = |m: usize| m * size + at;
            let Some(sweeps) = sweeps else {
                for m in (0..frames).filter(|&m| emitted_sum[at][m] > 0.0) {
                    let value = self.factors[n][f(m)] * wanted[at][m] / emitted_sum[at][m];
                    self.factors[n][f(m)] = value.clamp(low, high);
                }
                continue;
            };
            for _ in 0..sweeps {
                for m in (0..frames).filter(|&m| gram[at][m][m] > 0.0) {
                    let before = self.factors[n][f(m)];
                    let best = before + frames as f64 * residual[at][m] / gram[at][m][m];
                    let after = best.clamp(low, high);
                    self.factors[n][f(m)] = after;
                    for k in 0..frames {
                        residual[at][k] -= gram[at][m][k] * (after - before) / frames as f64;
                    }
                }
            }
        }
        let influence = |m: usize, at: usize| gram[at][m][m].sqrt() / frames as f64;
        let mut influences: Vec<f64> = (0..frames * size).map(|i| influence(i / size, i % size)).collect();
        if self.tied[n] {
            // In tied channels, the steps changed only the red value. Copy it to green and blue.
            for values in [&mut self.factors[n], &mut influences] {
                values.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&[pixel[0]; 3]));
            }
        }
        influences
    }

    /// Returns Σ w (βL − L̃)².
    pub(crate) fn objective(&self) -> f64 {
        let error = |ray: &Ray, channel| ray.weight * (ray.wanted[channel] - self.emitted(ray, channel)).powi(2);
        self.rays.iter().map(|ray| (0..3).map(|channel| error(ray, channel)).sum::<f64>()).sum()
    }

    pub(crate) fn ray_count(&self) -> usize {
        self.rays.len()
    }

    /// Compares factor n of this oracle with factor n of a stack. Returns the largest absolute
    /// difference of two values, where difference i is first multiplied by `counts(i)`.
    pub(crate) fn distance(&self, n: usize, stack: &LayerStack, counts: impl Fn(usize) -> f64) -> f64 {
        let mut tensors = stack.layers.iter().map(|t| t.data()).chain(stack.emission.iter().map(|t| t.data()));
        let found = tensors.nth(n).unwrap_or(&[]);
        let differences = self.factors[n].iter().zip(found).map(|(a, &b)| (a - f64::from(b)).abs());
        differences.enumerate().map(|(i, difference)| difference * counts(i)).fold(0.0, f64::max)
    }
}

/// Returns, for each channel, the stored values of a layer that a ray through these pixels reads.
fn entries(layer: &Layer, pixels: &[(usize, f64)]) -> [Vec<Entry>; 3] {
    let [cols, rows] = layer.resolution;
    let tied = layer.colour == LayerColour::Mono;
    let taps: Vec<f64> =
        layer.response().map_or(vec![1.0], |response| response.taps().iter().map(|&t| f64::from(t)).collect());
    let radius = (taps.len() / 2) as isize;
    // Spread a pixel along one axis by the blur. The shares of pixels outside the border are
    // divided among the pixels inside.
    let spread = |i: usize, count: usize| -> Vec<(usize, f64)> {
        let all = (-radius..=radius).map(|k| (i as isize + k, taps[(k + radius) as usize]));
        let within: Vec<_> = all.filter(|(i, _)| (0..count as isize).contains(i)).collect();
        let total: f64 = within.iter().map(|(_, tap)| tap).sum();
        within.into_iter().map(|(i, tap)| (i as usize, tap / total)).collect()
    };
    let crosstalk = layer.crosstalk.unwrap_or([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let filter =
        |col: usize| if layer.filters.is_empty() { [1.0; 3] } else { layer.filters[col % layer.filters.len()] };
    [0, 1, 2].map(|channel: usize| {
        let mut list: Vec<Entry> = Vec::new();
        // each pixel is a mixture of the stored values of its neighbours and channels
        for &(pixel, t) in pixels {
            let mut shares = Vec::new();
            for (row, y) in spread(pixel / cols, rows) {
                for (col, x) in spread(pixel % cols, cols) {
                    for from in 0..3 {
                        let at = (row * cols + col) * 3 + if tied { 0 } else { from };
                        shares.push((at, crosstalk[channel][from] * y * x * filter(col)[from]));
                    }
                }
            }
            let total: f64 = shares.iter().map(|(_, share)| share).sum();
            list.extend(shares.iter().filter(|(_, s)| *s > 0.0).map(|&(at, s)| Entry {
                at,
                share: t * s,
                bound: t * s * total,
            }));
        }
        list
    })
}

/// Returns all valid rays with a weight above 0.
fn rays(problem: &Problem) -> Vec<Ray> {
    let (display, field) = (problem.display, problem.target.geometry());
    let mut rays = Vec::new();
    for [view_y, view_x] in field.grid.iter() {
        for (row, col) in (0..field.rows).flat_map(|row| (0..field.cols).map(move |col| (row, col))) {
            // compute the ray's position and slope at z = 0
            let x = (col as f64 - (field.cols as f64 - 1.0) / 2.0) * field.pitch_mm;
            let y = ((field.rows as f64 - 1.0) / 2.0 - row as f64) * field.pitch_mm;
            let (mut sx, mut sy) = (field.grid.slope_x[view_x], field.grid.slope_y[view_y]);
            if let Projection::Perspective { distance_mm } = field.grid.projection {
                (sx, sy) = ((sx * distance_mm - x) / distance_mm, (sy * distance_mm - y) / distance_mm);
            }
            // find the pixels of each layer that the ray reads
            let mut reads = Vec::new();
            let mut counts = true;
            for layer in &display.layers {
                let [cols, rows] = layer.resolution;
                let u = (x + layer.d_mm * sx - layer.offset_mm[0]) / layer.pitch_mm + (cols as f64 - 1.0) / 2.0;
                let v = (rows as f64 - 1.0) / 2.0 - (y + layer.d_mm * sy - layer.offset_mm[1]) / layer.pitch_mm;
                let (i, j) = ((u + 0.5).floor(), (v + 0.5).floor());
                if i < 0.0 || j < 0.0 || i >= cols as f64 || j >= rows as f64 {
                    counts &= display.missing == Missing::Clear;
                    reads.push(Read::Constant(if display.formation == Formation::Attenuating { 1.0 } else { 0.0 }));
                } else if display.sampling == Sampling::Nearest {
                    reads.push(Read::Entries(entries(layer, &[(j as usize * cols + i as usize, 1.0)])));
                } else {
                    let mut pixels = Vec::new();
                    for (j, tv) in neighbours(v, rows) {
                        pixels.extend(neighbours(u, cols).map(|(i, tu)| (j * cols + i, tu * tv)));
                    }
                    reads.push(Read::Entries(entries(layer, &pixels)));
                }
            }
            // find the lenslet and angular bin that the ray hits
            if let Backlight::Lenslets(b) = &display.backlight {
                let ([cols, rows], [bins_x, bins_y]) = (b.lenslets.map(|n| n as f64), b.views.map(|n| n as f64));
                let i = ((x + b.d_mm * sx - b.offset_mm[0]) / b.pitch_mm + (cols - 1.0) / 2.0 + 0.5).floor();
                let j = ((rows - 1.0) / 2.0 - (y + b.d_mm * sy - b.offset_mm[1]) / b.pitch_mm + 0.5).floor();
                counts &= i >= 0.0 && j >= 0.0 && i < cols && j < rows;
                let tan = b.fov_deg.map(|fov| (fov / 2.0).to_radians().tan());
                let bin_x = (bins_x / 2.0 * (1.0 + sx / tan[0])).floor();
                let bin_y = (bins_y / 2.0 * (1.0 - sy / tan[1])).floor();
                // Outside its bins, a lenslet is dark, or it repeats the picture of the pixels
                // behind a neighbouring lenslet.
                let (zone_x, zone_y) = ((bin_x / bins_x).floor(), (bin_y / bins_y).floor());
                let (i, j) = (i - zone_x, j - zone_y);
                let (bin_x, bin_y) = (bin_x - zone_x * bins_x, bin_y - zone_y * bins_y);
                let lit = (zone_x == 0.0 && zone_y == 0.0)
                    || (b.outside_bins == OutsideBins::Repeat && i >= 0.0 && j >= 0.0 && i < cols && j < rows);
                let pixel = (((bin_y * bins_x) + bin_x) * rows + j) * cols + i;
                let entry = |channel: usize| vec![Entry { at: pixel as usize * 3 + channel, share: 1.0, bound: 1.0 }];
                reads.push(if lit { Read::Entries([0, 1, 2].map(entry)) } else { Read::Constant(0.0) });
            }
            // keep the valid rays with a weight above 0
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

/// Returns the two pixels around a position, with their weights. At the border a position may have
/// one pixel only.
fn neighbours(u: f64, count: usize) -> impl Iterator<Item = (usize, f64)> {
    let u = u.clamp(0.0, count as f64 - 1.0);
    let first = u.floor();
    let pair = [(first as usize, 1.0 - (u - first)), (first as usize + 1, u - first)];
    pair.into_iter().filter(|(_, t)| *t > 0.0)
}
