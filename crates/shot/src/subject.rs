//! The scene in front of which a display is placed.

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
