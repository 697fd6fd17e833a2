//! The viewing zone of a display, and the errors of the seen pictures from this zone.
//!
//! The zone of an oblique light field is the set of slopes s with |s_x| ≤ tan(α_x/2) and |s_y| ≤
//! tan(α_y/2). The zone of a perspective light field is the set of eye positions D·s for these
//! slopes, where D is the viewing distance. With eye boxes, the zone is a disc of eye positions in
//! each box.
//!
//! The score `psnr_zone` is −10 log₁₀ of the mean squared error between seen picture / β and the
//! scene's picture. The mean is over directions that are spread over the whole zone and that the
//! solver did not use. The scene's pictures are noisy, so each is rendered twice, with independent
//! noise n₁ and n₂. With e the true error, the two measured errors are e + n₁ and e + n₂. The mean
//! squared error is the mean of their product, since E[(e + n₁)(e + n₂)] = e².

use crate::{EyeBox, LEAST_SHARE, Projection, SeenView, ViewGrid};

/// Smallest number of directions of a score.
pub const LEAST_DIRECTIONS: usize = 32;
/// Radius of the disc that represents an eye box, in standard deviations of the box.
const EYE_BOX_SIGMAS: f64 = 1.5;

/// The slopes or eye positions from which a display is expected to be seen.
#[derive(Clone, Debug, PartialEq)]
pub enum Zone {
    /// Slopes, or eye positions D·s: a rectangle around 0.
    Slopes {
        /// Projection of the rays of a view.
        projection: Projection,
        /// tan(α/2) per axis (x, y), ≥ 0.
        half_width: [f64; 2],
    },
    /// Eye positions: a disc in each eye box.
    Eyes(Vec<EyeBox>),
}

impl Zone {
    /// Returns the zone of a light field's views. If `fov_deg` is known, the zone is as wide as
    /// these full angles. Otherwise it reaches half a spacing past the outermost views. An axis
    /// with one view has no width, since a display that is solved for one direction is wrong in all
    /// others.
    pub fn of_grid(grid: &ViewGrid, fov_deg: Option<[f64; 2]>) -> Self {
        let slopes = [&grid.slope_x, &grid.slope_y];
        let spacing = grid.bin_width();
        let half_width = [0, 1].map(|axis| match (slopes[axis].len(), fov_deg) {
            (0 | 1, _) => 0.0,
            (_, Some(fov)) => (0.5 * fov[axis].to_radians()).tan(),
            _ => slopes[axis].iter().fold(0.0f64, |most, slope| most.max(slope.abs())) + 0.5 * spacing[axis],
        });
        Self::Slopes { projection: grid.projection, half_width }
    }

    /// Returns `count` directions, each as a grid of one view. An additive recurrence of low
    /// discrepancy (Roberts' R₂) spreads them over the zone. Its steps are 1/r and 1/r², where r is
    /// the real root of x³ = x + 1. Equal zones and counts give equal directions.
    pub fn directions(&self, count: usize) -> Vec<ViewGrid> {
        const RATIO: f64 = 1.324_717_957_244_746;
        let point = |i: usize| [1.0, 2.0].map(|power| (0.5 + (i + 1) as f64 * RATIO.powf(-power)).fract());
        let direction = |i: usize| {
            let [u, v] = point(i);
            match self {
                Self::Slopes { projection, half_width: [x, y] } => {
                    ViewGrid::single(*projection, [(2.0 * u - 1.0) * x, (2.0 * v - 1.0) * y])
                }
                Self::Eyes(boxes) => {
                    // Take the eye boxes in turn. Within a box, spread directions uniformly over
                    // its disc.
                    let EyeBox { eye_mm: [x, y, z], sigma_mm, .. } = boxes[i % boxes.len()];
                    let [u, v] = point(i / boxes.len());
                    let (radius, angle) = (EYE_BOX_SIGMAS * sigma_mm * u.sqrt(), std::f64::consts::TAU * v);
                    let slope = [(x + radius * angle.cos()) / z, (y + radius * angle.sin()) / z];
                    ViewGrid::single(Projection::Perspective { distance_mm: z }, slope)
                }
            }
        };
        match self {
            Self::Eyes(boxes) if boxes.is_empty() => Vec::new(),
            _ => (0..count).map(direction).collect(),
        }
    }
}

