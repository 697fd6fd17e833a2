//! Rotation of the environment about the up axis, and warnings about keys that need an environment.

use glam::Quat;
use lumistack_core::Task;
use lumistack_scene::Scene;

use crate::edit::edited;
use crate::error::ShotError;
use crate::job::LightJob;

/// Warns of keys about the environment that have no effect, since the scene has no environment.
pub(crate) fn warn_of_unused(scene: &Scene, job: &LightJob, task: Task<'_>) {
    let changed = [
        ("light.environment_strength", job.environment_strength != 1.0),
        ("light.environment_rotation_deg", job.environment_rotation_deg != 0.0),
    ];
    for (key, _) in changed.into_iter().filter(|(_, changed)| *changed) {
        task.warn(&scene.name, format!("`{key}` changes nothing, since the scene has no environment"));
    }
}

/// Rotates the environment by the job's angle. The environment may come from a file or be the
/// studio light.
///
/// # Errors
/// When the changed scene is not valid.
pub(crate) fn turned(scene: Scene, job: &LightJob, task: Task<'_>) -> Result<Scene, ShotError> {
    if job.environment_rotation_deg == 0.0 {
        return Ok(scene);
    }
    let turn = Quat::from_rotation_y(job.environment_rotation_deg.to_radians() as f32);
    edited::<ShotError>(scene, task, |parts| {
        if let Some(environment) = &mut parts.environment {
            environment.scene_from_environment = turn * environment.scene_from_environment;
        }
        Ok(())
    })
}
