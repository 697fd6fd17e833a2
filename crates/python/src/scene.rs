//! The class of scenes.

use std::path::PathBuf;
use std::sync::Arc;

use lumistack_pipeline::{
    ImporterJob, Ingested, LightJob, PipelineError, PoseJob, SceneContents, ingest_scene, is_usd, load_scene,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::json::{table, table_of};
use crate::plugin::registry;
use crate::splats;
use crate::usd;
use crate::work::long;

/// A scene: glTF (.gltf, .glb), USD (.usd, .usda, .usdc, .usdz), Blender (.blend), or a file for an
/// importer plugin. The package has importers for Wavefront OBJ (.obj) and for captures of Gaussian
/// splats (.ply, .spz, .sog).
///
/// * path: the file, or a stage (pxr.Usd.Stage), which is read from memory
/// * time: time at which animations are sampled, seconds; without it nodes have the poses of the
///   file
/// * animation, variant: for glTF, name or number of the animation and of the material variant
/// * variants: for USD, a list of "set=variant", for every prim that has the set, or
///   "/prim{set=variant}", for one prim
/// * light: a mapping with the keys of a job's [light]
/// * importer: a mapping {"plugin": ..., "allow_outside": ..., "picture_mib": ..., "params": {...}}
/// * callback: callback(stage, fraction) receives progress
///
/// These keys of light belong to the scene: environment (a Radiance HDR or OpenEXR file),
/// environment_strength, environment_rotation_deg, from_splats, visible and automatic. The key
/// automatic adds a studio light to a scene without light. All other keys of light are defaults
/// for render().
///
/// The file is read once, and its acceleration structures are kept: render() may be called many
/// times.
#[pyclass(frozen, module = "lumistack")]
pub(crate) struct Scene {
    pub(crate) path: PathBuf,
    pub(crate) light: LightJob,
    pub(crate) ingested: Ingested,
    animations: Vec<(String, f32)>,
    variants: Vec<String>,
    duration: Option<f64>,
}

impl Scene {
    /// Reads a file or a stage. A stage is read in this process. A USD file is read in this process
    /// if this Python has OpenUSD and the caller names no importer. All other files are read as in
    /// the command, which reads USD without a named importer in another Python.
    pub(crate) fn load(
        py: Python<'_>,
        source: &Bound<'_, PyAny>,
        pose: PoseJob,
        light: LightJob,
        importer: ImporterJob,
        callback: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        // Read USD with this Python's OpenUSD if possible.
        let stage = usd::is_stage(source).then_some(source);
        let path: PathBuf = match stage {
            Some(stage) => stage.call_method0("GetRootLayer")?.getattr("identifier")?.extract()?,
            None => source.extract().map_err(|_| {
                let found = source.get_type().name().map(|name| name.to_string()).unwrap_or_default();
                PyTypeError::new_err(format!("scene: expected a Scene, a path or an OpenUSD stage, found {found}"))
            })?,
        };
        if stage.is_some() || (importer.plugin.is_none() && is_usd(&path) && usd::is_here(py)) {
            let walked = usd::walk(py, stage, &path, &pose)?;
            let is_given = stage.is_some();
            let ingested = long(py, callback, |task| {
                let name = path.display().to_string();
                let scene = lumistack_usd::scene_from_package(&name, &walked.package(), task)?;
                let files: Vec<PathBuf> = walked.header.files.iter().map(PathBuf::from).collect();
                // A stage in memory may differ from its files, so its content is part of the
                // scene's key.
                let content = if is_given { walked.content() } else { Vec::new() };
                ingest_scene(scene, &files, &content, &pose, &light, task)
            })?;
            return Ok(Self::new_of(path, light, ingested, SceneContents::Usd(walked.header.contents)));
        }
        // Read all other files as the command does.
        let registry = registry(py)?;
        let (ingested, contents) = long(py, callback, |task| {
            let ingested = load_scene(&path, &pose, &importer, registry, &light, None, task)?;
            let contents = ingested.contents(&path, &importer, registry, task)?;
            Ok((ingested, contents))
        })?;
        Ok(Self::new_of(path, light, ingested, contents))
    }

    fn new_of(path: PathBuf, light: LightJob, ingested: Ingested, contents: SceneContents) -> Self {
        let (animations, variants, duration) = match contents {
            SceneContents::Gltf(contents) => {
                let ends = contents.animations.iter().map(|(_, end)| f64::from(*end));
                let duration = ends.reduce(f64::max);
                (contents.animations, contents.variants, duration)
            }
            SceneContents::Blend(contents) => (Vec::new(), Vec::new(), Some(contents.duration_s())),
            SceneContents::Usd(contents) => {
                let every = contents.variant_sets.iter().flat_map(|set| {
                    let place = set.place.trim_end_matches('}');
                    set.choices.iter().map(move |choice| format!("{place}={choice}}}"))
                });
                (Vec::new(), every.collect(), contents.time_range.map(|range| range.duration_s()))
            }
        };
        Self { path, light, ingested, animations, variants, duration }
    }
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (path, *, time=None, animation=None, variant=None, variants=None, light=None, importer=None, callback=None))]
    fn new(
        py: Python<'_>,
        path: &Bound<'_, PyAny>,
        time: Option<&Bound<'_, PyAny>>,
        animation: Option<&Bound<'_, PyAny>>,
        variant: Option<&Bound<'_, PyAny>>,
        variants: Option<&Bound<'_, PyAny>>,
        light: Option<&Bound<'_, PyAny>>,
        importer: Option<&Bound<'_, PyAny>>,
        callback: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        // `animation` and `variant` may be names or numbers; the job's table reads texts
        let [animation, variant] = [animation, variant].map(|choice| choice.map(|choice| choice.str()).transpose());
        let (animation, variant) = (animation?.map(Bound::into_any), variant?.map(Bound::into_any));
        let pose = [
            ("time_s", time),
            ("animation", animation.as_ref()),
            ("variant", variant.as_ref()),
            ("variants", variants),
        ];
        let pose = table(py, "pose", &pose)?;
        let light = light.map(|light| table_of("light", light)).transpose()?.unwrap_or_default();
        let importer = importer.map(|importer| table_of("importer", importer)).transpose()?.unwrap_or_default();
        Self::load(py, path, pose, light, importer, callback)
    }

    /// Makes a scene of Gaussian splats from arrays: one mapping, or a sequence of mappings, as the
    /// property `splats` returns them. A mapping has these keys:
    ///
    /// * positions [splat, xyz], in a scene with y up
    /// * rotations [splat, xyzw], quaternions that rotate a splat's own axes; without them no
    ///   rotation
    /// * scales [splat, xyz], standard deviations, not their logarithms
    /// * opacities [splat], 0 to 1
    /// * harmonics [splat, coefficient, rgb], 1, 4, 9 or 16 coefficients by degree and then order;
    ///   a colour is ½ plus the sum of all coefficients times their spherical harmonics
    /// * encoding, "srgb" (the default, as captures are trained) or "linear"
    /// * scene_from_cloud [4, 4], the matrix that places the cloud; it multiplies column vectors
    ///
    /// light: a mapping with the keys of a job's [light]; name: name of the scene in messages.
    ///
    /// >>> import numpy as np
    /// >>> red = [[[1.77, -1.77, -1.77]]]
    ///
    /// >>> ball = {"positions": np.zeros((1, 3)), "scales": np.ones((1, 3))}
    /// >>> ball.update(opacities=np.ones(1), harmonics=np.array(red))
    ///
    /// >>> Scene.from_splats(ball).splats[0]["harmonics"].shape
    /// (1, 1, 3)
    #[staticmethod]
    #[pyo3(signature = (splats, *, light=None, name="splats"))]
    fn from_splats(
        py: Python<'_>,
        splats: &Bound<'_, PyAny>,
        light: Option<&Bound<'_, PyAny>>,
        name: &str,
    ) -> PyResult<Self> {
        let light: LightJob = light.map(|light| table_of("light", light)).transpose()?.unwrap_or_default();
        let parts = splats::from_python(name, splats)?;
        let ingested = long(py, None, |task| {
            let content = splats::content(&parts);
            let named = |source| PipelineError::Scene { name: name.into(), source };
            let scene = parts.validate(task).map_err(named)?;
            ingest_scene(scene, &[], &[content.as_slice()], &PoseJob::default(), &light, task)
        })?;
        let (animations, variants, duration) = (Vec::new(), Vec::new(), None);
        Ok(Self { path: name.into(), light, ingested, animations, variants, duration })
    }

    /// The splats: a dictionary of arrays for every placed cloud, which `from_splats` accepts.
    ///
    /// Invalid splats are omitted. In large clouds the order of the splats differs from the order
    /// in the file.
    #[getter]
    fn splats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        splats::to_python(py, &self.ingested.scene)
    }

    /// The file that was read; for a stage its identifier, and for splats from arrays their name.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// Number of triangles, including every copy of a mesh.
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

    /// Time at which the last animation of a glTF scene ends, or the duration of the USD stage or
    /// of the Blender scene, seconds. None without animations, or for a stage without a time range.
    #[getter]
    fn duration(&self) -> Option<f64> {
        self.duration
    }

    /// Names of the material variants of glTF; for USD every choice, "/prim{set=variant}".
    #[getter]
    fn variants(&self) -> Vec<String> {
        self.variants.clone()
    }

    /// Opposite corners of the scene's bounding box, ((x, y, z), (x, y, z)), scene units.
    #[getter]
    fn bounds(&self) -> ((f32, f32, f32), (f32, f32, f32)) {
        let bounds = Arc::as_ref(&self.ingested.scene).bounds();
        let [min, max] = [bounds.min, bounds.max].map(|corner| corner.to_array());
        (min.into(), max.into())
    }

    fn __repr__(&self) -> String {
        let splats = match self.ingested.scene.splat_count() {
            0 => String::new(),
            count => format!(", {count} splats"),
        };
        format!("<lumistack.Scene \"{}\": {} triangles{splats}>", self.path.display(), self.triangles())
    }
}