/// Error of the seen picture in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionScore {
    /// Slope (x, y) of the direction, at the centre of the light field's rectangle.
    pub slope: [f64; 2],
    /// Mean squared error over pixels and channels. If the true error is tiny, noise may make this
    /// value slightly negative.
    pub mse: f64,
    /// Number of pixels that are scored.
    pub pixels: usize,
}

impl DirectionScore {
    /// Compares a seen picture / β with two renders of the scene's picture, `[row][col][rgb]`,
    /// whose noise is independent. Without noise, pass the same picture twice. Pixels that were not
    /// rendered have the value NaN in both renders, and are not scored.
    pub fn new(direction: &ViewGrid, seen: &SeenView, brightness: f64, references: [&[f32]; 2]) -> Self {
        let (mut sum, mut pixels) = (0.0, 0);
        let pictures = references[0].chunks_exact(3).zip(references[1].chunks_exact(3));
        for ((seen, (a, b)), share) in seen.radiance.data().chunks_exact(3).zip(pictures).zip(&seen.share) {
            if *share >= LEAST_SHARE && !a[0].is_nan() {
                pixels += 1;
                for c in 0..3 {
                    let seen = f64::from(seen[c]) / brightness;
                    sum += (seen - f64::from(a[c])) * (seen - f64::from(b[c]));
                }
            }
        }
        let mse = if pixels == 0 { 0.0 } else { sum / (3 * pixels) as f64 };
        Self { slope: [direction.slope_x[0], direction.slope_y[0]], mse, pixels }
    }

    /// Returns the PSNR in this direction, −10 log₁₀ of the mean squared error, dB.
    pub fn psnr(&self) -> f64 {
        psnr(self.mse)
    }
}

/// Errors in directions all over the zone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ZoneScore {
    /// One score per direction.
    pub directions: Vec<DirectionScore>,
}

impl ZoneScore {
    /// Returns `psnr_zone`: the PSNR of the mean error over all directions, dB. `None` if no pixel
    /// could be scored.
    pub fn psnr(&self) -> Option<f64> {
        mean(&self.scored()).map(psnr)
    }

    /// Returns the PSNR of the mean error over the worst tenth of the directions, dB. The number of
    /// these directions is rounded up. `None` if no pixel could be scored.
    pub fn worst_tenth(&self) -> Option<f64> {
        let mut scored = self.scored();
        scored.sort_by(|a, b| b.total_cmp(a));
        scored.truncate(scored.len().div_ceil(10));
        mean(&scored).map(psnr)
    }

