//! Reads a scene file into a lit [`Scene`].

mod crop;
mod from_splats;
mod light;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use lumistack_core::Task;
use lumistack_files::{Folder, MAX_FILE_BYTES, Refusal};
use lumistack_gltf::{AssetResolver, LoadOptions};
use lumistack_plugin_host::{PluginError, Registry};
use lumistack_scene::Scene;
use lumistack_shot::SceneRenderer;
use lumistack_usd::{BlendContents, HandedOver};

use crate::error::{PipelineError, host_error, read};
use crate::job::{ImporterJob, Job, LightJob, PoseJob};
use crate::reader::{Reader, reader_of};
use crate::store::handover;
use crate::store::key::{KeyBuilder, hash};
use crate::store::plugin_files::plugin_key;

/// A loaded scene, and the files that it was read from.
pub struct Ingested {
    /// The scene and its lights.
    pub scene: Arc<Scene>,
    /// All files that were read, each with a hash of its content. An importer, Blender, and data in
    /// memory also have entries, with a name instead of a path.
    pub files: Vec<(PathBuf, String)>,
    /// Pose and variants that were selected.
    pub pose: PoseJob,
    /// True if the built-in studio light was added to the scene.
    pub(crate) studio: bool,
    /// Animations, variants and similar choices in the file, if the reader listed them.
    known: Option<SceneContents>,
    renderer: OnceLock<SceneRenderer>,
}

impl Ingested {
    /// Returns the scene in the form that the renderer needs. The first call prepares it.
    ///
    /// # Errors
    /// If the scene cannot be rendered, or the task is cancelled.
    pub(crate) fn renderer(&self, task: Task<'_>) -> Result<&SceneRenderer, PipelineError> {
        if let Some(renderer) = self.renderer.get() {
            return Ok(renderer);
        }
        task.progress.begin("prepare scene", 1, "scene");
        let renderer = SceneRenderer::new(self.scene.clone(), task);
        task.progress.end();
        let renderer = renderer?;
        Ok(self.renderer.get_or_init(|| renderer))
    }

    /// If the scene comes from a `.blend` file, returns the file's contents and its features that
    /// the conversion lost.
    pub(crate) fn blend(&self) -> Option<&BlendContents> {
        match &self.known {
            Some(SceneContents::Blend(contents)) => Some(contents),
            _ => None,
        }
    }

    /// Returns the animations, variants and similar choices in the file. Reads the file again if
    /// the choices were not listed when the scene was loaded.
    ///
    /// # Errors
    /// The errors of [`scene_contents`].
    pub fn contents(
        &self,
        path: &Path,
        importer: &ImporterJob,
        registry: &Registry,
        task: Task<'_>,
    ) -> Result<SceneContents, PipelineError> {
        self.known.clone().map_or_else(|| scene_contents(path, importer, registry, task), Ok)
    }

    /// Adds to a key everything from which the scene was made.
    pub(crate) fn add_to(&self, key: &mut KeyBuilder) {
        for (path, content) in &self.files {
            key.add("file", path.file_name().unwrap_or_default().as_encoded_bytes()).add("content", content.as_bytes());
        }
        key.add_json("pose", &self.pose);
        // The key contains the field `lamp` of materials, since the job may change this field to
        // hide light sources.
        let lamps: Vec<u8> = self.scene.materials.iter().map(|material| material.lamp as u8).collect();
        key.add("lamps", &lamps);
    }
}

/// Choices that a scene file offers.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneContents {
    /// Animations and material variants.
    Gltf(lumistack_gltf::Contents),
    /// Time range, variant sets and cameras.
    Usd(lumistack_usd::Contents),
    /// Scenes and frames of a `.blend` file.
    Blend(lumistack_usd::BlendContents),
}

/// Lists the choices that a scene file offers.
///
/// # Errors
/// If the scene has no reader, or a file cannot be read or is damaged.
pub fn scene_contents(
    path: &Path,
    importer: &ImporterJob,
    registry: &Registry,
    task: Task<'_>,
) -> Result<SceneContents, PipelineError> {
    let reader = reader_of(path, importer, registry)?;
    if reader == Reader::Usd {
        return Ok(SceneContents::Usd(lumistack_usd::contents(path, task)?));
    }
    if reader == Reader::Blend {
        return Ok(SceneContents::Blend(lumistack_usd::blend_contents(path, task)?));
    }
    let resolver = Files::beside(path, importer.allow_outside)?;
    let bytes = gltf_bytes(path, &reader, importer, registry, &resolver, task)?;
    Ok(SceneContents::Gltf(lumistack_gltf::contents(&path.display().to_string(), &bytes, &resolver, task)?))
}

