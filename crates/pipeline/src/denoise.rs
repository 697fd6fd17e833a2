//! Denoising of a rendered light field: views in two halves in, filtered views and what was done to them out.
//!
//! ```text
//! cache/views/target-KEY/view_YY_XX-a.exr -b.exr       halves of the samples, as traced
//! cache/views/target-KEY/guided/view_YY_XX.exr       filtered; figures.json is written last
//! ```
//!
//! A run that is stopped goes on from its finished halves, and another filter costs no rendering.

use std::path::{Path, PathBuf};

use lumistack_core::{Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_pathtracer::denoise::{self, Estimate, NoisyView, ViewFigures, Window as Around};
use lumistack_pathtracer::{Checks, Renderer, Settings};
use lumistack_report::{DenoisedView, Denoising};
use lumistack_scene::Window;

use crate::error::PipelineError;
use crate::files::{read_json, write_json};
use crate::job::Denoise;
use crate::look::Look;
use crate::oidn::Oidn;
use crate::render::{read_view, render_error, view_path};
use crate::sealed;

/// Rays per pixel that the guides are averaged over.
pub(crate) const FEATURE_SAMPLES: u32 = 16;
/// Paths of each render of a checked pixel, over those of a pixel of the views.
const CHECK_FACTOR: u32 = 2;
/// What the path tracer takes.
const MOST_SAMPLES: u32 = 65536;

/// What a denoiser did to the target.
pub(crate) struct Denoised {
    kind: Denoise,
    /// Per view, in the order of the grid; exposed radiance.
    figures: Vec<ViewFigures>,
    /// The middle view as it was, `[row][col][rgb]`, as displayed.
    unbiased: Vec<f32>,
    /// The middle view as it became, likewise.
    filtered: Vec<f32>,
}

/// The traced views of a light field and the place of the filtered ones.
pub(crate) struct Traced<'a> {
    pub(crate) geometry: &'a FieldGeometry,
    pub(crate) settings: Settings,
    /// Where the halves lie.
    pub(crate) folder: &'a Path,
    /// Whether errors are to be measured.
    pub(crate) checked: bool,
}

/// Parts in which views are traced: the filters need two halves.
pub(crate) fn parts(kind: Denoise) -> &'static [Option<usize>] {
    if kind == Denoise::Off { &[None] } else { &[Some(0), Some(1)] }
}

/// Where finished views lie.
pub(crate) fn finished(kind: Denoise, folder: &Path) -> PathBuf {
    if kind == Denoise::Off { folder.to_owned() } else { folder.join(kind.name()) }
}

/// Fails early where a filter cannot be had: before an hour of rendering, not after.
pub(crate) fn check(kind: Denoise) -> Result<(), PipelineError> {
    if kind == Denoise::Oidn { Oidn::find().map(drop) } else { Ok(()) }
}

impl Traced<'_> {
    /// Whether the filter has been here.
    pub(crate) fn is_finished(&self, kind: Denoise) -> bool {
        let folder = finished(kind, self.folder);
        let is_there = |view| read_view(&view_path(&folder, view, None), self.geometry).is_some();
        kind == Denoise::Off || (read_figures(&folder).is_some() && self.geometry.grid.iter().all(is_there))
    }

    /// Filters the views; what was done to them is written last.
    ///
    /// # Errors
    /// When cancelled, when a file cannot be written, or when Open Image Denoise is asked for and fails.
    pub(crate) fn filter(
        &self,
        kind: Denoise,
        renderer: &Renderer,
        window: &Window,
        task: Task<'_>,
    ) -> Result<(), PipelineError> {
        let (geometry, settings) = (self.geometry, self.settings);
        let noisy = |view| -> Result<NoisyView, PipelineError> {
            let features =
                renderer.render_features(window, geometry, view, FEATURE_SAMPLES, settings.angular_filter, task);
            let halves = [self.half(view, 0)?, self.half(view, 1)?];
            let noisy = NoisyView { halves, features: features.map_err(render_error)? };
            task.progress.advance(1, "");
            Ok(noisy)
        };
        let count = geometry.grid.iter().count() as u64;
        task.progress.begin("guides of the denoiser", count, "views");
        let views: Result<Vec<NoisyView>, _> = geometry.grid.iter().map(noisy).collect();
        task.progress.end();
        let views = views?;
        let folder = finished(kind, self.folder);
        std::fs::create_dir_all(&folder).map_err(PipelineError::write(&folder))?;
        let filtered = run_filter(kind, geometry, &views, &folder, task)?;
        let of_checks = Settings { samples: (CHECK_FACTOR * settings.samples).min(MOST_SAMPLES), ..settings };
        let mut told = Vec::new();
        let stage = if self.checked { "check the denoiser" } else { "write views" };
        task.progress.begin(stage, count, "views");
        let checked = geometry.grid.iter().zip(&views).zip(&filtered).try_for_each(|((view, noisy), picture)| {
            write_view(&view_path(&folder, view, None), picture)?;
            let checks = if self.checked {
                renderer.render_checks(window, geometry, view, &of_checks, task).map_err(render_error)?
            } else {
                Checks::default()
            };
            let figures = denoise::figures(picture, noisy, &checks);
            told.push((figures.mean, [figures.change, figures.mse_before, figures.mse_after].map(|e| e.parts())));
            task.progress.advance(1, "");
            Ok::<_, PipelineError>(())
        });
        task.progress.end();
        checked?;
        write_json(&figures_path(&folder), &told)
    }

    /// A half of a view, as it was traced.
    fn half(&self, view: [usize; 2], half: usize) -> Result<Tensor<3>, PipelineError> {
        let path = view_path(self.folder, view, Some(half));
        read_view(&path, self.geometry)
            .and_then(|values| {
                Tensor::from_vec(["row", "col", "rgb"], [self.geometry.rows, self.geometry.cols, 3], values).ok()
            })
            .ok_or_else(|| PipelineError::value(&path, "cached view", "the picture just written", "another or none"))
    }

    /// What the report tells of the filter.
    ///
    /// # Errors
    /// When what the filter wrote is not there.
    pub(crate) fn denoised(&self, kind: Denoise, look: Look) -> Result<Option<Denoised>, PipelineError> {
        if kind == Denoise::Off {
            return Ok(None);
        }
        let folder = finished(kind, self.folder);
        let path = figures_path(&folder);
        let missing = || PipelineError::value(&path, "content", "the figures just written", "others or none");
        let mut figures = read_figures(&folder).ok_or_else(missing)?;
        for f in &mut figures {
            f.mean *= look.exposure;
            f.change = f.change.scaled(look.exposure);
            f.mse_before = f.mse_before.scaled(look.exposure.powi(2));
            f.mse_after = f.mse_after.scaled(look.exposure.powi(2));
        }
        let middle = self.geometry.grid.views().map(|count| count / 2);
        let (a, b) = (self.half(middle, 0)?, self.half(middle, 1)?);
        let mut unbiased: Vec<f32> = a.data().iter().zip(b.data()).map(|(a, b)| 0.5 * (a + b)).collect();
        let mut filtered = read_view(&view_path(&folder, middle, None), self.geometry).ok_or_else(missing)?;
        look.apply_to(&mut unbiased);
        look.apply_to(&mut filtered);
        Ok(Some(Denoised { kind, figures, unbiased, filtered }))
    }
}

