//! Scene file to a lit [`Scene`] and the [`Window`] through which the display looks at it.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use lumistack_core::Task;
use lumistack_gltf::AssetResolver;
use lumistack_scene::{Camera, Scene, Window};

use crate::error::{PipelineError, read};
use crate::job::{LightJob, WindowFrom, WindowJob};
use crate::light;

/// A loaded scene and what it was made from.
pub struct Ingested {
    /// Lit scene.
    pub scene: Arc<Scene>,
    /// Every file that was read, with a hash of its content.
    pub files: Vec<(PathBuf, String)>,
}

/// Loads a scene, replaces its environment where the job says so, and lights it where it has no light.
///
/// # Errors
/// When a file cannot be read or the scene cannot be rendered.
pub fn load_scene(path: &Path, light_job: &LightJob, task: Task<'_>) -> Result<Ingested, PipelineError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if !matches!(extension.as_str(), "gltf" | "glb") {
        return Err(PipelineError::value(path, "scene", "a .gltf or .glb file", format!("extension `{extension}`")));
    }
    let bytes = read(path)?;
    let resolver = Files { base: path.parent().unwrap_or(Path::new("")), read: RefCell::default() };
    let mut scene = lumistack_gltf::load(&path.display().to_string(), &bytes, &resolver, task)?;
    let mut files = vec![(path.to_owned(), hash(&bytes))];
    files.append(&mut resolver.read.borrow_mut());
    if let Some(environment) = &light_job.environment {
        files.push((environment.clone(), hash(&read(environment)?)));
        scene = light::edited(scene, task, |parts| {
            light::load_environment(parts, environment, light_job.environment_strength)
        })?;
    } else if let Some(strength) = scene.environment.map(|environment| environment.strength)
        && light_job.environment_strength != 1.0
    {
        scene = light::edited(scene, task, |parts| {
            if let Some(environment) = &mut parts.environment {
                environment.strength = strength * light_job.environment_strength;
            }
            Ok(())
        })?;
    }
    if !scene.is_lit() && light_job.automatic {
        scene = light::edited(scene, task, |parts| {
            light::add_studio_light(parts);
            if let Some(environment) = &mut parts.environment {
                environment.strength = Vec3::splat(light_job.environment_strength);
            }
            Ok(())
        })?;
    }
    Ok(Ingested { scene: Arc::new(scene), files })
}

/// Places the display in the scene.
///
/// # Errors
/// When the job names a camera that does not exist or gives numbers that make no rectangle.
pub fn place_window(scene: &Scene, job: &WindowJob, size_mm: [f64; 2]) -> Result<Window, PipelineError> {
    let camera = match (&job.from, &job.camera) {
        (WindowFrom::Auto | WindowFrom::Camera, Some(wanted)) => Some(find_camera(scene, wanted)?),
        (WindowFrom::Auto, None) => scene.cameras.first(),
        (WindowFrom::Camera, None) => match scene.cameras.first() {
            Some(camera) => Some(camera),
            None => return Err(PipelineError::value(&scene.name, "window.from", "a camera in the scene", "none")),
        },
        (WindowFrom::Bounds | WindowFrom::Given, _) => None,
    };
    let window = if job.from == WindowFrom::Given {
        let missing = |key: &str| PipelineError::value("job", format!("window.{key}"), "a value, as `from = \"given\"` needs", "nothing");
        let vector = |key: &str, value: Option<[f64; 3]>| value.map(DVec3::from_array).ok_or_else(|| missing(key));
        Window::given(
            vector("centre", job.centre)?,
            vector("forward", job.forward)?,
            vector("up", job.up)?,
            job.width.ok_or_else(|| missing("width"))?,
            size_mm,
        )
    } else if let Some(camera) = camera {
        let focus_distance = job.focus_distance.or(camera.focus_distance);
        Window::from_camera(&Camera { focus_distance, ..camera.clone() }, scene.bounds(), size_mm)
    } else {
        Window::framing(scene.bounds(), size_mm)
    };
    match window {
        // a camera that the user did not ask for must not stand in the way
        Err(_) if job.from == WindowFrom::Auto && job.camera.is_none() => Window::framing(scene.bounds(), size_mm),
        other => other,
    }
    .map_err(|source| PipelineError::Window { name: scene.name.clone(), source })
}

fn find_camera<'a>(scene: &'a Scene, wanted: &str) -> Result<&'a Camera, PipelineError> {
    let by_name = scene.cameras.iter().find(|camera| camera.name == wanted);
    let by_number = || wanted.parse::<usize>().ok().and_then(|number| scene.cameras.get(number));
    by_name.or_else(by_number).ok_or_else(|| {
        let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
        let expected = format!("one of {} cameras: {}", names.len(), names.join(", "));
        PipelineError::value(&scene.name, "window.camera", expected, wanted)
    })
}

/// Reads what a glTF file refers to, and remembers it.
struct Files<'a> {
    base: &'a Path,
    read: RefCell<Vec<(PathBuf, String)>>,
}

impl AssetResolver for Files<'_> {
    fn read(&self, uri: &str) -> Result<Vec<u8>, String> {
        let path = self.base.join(uri);
        let bytes = std::fs::read(&path).map_err(|error| error.to_string())?;
        self.read.borrow_mut().push((path, hash(&bytes)));
        Ok(bytes)
    }
}

fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}
