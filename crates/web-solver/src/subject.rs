//! A lit scene in memory.

use std::sync::Arc;

use lumistack_core::Task;
use lumistack_scene::Scene;
use lumistack_shot::{SceneRenderer, Subject};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::Error;

/// A lit scene and its renderer. Rendered views are not cached, since the page needs each view only
/// once.
pub(crate) struct Held {
    pub(crate) scene: Arc<Scene>,
    pub(crate) renderer: SceneRenderer,
}

impl Held {
    pub(crate) fn new(scene: Arc<Scene>, task: Task<'_>) -> Result<Self, Error> {
        Ok(Self { renderer: SceneRenderer::new(scene.clone(), task)?, scene })
    }

    /// Returns true if the path tracer renders the views of this scene: it has surfaces, or a
    /// background behind its splats.
    pub(crate) fn is_traced(&self) -> bool {
        !self.scene.instances.is_empty() || self.scene.environment.is_some() || self.scene.backdrop.is_some()
    }
}

impl Subject for Held {
    type Error = Error;

    fn scene(&self) -> &Scene {
        &self.scene
    }

    fn renderer(&self, _task: Task<'_>) -> Result<&SceneRenderer, Error> {
        Ok(&self.renderer)
    }

    fn remembered<T: Serialize + DeserializeOwned>(
        &self,
        _kind: &str,
        _of: &str,
        make: impl FnOnce() -> Result<T, Error>,
    ) -> Result<T, Error> {
        make()
    }
}
