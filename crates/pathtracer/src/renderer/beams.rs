//! Rays of a view's samples. Light, guides and misses of the samples are computed from the same
//! rays and random numbers.

use lumistack_core::seed;

use super::first::DisplayAxes;
use crate::bvh::{BEAM, Ray};
use crate::math::all_ones;
use crate::primary::PrimaryRays;
use crate::sampler::{Draws, SampleBank};
use crate::settings::Settings;
use crate::sparse::SparsePaths;
use crate::tracer::Cone;

/// Pair of random numbers for a primary ray's position in the pixel.
const PLACE_PAIR: u64 = 0;
/// Pair of random numbers for a primary ray's slope.
const SLOPE_PAIR: u64 = 1;

/// Samples of a view.
pub(super) struct ViewSamples<'a> {
    rays: PrimaryRays<'a>,
    /// Converts data of surfaces to display space.
    pub(super) axes: DisplayAxes,
    bank: SampleBank,
    paths: u32,
    seed: u64,
    is_sparse: bool,
}

impl<'a> ViewSamples<'a> {
    /// Prepares the samples of the view [view_y, view_x]. The largest number of rays of a pixel is
    /// the greater of `rays_per_pixel` and the samples of the settings.
    pub(super) fn new(
        rays: PrimaryRays<'a>,
        axes: DisplayAxes,
        view: [usize; 2],
        settings: &Settings,
        rays_per_pixel: u32,
    ) -> Self {
        let seed = seed::derive(settings.seed, &[view[0] as u64, view[1] as u64]);
        let bank = SampleBank::with_more(settings.samples, rays_per_pixel);
        Self { rays, axes, bank, paths: settings.samples, seed, is_sparse: settings.has_sparse_paths() }
    }

    /// Returns the seed of a pixel's random numbers.
    pub(super) fn pixel_seed(&self, [row, col]: [usize; 2]) -> u64 {
        seed::derive(self.seed, &[row as u64, col as u64])
    }

    /// Calls `take` with the rays of the given pixels, at most [`BEAM`] per call, and with the
    /// random numbers of these rays. Each pixel has [`Settings::samples`] rays. Several pixels,
    /// which should be neighbours, may only be given together if all their rays fit into one call.
    #[inline]
    pub(super) fn for_each_beam(&self, pixels: &[[usize; 2]], take: impl FnMut(&mut RayBeam, &Draws<'_>)) {
        self.for_each_beam_of(pixels, |at| self.pixel_seed(at), [self.paths; 2], take);
    }

    /// Does the same as [`for_each_beam`](Self::for_each_beam), for the given numbers [paths, rays]
    /// of a pixel. The first `paths` rays of a pixel continue as paths. `seed` returns the seed of
    /// a pixel.
    #[inline]
    pub(super) fn for_each_beam_of(
        &self,
        pixels: &[[usize; 2]],
        seed: impl Fn([usize; 2]) -> u64,
        [paths, count]: [u32; 2],
        mut take: impl FnMut(&mut RayBeam, &Draws<'_>),
    ) {
        let mut seeds = [0; BEAM];
        seeds.iter_mut().zip(pixels).for_each(|(to, at)| *to = seed(*at));
        let seeds = &seeds[..pixels.len()];
        // a pixel with more rays than a beam is traced in several beams
        for first in (0..count).step_by(BEAM) {
            let each = (count - first).min(BEAM as u32) as usize;
            let draws = self.bank.draws(seeds, first, each as u32);
            let mut beam = RayBeam {
                rays: [Ray::ANY; BEAM],
                cones: [Cone { width: 0.0, spread: 0.0 }; BEAM],
                count: each * pixels.len(),
                each,
                paths: 0,
                sparse: None,
                in_bounds: false,
            };
            let paths = (paths.saturating_sub(first) as usize).min(each);
            let of_pixel = all_ones(paths);
            beam.sparse = (self.is_sparse && paths > 0).then(|| SparsePaths::new(pixels, seeds, each, paths));
            let (mut in_pixel, mut in_bin) = (draws.pair(PLACE_PAIR), draws.pair(SLOPE_PAIR));
            // append the rays of every pixel
            for (number, [row, col]) in pixels.iter().enumerate() {
                let (pixel, at) = (self.rays.pixel(*row, *col), number * each);
                pixel.fill(&mut beam.rays[at..at + each], |index| {
                    [centred(in_pixel.of(at + index)), centred(in_bin.of(at + index))]
                });
                beam.cones[at..at + each].fill(pixel.cone);
                beam.paths |= of_pixel << at;
                beam.in_bounds |= pixel.in_bounds;
            }
            take(&mut beam, &draws);
        }
    }
}

/// Rays of one pixel, or of neighbouring pixels, that are traced together.
pub(super) struct RayBeam {
    rays: [Ray; BEAM],
    cones: [Cone; BEAM],
    count: usize,
    /// Number of rays of a pixel. The rays of a pixel are successive.
    pub(super) each: usize,
    /// Bit i is set if ray i continues as a path.
    pub(super) paths: u32,
    /// The groups of the rays, with [`Settings::sparse_paths`].
    pub(super) sparse: Option<SparsePaths>,
    /// False if no ray can hit the scene.
    pub(super) in_bounds: bool,
}

impl RayBeam {
    /// Returns the rays and their cones.
    pub(super) fn parts(&mut self) -> (&mut [Ray], &[Cone]) {
        (&mut self.rays[..self.count], &self.cones[..self.count])
    }
}

/// Returns the position of a ray of a beam, in pixels from the pixel's centre.
pub(super) fn place_in_pixel(draws: &Draws<'_>, index: usize) -> [f32; 2] {
    centred(draws.numbers(PLACE_PAIR, index))
}

/// Converts numbers in 0..1 to offsets −0.5..0.5 from a centre.
fn centred(pair: [f32; 2]) -> [f32; 2] {
    pair.map(|u| u - 0.5)
}
