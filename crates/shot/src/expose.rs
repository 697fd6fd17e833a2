//! Exposure of radiance in front of a background, and the rays that an automatic exposure measures.

use lumistack_display::FieldGeometry;
use lumistack_splats::Space;

use crate::depth::Depths;
use crate::tone_mapping::ToneMapping;

/// Largest number of rays that an automatic exposure measures.
const MOST_RAYS: usize = 4_000_000;

/// Exposes pixels `[..][rgb]` that are black outside surfaces, and blends them over a background.
/// `missed` is the fraction of each pixel's rays without a hit, 0..1. Splats are blended over the
/// background in their own colour space, as they are over a surface.
pub fn expose_over(
    tone_mapping: ToneMapping,
    background: [f32; 3],
    splats: Option<Space>,
    missed: &[f32],
    rgb: &mut [f32],
) {
    if let Some(space) = splats {
        tone_mapping.apply_to(rgb);
        for (pixel, &missed) in rgb.as_chunks_mut::<3>().0.iter_mut().zip(missed) {
            *pixel = space.before(*pixel, missed, background);
        }
        return;
    }
    // Expose only the light of the surfaces in the pixel, and blend it with the background after
    // the tone curve. So an edge is a blend of shown values, not of radiance.
    for (pixel, &missed) in rgb.chunks_exact_mut(3).zip(missed) {
        let covered = 1.0 - missed;
        if covered > 0.0 {
            pixel.iter_mut().for_each(|value| *value /= covered);
        }
    }
    tone_mapping.apply_to(rgb);
    for (pixel, &missed) in rgb.chunks_exact_mut(3).zip(missed) {
        for (value, background) in pixel.iter_mut().zip(background) {
            *value = (1.0 - missed) * *value + missed * background;
        }
    }
}

/// Collects values of the rays of a light field, from which
/// [`ToneMapping::choose`](crate::ToneMapping::choose) chooses an exposure. At most four million
/// rays are measured, spread evenly over the views.
pub struct Brightest<'a> {
    geometry: &'a FieldGeometry,
    depths: &'a Depths,
    /// Step between measured rays: every `every`-th ray is measured, counted through all views.
    every: usize,
}

impl<'a> Brightest<'a> {
    /// Prepares the collection from `views` views of a geometry.
    pub fn new(geometry: &'a FieldGeometry, views: usize, depths: &'a Depths) -> Self {
        let all = views * geometry.rows * geometry.cols;
        Self { geometry, depths, every: all.div_ceil(MOST_RAYS).max(1) }
    }

    /// Returns two values for each measured ray of a view: the largest channel, and true if the ray
    /// hits a surface. `number` counts the measured views from 0. `view` is the view's place in the
    /// grid, [view_y, view_x], and `picture` is its radiance, `[row][col][rgb]`.
    pub fn of_view(&self, number: usize, view: [usize; 2], picture: &[f32]) -> Vec<(f32, bool)> {
        // The index of a view's first measured ray depends on the number of rays in the views
        // before it.
        let (size, every) = (self.geometry.rows * self.geometry.cols, self.every);
        let first = (every - number * size % every) % every;
        let measured = picture.as_chunks::<3>().0.iter().enumerate().skip(first).step_by(every);
        let values = measured.map(|(i, rgb)| {
            let (row, col) = (i / self.geometry.cols, i % self.geometry.cols);
            (rgb[0].max(rgb[1]).max(rgb[2]), self.depths.is_surface(view, row, col, self.geometry))
        });
        values.collect()
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::tone::ToneCurve;

    use super::*;

    #[test]
    fn edges_mix_what_is_shown_of_both() {
        let tone_mapping = ToneMapping { exposure: 2.0, curve: ToneCurve::Linear };
        // a surface of radiance 0.3 covers all of the first pixel, a quarter of the second and
        // nothing of the third
        let mut rgb: Vec<f32> = [0.3, 0.25 * 0.3, 0.0].iter().flat_map(|value| [*value; 3]).collect();
        expose_over(tone_mapping, [1.0, 0.5, 0.0], None, &[0.0, 0.75, 1.0], &mut rgb);
        let expected = [0.6, 0.6, 0.6, 0.15 + 0.75, 0.15 + 0.375, 0.15, 1.0, 0.5, 0.0];
        for (found, expected) in rgb.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{rgb:?}");
        }
    }
}