impl Denoised {
    /// For the report.
    pub(crate) fn about(&self) -> Denoising<'_> {
        let pair = |estimate: Estimate| [estimate.value(), estimate.error()];
        let view = |figures: &ViewFigures| DenoisedView {
            mean: figures.mean,
            mean_change: pair(figures.change),
            mse_before: pair(figures.mse_before),
            mse_after: pair(figures.mse_after),
        };
        let all = |of: fn(&ViewFigures) -> Estimate| Estimate::joined(self.figures.iter().map(of));
        let overall = ViewFigures {
            mean: self.figures.iter().map(|f| f.mean).sum::<f64>() / self.figures.len() as f64,
            change: all(|f| f.change),
            mse_before: all(|f| f.mse_before),
            mse_after: all(|f| f.mse_after),
        };
        let name = match self.kind {
            Denoise::Oidn => "Intel Open Image Denoise, view by view",
            Denoise::Guided | Denoise::Off => "the guided filter over all views",
        };
        Denoising {
            name,
            overall: view(&overall),
            views: self.figures.iter().map(view).collect(),
            unbiased: &self.unbiased,
            filtered: &self.filtered,
        }
    }
}

fn run_filter(
    kind: Denoise,
    geometry: &FieldGeometry,
    views: &[NoisyView],
    folder: &Path,
    task: Task<'_>,
) -> Result<Vec<Tensor<3>>, PipelineError> {
    match kind {
        Denoise::Off => Ok(views.iter().map(NoisyView::mean).collect()),
        Denoise::Guided => {
            task.progress.begin("denoise", denoise::steps(geometry), "bands");
            let filtered = denoise::denoise(geometry, views, Around::default(), task);
            task.progress.end();
            Ok(filtered?)
        }
        Denoise::Oidn => {
            let oidn = Oidn::find()?;
            let exchange = folder.join("exchange");
            std::fs::create_dir_all(&exchange).map_err(PipelineError::write(&exchange))?;
            task.progress.begin("denoise", views.len() as u64, "views");
            let one = |view: &NoisyView| -> Result<Tensor<3>, PipelineError> {
                task.cancel.check()?;
                let mut picture = view.mean();
                let values = oidn.denoise(picture.data(), &view.features, &exchange)?;
                picture.data_mut().copy_from_slice(&values);
                task.progress.advance(1, &oidn.version);
                Ok(picture)
            };
            let filtered: Result<Vec<_>, PipelineError> = views.iter().map(one).collect();
            task.progress.end();
            let removed = std::fs::remove_dir_all(&exchange).map_err(PipelineError::write(&exchange));
            let filtered = filtered?;
            removed.map(|()| filtered)
        }
    }
}

fn figures_path(folder: &Path) -> PathBuf {
    folder.join("figures.json")
}

/// What was done to the views in a folder; `None` before it is finished.
fn read_figures(folder: &Path) -> Option<Vec<ViewFigures>> {
    let list: Vec<(f64, [[f64; 3]; 3])> = read_json(&figures_path(folder))?;
    let figures = list.into_iter().map(|(mean, parts)| {
        let [change, mse_before, mse_after] = parts.map(Estimate::from_parts);
        ViewFigures { mean, change, mse_before, mse_after }
    });
    Some(figures.collect())
}

/// Writes a view, linear.
///
/// # Errors
/// When the file cannot be written.
pub(crate) fn write_view(path: &Path, picture: &Tensor<3>) -> Result<(), PipelineError> {
    let [rows, cols, _] = picture.shape();
    sealed::write_picture(path, [cols, rows], picture.data())
}
