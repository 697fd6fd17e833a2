//! Scores of every view of a light field.

use lumistack_core::Task;
use lumistack_core::colour::luminance;
use lumistack_core::metrics::{Flip, Mean, SquaredError, ssim};
use lumistack_display::{EmittedView, FieldGeometry, LightField, RayMap, Simulator, Weights, view_error};
use rayon::prelude::*;

use crate::{ReportError, ReportInput, ZoneView};

/// Scores of one view, over the rays that scores include.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ViewFigures {
    /// Error of L̃/β against L, in linear light.
    pub(crate) error: SquaredError,
    /// SSIM of L̃/β and L, sRGB-encoded.
    pub(crate) ssim: Mean,
    /// FLIP error of L̃/β against L, from linear light.
    pub(crate) flip: Mean,
    /// Mean luminance of L̃.
    pub(crate) emitted: Mean,
    /// Mean luminance of L.
    pub(crate) wanted: Mean,
}

/// Scores of a light field's views.
#[derive(Clone, Debug)]
pub(crate) struct FieldScore {
    pub(crate) geometry: FieldGeometry,
    /// The views, in row order.
    views: Vec<ViewFigures>,
    brightness: f64,
}

/// Simulates views and compares them with their targets.
pub(crate) struct Judge<'a> {
    pub(crate) input: &'a ReportInput<'a>,
    pub(crate) simulator: Simulator<'a>,
    flip: Flip,
}

impl<'a> Judge<'a> {
    pub(crate) fn new(input: &'a ReportInput<'a>) -> Self {
        let simulator = Simulator::new(input.display, input.stack);
        Self { input, simulator, flip: Flip::new(input.pixels_per_degree) }
    }

    /// Simulates all views of a light field in parallel, and passes them to `each` in row order.
    pub(crate) fn field(
        &self,
        field: &LightField,
        weights: &Weights,
        task: Task,
        mut each: impl FnMut([usize; 2], &ViewFigures, EmittedView),
    ) -> Result<FieldScore, ReportError> {
        let geometry = field.geometry();
        let map = RayMap::new(self.input.display, geometry);
        let order: Vec<[usize; 2]> = geometry.grid.iter().collect();
        let mut views = Vec::with_capacity(order.len());
        for together in order.chunks(rayon::current_num_threads()) {
            task.cancel.check()?;
            let done: Vec<_> = together
                .par_iter()
                .map(|&view| {
                    let emitted = self.simulator.view(&map, geometry, view);
                    let counts = counting(&emitted, geometry, weights, view);
                    (self.figures(geometry, field.view(view), &emitted, &counts), emitted)
                })
                .collect();
            for (view, (figures, emitted)) in together.iter().zip(done) {
                each(*view, &figures, emitted);
                views.push(figures);
                task.progress.advance(1, "");
            }
        }
        Ok(FieldScore { geometry: geometry.clone(), views, brightness: self.input.stack.brightness })
    }

    /// Returns the scores of a direction of the zone. The squared error is that of the zone score,
    /// which excludes the noise of rendered references.
    pub(crate) fn zone_view(&self, view: &ZoneView) -> ViewFigures {
        let figures = self.figures(self.input.target.geometry(), &view.target, &view.seen, &view.seen.valid);
        let count = 3 * view.score.pixels as u64;
        ViewFigures { error: SquaredError { sum: view.score.mse.max(0.0) * count as f64, count }, ..figures }
    }

    fn figures(&self, geometry: &FieldGeometry, target: &[f32], emitted: &EmittedView, counts: &[bool]) -> ViewFigures {
        let shape = [geometry.rows, geometry.cols];
        let weight = |i: usize| if counts[i] { 1.0 } else { 0.0 };
        let shown = seen(emitted, target, self.input.stack.brightness, counts);
        let mean = |rgb: &[f32]| {
            let pixels = rgb.chunks_exact(3).zip(counts).filter(|(_, counts)| **counts);
            pixels.fold(Mean::default(), |mean, (rgb, _)| {
                mean.merged(Mean { sum: f64::from(luminance([rgb[0], rgb[1], rgb[2]])), count: 1 })
            })
        };
        ViewFigures {
            error: view_error(emitted, target, self.input.stack.brightness, weight),
            ssim: ssim(target, &shown, shape).mean_where(|i| counts[i]),
            flip: self.flip.compare(target, &shown, shape).mean_where(|i| counts[i]),
            emitted: mean(emitted.radiance.data()),
            wanted: mean(target),
        }
    }
}

/// Returns, for each ray of a view, true if scores include it. Such a ray hits the display and has
/// a weight above 0.
pub(crate) fn counting(
    emitted: &EmittedView,
    geometry: &FieldGeometry,
    weights: &Weights,
    view: [usize; 2],
) -> Vec<bool> {
    let weight = |i: usize| weights.at(view, i / geometry.cols, i % geometry.cols);
    emitted.valid.iter().enumerate().map(|(i, valid)| *valid && weight(i) > 0.0).collect()
}

/// Returns L̃/β. A ray that is excluded from the scores gets the target's value, so it adds neither
/// error nor edges.
pub(super) fn seen(emitted: &EmittedView, target: &[f32], brightness: f64, counts: &[bool]) -> Vec<f32> {
    let scale = (1.0 / brightness) as f32;
    let pixels = emitted.radiance.data().chunks_exact(3).zip(target.chunks_exact(3)).zip(counts);
    pixels
        .flat_map(|((l, t), counts)| if *counts { [0, 1, 2].map(|c| l[c] * scale) } else { [t[0], t[1], t[2]] })
        .collect()
}

impl FieldScore {
    /// Returns the PSNR of all rays, L̃/β against L, dB.
    pub(crate) fn psnr_view(&self) -> f64 {
        self.total(|view| view.error, SquaredError::merged).psnr()
    }

    /// Returns the PSNR of all rays, L̃ against βL, dB.
    pub(crate) fn psnr_raw(&self) -> f64 {
        self.psnr_view() - 20.0 * self.brightness.log10()
    }

    /// Returns the mean of a score over all rays.
    pub(crate) fn mean(&self, figure: impl Fn(&ViewFigures) -> Mean) -> f64 {
        self.total(figure, Mean::merged).value()
    }

    /// Returns the scores of one view; `view` = [view_y, view_x].
    pub(crate) fn view(&self, view: [usize; 2]) -> &ViewFigures {
        &self.views[view[0] * self.geometry.grid.views()[1] + view[1]]
    }

    /// Returns the fraction of a view's rays that scores include, 0..1.
    pub(crate) fn counted_share(&self, view: [usize; 2]) -> f64 {
        self.view(view).error.count as f64 / (3 * self.geometry.rows * self.geometry.cols) as f64
    }

    /// Returns the view with the lowest PSNR; `None` if no view has a finite PSNR.
    pub(crate) fn worst_view(&self) -> Option<[usize; 2]> {
        let figures = self.geometry.grid.iter().map(|view| (view, self.view(view).error.psnr()));
        figures.filter(|(_, psnr)| psnr.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(view, _)| view)
    }

    fn total<T: Default>(&self, part: impl Fn(&ViewFigures) -> T, merge: impl Fn(T, T) -> T) -> T {
        self.views.iter().fold(T::default(), |sum, view| merge(sum, part(view)))
    }
}
