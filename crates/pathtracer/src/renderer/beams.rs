//! Rays of a view's samples. Light, guides and misses of the samples are computed from the same
//! rays and random numbers.

use lumistack_core::seed;

use super::first::DisplayAxes;
use crate::bvh::{BEAM, Ray};
use crate::primary::{PixelRays, PrimaryRays};
use crate::sampler::{Draws, SampleBank};
use crate::settings::Settings;

/// Pairs of random numbers of a primary ray: one for the position in the pixel, one for the slope.
const PLACE_PAIR: u64 = 0;
const SLOPE_PAIR: u64 = 1;

/// Samples of a view.
pub(super) struct ViewSamples<'a> {
    rays: PrimaryRays<'a>,
    /// Display space, in which surfaces are reported.
    pub(super) axes: DisplayAxes,
    bank: SampleBank,
    paths: u32,
    seed: u64,
}

impl<'a> ViewSamples<'a> {
    /// Prepares the samples of the view [view_y, view_x]. A pixel may have up to `rays_per_pixel`
    /// rays, or the number of samples of the settings if that is more.
    pub(super) fn new(
        rays: PrimaryRays<'a>,
        axes: DisplayAxes,
        view: [usize; 2],
        settings: &Settings,
        rays_per_pixel: u32,
    ) -> Self {
        let seed = seed::derive(settings.seed, &[view[0] as u64, view[1] as u64]);
        let bank = SampleBank::with_more(settings.samples, rays_per_pixel);
        Self { rays, axes, bank, paths: settings.samples, seed }
    }

    /// Returns the seed of a pixel's random numbers.
    pub(super) fn pixel_seed(&self, row: usize, col: usize) -> u64 {
        seed::derive(self.seed, &[row as u64, col as u64])
    }

    /// Calls `take` with the rays of a pixel, at most [`BEAM`] per call, and with the random
    /// numbers of these rays. The numbers follow from `pixel_seed`.
    #[inline]
    pub(super) fn for_each_beam(
        &self,
        at: [usize; 2],
        pixel_seed: u64,
        mut take: impl FnMut(&mut [Ray], &PixelRays, &Draws<'_>),
    ) {
        self.for_each_beam_of(at, pixel_seed, [self.paths; 2], |beam, _, rays, draws| take(beam, rays, draws));
    }

    /// Does the same as [`for_each_beam`](Self::for_each_beam), for the given numbers [paths, rays]
    /// of a pixel. `take` also gets the number of the beam's rays that continue as paths.
    #[inline]
    pub(super) fn for_each_beam_of(
        &self,
        [row, col]: [usize; 2],
        pixel_seed: u64,
        [paths, count]: [u32; 2],
        mut take: impl FnMut(&mut [Ray], usize, &PixelRays, &Draws<'_>),
    ) {
        let pixel = self.rays.pixel(row, col);
        let mut beam = [Ray::ANY; BEAM];
        for first in (0..count).step_by(BEAM) {
            let beam = &mut beam[..(count - first).min(BEAM as u32) as usize];
            let draws = self.bank.draws(pixel_seed, first);
            let (in_pixel, in_bin) = (draws.pair(PLACE_PAIR), draws.pair(SLOPE_PAIR));
            pixel.fill(beam, |index| [centred(in_pixel.of(index)), centred(in_bin.of(index))]);
            let paths = (paths.saturating_sub(first) as usize).min(beam.len());
            take(beam, paths, &pixel, &draws);
        }
    }
}

/// Returns the position of a ray of a beam, in pixels from the pixel's centre.
pub(super) fn place_in_pixel(draws: &Draws<'_>, index: usize) -> [f32; 2] {
    centred(draws.pair(PLACE_PAIR).of(index))
}

/// Converts numbers in 0..1 to offsets −0.5..0.5 from a centre.
fn centred(pair: [f32; 2]) -> [f32; 2] {
    pair.map(|u| u - 0.5)
}
