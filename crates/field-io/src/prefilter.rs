//! A display's prefilter for an existing light field. Every view that is kept becomes the mean of
//! the views around it, over the slopes that the display cannot resolve.
//!
//! ```text
//! L'(x, s_i) = Σ_j w_ij L(x, s_j) / Σ_j w_ij
//! w_ij = length of [s_i − δs/2, s_i + δs/2] ∩ [s_j − Δs/2, s_j + Δs/2]
//! ```
//!
//! with δs the [`angular_footprint`](lumistack_display::Display::angular_footprint) and Δs the step
//! of the views, per axis. A view stands for its bin of slopes, so footprints no wider than a bin
//! change nothing: the light between the views is unknown. The path tracer's
//! `angular_filter = "display"` is the same with any number of views. A plane at z with a grating
//! of frequency ω keeps, for δs = nΔs,
//!
//! ```text
//! sin(πω|z|nΔs)/(n sin(πω|z|Δs)) → sinc(ω z δs)        of its contrast
//! ```
//!
//! At the outermost views the mean runs over the views that exist.

use lumistack_display::FieldGeometry;

/// The width of slopes [x, y] over which a light field of some geometry may be averaged for a
/// display.
pub type Footprint<'a> = &'a dyn Fn(&FieldGeometry) -> [f64; 2];

/// Per view that is kept, along one axis: the views that are averaged for it, and their shares.
pub(crate) type Shares = Vec<Vec<(usize, f32)>>;

/// Every view for itself.
pub(crate) fn alone(picks: &[usize]) -> Shares {
    picks.iter().map(|&view| vec![(view, 1.0)]).collect()
}

/// Shares along an axis. `slopes` are those of the views `picks` that are kept, `positions` of all
/// views in any unit.
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
        // rounding leaves slivers of bins that only touch
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
        // three of nine views are kept, 0.4 apart; a bin of all nine is 0.1
        let of = |width: f64| shares(&[-0.4, 0.0, 0.4], &[0, 4, 8], &positions, width);
        let close = |found: &[(usize, f32)], expected: &[(usize, f32)]| {
            let near = |(a, b): (&(usize, f32), &(usize, f32))| a.0 == b.0 && (a.1 - b.1).abs() < 1e-6;
            assert!(found.len() == expected.len() && found.iter().zip(expected).all(near), "{found:?} {expected:?}");
        };
        assert_eq!(of(0.1), alone(&[0, 4, 8]));
        close(&of(0.2)[1], &[(3, 0.25), (4, 0.5), (5, 0.25)]);
        close(&of(0.3)[1], &[(3, 1.0 / 3.0), (4, 1.0 / 3.0), (5, 1.0 / 3.0)]);
        // at the end, over the existing views
        close(&of(0.3)[0], &[(0, 0.5), (1, 0.5)]);
        assert_eq!(shares(&[0.0], &[4], &positions, 1.0), alone(&[4]), "one view has no step");
    }
}
