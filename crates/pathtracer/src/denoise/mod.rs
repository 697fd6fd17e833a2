//! A filter for noisy views. It filters all views of a light field together, guided by the surfaces
//! that they show. It trades noise for bias.
//!
//! ```text
//! u = L / albedo                                           (textures are not filtered)
//! F_a(p) = Σ_q w_b(p, q) u_a(q) / Σ_q w_b(p, q)
//! F_b(p) = the same with a and b exchanged
//! L' = albedo (F_a + F_b) / 2
//! w(p, q) = k(colour distance of patches) · k(distance of guides)
//!         · (fraction of light that does not depend on the view)
//! ```
//!
//! a and b are two renders, with half of the samples each. u_a and u_b are u of these renders. The
//! weights for u_a are computed from u_b, so they are independent of the noise that they average.
//!
//! The curve k is 1 at distance 0, and falls to 0. Guides are properties of the surfaces that the
//! pixels show, such as normal, position and albedo. The pixel q runs over a window around p in p's
//! own view. It also runs over small windows in neighbouring views, around the position where p's
//! surface point appears. If a point at depth Z is at x in view s, it is at x + (s − s')·Z in view
//! s'. In an epipolar picture, these positions are on a line. Views thus share their samples, and
//! the remaining noise is similar in all views.
//!
//! Every pixel has three candidates: its radiance as rendered, filtered by guides and colours, and
//! filtered by guides alone. The result is their mean, in which candidates with smaller squared
//! errors have more weight. Each error is estimated by a comparison of F_a with u_b. This estimate
//! has no bias if F_a does not depend on u_b:
//!
//! ```text
//! E[(F_a − u_b)²] = E[(F_a − truth)²] + Var(u_b)
//! ```
//!
//! But weights from colours depend on u_b. So, for the estimate alone, F_a is computed a second
//! time, with weights from u_a. The errors of the result are measured with
//! [samples that the filter never used](crate::Checks).
//!
//! Sources:
//!
//! * Rousselle, Manzi, Zwicker 2013, "Robust Denoising using Feature and Color Information":
//!   distances, two half buffers.
//! * Bitterli et al. 2016, "Nonlinearly Weighted First-order Regression for Denoising Monte Carlo
//!   Renderings": demodulation, estimates by halves.

mod band;
mod choice;
mod figures;
mod frame;
mod shared;
mod view;

#[cfg(test)]
mod tests;

use lumistack_core::{Cancelled, Task, Tensor};
use lumistack_display::FieldGeometry;
#[cfg(feature = "parallel")]
use rayon::prelude::*;

pub use figures::{Estimate, ViewFigures, figures};
use frame::Frame;
pub use shared::{MeanLight, SharedLight};
pub use view::{NoisyView, Window};

/// Number of rows that are filtered together: the unit of work, of progress and of cancellation.
const BAND: usize = 16;

/// Returns the number of steps by which [`denoise`] advances the progress.
pub fn steps(geometry: &FieldGeometry) -> u64 {
    (geometry.rows.div_ceil(BAND) * geometry.grid.iter().count()) as u64
}

/// Filters all views of a light field, given in the order of the grid.
///
/// # Errors
/// When cancelled.
///
/// # Panics
/// If the number of views is not the number in the grid, or a view is not of the geometry's size.
pub fn denoise(
    geometry: &FieldGeometry,
    views: &[NoisyView],
    window: Window,
    task: Task<'_>,
) -> Result<Vec<Tensor<3>>, Cancelled> {
    let places: Vec<[usize; 2]> = geometry.grid.iter().collect();
    assert_eq!(places.len(), views.len(), "expected one picture for every view of the grid");
    let mut frames = Vec::with_capacity(views.len());
    for (&place, view) in places.iter().zip(views) {
        task.cancel.check()?;
        frames.push(Frame::new(geometry, place, view));
    }
    let starts: Vec<usize> = (0..geometry.rows).step_by(BAND).collect();
    let mut filtered = Vec::with_capacity(views.len());
    for index in 0..views.len() {
        let neighbours = neighbours(&places, index, window.views);
        let fill = |&start: &usize| {
            task.cancel.check()?;
            let rows = start..(start + BAND).min(geometry.rows);
            let answers = band::filter(&frames, index, &neighbours, rows, window);
            task.progress.advance(1, "");
            Ok(answers)
        };
        #[cfg(feature = "parallel")]
        let bands: Result<Vec<_>, Cancelled> = starts.par_iter().map(fill).collect();
        #[cfg(not(feature = "parallel"))]
        let bands: Result<Vec<_>, Cancelled> = starts.iter().map(fill).collect();
        filtered.push(choice::choose(&frames[index], &bands?));
    }
    Ok(filtered)
}

/// Returns the indices of the views around the view `index`, without `index` itself.
fn neighbours(places: &[[usize; 2]], index: usize, radius: usize) -> Vec<usize> {
    let near = |other: &[usize; 2]| (0..2).all(|axis| other[axis].abs_diff(places[index][axis]) <= radius);
    (0..places.len()).filter(|&other| other != index && near(&places[other])).collect()
}
