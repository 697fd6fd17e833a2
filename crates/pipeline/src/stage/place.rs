//! Places the window in a scene with the crate `shot`, and caches the results.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{Display, FieldGeometry};
use lumistack_scene::{Scene, Window};
use lumistack_shot::{Placement, SceneRenderer, Subject, find_window};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::PipelineError;
use crate::job::WindowJob;
use crate::stage::ingest::Ingested;
use crate::store::code;
use crate::store::key::KeyBuilder;
use crate::store::stamps::remembered;

/// A loaded scene, and the folder in which results are cached.
struct CachedScene<'a> {
    ingested: &'a Ingested,
    cache_dir: Option<&'a Path>,
}

impl Subject for CachedScene<'_> {
    type Error = PipelineError;

    fn scene(&self) -> &Scene {
        &self.ingested.scene
    }

    fn renderer(&self, task: Task<'_>) -> Result<&SceneRenderer, PipelineError> {
        self.ingested.renderer(task)
    }

    fn remembered<T: Serialize + DeserializeOwned>(
        &self,
        kind: &str,
        of: &str,
        make: impl FnOnce() -> Result<T, PipelineError>,
    ) -> Result<T, PipelineError> {
        let mut key = KeyBuilder::new(kind, code::VIEWS);
        self.ingested.add_to(&mut key);
        let key = key.add("of", of.as_bytes()).finish();
        remembered(self.cache_dir, &format!("{kind}-{}.json", &key[..16]), make)
    }
}

/// Calls [`lumistack_shot::place()`] for a loaded scene.
///
/// # Errors
/// The errors of [`lumistack_shot::place()`], and an error if a result cannot be written.
pub(crate) fn place(
    ingested: &Ingested,
    job: &WindowJob,
    display: &Display,
    geometry: &FieldGeometry,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<Placement, PipelineError> {
    lumistack_shot::place(&CachedScene { ingested, cache_dir }, job, display, geometry, task)
}

/// Calls [`find_window`] for a loaded scene. Returns the window that it finds, which is not yet
/// moved to fit the depth.
///
/// # Errors
/// The errors of [`find_window`], and an error if a result cannot be written.
pub fn place_window(
    ingested: &Ingested,
    job: &WindowJob,
    geometry: &FieldGeometry,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<Window, PipelineError> {
    find_window(&CachedScene { ingested, cache_dir }, job, geometry, task).map(|found| found.window)
}
