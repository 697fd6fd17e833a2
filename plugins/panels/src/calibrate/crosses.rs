//! Detects dark crosses on a bright ground.
//!
//! Pixels that are darker than their surroundings form connected components. Crosses are the
//! components that fill little of their bounding box and have about the median size of such
//! components. A disc marks the central cross. From the central cross a search proceeds from
//! neighbour to neighbour. The centre of a cross is the intersection of two lines, each of which is
//! fitted to two opposite arms.

use std::collections::{BTreeMap, VecDeque};

use image::GrayImage;

/// A cross that was detected in the photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cross {
    /// [steps to the right, steps upwards] from the central cross to this cross.
    pub index: [i32; 2],
    /// [column, row] of the cross's centre in the photograph.
    pub at_px: [f64; 2],
}

/// Smallest darkness of a component's pixels, as a fraction of the 99.9 % quantile of the
/// photograph's darkness.
const DARK: f32 = 0.4;
/// Smallest number of pixels of a component.
const MIN_PIXELS: usize = 12;
/// A component that fills less than this fraction of its bounding box may be a cross.
const CROSS_FILLS: f64 = 0.5;
/// A component that fills more than this fraction of its bounding box may be a disc.
const DISC_FILLS: f64 = 0.62;
/// Largest distance of a cross from its expected position, as a fraction of the distance between
/// neighbouring crosses.
const REACH: f64 = 0.35;
/// Length of an arm as [`crate::Pattern`] draws it, as a fraction of the distance between
/// neighbouring crosses.
const ARM_OF_STEP: f64 = 0.3;

/// Darkness of every pixel, relative to the mean of its surroundings.
struct Darkness {
    cols: usize,
    rows: usize,
    value: Vec<f32>,
}

struct Component {
    low: [usize; 2],
    high: [usize; 2],
    count: usize,
}

impl Component {
    fn size(&self) -> [f64; 2] {
        [0, 1].map(|axis| (self.high[axis] - self.low[axis] + 1) as f64)
    }

    fn centre(&self) -> [f64; 2] {
        [0, 1].map(|axis| 0.5 * (self.high[axis] + self.low[axis]) as f64)
    }

    fn fills(&self) -> f64 {
        self.count as f64 / (self.size()[0] * self.size()[1])
    }
}