/// Returns the scene as glTF: the file itself, or the document that an importer made of it.
fn gltf_bytes(
    path: &Path,
    reader: &Reader,
    importer: &ImporterJob,
    registry: &Registry,
    resolver: &Files,
    task: Task<'_>,
) -> Result<Vec<u8>, PipelineError> {
    let Reader::Plugin(id) = reader else {
        return Ok(resolver.keep(path.to_owned(), read(path)?));
    };
    // Open the file before an importer does, so that a missing file has the same message with every
    // reader.
    lumistack_files::open(path).map_err(|source| PipelineError::Read { path: path.to_owned(), source })?;
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    // If the file's name is not Unicode, the importer requests the file by a name with replacement
    // characters.
    let own = |name: &str| name == file && file.contains(char::REPLACEMENT_CHARACTER);
    let read = |name: &str| {
        let bytes = match own(name) {
            true => lumistack_files::read(path)
                .map(|bytes| resolver.keep(path.to_owned(), bytes))
                .map_err(|e| e.to_string()),
            false => resolver.read(name, MAX_FILE_BYTES),
        };
        bytes.map_err(|error| PluginError::Failed(format!("{}: {error}", resolver.folder.path_of(name).display())))
    };
    let params = importer.params.clone().into();
    lumistack_plugin_host::import_scene(registry, id, &params, &file, &read, task).map_err(host_error)
}

