//! Traced views become display-referred light fields: one exposure and one tone curve for all of them, and a background where the job has one.
//!
//! ```text
//! L = (1 − m) · curve(exposure · radiance / (1 − m)) + m · background          m: share of a pixel's samples that meet no surface
//! ```
//!
//! Radiance is traced without what is seen of the environment, so that neither exposure nor cached views depend on the background.

use std::borrow::Cow;

use lumistack_core::Task;
use lumistack_core::tone::ToneCurve;
use lumistack_display::LightField;
use lumistack_shot::{Look, brightest, expose_over};
use lumistack_splats::Space;

use super::denoise::{self, Denoised};
use super::fields::{FieldJob, Shot};
use super::trace::Traced;
use crate::error::PipelineError;
use crate::job::Background;
use crate::store::paged::Paged;

/// Display-referred light fields.
pub(crate) struct Exposed {
    /// What the display should show. Views that were not wanted are black.
    pub(crate) target: LightField,
    /// In-between views that the solver does not see.
    pub(crate) held_out: Option<LightField>,
    /// Views beyond the outermost ones, which it does not see either.
    pub(crate) outside: Option<LightField>,
    /// How scene-linear radiance became display-referred.
    pub(crate) look: Look,
    /// What the denoiser did to the target, where there is one.
    pub(crate) denoised: Option<Denoised>,
}

/// Reads the finished views of all fields and makes them display-referred, with one look for all; with `linear` leaves them as they are.
///
/// # Errors
/// When a view is not there, or the scene's background cannot be traced.
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
    // what is too large for memory is read twice instead
    let mut radiance = Vec::new();
    for one in fields {
        let mut field = None;
        if job.render.is_held(&one.geometry) {
            let held = field.insert(LightField::black(one.geometry.clone())?);
            for view in one.wanted(views) {
                held.view_mut(view).copy_from_slice(&read(one, view)?);
            }
        }
        radiance.push(field);
    }
    let look = if linear {
        Look { exposure: 1.0, curve: ToneCurve::Linear }
    } else {
        let picture = |view| match &radiance[0] {
            Some(held) => Ok(Cow::Borrowed(held.view(view))),
            None => read(&fields[0], view).map(Cow::Owned),
        };
        Look::choose(&job.light, &ingested.scene, &brightest(&fields[0].geometry, views, depths, picture)?)
    };
    let denoised = denoise::denoised(&fields[0], kind, look)?;
    let expose_view = |field: &FieldJob, view: [usize; 2], rgb: &mut [f32]| -> Result<(), PipelineError> {
        if linear {
            // neither exposed nor clipped nor rounded
            return Ok(());
        }
        if let Background::Colour(background) = job.light.background {
            let missed = field.missed(view, shot, task)?;
            expose_over(look, background, Space::of(&ingested.scene), &missed, rgb);
        } else {
            look.apply_to(rgb);
        }
        lumistack_field_io::round_to_half(rgb);
        Ok(())
    };
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
                let mut paged = Paged::begin(field.geometry.clone(), &field.folder)?;
                let black = vec![0.0; 3 * field.geometry.rows * field.geometry.cols];
                for view in grid.iter() {
                    if wanted.contains(&view) {
                        let mut picture = read(field, view)?;
                        expose_view(field, view, &mut picture)?;
                        paged.write(&picture)?;
                    } else {
                        paged.write(&black)?;
                    }
                }
                paged.finish()?
            }
        };
        task.progress.advance(grid.iter().count() as u64, "");
        match field.name {
            "target" => target = Some(exposed),
            "held-out" => held_out = Some(exposed),
            _ => outside = Some(exposed),
        }
    }
    let target = target.ok_or_else(|| PipelineError::job("views", "at least one", "none"))?;
    Ok(Exposed { target, held_out, outside, look, denoised })
}
