//! A blue-noise threshold map, by void-and-cluster (Ulichney, "The void-and-cluster method for
//! dither array generation", 1993).
//!
//! Dots at pixels of a torus are ranked one by one. The energy of a position is the sum of
//! exp(−r²/2σ²) over all dots at distances r, with σ = 1.5 pixels. The tightest cluster is the dot
//! whose position has the highest energy. Among the positions without a dot, the largest void is
//! the one with the lowest energy.
//!
//! 1. Some random dots are placed. Then the tightest cluster is moved to the largest void,
//!    repeatedly, until the move returns the dot to its old position.
//! 2. The dots of step 1 get the low ranks, from the highest down: the tightest cluster gets the
//!    next lower rank and is removed, repeatedly.
//! 3. All other positions get the high ranks, from the lowest up. Starting from the dots of step 1,
//!    the largest void gets the next higher rank and a dot, repeatedly.

use std::sync::OnceLock;

use lumistack_core::seed::{Stream, derive};

/// Rows and columns of the map.
pub const BLUE_NOISE_SIDE: usize = 64;

const COUNT: usize = BLUE_NOISE_SIDE * BLUE_NOISE_SIDE;
/// Number of dots in the initial pattern.
const FIRST: usize = COUNT / 10;
const SIGMA: f64 = 1.5;

/// Returns the thresholds (rank + ½) / 4096 of a 64 × 64 map that tiles without a seam, row by row.
/// Every rank occurs once. The map is computed at the first call.
pub fn blue_noise() -> &'static [f32] {
    static MAP: OnceLock<Vec<f32>> = OnceLock::new();
    MAP.get_or_init(|| ranks().into_iter().map(|rank| (rank as f32 + 0.5) / COUNT as f32).collect())
}

fn ranks() -> Vec<usize> {
    // Begin with random dots.
    let mut pattern = Pattern::new();
    let mut random = Stream::new(derive(0x626c_7565, &[]));
    while pattern.dots < FIRST {
        let place = (random.next_u64() % COUNT as u64) as usize;
        if !pattern.has[place] {
            pattern.toggle(place);
        }
    }
    // Move the tightest cluster to the largest void, until the moved dot returns to its old
    // position.
    loop {
        let cluster = pattern.tightest_cluster();
        pattern.toggle(cluster);
        let void = pattern.largest_void();
        pattern.toggle(void);
        if void == cluster {
            break;
        }
    }
    // The dots of the initial pattern get the low ranks, in reverse order of their removal. All
    // other positions get the next ranks, in the order in which they get dots.
    let mut ranks = vec![0; COUNT];
    let mut thinned = pattern.clone();
    for rank in (0..FIRST).rev() {
        let cluster = thinned.tightest_cluster();
        thinned.toggle(cluster);
        ranks[cluster] = rank;
    }
    for rank in FIRST..COUNT {
        let void = pattern.largest_void();
        pattern.toggle(void);
        ranks[void] = rank;
    }
    ranks
}

#[derive(Clone)]
struct Pattern {
    has: Vec<bool>,
    /// The energy of every position, row by row.
    tightness: Vec<f64>,
    /// The energy that a dot at (0, 0) adds at every position, row by row.
    dot: Vec<f64>,
    dots: usize,
}

impl Pattern {
    fn new() -> Self {
        let distance = |i: usize| i.min(BLUE_NOISE_SIDE - i) as f64;
        let dot = (0..COUNT).map(|i| {
            let (y, x) = (distance(i / BLUE_NOISE_SIDE), distance(i % BLUE_NOISE_SIDE));
            (-(x * x + y * y) / (2.0 * SIGMA * SIGMA)).exp()
        });
        Self { has: vec![false; COUNT], tightness: vec![0.0; COUNT], dot: dot.collect(), dots: 0 }
    }

    fn toggle(&mut self, place: usize) {
        let (row, col) = (place / BLUE_NOISE_SIDE, place % BLUE_NOISE_SIDE);
        let sign = if self.has[place] { -1.0 } else { 1.0 };
        for y in 0..BLUE_NOISE_SIDE {
            let from = (y + BLUE_NOISE_SIDE - row) % BLUE_NOISE_SIDE * BLUE_NOISE_SIDE;
            for x in 0..BLUE_NOISE_SIDE {
                let dot = self.dot[from + (x + BLUE_NOISE_SIDE - col) % BLUE_NOISE_SIDE];
                self.tightness[y * BLUE_NOISE_SIDE + x] += sign * dot;
            }
        }
        self.has[place] = !self.has[place];
        self.dots = if self.has[place] { self.dots + 1 } else { self.dots - 1 };
    }