    fn scored(&self) -> Vec<f64> {
        self.directions.iter().filter(|direction| direction.pixels > 0).map(|direction| direction.mse).collect()
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Returns the PSNR with peak 1, dB. Errors below 1.5e-6² are raised to this value, since noise may
/// make an error 0 or negative. 1.5e-6 is a tenth of a 16-bit step.
fn psnr(mse: f64) -> f64 {
    const LEAST: f64 = 1.5e-6 * 1.5e-6;
    -10.0 * mse.max(LEAST).log10()
}

#[cfg(test)]
mod tests {
    use lumistack_core::Tensor;
    use lumistack_core::seed::{Stream, derive};

    use super::*;

    #[test]
    fn the_zone_reaches_half_a_spacing_beyond_the_views() {
        let grid = ViewGrid::uniform(Projection::Oblique, [5, 3], [20.0, 14.0]).unwrap();
        let expected = [10.0f64, 7.0].map(|deg| deg.to_radians().tan());
        for fov in [None, Some([20.0, 14.0])] {
            let Zone::Slopes { half_width, .. } = Zone::of_grid(&grid, fov) else { panic!("slopes") };
            assert!((0..2).all(|axis| (half_width[axis] - expected[axis]).abs() < 1e-12), "{half_width:?}");
        }
        let row = ViewGrid::uniform(Projection::Oblique, [5, 1], [20.0, 14.0]).unwrap();
        let Zone::Slopes { half_width, .. } = Zone::of_grid(&row, Some([20.0, 14.0])) else { panic!("slopes") };
        assert_eq!(half_width[1], 0.0, "with one view row, the zone has no height");
    }

    #[test]
    fn directions_cover_the_zone_evenly() {
        let zone = Zone::Slopes { projection: Projection::Oblique, half_width: [0.2, 0.1] };
        let directions = zone.directions(32);
        assert_eq!(directions, zone.directions(32));
        // The directions are evenly spread: every cell of a 4 × 4 grid over the zone holds one to
        // three of the 32 directions.
        let mut cells = [0; 16];
        for direction in &directions {
            let [x, y] = [direction.slope_x[0] / 0.2, direction.slope_y[0] / 0.1].map(|s| (2.0 + 2.0 * s) as usize);
            cells[4 * y + x] += 1;
        }
        assert!(cells.iter().all(|count| (1..=3).contains(count)), "{cells:?}");
    }

    #[test]
    fn eyes_are_looked_at_from_their_boxes() {
        let boxes =
            [[60.0, 0.0, 500.0], [-60.0, 10.0, 600.0]].map(|eye_mm| EyeBox { eye_mm, sigma_mm: 8.0, weight: 1.0 });
        let directions = Zone::Eyes(boxes.to_vec()).directions(32);
        for (i, direction) in directions.iter().enumerate() {
            let [x, y, z] = boxes[i % 2].eye_mm;
            assert_eq!(direction.projection, Projection::Perspective { distance_mm: z });
            let offset = (direction.slope_x[0] * z - x).hypot(direction.slope_y[0] * z - y);
            assert!(offset <= EYE_BOX_SIGMAS * 8.0, "{offset}");
        }
        assert!(Zone::Eyes(Vec::new()).directions(32).is_empty());
    }

    /// With two noisy references the score is the error of the seen picture alone. The mean square
    /// of the noise is 19 times that error.
    #[test]
    fn noise_of_the_references_does_not_count() {
        let pixels = 40_000;
        let mut random = Stream::new(derive(7, &[]));
        let mut noisy = || (0..3 * pixels).map(|_| 0.5 + (random.next_f32() - 0.5) * 0.6).collect::<Vec<f32>>();
        let (a, b) = (noisy(), noisy());
        let seen = SeenView {
            radiance: Tensor::filled(["row", "col", "rgb"], [1, pixels, 3], 0.2 * 0.54),
            share: vec![1.0; pixels],
        };
        let direction = ViewGrid::single(Projection::Oblique, [0.0; 2]);
        let score = DirectionScore::new(&direction, &seen, 0.2, [&a, &b]);
        // The standard error of the mean product of 120,000 pairs is 9e-5. The tolerance is five
        // standard errors.
        assert!((score.mse - 0.0016).abs() < 4.5e-4, "{}", score.mse);
        assert!((DirectionScore::new(&direction, &seen, 0.2, [&a, &a]).mse - 0.0316).abs() < 1e-3);
    }

    #[test]
    fn pixels_that_were_not_rendered_are_not_scored() {
        let seen =
            SeenView { radiance: Tensor::filled(["row", "col", "rgb"], [1, 3, 3], 0.1), share: vec![1.0, 1.0, 0.0] };
        let reference = [0.4, 0.4, 0.4, f32::NAN, f32::NAN, f32::NAN, 0.5, 0.5, 0.5];
        let direction = ViewGrid::single(Projection::Oblique, [0.0; 2]);
        let score = DirectionScore::new(&direction, &seen, 0.2, [&reference, &reference]);
        assert!(score.pixels == 1 && (score.mse - 0.01).abs() < 1e-7, "{score:?}");
    }

    #[test]
    fn the_worst_tenth_is_the_worst() {
        let direction = |mse| DirectionScore { slope: [0.0; 2], mse, pixels: 10 };
        let mut score = ZoneScore { directions: vec![direction(1e-3); 18] };
        score.directions.extend([direction(1e-1), direction(1e-2)]);
        score.directions.push(DirectionScore { pixels: 0, ..direction(1.0) });
        assert!((score.worst_tenth().unwrap() - psnr(0.055)).abs() < 1e-12);
        assert!((score.psnr().unwrap() - psnr(0.128 / 20.0)).abs() < 1e-12);
        assert_eq!(ZoneScore::default().psnr(), None);
        assert!(DirectionScore { mse: -1e-9, ..direction(0.0) }.psnr() > 100.0, "an error below 0 is only noise");
    }
}
