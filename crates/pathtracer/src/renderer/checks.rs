//! Checks: a few pixels of a view, which are rendered twice more, independently of all other
//! renders. The checks measure the error of a denoised picture F, since F is independent of the
//! checks:
//!
//! ```text
//! E[(F − c₁)(F − c₂)] = E[(F − truth)²]
//! ```
//!
//! Here c₁ and c₂ are the two renders of a pixel, with independent noise. One pixel is drawn in
//! every square of [`SPACING`] × [`SPACING`] pixels. If the edge of the picture cuts a square, the
//! drawn pixel may be outside of the picture; this square then has no check.

use lumistack_core::{NoProgress, Task, seed};
use lumistack_display::FieldGeometry;
use lumistack_scene::Window;

use super::{RenderError, Renderer};
use crate::clamp::Clamped;
use crate::settings::Settings;

/// Edge of the squares of pixels; a square has at most one check.
const SPACING: usize = 8;
/// Stream of the random numbers by which the pixels are chosen. No view uses this stream.
const PLACES: u64 = 0xc4ec_0001;
/// Stream of the random numbers with which the pixels are rendered. No view uses this stream.
const RADIANCE: u64 = 0xc4ec_0002;

/// Pixels of a view with two renders each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checks {
    pub(crate) list: Vec<Check>,
}

/// A pixel and its radiance in two independent renders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Check {
    pub(crate) row: usize,
    pub(crate) col: usize,
    pub(crate) radiance: [[f32; 3]; 2],
}

impl Renderer {
    /// Renders one pixel of every 8 × 8 pixels of a view twice. `settings.seed` must be the seed
    /// with which the whole view is rendered. Does not advance the progress.
    ///
    /// # Errors
    /// The same errors as [`render_view`](Self::render_view).
    pub fn render_checks(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<Checks, RenderError> {
        let samples = self.samples_of(window, geometry, view, settings, settings.samples)?;
        let of_view = |stream: u64| seed::derive(settings.seed, &[stream, view[0] as u64, view[1] as u64]);
        let (places, radiance) = (of_view(PLACES), of_view(RADIANCE));
        let clamped = Clamped::default();
        let quiet = Task { progress: &NoProgress, ..task };
        // render the drawn pixels twice, with two seeds; all other pixels stay NaN
        let values = self.by_groups(geometry, quiet, ["row", "col", "half rgb"], 1, |pixels, buffers, values| {
            let mut halves = [f32::NAN; 6];
            if pixels.iter().all(|[row, col]| is_drawn(places, *row, *col)) {
                for (half, mean) in halves.chunks_exact_mut(3).enumerate() {
                    let seed = |[row, col]: [usize; 2]| seed::derive(radiance, &[row as u64, col as u64, half as u64]);
                    let count = [settings.samples; 2];
                    self.pixels::<false>(&samples, pixels, seed, count, settings, &clamped, buffers, |pixel, _| {
                        mean.copy_from_slice(&pixel.mean.to_array());
                    });
                }
            }
            values.push(halves);
        })?;
        // collect the drawn pixels
        let at = |row: usize, col: usize| {
            let v = values.block([row, col]);
            Check { row, col, radiance: [[v[0], v[1], v[2]], [v[3], v[4], v[5]]] }
        };
        let pixels = (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| (row, col)));
        let drawn = pixels.filter(|(row, col)| is_drawn(places, *row, *col));
        Ok(Checks { list: drawn.map(|(row, col)| at(row, col)).collect() })
    }
}

/// Returns true if this pixel was chosen in its square of [`SPACING`] × [`SPACING`] pixels.
fn is_drawn(seed: u64, row: usize, col: usize) -> bool {
    let chosen = seed::derive(seed, &[(row / SPACING) as u64, (col / SPACING) as u64]) as usize % (SPACING * SPACING);
    chosen == row % SPACING * SPACING + col % SPACING
}
