//! Scenes.

use std::path::PathBuf;
use std::sync::Arc;

use lumistack_pipeline::{ImporterJob, Ingested, LightJob, PoseJob, load_scene, scene_contents};
use pyo3::prelude::*;

use crate::functions::registry;
use crate::json::{table, table_of};
use crate::work::long;

/// A scene: glTF (.gltf, .glb), or what an importer plugin takes.
///
/// path: the file; time: seconds at which its animations are sampled (without it as its nodes stand); animation, variant: name or number; light: a mapping
/// with the keys of a job's [light], of which environment (a Radiance HDR or OpenEXR file), environment_strength and automatic (whether a scene without light gets
/// the studio light) belong to the scene, and the others are what render() takes unless it is told otherwise; importer: a mapping {"plugin": ..., "params":
/// {...}}. `callback(stage, fraction)` hears of progress.
///
/// The file is read once, and what is made of it for rendering is kept: render() may be called many times.
#[pyclass(frozen, module = "lumistack")]
pub(crate) struct Scene {
    pub(crate) path: PathBuf,
    pub(crate) light: LightJob,
    pub(crate) ingested: Ingested,
    animations: Vec<(String, f32)>,
    variants: Vec<String>,
}

impl Scene {
    pub(crate) fn load(
        py: Python<'_>,
        path: PathBuf,
        pose: PoseJob,
        light: LightJob,
        importer: ImporterJob,
        callback: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let registry = registry(py)?;
        let (ingested, contents) = long(py, callback, |task| {
            let ingested = load_scene(&path, &pose, &importer, registry, &light, task)?;
            Ok((ingested, scene_contents(&path, &importer, registry, task)?))
        })?;
        Ok(Self { path, light, ingested, animations: contents.animations, variants: contents.variants })
    }
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (path, *, time=None, animation=None, variant=None, light=None, importer=None, callback=None))]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        time: Option<&Bound<'_, PyAny>>,
        animation: Option<&Bound<'_, PyAny>>,
        variant: Option<&Bound<'_, PyAny>>,
        light: Option<&Bound<'_, PyAny>>,
        importer: Option<&Bound<'_, PyAny>>,
        callback: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        // by name or by number
        let [animation, variant] = [animation, variant].map(|choice| choice.map(|choice| choice.str()).transpose());
        let (animation, variant) = (animation?.map(Bound::into_any), variant?.map(Bound::into_any));
        let pose = [("time_s", time), ("animation", animation.as_ref()), ("variant", variant.as_ref())];
        let pose = table(py, "pose", &pose)?;
        let light = light.map(|light| table_of("light", light)).transpose()?.unwrap_or_default();
        let importer = importer.map(|importer| table_of("importer", importer)).transpose()?.unwrap_or_default();
        Self::load(py, path, pose, light, importer, callback)
    }

    /// The file that it was read from.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// Number of triangles, copies of a mesh counted.
    #[getter]
    fn triangles(&self) -> usize {
        self.ingested.scene.triangle_count()
    }

    /// Names of the cameras.
    #[getter]
    fn cameras(&self) -> Vec<String> {
        self.ingested.scene.cameras.iter().map(|camera| camera.name.clone()).collect()
    }

    /// Names of the materials.
    #[getter]
    fn materials(&self) -> Vec<String> {
        self.ingested.scene.materials.iter().map(|material| material.name.clone()).collect()
    }

    /// Animations: (name, time of the last key in seconds).
    #[getter]
    fn animations(&self) -> Vec<(String, f32)> {
        self.animations.clone()
    }

    /// Names of the material variants.
    #[getter]
    fn variants(&self) -> Vec<String> {
        self.variants.clone()
    }

    /// Corners of the box around everything, in scene units: ((x, y, z), (x, y, z)).
    #[getter]
    fn bounds(&self) -> ((f32, f32, f32), (f32, f32, f32)) {
        let bounds = Arc::as_ref(&self.ingested.scene).bounds();
        let [min, max] = [bounds.min, bounds.max].map(|corner| corner.to_array().map(|x| x as f32));
        (min.into(), max.into())
    }

    fn __repr__(&self) -> String {
        format!("<lumistack.Scene \"{}\": {} triangles>", self.path.display(), self.triangles())
    }
}