/// Loads a scene in its pose, with the environment of the job. With `light.automatic`, meshes
/// without light get studio light. Files that are neither glTF, USD nor `.blend` need an importer.
/// Conversions by Blender are kept in `cache_dir`.
///
/// # Errors
/// If a file cannot be read, no importer accepts it, or the scene cannot be rendered.
pub fn load_scene(
    path: &Path,
    pose: &PoseJob,
    importer: &ImporterJob,
    registry: &Registry,
    light_job: &LightJob,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<Ingested, PipelineError> {
    let mut known = None;
    let (scene, files) = match reader_of(path, importer, registry)? {
        Reader::Usd => load_usd(path, pose, task)?,
        Reader::Blend => {
            let (read, contents) = load_blend(path, pose, importer, cache_dir, task)?;
            known = Some(SceneContents::Blend(contents));
            read
        }
        reader => load_gltf(path, pose, &reader, importer, registry, task)?,
    };
    Ok(Ingested { known, ..lit(scene, files, pose, light_job, task)? })
}

/// Crops and lights a scene that the caller made, by the rules of [`load_scene`]. The caller made
/// the scene from `files`, and from `content`, which are data in memory. The scene's key contains
/// hashes of `files` and of `content`.
///
/// # Errors
/// If a file cannot be read, or the scene cannot be rendered.
pub fn ingest_scene(
    scene: Scene,
    files: &[PathBuf],
    content: &[&[u8]],
    pose: &PoseJob,
    light_job: &LightJob,
    task: Task<'_>,
) -> Result<Ingested, PipelineError> {
    let mut files = hashed(files)?;
    if !content.is_empty() {
        let mut hasher = blake3::Hasher::new();
        for part in content {
            hasher.update(&(part.len() as u64).to_le_bytes()).update(part);
        }
        files.push(("memory".into(), hasher.finalize().to_hex().to_string()));
    }
    lit(scene, files, pose, light_job, task)
}

/// Checks that a job's scene has a reader, and that a glTF scene has the camera that the job names.
/// Other readers may need another program or a plugin, so their cameras are checked when the scene
/// is read.
///
/// # Errors
/// If the scene has no reader or no such camera, or a glTF file cannot be read.
pub(crate) fn check_scene(job: &Job, registry: &Registry, task: Task<'_>) -> Result<(), PipelineError> {
    let Some(path) = &job.scene else { return Ok(()) };
    let reader = reader_of(path, &job.importer, registry)?;
    let Some(camera) = job.window.camera.as_ref().filter(|_| reader == Reader::Gltf) else { return Ok(()) };
    let (scene, _) = load_gltf(path, &job.pose, &reader, &job.importer, registry, task)?;
    Ok(lumistack_shot::find_camera(&scene, camera).map(drop)?)
}

fn lit(
    mut scene: Scene,
    mut files: Vec<(PathBuf, String)>,
    pose: &PoseJob,
    light_job: &LightJob,
    task: Task<'_>,
) -> Result<Ingested, PipelineError> {
    // Crop first, since removed splats emit no light.
    scene = crop::cropped(scene, pose, task)?;
    // The environment of the job replaces the environment of the file. The functions that load or
    // make this environment also apply the job's strength.
    let mut has_own = light_job.environment.is_some();
    if let Some(environment) = &light_job.environment {
        files.push((environment.clone(), hash(&read(environment)?)));
        scene = lumistack_shot::edited(scene, task, |parts| {
            light::load_environment(parts, environment, light_job.environment_strength)
        })?;
    } else if light_job.from_splats {
        (scene, has_own) = light::from_splats(scene, light_job.environment_strength, task)?;
    }
    let (scene, studio) = lumistack_shot::light::lit(scene, has_own, light_job, task)?;
    Ok(Ingested { scene, files, pose: pose.clone(), studio, known: None, renderer: OnceLock::new() })
}

/// A scene, and all files that were read, each with a hash of its content.
type Read = (Scene, Vec<(PathBuf, String)>);

fn load_gltf(
    path: &Path,
    pose: &PoseJob,
    reader: &Reader,
    importer: &ImporterJob,
    registry: &Registry,
    task: Task<'_>,
) -> Result<Read, PipelineError> {
    let PoseJob { time_s, animation, variant, variants, .. } = pose.clone();
    if let Some(variants) = variants.first() {
        let expected = "no value, since only USD has variant sets; `pose.variant` selects a material variant of glTF";
        return Err(PipelineError::value(path, "pose.variants", expected, variants));
    }
    // The resolver records all files that the loader reads.
    let resolver = Files::beside(path, importer.allow_outside)?;
    let max_picture_bytes = importer.picture_mib.saturating_mul(1 << 20);
    let options = LoadOptions { time_s, animation, variant, max_picture_bytes, ..LoadOptions::default() };
    let read = || -> Result<Scene, PipelineError> {
        let bytes = gltf_bytes(path, reader, importer, registry, &resolver, task)?;
        Ok(lumistack_gltf::load_with(&path.display().to_string(), &bytes, &resolver, &options, task)?)
    };
    // Report progress while the loader reads the file and its references.
    task.progress.begin("read scene", 1, "scene");
    let scene = read();
    task.progress.end();
    let scene = scene?;
    let mut files = resolver.read.into_inner().unwrap_or_else(PoisonError::into_inner);
    // The scene also depends on the importer and its parameters, so its key contains them.
    if let Reader::Plugin(id) = reader {
        files.push((id.into(), plugin_key(registry, id, &importer.params)?));
    }
    Ok((scene, files))
}

fn load_usd(path: &Path, pose: &PoseJob, task: Task<'_>) -> Result<Read, PipelineError> {
    let PoseJob { time_s, animation, variant, variants, .. } = pose.clone();
    if let Some(animation) = animation {
        return Err(PipelineError::value(
            path,
            "pose.animation",
            "no value, since a USD stage has only one timeline",
            animation,
        ));
    }
    if let Some(variant) = variant {
        let expected = "`pose.variants`, a list of `set=variant` or `/prim{set=variant}`";
        return Err(PipelineError::value(path, "pose.variant", expected, variant));
    }
    let options = lumistack_usd::LoadOptions { time_s, variants };
    // OpenUSD runs in another process, which reports no progress.
    task.progress.begin("open USD", 1, "stage");
    let loaded = lumistack_usd::load(path, &options, task).inspect(|_| task.progress.advance(1, ""));
    task.progress.end();
    let loaded = loaded?;
    Ok((loaded.scene, hashed(&loaded.files)?))
}

fn load_blend(
    path: &Path,
    pose: &PoseJob,
    importer: &ImporterJob,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<(Read, BlendContents), PipelineError> {
    let PoseJob { time_s, animation, variant, variants, .. } = pose.clone();
    let given = [("animation", animation), ("variant", variant), ("variants", variants.into_iter().next())];
    if let Some((key, found)) = given.into_iter().find_map(|(key, given)| Some((key, given?))) {
        let expected =
            "no value, since a .blend file is converted in the state that the file has in Blender at `pose.time_s`";
        return Err(PipelineError::value(path, format!("pose.{key}"), expected, found));
    }
    let HandedOver { glb, account } = handover::hand_over(path, time_s, cache_dir, task)?;
    // Blender packs all pictures into the converted file, so files outside of the folder need not
    // be allowed.
    let resolver = Files::beside(path, false)?;
    let max_picture_bytes = importer.picture_mib.saturating_mul(1 << 20);
    let options = LoadOptions { max_picture_bytes, ..LoadOptions::default() };
    let scene = lumistack_gltf::load_with(&path.display().to_string(), &glb, &resolver, &options, task)?;
    let mut files = hashed(&[&[path.to_owned()], &account.files[..]].concat())?;
    files.push(("blender".into(), account.blender));
    Ok(((scene, files), account.contents))
}

/// Returns files with hashes of their content.
fn hashed(files: &[PathBuf]) -> Result<Vec<(PathBuf, String)>, PipelineError> {
    files.iter().map(|file| Ok((file.clone(), hash(&read(file)?)))).collect()
}

/// Resolves the references of a scene file, and records the files that were read.
struct Files {
    folder: Folder,
    read: Mutex<Vec<(PathBuf, String)>>,
}

impl Files {
    /// Returns a resolver for the references of the scene at `path`. It reads regular files of the
    /// scene's folder or, with `allow_outside`, any regular files.
    fn beside(path: &Path, allow_outside: bool) -> Result<Self, PipelineError> {
        let io = |source| PipelineError::Read { path: path.to_owned(), source };
        let folder = if allow_outside { Folder::anywhere(path) } else { Folder::around(path).map_err(io)? };
        Ok(Self { folder, read: Mutex::default() })
    }

    /// Records a file that was read. Returns its bytes.
    fn keep(&self, path: PathBuf, bytes: Vec<u8>) -> Vec<u8> {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = (path, hash(&bytes));
        if !read.contains(&entry) {
            read.push(entry);
        }
        bytes
    }
}

impl AssetResolver for Files {
    fn read(&self, uri: &str, max_bytes: u64) -> Result<Vec<u8>, String> {
        let bytes = self.folder.read(uri, max_bytes).map_err(|refusal| match refusal {
            Refusal::Io(error) => error.to_string(),
            Refusal::Outside { .. } => {
                format!("{refusal}; {OUTSIDE_ADVICE}")
            }
        })?;
        Ok(self.keep(self.folder.path_of(uri), bytes))
    }
}

/// Advice for references that lead out of the scene's folder.
const OUTSIDE_ADVICE: &str =
    "--allow-outside (in a job `importer.allow_outside = true`) lets a scene read files of other folders";

#[cfg(test)]
mod tests {
    use glam::{Affine3A, Quat, Vec3};
    use lumistack_core::{Cancel, Collector, Progress};
    use lumistack_scene::{Image, Instance, Material, Mesh, Pixels, SceneParts};
    use lumistack_shot::light::set_environment;

    use super::*;

    #[test]
    fn a_usd_file_that_cannot_be_read_ends_its_progress() {
        #[derive(Default)]
        struct Stages(Mutex<Vec<&'static str>>);
        impl Progress for Stages {
            fn begin(&self, _: &str, _: u64, _: &str) {
                self.0.lock().unwrap().push("begin");
            }
            fn advance(&self, _: u64, _: &str) {}
            fn end(&self) {
                self.0.lock().unwrap().push("end");
            }
        }
        let (stages, warnings, cancel) = (Stages::default(), Collector::default(), Cancel::default());
        let task = Task { progress: &stages, ..Task::quiet(&warnings, &cancel) };
        assert!(load_usd(Path::new("no-such.usda"), &PoseJob::default(), task).is_err());
        assert_eq!(stages.0.into_inner().unwrap(), ["begin", "end"]);
    }

    /// The map from splats would replace the scene's environment. Without splats there is no map,
    /// so the job's strength applies to the environment of the scene.
    #[test]
    fn a_scene_without_splats_keeps_its_environment_at_the_strength_of_the_job() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let mut parts = SceneParts {
            meshes: vec![Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, scene_from_mesh: Affine3A::IDENTITY }],
            materials: vec![Material::default()],
            ..SceneParts::default()
        };
        let grey = Pixels::RgbF32(vec![[0.5; 3]; 2]);
        let image = Image { name: "sky".into(), width: 2, height: 1, pixels: grey };
        set_environment(&mut parts, image, Vec3::splat(2.0), Quat::IDENTITY);
        let scene = parts.validate(task).unwrap();
        let job = LightJob { from_splats: true, environment_strength: 3.0, ..LightJob::default() };
        let lit = lit(scene, Vec::new(), &PoseJob::default(), &job, task).unwrap();
        assert_eq!(lit.scene.environment.unwrap().strength, Vec3::splat(6.0));
        let [warning] = &warnings.take()[..] else { panic!("one warning") };
        assert_eq!(warning.to_string(), "light.from_splats: no effect, since the scene has no splats");
    }
}
