//! Renders views of a scene in passes. Each pass lowers the noise of all views.
//!
//! ```text
//! pass 1, 2, 3, ...: 1, 1, 2, 4, ... more paths per pixel and view
//! result: mean of all paths so far ─▶ light shared between views ─▶ splats in front
//! ```
//!
//! The first pass traces one path per pixel and view. If n views share light, the noise of this
//! pass is about the noise of n paths per pixel.

use lumistack_core::{Task, Tensor};
use lumistack_display::LightField;
use lumistack_pathtracer::denoise::SharedLight;
use lumistack_pathtracer::{Renderer, Settings, SplitView};
use lumistack_shot::{put_before, slopes};
use lumistack_splats::Space;

use crate::error::{PipelineError, render_error};
use crate::job::{Background, Denoise};
use crate::stage::fields::{FieldJob, Shot};

/// Number of paths per pixel that measure the fraction of the pixel in which the background is
/// visible.
const MISSED_SAMPLES: u32 = 4;

/// Views in progress.
pub(super) struct Progressive {
    pub(super) of: FieldJob,
    shares: bool,
    views: Vec<View>,
    pub(super) passes: u32,
}

#[derive(Default)]
struct View {
    place: [usize; 2],
    /// Mean of the values of all passes so far; `None` before the first pass, or if the scene needs
    /// no paths.
    split: Option<SplitView>,
    samples: u32,
    /// Splats in front of the surfaces, `[row][col][r, g, b, T]` with the transmittance T; empty
    /// without splats.
    splats: Vec<f32>,
    /// Fraction of each pixel that shows the background; empty without a background colour.
    missed: Vec<f32>,
}

/// Scene-linear views, and data of their rays for the choice of an exposure.
pub(super) struct Radiance {
    pub(super) field: LightField,
    /// For each ray, its brightest channel, and true if it hits a surface.
    pub(super) brightest: Vec<(f32, bool)>,
}

impl Progressive {
    /// Prepares the target's views. Renders the data that all passes use: the splats and, for a
    /// background colour, the fraction of each pixel that shows this colour.
    ///
    /// # Errors
    /// If the scene cannot be rendered, or when cancelled.
    pub(super) fn new(shot: Shot<'_>, task: Task<'_>) -> Result<Self, PipelineError> {
        let fields = shot.fields(std::path::Path::new(""), false);
        let of = fields.into_iter().next().ok_or_else(|| PipelineError::job("views", "at least one", "none"))?;
        let renderer = shot.ingested.renderer(task)?;
        let mut views: Vec<View> = of.traced.grid.iter().map(|place| View { place, ..View::default() }).collect();
        let places: Vec<[usize; 2]> = views.iter().map(|view| view.place).collect();
        renderer.splat_views(shot.window(), &of.traced, &slopes(&of.traced, &places), task, |number, seen| {
            views[number].splats = seen.light.into_data();
            Ok::<(), PipelineError>(())
        })?;
        if shot.job.light.background != Background::Environment {
            let settings = Settings { samples: MISSED_SAMPLES, ..of.settings };
            for view in &mut views {
                let missed = renderer.tracer.render_misses(shot.window(), &of.traced, view.place, &settings, task);
                view.missed = missed.map_err(render_error)?.into_data();
                view.missed.iter_mut().zip(view.splats.chunks_exact(4)).for_each(|(missed, pixel)| *missed *= pixel[3]);
            }
        }
        Ok(Self { of, shares: shot.job.render.denoise != Denoise::Off, views, passes: 0 })
    }

    /// Traces another pass. Returns false if all samples have been traced. If the pass is
    /// cancelled, views keep the paths that the pass has traced.
    ///
    /// # Errors
    /// If rendering fails or is cancelled.
    pub(super) fn pass(&mut self, shot: Shot<'_>, task: Task<'_>) -> Result<bool, PipelineError> {
        let most = if shot.ingested.scene.needs_paths() { self.of.settings.samples } else { 0 };
        let is_first = self.passes == 0;
        if !is_first && self.views.iter().all(|view| view.samples >= most) {
            return Ok(false);
        }
        let renderer = &shot.ingested.renderer(task)?.tracer;
        for view in &mut self.views {
            let samples = view.samples.max(1).min(most.saturating_sub(view.samples));
            if samples > 0 {
                view.trace(renderer, shot, &self.of, samples, task)?;
            }
        }
        self.passes += 1;
        Ok(true)
    }

