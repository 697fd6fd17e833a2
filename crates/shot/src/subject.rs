//! What a display is put in front of.

use lumistack_core::{Cancelled, Task};
use lumistack_scene::Scene;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::ShotError;
use crate::renderer::SceneRenderer;

/// A lit scene, its renderer, and a memory for what was found out about it.
pub trait Subject {
    /// What can go wrong beside what a shot can.
    type Error: From<ShotError> + From<Cancelled>;

    /// The scene.
    fn scene(&self) -> &Scene;

    /// The scene prepared for rendering, once for all who ask.
    ///
    /// # Errors
    /// When it cannot be rendered, or when cancelled.
    fn renderer(&self, task: Task<'_>) -> Result<&SceneRenderer, Self::Error>;

    /// The answer to a question of some `kind` about the scene, which `of` tells from others of that kind: one that was kept, or what `make` finds.
    ///
    /// # Errors
    /// Those of `make`, and when the answer cannot be kept.
    fn remembered<T: Serialize + DeserializeOwned>(
        &self,
        kind: &str,
        of: &str,
        make: impl FnOnce() -> Result<T, Self::Error>,
    ) -> Result<T, Self::Error>;
}
