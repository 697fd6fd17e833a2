//! A scene that contains one file of splats.

use glam::{Affine3A, Vec3};
use lumistack_core::Task;
use lumistack_scene::{PlacedCloud, Scene, SceneError, SceneParts};
use thiserror::Error;

use crate::read::{Found, ReadError, read};

/// Errors of [`scene`].
#[derive(Debug, Error)]
pub enum LoadError {
    /// The file cannot be read.
    #[error("{name}: {source}")]
    Read {
        /// The file as the caller named it.
        name: String,
        /// Place in the file, and the reason why it cannot be read.
        source: ReadError,
    },
    /// The file has no splats, or none that can be rendered.
    #[error("{name}: {source}")]
    Scene {
        /// The file as the caller named it.
        name: String,
        /// Place in the file, and the reason why nothing can be rendered.
        source: SceneError,
    },
}

/// Reads a `.ply`, `.spz` or SOG file into a scene; the format's up direction becomes y.
///
/// `beside` returns the content of a file that a SOG's `meta.json` names. `task` receives a warning
/// for each kind of data that was not read.
///
/// # Errors
/// If the file is not valid, or has no splat that can be rendered.
pub fn scene(
    name: &str,
    bytes: &[u8],
    beside: &dyn Fn(&str) -> Result<Vec<u8>, String>,
    task: Task<'_>,
) -> Result<Scene, LoadError> {
    let found = read(bytes, beside).map_err(|source| LoadError::Read { name: name.to_owned(), source })?;
    let Found { cloud, axes, left_out } = found;
    left_out.iter().for_each(|message| task.warn(name, message));
    let scene_from_cloud = Affine3A::from_rotation_translation(axes.scene_from_file(), Vec3::ZERO);
    let parts = SceneParts {
        name: name.to_owned(),
        clouds: vec![cloud],
        placed_clouds: vec![PlacedCloud { cloud: 0, scene_from_cloud }],
        ..SceneParts::default()
    };
    parts.validate(task).map_err(|source| LoadError::Scene { name: name.to_owned(), source })
}