/// Returns the crosses of an array that has `counts` = [columns, rows] of crosses on each side of
/// the central cross.
///
/// # Errors
/// If the photograph shows no such array: a description of the dark components that were found.
pub fn find_crosses(photograph: &GrayImage, counts: [usize; 2]) -> Result<Vec<Cross>, String> {
    let dark = Darkness::new(photograph);
    let components = dark.components();
    // Find the crosses: components that fill little of their bounding box, and have about the
    // median size of such components.
    let mut sizes: Vec<f64> =
        components.iter().filter(|p| p.fills() < CROSS_FILLS).map(|p| p.size()[0].max(p.size()[1])).collect();
    if sizes.is_empty() {
        return Err(format!("no cross (dark components: {})", components.len()));
    }
    sizes.sort_by(f64::total_cmp);
    let usual = sizes[sizes.len() / 2];
    let is_cross = |component: &&Component| {
        let [width, height] = component.size();
        let near = |length: f64| (0.6..1.6).contains(&(length / usual));
        component.fills() < CROSS_FILLS && near(width) && near(height)
    };
    let crosses: Vec<[f64; 2]> = components.iter().filter(is_cross).map(|component| component.centre()).collect();
    // The largest disc is the mark of the central cross.
    let is_disc = |component: &&Component| {
        let [width, height] = component.size();
        component.fills() > DISC_FILLS
            && (0.6..1.7).contains(&(width / height))
            && (0.08..0.5).contains(&(width / usual))
    };
    let disc = components.iter().filter(is_disc).max_by_key(|component| component.count).map(Component::centre);
    let disc = disc.ok_or_else(|| format!("no mark (crosses: {})", crosses.len()))?;
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    // The central cross is the nearest cross that is below the mark and left of it.
    let middle = crosses
        .iter()
        .filter(|at| at[0] < disc[0] && at[1] > disc[1])
        .min_by(|a, b| apart(**a, disc).total_cmp(&apart(**b, disc)))
        .ok_or_else(|| format!("a mark without a cross below and left of the mark (crosses: {})", crosses.len()))?;
    // Search breadth first: from the central cross to its four neighbours, from each of these to
    // its neighbours, and so on.
    let step = usual / (2.0 * ARM_OF_STEP);
    let mut found: BTreeMap<[i32; 2], [f64; 2]> = BTreeMap::from([([0, 0], *middle)]);
    let mut open = VecDeque::from([[0, 0]]);
    while let Some(index) = open.pop_front() {
        let here = found[&index];
        for direction in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
            let next = [index[0] + direction[0], index[1] + direction[1]];
            let outside = (0..2).any(|axis| next[axis].unsigned_abs() as usize > counts[axis]);
            if outside || found.contains_key(&next) {
                continue;
            }
            // Extrapolate from the neighbour on the opposite side, if it is known. Otherwise use
            // the step computed from the usual size of a cross.
            let back = found.get(&[index[0] - direction[0], index[1] - direction[1]]);
            let expected = back
                .map_or([here[0] + step * f64::from(direction[0]), here[1] - step * f64::from(direction[1])], |back| {
                    [2.0 * here[0] - back[0], 2.0 * here[1] - back[1]]
                });
            let nearest = crosses.iter().min_by(|a, b| apart(**a, expected).total_cmp(&apart(**b, expected)));
            if let Some(at) = nearest.filter(|at| apart(**at, expected) < REACH * step)
                && !found.values().any(|other| other == at)
            {
                found.insert(next, *at);
                open.push_back(next);
            }
        }
    }
    let arm = 0.5 * usual;
    Ok(found.into_iter().filter_map(|(index, at)| Some(Cross { index, at_px: dark.centre(at, arm)? })).collect())
}

