//! The scene in front of which a display is placed.

use std::sync::Arc;

use lumistack_core::{Cancelled, Task};
use lumistack_scene::Scene;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::ShotError;
use crate::renderer::SceneRenderer;

/// A lit scene, its renderer, and a cache of results about it.
pub trait Subject {
    /// Error of the implementation, which can also hold a [`ShotError`].
    type Error: From<ShotError> + From<Cancelled>;

    /// Returns the lit scene in front of which a display is placed.
    fn scene(&self) -> &Scene;

    /// Returns the scene prepared for rendering. The first call prepares it.
    ///
    /// # Errors
    /// If the scene cannot be rendered, or the task was cancelled.
    fn renderer(&self, task: Task<'_>) -> Result<&SceneRenderer, Self::Error>;

    /// Returns the cached result of `kind` with the key `of`, or computes it by `make` and caches
    /// it.
    ///
    /// # Errors
    /// The errors of `make`. It is also an error if the result cannot be written to the cache.
    fn remembered<T: Serialize + DeserializeOwned>(
        &self,
        kind: &str,
        of: &str,
        make: impl FnOnce() -> Result<T, Self::Error>,
    ) -> Result<T, Self::Error>;
}

/// A lit scene in memory, whose results are not cached. It serves programs that place a display
/// once.
pub struct LitScene {
    /// The scene, with its light.
    pub scene: Arc<Scene>,
    /// The scene prepared for rendering.
    pub renderer: SceneRenderer,
}

impl LitScene {
    /// Prepares a scene that [`light::lit`](crate::light::lit) returned.
    ///
    /// # Errors
    /// If the scene cannot be rendered, or the task was cancelled.
    pub fn new(scene: Arc<Scene>, task: Task<'_>) -> Result<Self, ShotError> {
        Ok(Self { renderer: SceneRenderer::new(scene.clone(), task)?, scene })
    }
}

impl Subject for LitScene {
    type Error = ShotError;

    fn scene(&self) -> &Scene {
        &self.scene
    }

    fn renderer(&self, _task: Task<'_>) -> Result<&SceneRenderer, ShotError> {
        Ok(&self.renderer)
    }

    fn remembered<T: Serialize + DeserializeOwned>(
        &self,
        _kind: &str,
        _of: &str,
        make: impl FnOnce() -> Result<T, ShotError>,
    ) -> Result<T, ShotError> {
        make()
    }
}
