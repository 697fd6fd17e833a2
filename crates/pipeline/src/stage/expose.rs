//! Exposes traced views, which makes display-referred light fields. All views have one exposure and
//! tone curve, and a background if the job has one.
//!
//! ```text
//! L = (1 − m) · curve(exposure · radiance / (1 − m)) + m · background
//!
//! m: fraction of a pixel that shows the background
//! ```
//!
//! If the job has a background colour, views are traced without a visible environment. Therefore
//! neither the exposure nor the cached views depend on the colour.

use lumistack_core::Task;
use lumistack_core::tone::ToneCurve;
use lumistack_display::LightField;
use lumistack_field_io::Paged;
use lumistack_shot::{Brightest, ToneMapping, expose_over};
use lumistack_splats::Space;

use super::denoise::{self, Denoised};
use super::fields::{FieldJob, Shot};
use super::groups::in_groups;
use super::trace::Traced;
use crate::error::{PipelineError, field_error};
use crate::job::Background;

/// Light fields of a shot: display-referred or, with `linear`, scene-linear.
pub(crate) struct Exposed {
    /// Target of the display. Views that the options do not select are black.
    pub(crate) target: LightField,
    /// Held-out views, whose slopes are between the slopes of the target's views.
    pub(crate) held_out: Option<LightField>,
    /// Views outside the viewing zone.
    pub(crate) outside: Option<LightField>,
    /// Exposure and tone curve of all views.
    pub(crate) tone_mapping: ToneMapping,
    /// Results of the denoiser on the target, if there was a denoiser.
    pub(crate) denoised: Option<Denoised>,
}

/// Reads the finished views of all light fields and applies one exposure and tone curve. With
/// `linear`, values remain scene-linear.
///
/// # Errors
/// If a view is missing, the scene's background cannot be traced, a file cannot be written, or the
/// task is cancelled.
pub(crate) fn run(shot: Shot<'_>, traced: &Traced, linear: bool, task: Task<'_>) -> Result<Exposed, PipelineError> {
    let all: usize = traced.fields.iter().map(|field| field.geometry.grid.iter().count()).sum();
    task.progress.begin("expose", all as u64, "views");
    let exposed = expose(shot, traced, linear, task);
    task.progress.end();
    exposed
}

fn expose(shot: Shot<'_>, traced: &Traced, linear: bool, task: Task<'_>) -> Result<Exposed, PipelineError> {
    let Shot { job, ingested, .. } = shot;
    let Traced { fields, depths, views, .. } = traced;
    let kind = shot.denoise();
    let read = |one: &FieldJob, view| one.radiance(view, shot);
    // Read the views of each light field into memory. A light field that is too large is read
    // later, view by view. Such a target is read twice: for the exposure, and for the result.
    let mut radiance = Vec::new();
    for one in fields {
        let mut field = None;
        if job.render.is_held(&one.geometry) {
            let held = field.insert(LightField::black(one.geometry.clone())?);
            let read_one = |_: usize, &view: &[usize; 2], _: Task<'_>| Ok((view, read(one, view)?));
            in_groups(&one.wanted(views), task, read_one, |(view, picture)| {
                held.view_mut(view).copy_from_slice(&picture);
                Ok(())
            })?;
        }
        radiance.push(field);
    }
    // Choose exposure and tone curve by the target's views. All light fields get this exposure and
    // tone curve.
    let tone_mapping = if linear {
        ToneMapping { exposure: 1.0, curve: ToneCurve::Linear }
    } else {
        let (brightest, mut rays) = (Brightest::new(&fields[0].geometry, views.len(), depths), Vec::new());
        let of_view = |number: usize, &view: &[usize; 2], _: Task<'_>| match &radiance[0] {
            Some(held) => Ok(brightest.of_view(number, view, held.view(view))),
            None => Ok(brightest.of_view(number, view, &read(&fields[0], view)?)),
        };
        in_groups(views, task, of_view, |of_view| {
            rays.extend(of_view);
            Ok(())
        })?;
        ToneMapping::choose(&job.light, &ingested.scene, &rays)
    };
    // Read the results of the denoiser on the target's views, for the report.
    let denoised = denoise::denoised(&fields[0], kind, tone_mapping)?;
    // This closure exposes one view. If the job has a background colour, each pixel gets this
    // colour in the fraction that shows the background.
    let expose_view = |field: &FieldJob, view: [usize; 2], rgb: &mut [f32]| -> Result<(), PipelineError> {
        if linear {
            // Scene-linear values are neither exposed, nor clipped, nor rounded.
            return Ok(());
        }
        if let Background::Colour(background) = job.light.background {
            let missed = field.missed(view, shot, task)?;
            expose_over(tone_mapping, background, Space::of(&ingested.scene), &missed, rgb);
        } else {
            tone_mapping.apply_to(rgb);
        }
        lumistack_field_io::round_to_half(rgb);
        Ok(())
    };
    // Expose every light field: in memory, or view by view into a mapped file.
    let (mut target, mut held_out, mut outside) = (None, None, None);
    for (field, radiance) in fields.iter().zip(radiance) {
        let (wanted, grid) = (field.wanted(views), &field.geometry.grid);
        let exposed = match radiance {
            Some(mut held) => {
                for &view in &wanted {
                    expose_view(field, view, held.view_mut(view))?;
                }
                held
            }
            None => {
                let paged = Paged::begin(field.geometry.clone(), &field.folder, job.render.window_bytes());
                let mut paged = paged.map_err(field_error)?;
                let all: Vec<[usize; 2]> = grid.iter().collect();
                let read_one = |_: usize, view: &[usize; 2], _: Task<'_>| {
                    let is_wanted = wanted.contains(view);
                    Ok((*view, is_wanted.then(|| read(field, *view)).transpose()?))
                };
                in_groups(&all, task, read_one, |(view, picture)| {
                    let picture = match picture {
                        Some(mut picture) => expose_view(field, view, &mut picture).map(|()| picture)?,
                        None => vec![0.0; 3 * field.geometry.rows * field.geometry.cols],
                    };
                    paged.write(&picture).map_err(field_error)
                })?;
                paged.finish().map_err(field_error)?
            }
        };
        task.progress.advance(grid.iter().count() as u64, "");
        match field.name {
            "target" => target = Some(exposed),
            "held-out" => held_out = Some(exposed),
            _ => outside = Some(exposed),
        }
    }
    // Only the target must exist; held-out views and views outside the zone may be absent.
    let target = target.ok_or_else(|| PipelineError::job("views", "at least one", "none"))?;
    Ok(Exposed { target, held_out, outside, tone_mapping, denoised })
}
