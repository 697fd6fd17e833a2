//! Finds dark crosses on a bright ground.
//!
//! What is darker than its surroundings falls into connected pieces; long thin ones are crosses, and one round one is the mark of the middle cross. From there
//! neighbours are found where a step of the array leads. The centre of a cross is where its two arms' lines meet, each fitted to the arm's own pixels.

use std::collections::{BTreeMap, VecDeque};

use image::GrayImage;

/// One cross.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cross {
    /// How many to the right and up from the middle one.
    pub index: [i32; 2],
    /// [column, row] of its centre in the photograph.
    pub at_px: [f64; 2],
}

/// Darkness relative to the darkest from which on a pixel belongs to a cross.
const DARK: f32 = 0.4;
/// Smallest pieces, pixels.
const FEW: usize = 12;
/// Share of its frame that a cross, and a disc, fills.
const CROSS_FILLS: f64 = 0.5;
const DISC_FILLS: f64 = 0.62;
/// How far from where it is expected a neighbour may be, in steps.
const REACH: f64 = 0.35;
/// Arm of a cross in steps of the array, as it is drawn.
const ARM_OF_STEP: f64 = 0.3;

/// How much darker than its surroundings every pixel is.
struct Darkness {
    cols: usize,
    rows: usize,
    value: Vec<f32>,
}

struct Piece {
    low: [usize; 2],
    high: [usize; 2],
    count: usize,
}

impl Piece {
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

/// All crosses of an array that reaches `counts` crosses to the right, left, up and down of its middle one.
///
/// # Errors
/// What was found where it is no array.
pub fn find_crosses(photograph: &GrayImage, counts: [usize; 2]) -> Result<Vec<Cross>, String> {
    let dark = Darkness::new(photograph);
    let pieces = dark.pieces();
    let mut sizes: Vec<f64> =
        pieces.iter().filter(|p| p.fills() < CROSS_FILLS).map(|p| p.size()[0].max(p.size()[1])).collect();
    if sizes.is_empty() {
        return Err(format!("{} dark pieces, none of them a cross", pieces.len()));
    }
    sizes.sort_by(f64::total_cmp);
    let usual = sizes[sizes.len() / 2];
    let is_cross = |piece: &&Piece| {
        let [width, height] = piece.size();
        let near = |length: f64| (0.6..1.6).contains(&(length / usual));
        piece.fills() < CROSS_FILLS && near(width) && near(height)
    };
    let crosses: Vec<[f64; 2]> = pieces.iter().filter(is_cross).map(|piece| piece.centre()).collect();
    let is_disc = |piece: &&Piece| {
        let [width, height] = piece.size();
        piece.fills() > DISC_FILLS && (0.6..1.7).contains(&(width / height)) && (0.08..0.5).contains(&(width / usual))
    };
    let disc = pieces.iter().filter(is_disc).max_by_key(|piece| piece.count).map(Piece::centre);
    let disc = disc.ok_or_else(|| format!("{} crosses and no mark", crosses.len()))?;
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    // the mark is up and right of its cross
    let middle = crosses
        .iter()
        .filter(|at| at[0] < disc[0] && at[1] > disc[1])
        .min_by(|a, b| apart(**a, disc).total_cmp(&apart(**b, disc)))
        .ok_or_else(|| format!("{} crosses, none below and left of the mark", crosses.len()))?;
    let step = usual / (2.0 * ARM_OF_STEP);
    let mut found: BTreeMap<[i32; 2], [f64; 2]> = BTreeMap::from([([0, 0], *middle)]);
    let mut open = VecDeque::from([[0, 0]]);
    while let Some(index) = open.pop_front() {
        let here = found[&index];
        for way in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
            let next = [index[0] + way[0], index[1] + way[1]];
            let outside = (0..2).any(|axis| next[axis].unsigned_abs() as usize > counts[axis]);
            if outside || found.contains_key(&next) {
                continue;
            }
            // the same step as the last one this way, where there is one
            let back = found.get(&[index[0] - way[0], index[1] - way[1]]);
            let expected = back
                .map_or([here[0] + step * f64::from(way[0]), here[1] - step * f64::from(way[1])], |back| {
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
        // sums over everything above and left
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

    /// Dark pieces, by flooding.
    fn pieces(&self) -> Vec<Piece> {
        let mut smooth = self.value.clone();
        for row in 1..self.rows.saturating_sub(1) {
            for col in 1..self.cols.saturating_sub(1) {
                let around = (0..9).map(|k| self.value[(row + k / 3 - 1) * self.cols + col + k % 3 - 1]);
                smooth[row * self.cols + col] = around.sum::<f32>() / 9.0;
            }
        }
        // the darkest of a thousand pixels stands for all: single ones may be anything
        let mut sorted = smooth.clone();
        let rank = (sorted.len() - 1) - sorted.len() / 1000;
        let (_, darkest, _) = sorted.select_nth_unstable_by(rank, f32::total_cmp);
        let limit = DARK * *darkest;
        let mut open: Vec<bool> = smooth.iter().map(|value| *value > limit && limit > 0.0).collect();
        let mut pieces = Vec::new();
        for start in 0..open.len() {
            if !open[start] {
                continue;
            }
            open[start] = false;
            let mut piece = Piece { low: [usize::MAX; 2], high: [0; 2], count: 0 };
            let mut front = vec![start];
            while let Some(i) = front.pop() {
                let at = [i % self.cols, i / self.cols];
                piece.count += 1;
                for axis in 0..2 {
                    piece.low[axis] = piece.low[axis].min(at[axis]);
                    piece.high[axis] = piece.high[axis].max(at[axis]);
                }
                for row in at[1].saturating_sub(1)..=(at[1] + 1).min(self.rows - 1) {
                    for col in at[0].saturating_sub(1)..=(at[0] + 1).min(self.cols - 1) {
                        if std::mem::take(&mut open[row * self.cols + col]) {
                            front.push(row * self.cols + col);
                        }
                    }
                }
            }
            if piece.count >= FEW {
                pieces.push(piece);
            }
        }
        pieces
    }

    /// Where the lines of a cross' arms meet, near a place; arms of this length.
    fn centre(&self, mut at: [f64; 2], arm: f64) -> Option<[f64; 2]> {
        // the lines' slopes against the photograph's rows and columns
        let mut slope = [0.0f64; 2];
        for _ in 0..6 {
            let mut line = [[0.0f64; 2]; 2];
            for axis in 0..2 {
                line[axis] = self.arm(at, arm, axis, slope[axis])?;
                slope[axis] = line[axis][1];
            }
            // y = a + b (x − x₀) of the one, x = c + d (y − y₀) of the other, relative to the place
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

    /// [offset, slope] of the arm along an axis (0: columns) relative to a place: a line through the centres of darkness across it.
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
                // pixels at the ends of the window count by the share that lies in it
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