    /// Returns the views, computed from all paths so far.
    ///
    /// # Errors
    /// When cancelled.
    pub(super) fn radiance(&self, shot: Shot<'_>, task: Task<'_>) -> Result<Radiance, PipelineError> {
        let samples = self.views.iter().map(|view| view.samples).max().unwrap_or(1);
        let splits: Option<Vec<&SplitView>> = self.views.iter().map(|view| view.split.as_ref()).collect();
        let shared = match &splits {
            Some(splits) if self.shares => {
                let mut light = SharedLight::new(&self.of.traced, &Settings { samples, ..self.of.settings });
                splits.iter().for_each(|split| light.add(split));
                Some(light.averaged(task)?)
            }
            _ => None,
        };
        let mut field = LightField::black(self.of.geometry.clone())?;
        let mut brightest = Vec::new();
        for (number, view) in self.views.iter().enumerate() {
            let to = field.view_mut(view.place);
            if let Some(split) = &view.split {
                let picture = shared.as_ref().map_or_else(|| split.radiance(), |light| light.on(number, split));
                to.copy_from_slice(picture.data());
            }
            if let (false, Some(space)) = (view.splats.is_empty(), Space::of(&shot.ingested.scene)) {
                put_before(space, &view.splats, to);
            }
            let surfaces = view.split.iter().flat_map(SplitView::surfaces).chain(std::iter::repeat(false));
            brightest.extend(to.chunks_exact(3).map(|rgb| rgb[0].max(rgb[1]).max(rgb[2])).zip(surfaces));
        }
        Ok(Radiance { field, brightest })
    }

    /// Returns the fraction of each pixel of view `number` that shows the background; empty without
    /// a background colour.
    pub(super) fn missed(&self, number: usize) -> &[f32] {
        &self.views[number].missed
    }
}

impl View {
    fn trace(
        &mut self,
        renderer: &Renderer,
        shot: Shot<'_>,
        of: &FieldJob,
        samples: u32,
        task: Task<'_>,
    ) -> Result<(), PipelineError> {
        // Another seed gives other paths than in the earlier passes. No pixel gets further paths,
        // since they would delay the passes.
        let settings = Settings { samples, further_paths: false, ..of.seeded(&[3, u64::from(self.samples)]) };
        let new =
            renderer.render_split(shot.window(), &of.traced, self.place, &settings, task).map_err(render_error)?;
        self.split = Some(match self.split.take() {
            None => new,
            Some(before) => mean(before, &new, samples as f32 / (samples + self.samples) as f32),
        });
        self.samples += samples;
        Ok(())
    }
}

/// Averages the values of two renders of a view. The render `new` has the weight `share`. If only
/// one of the renders hits a surface at a pixel, the normal and depth of this render are kept. The
/// smaller α (roughness²) is kept, since light of glass and of mirrors has a small α and cannot be
/// shared.
fn mean(before: SplitView, new: &SplitView, share: f32) -> SplitView {
    let mut values: Tensor<3> = before.values().clone();
    let parts = values.shape()[2];
    let pixels = values.data_mut().chunks_exact_mut(parts).zip(new.values().data().chunks_exact(parts));
    for (old, new) in pixels {
        let is_there = |pixel: &[f32]| pixel[SplitView::SURFACE].iter().any(|value| *value != 0.0);
        let of_surface = match (is_there(old), is_there(new)) {
            (false, true) => 1.0,
            (_, false) => 0.0,
            (true, true) => share,
        };
        let alpha = old[SplitView::ALPHA].min(new[SplitView::ALPHA]);
        for (i, (old, new)) in old.iter_mut().zip(new).enumerate() {
            *old += if SplitView::SURFACE.contains(&i) { of_surface } else { share } * (new - *old);
        }
        old[SplitView::ALPHA] = alpha;
    }
    SplitView::from_values(values).unwrap_or(before)
}
