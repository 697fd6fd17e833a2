//! Changes to a validated scene.

use lumistack_core::Task;
use lumistack_scene::{Scene, SceneError, SceneParts};

use crate::error::ShotError;

/// Applies `change` to the parts of a scene and validates the result.
///
/// # Errors
/// If `change` fails, or if the changed scene is not valid.
pub fn edited<E: From<ShotError>>(
    scene: Scene,
    task: Task<'_>,
    change: impl FnOnce(&mut SceneParts) -> Result<(), E>,
) -> Result<Scene, E> {
    let mut parts = scene.into_parts();
    let name = parts.name.clone();
    change(&mut parts)?;
    parts.validate(task).map_err(|source: SceneError| ShotError::Scene { name, source }.into())
}
