//! A display's prefilter for a given light field: every kept view is averaged with its neighbours
//! over the slopes that the display cannot resolve.
//!
//! ```text
//! L'(x, s_i) = Σ_j w_ij L(x, s_j) / Σ_j w_ij
//! w_ij = length of [s_i − δs/2, s_i + δs/2] ∩ [s_j − Δs/2, s_j + Δs/2]
//! ```
//!
//! L is the given light field and L' the result. x is a pixel, and s_i and s_j are the slopes of
//! views i and j. Both widths are per axis:
//!
//! * δs is [`angular_footprint`](lumistack_display::Display::angular_footprint).
//! * Δs is the step of the given views.
//!
//! A view represents a bin of slopes of width Δs.
//! Footprints of at most one bin have no effect, since radiance between the views is unknown.
//!
//! With more views the result approaches the result of the path tracer's `angular_filter =
//! "display"`. For δs = nΔs, a plane at z with a grating of frequency ω keeps this fraction of its
//! contrast:
//!
//! ```text
//! sin(πω|z|nΔs)/(n sin(πω|z|Δs)) → sinc(ω z δs)
//! ```
//!
//! The mean of an outermost view contains only the views that exist.

use lumistack_display::FieldGeometry;

/// A function of a light field's geometry. It returns the widths [x, y] of the range of slopes over
/// which the light field may be averaged for a display.
pub type Footprint<'a> = &'a dyn Fn(&FieldGeometry) -> [f64; 2];

/// For every kept view along one axis: the views that are averaged into it, and their weights.
pub(crate) type Shares = Vec<Vec<(usize, f32)>>;

/// Returns the views and weights without a prefilter: every kept view is only itself, with weight
/// 1.
pub(crate) fn alone(picks: &[usize]) -> Shares {
    picks.iter().map(|&view| vec![(view, 1.0)]).collect()
}

/// Returns the weights along an axis. `slopes` are the slopes of the kept views `picks`, and
/// `positions` the positions of all views in any unit. `width` is the footprint.
pub(crate) fn shares(slopes: &[f64], picks: &[usize], positions: &[f64], width: f64) -> Shares {
    let ([first, .., last], [from, .., to]) = (slopes, picks) else { return alone(picks) };
    let scale = (last - first) / (positions[*to] - positions[*from]);
    let bin = scale.abs() * (positions[positions.len() - 1] - positions[0]).abs() / (positions.len() - 1) as f64;
    if width <= bin || !width.is_finite() {
        return alone(picks);
    }
    let share = |picked: usize, other: usize| {
        let apart = (scale * (positions[other] - positions[picked])).abs();
        (0.5 * (bin + width) - apart).min(bin)
    };
    let of = |&picked: &usize| {
        let all = (0..positions.len()).map(|other| (other, share(picked, other)));
        // omit adjacent bins that overlap only by a rounding error
        let all: Vec<(usize, f64)> = all.filter(|(_, share)| *share > 1e-9 * bin).collect();
        let sum: f64 = all.iter().map(|(_, share)| share).sum();
        all.into_iter().map(|(other, share)| (other, (share / sum) as f32)).collect()
    };
    picks.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_lengths() {
        let positions: Vec<f64> = (0..9).map(f64::from).collect();
        // three of nine views are kept, with slopes 0.4 apart, so the bin of each of the nine is
        // 0.1 wide
        let of = |width: f64| shares(&[-0.4, 0.0, 0.4], &[0, 4, 8], &positions, width);
        let close = |found: &[(usize, f32)], expected: &[(usize, f32)]| {
            let near = |(a, b): (&(usize, f32), &(usize, f32))| a.0 == b.0 && (a.1 - b.1).abs() < 1e-6;
            assert!(found.len() == expected.len() && found.iter().zip(expected).all(near), "{found:?} {expected:?}");
        };
        assert_eq!(of(0.1), alone(&[0, 4, 8]));
        close(&of(0.2)[1], &[(3, 0.25), (4, 0.5), (5, 0.25)]);
        close(&of(0.3)[1], &[(3, 1.0 / 3.0), (4, 1.0 / 3.0), (5, 1.0 / 3.0)]);
        // the mean of an outermost view contains only views that exist
        close(&of(0.3)[0], &[(0, 0.5), (1, 0.5)]);
        assert_eq!(shares(&[0.0], &[4], &positions, 1.0), alone(&[4]), "one view has no step");
    }
}