impl Darkness {
    fn new(photograph: &GrayImage) -> Self {
        let (cols, rows) = (photograph.width() as usize, photograph.height() as usize);
        // Compute a summed-area table, for the mean around every pixel.
        let mut sums = vec![0.0f64; (cols + 1) * (rows + 1)];
        for row in 0..rows {
            let mut line = 0.0;
            for col in 0..cols {
                line += f64::from(photograph.as_raw()[row * cols + col]);
                sums[(row + 1) * (cols + 1) + col + 1] = sums[row * (cols + 1) + col + 1] + line;
            }
        }
        let mean = |row: usize, col: usize, radius: usize| {
            let (top, bottom) = (row.saturating_sub(radius), (row + radius + 1).min(rows));
            let (left, right) = (col.saturating_sub(radius), (col + radius + 1).min(cols));
            let at = |row: usize, col: usize| sums[row * (cols + 1) + col];
            let sum = at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left);
            sum / ((bottom - top) * (right - left)) as f64
        };
        let radius = (cols / 24).max(4);
        let value = (0..rows * cols).map(|i| {
            let (row, col) = (i / cols, i % cols);
            (mean(row, col, radius) - f64::from(photograph.as_raw()[i])).max(0.0) as f32
        });
        Self { cols, rows, value: value.collect() }
    }

    /// Returns the connected components of dark pixels.
    fn components(&self) -> Vec<Component> {
        // Smooth by a 3 × 3 box filter, which removes noise.
        let mut smooth = self.value.clone();
        for row in 1..self.rows.saturating_sub(1) {
            for col in 1..self.cols.saturating_sub(1) {
                let around = (0..9).map(|k| self.value[(row + k / 3 - 1) * self.cols + col + k % 3 - 1]);
                smooth[row * self.cols + col] = around.sum::<f32>() / 9.0;
            }
        }
        // The threshold refers to the 99.9 % quantile of the darkness, since single pixels may be
        // outliers.
        let mut sorted = smooth.clone();
        let rank = (sorted.len() - 1) - sorted.len() / 1000;
        let (_, darkest, _) = sorted.select_nth_unstable_by(rank, f32::total_cmp);
        let limit = DARK * *darkest;
        // Collect every component of pixels above the threshold by flood fill. Diagonal neighbours
        // are connected, too.
        let mut open: Vec<bool> = smooth.iter().map(|value| *value > limit && limit > 0.0).collect();
        let mut components = Vec::new();
        for start in 0..open.len() {
            if !open[start] {
                continue;
            }
            open[start] = false;
            let mut component = Component { low: [usize::MAX; 2], high: [0; 2], count: 0 };
            let mut front = vec![start];
            while let Some(i) = front.pop() {
                let at = [i % self.cols, i / self.cols];
                component.count += 1;
                for axis in 0..2 {
                    component.low[axis] = component.low[axis].min(at[axis]);
                    component.high[axis] = component.high[axis].max(at[axis]);
                }
                for row in at[1].saturating_sub(1)..=(at[1] + 1).min(self.rows - 1) {
                    for col in at[0].saturating_sub(1)..=(at[0] + 1).min(self.cols - 1) {
                        if std::mem::take(&mut open[row * self.cols + col]) {
                            front.push(row * self.cols + col);
                        }
                    }
                }
            }
            if component.count >= MIN_PIXELS {
                components.push(component);
            }
        }
        components
    }

    /// Returns the centre of a cross near `at`, in pixels: the intersection of the lines through
    /// its arms, which are `arm` pixels long. Iterates until the centre moves by less than 1e-4
    /// pixels, at most six times.
    fn centre(&self, mut at: [f64; 2], arm: f64) -> Option<[f64; 2]> {
        // `slope` holds the slopes of the two lines against the photograph's rows and columns.
        let mut slope = [0.0f64; 2];
        for _ in 0..6 {
            let mut line = [[0.0f64; 2]; 2];
            for axis in 0..2 {
                line[axis] = self.arm(at, arm, axis, slope[axis])?;
                slope[axis] = line[axis][1];
            }
            // Lines relative to `at`: y = a + b x and x = c + d y.
            let ([a, b], [c, d]) = (line[0], line[1]);
            let x = (c + d * a) / (1.0 - b * d);
            let y = a + b * x;
            at = [at[0] + x, at[1] + y];
            if x.hypot(y) < 1e-4 {
                break;
            }
        }
        at.iter().all(|value| value.is_finite()).then_some(at)
    }

    /// Returns [offset, slope] of the line through the two arms along `axis` (0: x, 1: y), relative
    /// to `at`. At every position along the arms, the centre of darkness across the arms is
    /// computed. The line is fitted to these centres, weighted by their darkness.
    fn arm(&self, at: [f64; 2], arm: f64, axis: usize, slope: f64) -> Option<[f64; 2]> {
        let across = 0.3 * arm;
        let (near, far) = (0.3 * arm, 0.85 * arm);
        let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let first = (at[axis] - far).ceil() as i64;
        for along in first..=(at[axis] + far).floor() as i64 {
            let x = along as f64 - at[axis];
            if x.abs() < near {
                continue;
            }
            let middle = at[1 - axis] + slope * x;
            let (mut weight, mut moment) = (0.0f64, 0.0f64);
            for place in (middle - across).round() as i64..=(middle + across).round() as i64 {
                let (col, row) = if axis == 0 { (along, place) } else { (place, along) };
                if col < 0 || row < 0 || col >= self.cols as i64 || row >= self.rows as i64 {
                    return None;
                }
                let value = f64::from(self.value[row as usize * self.cols + col as usize]);
                // weight pixels at the ends of the window by the fraction inside of the window
                let share = (across + 0.5 - (place as f64 - middle).abs()).clamp(0.0, 1.0);
                weight += share * value;
                moment += share * value * (place as f64 - at[1 - axis]);
            }
            if weight > 0.0 {
                let y = moment / weight;
                (n, sx, sy, sxx, sxy) =
                    (n + weight, sx + weight * x, sy + weight * y, sxx + weight * x * x, sxy + weight * x * y);
            }
        }
        let spread = n * sxx - sx * sx;
        if n <= 0.0 || spread <= 0.0 {
            return None;
        }
        let b = (n * sxy - sx * sy) / spread;
        Some([(sy - b * sx) / n, b])
    }
}