    fn tightest_cluster(&self) -> usize {
        let dots = (0..COUNT).filter(|&place| self.has[place]);
        dots.max_by(|&a, &b| self.tightness[a].total_cmp(&self.tightness[b])).expect("there is a dot")
    }

    fn largest_void(&self) -> usize {
        let places = (0..COUNT).filter(|&place| !self.has[place]);
        places.min_by(|&a, &b| self.tightness[a].total_cmp(&self.tightness[b])).expect("there is a void")
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// Returns the mean power of a pattern in bands of spatial frequency. Entry i belongs to the
    /// band around (i + 1)/64 cycles per pixel. The mean of the pattern is in no band.
    fn radial_power(values: &[f64]) -> Vec<f64> {
        let side = BLUE_NOISE_SIDE;
        let turn = |k: usize, x: usize| -TAU * ((k * x) % side) as f64 / side as f64;
        let mut rows = vec![[0.0; 2]; COUNT];
        for (y, k) in (0..side).flat_map(|y| (0..side).map(move |k| (y, k))) {
            for x in 0..side {
                let (sin, cos) = turn(k, x).sin_cos();
                rows[y * side + k][0] += values[y * side + x] * cos;
                rows[y * side + k][1] += values[y * side + x] * sin;
            }
        }
        let (mut sums, mut counts) = (vec![0.0; side / 2], vec![0.0; side / 2]);
        for (l, k) in (0..side).flat_map(|l| (0..side).map(move |k| (l, k))) {
            let (mut re, mut im) = (0.0, 0.0);
            for y in 0..side {
                let (sin, cos) = turn(l, y).sin_cos();
                let [a, b] = rows[y * side + k];
                re += a * cos - b * sin;
                im += a * sin + b * cos;
            }
            let radius = (l.min(side - l) as f64).hypot(k.min(side - k) as f64).round() as usize;
            if radius > 0 && radius < side / 2 {
                sums[radius] += re * re + im * im;
                counts[radius] += 1.0;
            }
        }
        sums.iter().zip(&counts).skip(1).map(|(sum, count)| sum / count).collect()
    }

    fn low_over_mean(power: &[f64]) -> f64 {
        let mean = |range: &[f64]| range.iter().sum::<f64>() / range.len() as f64;
        mean(&power[..6]) / mean(power)
    }

    #[test]
    fn every_threshold_comes_once() {
        let mut sorted = blue_noise().to_vec();
        sorted.sort_by(f32::total_cmp);
        assert!(sorted.iter().enumerate().all(|(i, &value)| value == (i as f32 + 0.5) / COUNT as f32));
    }

    #[test]
    fn low_frequencies_are_missing_and_no_direction_stands_out() {
        let power = radial_power(&blue_noise().iter().map(|&value| f64::from(value) - 0.5).collect::<Vec<_>>());
        let blue = low_over_mean(&power);
        let mut random = Stream::new(7);
        let white =
            low_over_mean(&radial_power(&(0..COUNT).map(|_| f64::from(random.next_f32()) - 0.5).collect::<Vec<_>>()));
        println!("power below 0.1 cycles per pixel over the mean: {blue:.4}, white noise {white:.2}");
        assert!(blue < 0.02 && (0.6..1.6).contains(&white), "{blue} {white}");
        // The dots whose threshold is below a level must also be blue noise, for every level.
        for level in [0.1, 0.25, 0.5, 0.8] {
            let mean = f64::from((level * COUNT as f32).round()) / COUNT as f64;
            let dots: Vec<f64> = blue_noise().iter().map(|&t| f64::from(u8::from(t < level)) - mean).collect();
            let blue = low_over_mean(&radial_power(&dots));
            println!("level {level}: {blue:.4}");
            assert!(blue < 0.1, "level {level}: {blue}");
        }
    }
}
