//! Widths for curves and points whose file states no widths, as a fraction of the distance between
//! neighbours.

use glam::Vec3;

/// Largest number of positions whose nearest neighbour is searched. The median of 256 distances is
/// accurate enough.
const ASKED: usize = 256;

/// A rule for a width: a fraction of the distance between neighbours, within bounds. The bounds are
/// fractions of the diagonal of the bounding box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rule {
    /// Width as a fraction of the median distance between neighbours.
    pub(crate) of_spacing: f32,
    /// Largest width, as a fraction of the diagonal of the bounding box. It also applies if there
    /// are no neighbours.
    pub(crate) largest: f32,
    /// Smallest width, as a fraction of the diagonal of the bounding box.
    pub(crate) smallest: f32,
}

/// Returns the width of objects at `places`. It is a fraction of the median distance to the nearest
/// other position, within bounds that follow from the bounding box of `points`. `None` if this box
/// has no extent.
pub(crate) fn width(places: &[Vec3], points: &[Vec3], rule: Rule) -> Option<f32> {
    let finite = || points.iter().copied().filter(|point| point.is_finite());
    let low = finite().reduce(Vec3::min)?;
    let high = finite().reduce(Vec3::max)?;
    let diagonal = (high - low).length();
    if !(diagonal > 0.0 && diagonal.is_finite()) {
        return None;
    }
    let largest = rule.largest * diagonal;
    let Some(spacing) = median_spacing(places) else { return Some(largest) };
    Some((rule.of_spacing * spacing).clamp(rule.smallest * diagonal, largest))
}

/// Returns the median distance of the positions to their nearest neighbours. Positions that
/// coincide are not regarded as neighbours. `None` if no position has a neighbour.
fn median_spacing(places: &[Vec3]) -> Option<f32> {
    // compare an evenly spread sample of the positions with all positions
    let asked = places.len().min(ASKED);
    let mut distances: Vec<f32> = (0..asked)
        .map(|i| places[i * places.len() / asked])
        .filter_map(|place| {
            let squares = places.iter().map(|other| other.distance_squared(place));
            squares.filter(|square| *square > 0.0 && square.is_finite()).reduce(f32::min)
        })
        .collect();
    distances.sort_by(f32::total_cmp);
    distances.get(distances.len() / 2).map(|square| square.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: Rule = Rule { of_spacing: 0.25, largest: 0.01, smallest: 0.0001 };

    #[test]
    fn widths_follow_the_spacing_within_bounds() {
        let grid = |step: f32| -> Vec<Vec3> {
            (0..100 * 100).map(|i| step * Vec3::new((i % 100) as f32, 0.0, (i / 100) as f32)).collect()
        };
        for step in [1e-3, 1.0, 250.0] {
            let width = width(&grid(step), &grid(step), RULE).unwrap();
            assert!((width / step - 0.25).abs() < 1e-3, "{width} at {step}");
        }
        let long = [Vec3::ZERO, Vec3::new(0.0, 0.0, 10.0)];
        let is_about = |places: &[Vec3], expected: f32| {
            let found = width(places, &long, RULE).unwrap();
            assert!((found / expected - 1.0).abs() < 1e-5, "{found}, not {expected}");
        };
        // a single position, or one far from its neighbour, gets the largest width
        is_about(&long[..1], 0.1);
        is_about(&long, 0.1);
        // nearly coincident positions get the smallest width
        is_about(&[Vec3::ZERO, Vec3::new(1e-9, 0.0, 0.0)], 0.001);
        // coincident positions have no spacing, so they get the largest width
        is_about(&[Vec3::ONE; 9], 0.1);
        assert_eq!(width(&[Vec3::ONE; 9], &[Vec3::ONE; 9], RULE), None);
        assert_eq!(width(&[], &[Vec3::NAN], RULE), None);
    }
}
