//! The environment turned about the up axis, and the background that is shown instead of it.
//!
//! ```text
//! L = (1 − m) · curve(exposure · radiance / (1 − m)) + m · background          m: share of a pixel's samples that meet no surface
//! ```
//!
//! Radiance is traced without what is seen of the environment, so that neither exposure nor cached views depend on the background.

use glam::Quat;
use lumistack_core::Task;
use lumistack_scene::Scene;

use crate::error::PipelineError;
use crate::job::LightJob;
use crate::light::edited;
use crate::look::Look;

/// Warns where a key about the environment changes nothing, since the scene has none.
pub(crate) fn warn_of_unused(scene: &Scene, job: &LightJob, task: Task<'_>) {
    let changed = [
        ("light.environment_strength", job.environment_strength != 1.0),
        ("light.environment_rotation_deg", job.environment_rotation_deg != 0.0),
    ];
    for (key, _) in changed.into_iter().filter(|(_, changed)| *changed) {
        task.warn(&scene.name, format!("`{key}` changes nothing, since the scene has no environment"));
    }
}

/// Turns the environment as the job says, the studio light like any other.
///
/// # Errors
/// When the changed scene is not valid.
pub(crate) fn turned(scene: Scene, job: &LightJob, task: Task<'_>) -> Result<Scene, PipelineError> {
    if job.environment_rotation_deg == 0.0 {
        return Ok(scene);
    }
    let turn = Quat::from_rotation_y(job.environment_rotation_deg.to_radians() as f32);
    edited(scene, task, |parts| {
        if let Some(environment) = &mut parts.environment {
            environment.scene_from_environment = turn * environment.scene_from_environment;
        }
        Ok(())
    })
}

/// Exposes pixels `[..][rgb]` that are black where no surface is, and puts a background there; `missed` holds m of every pixel.
pub(crate) fn expose_over(look: Look, background: [f32; 3], missed: &[f32], rgb: &mut [f32]) {
    for (pixel, &missed) in rgb.chunks_exact_mut(3).zip(missed) {
        let covered = 1.0 - missed;
        if covered > 0.0 {
            pixel.iter_mut().for_each(|value| *value /= covered);
        }
    }
    look.apply_to(rgb);
    for (pixel, &missed) in rgb.chunks_exact_mut(3).zip(missed) {
        for (value, background) in pixel.iter_mut().zip(background) {
            *value = (1.0 - missed) * *value + missed * background;
        }
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::tone::ToneCurve;

    use super::*;

    #[test]
    fn edges_mix_what_is_shown_of_both() {
        let look = Look { exposure: 2.0, curve: ToneCurve::Linear };
        // a surface of radiance 0.3 that covers all, a quarter and nothing of a pixel
        let mut rgb: Vec<f32> = [0.3, 0.25 * 0.3, 0.0].iter().flat_map(|value| [*value; 3]).collect();
        expose_over(look, [1.0, 0.5, 0.0], &[0.0, 0.75, 1.0], &mut rgb);
        let expected = [0.6, 0.6, 0.6, 0.15 + 0.75, 0.15 + 0.375, 0.15, 1.0, 0.5, 0.0];
        for (found, expected) in rgb.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{rgb:?}");
        }
    }
}
