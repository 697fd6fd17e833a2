//! Scene file to a lit [`Scene`] and the [`Window`] through which the display looks at it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use glam::{DVec3, Vec3};
use lumistack_core::{Task, Tensor};
use lumistack_display::{FieldGeometry, ViewGrid};
use lumistack_files::{Folder, MAX_FILE_BYTES, Refusal};
use lumistack_gltf::{AssetResolver, LoadOptions};
use lumistack_pathtracer::Renderer;
use lumistack_plugin_host::{Origin, PluginError, PluginKind, Registry};
use lumistack_scene::{Camera, Lamp, Scene, Window};
use lumistack_usd::{BlendContents, HandedOver};

use crate::blender;
use crate::cache::{KeyBuilder, remembered};
use crate::code;
use crate::error::{PipelineError, host_error, read};
use crate::file_params;
use crate::job::{ImporterJob, LightJob, Near, PoseJob, WindowFrom, WindowJob};
use crate::light;
use crate::render::render_error;
use crate::side;
use crate::surround;

/// What stays free on each side of what an automatic window shows, as a share of it.
const MARGIN: f64 = 0.03;
/// Share of a camera's view that the scene should cover, where nobody asked for the camera.
const COVERAGE: f64 = 0.26;
/// Least width of a window relative to the view of such a camera.
const CLOSEST: f64 = 0.58;
/// Columns of the straight view by which it is found out where the scene is seen.
const PROBE_COLS: usize = 336;

/// A loaded scene and what it was made from.
pub struct Ingested {
    /// Lit scene.
    pub scene: Arc<Scene>,
    /// Every file that was read, with a hash of its content.
    pub files: Vec<(PathBuf, String)>,
    /// What was taken of them.
    pub pose: PoseJob,
    /// Whether it got the built-in studio light.
    pub(crate) studio: bool,
    /// What it offers to choose from, where that came with it.
    known: Option<SceneContents>,
    renderer: OnceLock<Renderer>,
}

impl Ingested {
    /// The scene prepared for rendering, once for everything that traces it.
    ///
    /// # Errors
    /// When it cannot be rendered, or when cancelled.
    pub(crate) fn renderer(&self, task: Task<'_>) -> Result<&Renderer, PipelineError> {
        if let Some(renderer) = self.renderer.get() {
            return Ok(renderer);
        }
        task.progress.begin("prepare scene", 1, "scene");
        let renderer = Renderer::new(self.scene.clone(), task).map_err(render_error);
        task.progress.end();
        let renderer = renderer?;
        Ok(self.renderer.get_or_init(|| renderer))
    }

    /// What its `.blend` file offers and what of it is lost, where it comes from one.
    pub(crate) fn blend(&self) -> Option<&BlendContents> {
        match &self.known {
            Some(SceneContents::Blend(contents)) => Some(contents),
            _ => None,
        }
    }

    /// What the scene offers to choose from, without another look at the file where it has been told already.
    ///
    /// # Errors
    /// As [`scene_contents`].
    pub fn contents(
        &self,
        path: &Path,
        importer: &ImporterJob,
        registry: &Registry,
        task: Task<'_>,
    ) -> Result<SceneContents, PipelineError> {
        self.known.clone().map_or_else(|| scene_contents(path, importer, registry, task), Ok)
    }

    /// Adds everything the scene was made from.
    pub(crate) fn add_to(&self, key: &mut KeyBuilder) {
        for (path, content) in &self.files {
            key.add("file", path.file_name().unwrap_or_default().as_encoded_bytes()).add("content", content.as_bytes());
        }
        key.add_json("pose", &self.pose);
        // whether light sources are seen depends on the job
        let lamps: Vec<u8> = self.scene.materials.iter().map(|material| material.lamp as u8).collect();
        key.add("lamps", &lamps);
    }
}

/// What a scene offers to choose from.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneContents {
    /// Animations and material variants.
    Gltf(lumistack_gltf::Contents),
    /// Time range, variant sets and cameras.
    Usd(lumistack_usd::Contents),
    /// Scenes and frames of a `.blend` file.
    Blend(lumistack_usd::BlendContents),
}

/// Lists what a scene offers to choose from.
///
/// # Errors
/// When a file cannot be read or is broken.
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

/// The scene as glTF: the file itself, or what an importer makes of it.
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
    // so that a missing file is told like any other
    lumistack_files::open(path).map_err(|source| PipelineError::Read { path: path.to_owned(), source })?;
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    // its own name may be one that the boundary's texts cannot hold
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

/// Loads a scene in its pose, replaces its environment where the job says so, and lights it where it has no light. What is not glTF goes
/// through an importer. What another program made of the file is kept in `cache_dir`, and taken from there.
///
/// # Errors
/// When a file cannot be read, no importer takes it, or the scene cannot be rendered.
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

/// Lights a scene that the caller has made of these files, and of what lies in memory (`content`), as [`load_scene`] does.
///
/// # Errors
/// When a file cannot be read or the scene cannot be rendered.
pub fn take_scene(
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

fn lit(
    mut scene: Scene,
    mut files: Vec<(PathBuf, String)>,
    pose: &PoseJob,
    light_job: &LightJob,
    task: Task<'_>,
) -> Result<Ingested, PipelineError> {
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
    if let Some(visible) = light_job.visible {
        let wanted = if visible { Lamp::Seen } else { Lamp::Unseen };
        if scene.materials.iter().any(|material| material.lamp != Lamp::No && material.lamp != wanted) {
            scene = light::edited(scene, task, |parts| {
                let lamps = parts.materials.iter_mut().filter(|material| material.lamp != Lamp::No);
                lamps.for_each(|material| material.lamp = wanted);
                Ok(())
            })?;
        }
    }
    let has_environment = scene.environment.is_some();
    if has_environment {
        scene = surround::turned(scene, light_job, task)?;
    }
    let mut studio = light_job.automatic && !scene.is_lit();
    let mut scene = Arc::new(scene);
    if light_job.automatic
        && !studio
        && let Some(message) = light::probe(&scene, task)?
    {
        task.warn(&scene.name, message);
        studio = true;
    }
    if studio {
        let lit = light::edited(Arc::unwrap_or_clone(scene), task, |parts| {
            light::add_studio_light(parts);
            if let Some(environment) = &mut parts.environment {
                environment.strength = Vec3::splat(light_job.environment_strength);
            }
            Ok(())
        })?;
        scene = Arc::new(surround::turned(lit, light_job, task)?);
    } else if !has_environment {
        surround::warn_of_unused(&scene, light_job, task);
    }
    Ok(Ingested { scene, files, pose: pose.clone(), studio, known: None, renderer: OnceLock::new() })
}

/// What was loaded, and every file that was read, with a hash of its content.
type Read = (Scene, Vec<(PathBuf, String)>);

fn load_gltf(
    path: &Path,
    pose: &PoseJob,
    reader: &Reader,
    importer: &ImporterJob,
    registry: &Registry,
    task: Task<'_>,
) -> Result<Read, PipelineError> {
    let PoseJob { time_s, animation, variant, variants } = pose.clone();
    if let Some(variants) = variants.first() {
        let expected = "none, since only USD has variant sets; glTF's material variants are `pose.variant`";
        return Err(PipelineError::value(path, "pose.variants", expected, variants));
    }
    let resolver = Files::beside(path, importer.allow_outside)?;
    let max_picture_bytes = importer.picture_mib.saturating_mul(1 << 20);
    let options = LoadOptions { time_s, animation, variant, max_picture_bytes, ..LoadOptions::default() };
    let read = || -> Result<Scene, PipelineError> {
        let bytes = gltf_bytes(path, reader, importer, registry, &resolver, task)?;
        Ok(lumistack_gltf::load_with(&path.display().to_string(), &bytes, &resolver, &options, task)?)
    };
    task.progress.begin("read scene", 1, "scene");
    let scene = read();
    task.progress.end();
    let scene = scene?;
    let mut files = resolver.read.into_inner().unwrap_or_else(PoisonError::into_inner);
    if let Reader::Plugin(id) = reader {
        files.push((id.into(), plugin_key(registry, id, &importer.params)?));
    }
    Ok((scene, files))
}

fn load_usd(path: &Path, pose: &PoseJob, task: Task<'_>) -> Result<Read, PipelineError> {
    let PoseJob { time_s, animation, variant, variants } = pose.clone();
    if let Some(animation) = animation {
        return Err(PipelineError::value(path, "pose.animation", "none, since USD has one timeline", animation));
    }
    if let Some(variant) = variant {
        let expected = "`pose.variants`, a list of `set=variant` or `/prim{set=variant}`";
        return Err(PipelineError::value(path, "pose.variant", expected, variant));
    }
    let options = lumistack_usd::LoadOptions { time_s, variants };
    // another process works; nothing tells how far it has come
    task.progress.begin("open USD", 1, "stage");
    let loaded = lumistack_usd::load(path, &options, task)?;
    task.progress.advance(1, "");
    task.progress.end();
    Ok((loaded.scene, hashed(&loaded.files)?))
}

fn load_blend(
    path: &Path,
    pose: &PoseJob,
    importer: &ImporterJob,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<(Read, BlendContents), PipelineError> {
    let PoseJob { time_s, animation, variant, variants } = pose.clone();
    let given = [("animation", animation), ("variant", variant), ("variants", variants.into_iter().next())];
    if let Some((key, found)) = given.into_iter().find_map(|(key, given)| Some((key, given?))) {
        let expected = "none: of a .blend file the scene is taken as Blender shows it, at `pose.time_s`";
        return Err(PipelineError::value(path, format!("pose.{key}"), expected, found));
    }
    let HandedOver { glb, account } = blender::hand_over(path, time_s, cache_dir, task)?;
    // Blender packs pictures into what it hands over, wherever they were
    let resolver = Files::beside(path, false)?;
    let max_picture_bytes = importer.picture_mib.saturating_mul(1 << 20);
    let options = LoadOptions { max_picture_bytes, ..LoadOptions::default() };
    let scene = lumistack_gltf::load_with(&path.display().to_string(), &glb, &resolver, &options, task)?;
    let mut files = hashed(&[&[path.to_owned()], &account.files[..]].concat())?;
    files.push(("blender".into(), account.blender));
    Ok(((scene, files), account.contents))
}

/// Files with hashes of their content.
fn hashed(files: &[PathBuf]) -> Result<Vec<(PathBuf, String)>, PipelineError> {
    files.iter().map(|file| Ok((file.clone(), hash(&read(file)?)))).collect()
}

/// A window as it is found, before depth is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Found {
    pub(crate) window: Window,
    /// Whether somebody chose the depth at which it stands: by numbers or by a focus distance.
    pub(crate) chosen: bool,
    /// Azimuth and elevation from which the scene was framed, degrees.
    pub(crate) looked_from_deg: Option<[f64; 2]>,
}

/// Places the display in the scene.
///
/// Without a camera the scene is framed from the front, or, where that shows next to nothing, from where more of it is seen. The frame is moved
/// to what is seen, all of which it holds. A camera that nobody asked for and that has no focus is moved closer as long as nothing is cut off.
///
/// # Errors
/// When the job names a camera that does not exist or gives numbers that make no rectangle.
pub fn place_window(
    ingested: &Ingested,
    job: &WindowJob,
    geometry: &FieldGeometry,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<Window, PipelineError> {
    find_window(ingested, job, geometry, cache_dir, task).map(|found| found.window)
}

/// [`place_window`], and how the window was found.
///
/// # Errors
/// As there.
pub(crate) fn find_window(
    ingested: &Ingested,
    job: &WindowJob,
    geometry: &FieldGeometry,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<Found, PipelineError> {
    let mut found = unlimited_window(ingested, job, geometry, cache_dir, task)?;
    match job.near {
        Near::Auto => {}
        Near::Off => found.window.near_mm = None,
        Near::At(near) => found.window.near_mm = Some(near / found.window.scene_from_display.scale),
    }
    Ok(found)
}

fn unlimited_window(
    ingested: &Ingested,
    job: &WindowJob,
    geometry: &FieldGeometry,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<Found, PipelineError> {
    let scene = &*ingested.scene;
    let size_mm = geometry.size_mm();
    let error = |source| PipelineError::Window { name: scene.name.clone(), source };
    if job.from == WindowFrom::Given {
        let missing = |key: &str| {
            PipelineError::value("job", format!("window.{key}"), "a value, as `from = \"given\"` needs", "nothing")
        };
        let vector = |key: &str, value: Option<[f64; 3]>| value.map(DVec3::from_array).ok_or_else(|| missing(key));
        let (centre, forward) = (vector("centre", job.centre)?, vector("forward", job.forward)?);
        let (up, width) = (vector("up", job.up)?, job.width.ok_or_else(|| missing("width"))?);
        let window = Window::given(centre, forward, up, width, size_mm).map_err(error)?;
        return Ok(Found { window, chosen: true, looked_from_deg: None });
    }
    let camera = match (job.from, &job.camera) {
        (WindowFrom::Bounds, _) => None,
        (_, Some(wanted)) => Some(find_camera(scene, wanted)?),
        // a direction that somebody asked for goes before a camera that nobody asked for
        (_, None) if job.look_from.is_some() => None,
        (_, None) => scene.cameras.first(),
    };
    if job.from == WindowFrom::Camera && camera.is_none() {
        return Err(PipelineError::value(&scene.name, "window.from", "a camera in the scene", "none"));
    }
    let framed = || -> Result<Found, PipelineError> {
        let from_deg = match job.look_from {
            Some(from_deg) => from_deg,
            None => {
                let mut key = KeyBuilder::new("side", code::VIEWS);
                ingested.add_to(&mut key);
                let key = key.add("size", format!("{size_mm:?}").as_bytes()).finish();
                remembered(cache_dir, &format!("side-{}.json", &key[..16]), || {
                    side::choose(ingested.renderer(task)?, scene, size_mm, task)
                })?
            }
        };
        let window = side::framed(scene, from_deg, size_mm).map_err(error)?;
        let window = close_up(ingested, window, geometry, true, cache_dir, task)?;
        Ok(Found { window, chosen: false, looked_from_deg: Some(from_deg) })
    };
    let Some(camera) = camera else { return framed() };
    let focus_distance = job.focus_distance.or(camera.focus_distance);
    let found = |window| Found { window, chosen: focus_distance.is_some(), looked_from_deg: None };
    match Window::from_camera(&Camera { focus_distance, ..camera.clone() }, scene.seen_bounds(), size_mm) {
        Ok(window) if focus_distance.is_some() || job.from == WindowFrom::Camera || job.camera.is_some() => {
            Ok(found(window))
        }
        Ok(window) => close_up(ingested, window, geometry, false, cache_dir, task).map(found),
        // a camera that nobody asked for must not stand in the way
        Err(_) if job.from == WindowFrom::Auto && job.camera.is_none() => framed(),
        Err(source) => Err(error(source)),
    }
}

/// Moves a window to what is seen of the scene, with `recentre`; without, closer along its axis, until the scene covers [`COVERAGE`] of it. Nothing that the
/// window shows is cut off.
fn close_up(
    ingested: &Ingested,
    window: Window,
    geometry: &FieldGeometry,
    recentre: bool,
    cache_dir: Option<&Path>,
    task: Task<'_>,
) -> Result<Window, PipelineError> {
    let mut key = KeyBuilder::new("window", code::VIEWS);
    ingested.add_to(&mut key);
    let key = key.add("window", format!("{window:?} {recentre}").as_bytes()).finish();
    let (place, factor): ([f64; 2], f64) = remembered(cache_dir, &format!("window-{}.json", &key[..16]), || {
        let renderer = ingested.renderer(task)?;
        // a coarse straight view is enough to find out where the scene is
        let cols = geometry.cols.min(PROBE_COLS);
        let pitch_mm = window.size_mm[0] / cols as f64;
        let rows = ((window.size_mm[1] / pitch_mm).round() as usize).max(1);
        let grid = ViewGrid::single(geometry.grid.projection, [0.0, 0.0]);
        let probe = FieldGeometry { rows, cols, pitch_mm, grid };
        let mask = renderer.hit_mask(&window, &probe, [0, 0], task).map_err(render_error)?;
        let (factor, [row, col]) = if recentre { whole(&mask) } else { closer(&mask) };
        let half = 0.5 * pitch_mm;
        Ok(([probe.x_mm(0) - half + col * pitch_mm, probe.y_mm(0) + half - row * pitch_mm], factor))
    })?;
    Ok(window.scaled_about(place, factor))
}

/// First and end of the rows and of the columns where the mask is set.
fn extents(mask: &Tensor<2>) -> Option<[[usize; 2]; 2]> {
    let [rows, cols] = mask.shape();
    let is_hit = |row: usize, col: usize| mask.get([row, col]) > 0.0;
    let hit = |axis: usize, i: usize| match axis {
        0 => (0..cols).any(|col| is_hit(i, col)),
        _ => (0..rows).any(|row| is_hit(row, i)),
    };
    let seen = |axis: usize, count: usize| {
        Some([(0..count).find(|&i| hit(axis, i))?, (0..count).rfind(|&i| hit(axis, i))? + 1])
    };
    Some([seen(0, rows)?, seen(1, cols)?])
}

/// The part of a picture that holds all that is set in the mask and a [margin](MARGIN), as a factor on its size and its centre [row, column] in pixels.
fn whole(mask: &Tensor<2>) -> (f64, [f64; 2]) {
    let size = mask.shape();
    let Some(seen) = extents(mask) else { return (1.0, size.map(|count| 0.5 * count as f64)) };
    // one pixel more, since what is seen may end anywhere in its last one
    let share = |axis: usize| (seen[axis][1] - seen[axis][0] + 1) as f64 / size[axis] as f64;
    let factor = (1.0 + 2.0 * MARGIN) * share(0).max(share(1));
    (factor, seen.map(|[first, end]| 0.5 * (first + end) as f64))
}

/// The middle of a picture of which [`COVERAGE`] is set in the mask, or as much of it as holds all that is set; no smaller than [`CLOSEST`].
fn closer(mask: &Tensor<2>) -> (f64, [f64; 2]) {
    let [rows, cols] = mask.shape();
    let middle = [rows, cols].map(|count| 0.5 * count as f64);
    let Some(seen) = extents(mask) else { return (1.0, middle) };
    let reach = |axis: usize| {
        let [first, end] = seen[axis].map(|edge| (edge as f64 - middle[axis]).abs());
        (1.0 + 2.0 * MARGIN) * first.max(end) / middle[axis]
    };
    let least = reach(0).max(reach(1)).max(CLOSEST);
    // nothing is cut off, so the same pixels cover more of a smaller picture
    let covered = mask.data().iter().map(|&hit| f64::from(hit)).sum::<f64>() / (rows * cols) as f64;
    ((covered / COVERAGE).sqrt().max(least).min(1.0), middle)
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

/// What reads a scene's file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Reader {
    Gltf,
    Usd,
    Blend,
    /// Id of an importer.
    Plugin(String),
}

/// Whether a file is USD by its extension.
pub fn is_usd(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    lumistack_usd::EXTENSIONS.contains(&extension.as_str())
}

/// Whether a file is Blender's by its extension.
pub fn is_blend(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(lumistack_usd::BLEND_EXTENSION))
}

/// Who reads a file without a plugin.
pub(crate) fn own_reader(path: &Path) -> Option<Reader> {
    let is_gltf = |extension: &std::ffi::OsStr| ["gltf", "glb"].iter().any(|own| extension.eq_ignore_ascii_case(own));
    if path.extension().is_some_and(is_gltf) {
        return Some(Reader::Gltf);
    }
    if is_usd(path) {
        return Some(Reader::Usd);
    }
    is_blend(path).then_some(Reader::Blend)
}

fn reader_of(path: &Path, importer: &ImporterJob, registry: &Registry) -> Result<Reader, PipelineError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if let Some(id) = &importer.plugin {
        registry.get_kind(id, PluginKind::Importer).map_err(PipelineError::Output)?;
        return Ok(Reader::Plugin(id.clone()));
    }
    if let Some(reader) = own_reader(path) {
        return Ok(reader);
    }
    let found = registry.importer_of(&extension).map(|info| info.id.clone());
    found.map(Reader::Plugin).ok_or_else(|| {
        let known = registry.infos().flat_map(|info| info.extensions.iter().map(|extension| format!(", .{extension}")));
        let usd = lumistack_usd::EXTENSIONS.map(|extension| format!(", .{extension}")).concat();
        let expected = format!("a file .gltf, .glb, .blend{usd}{}", known.collect::<String>());
        PipelineError::value(path, "scene", expected, format!("extension `{extension}`"))
    })
}

/// What the work of a plugin depends on, besides what it is given: its version, its parameters, and its code, which changes while somebody writes
/// it: the library's content, or the sources of one that is compiled in.
pub(crate) fn plugin_key(
    registry: &Registry,
    id: &str,
    params: &serde_json::Map<String, serde_json::Value>,
) -> Result<String, PipelineError> {
    let mut key = KeyBuilder::new(&format!("plugin {id}"), code::PLUGINS);
    key.add("version", registry.get(id).map_err(PipelineError::Output)?.info().version.as_bytes());
    key.add_json("params", params);
    for (name, path) in file_params::of(registry, id, params) {
        key.add("file", name.as_bytes()).add("content", hash(&read(Path::new(path))?).as_bytes());
    }
    match registry.origin(id) {
        Some(Origin::Library(library)) => {
            key.add("library", hash(&read(library)?).as_bytes());
        }
        _ => {
            let sources = lumistack_plugin_host::fingerprint_of(id).unwrap_or_default();
            key.add("sources", sources.as_bytes());
        }
    }
    Ok(key.finish())
}

/// Reads what a scene's file refers to, and remembers it.
struct Files {
    folder: Folder,
    read: Mutex<Vec<(PathBuf, String)>>,
}

impl Files {
    /// What the scene at `path` refers to: regular files in its own folder, or anywhere.
    fn beside(path: &Path, allow_outside: bool) -> Result<Self, PipelineError> {
        let io = |source| PipelineError::Read { path: path.to_owned(), source };
        let folder = if allow_outside { Folder::anywhere(path) } else { Folder::around(path).map_err(io)? };
        Ok(Self { folder, read: Mutex::default() })
    }

    /// Remembers what was read, and gives it back.
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

/// The way out where a scene is known to be harmless.
const OUTSIDE_ADVICE: &str =
    "--allow-outside (in a job `importer.allow_outside = true`) lets a scene read files that lie elsewhere";

pub(crate) fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: usize, cols: usize, is_set: impl Fn(usize, usize) -> bool) -> Tensor<2> {
        let mut mask = Tensor::zeros(["row", "col"], [rows, cols]);
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            *mask.at_mut([row, col]) = f32::from(u8::from(is_set(row, col)));
        }
        mask
    }

    /// Edges of the part that is kept: top, bottom, left, right.
    fn edges(mask: &Tensor<2>, (factor, [row, col]): (f64, [f64; 2])) -> [f64; 4] {
        let [height, width] = mask.shape().map(|count| 0.5 * factor * count as f64);
        [row - height, row + height, col - width, col + width]
    }

    #[test]
    fn what_is_framed_is_shown_whole() {
        // a head above a thin stand; a slender animal; a wide row of small things; a speck in a corner; all there is
        let cases: [(&str, Box<dyn Fn(usize, usize) -> bool>); 5] = [
            ("bust", Box::new(|row, col| col.abs_diff(80) < if row < 40 { 22 } else { 3 })),
            ("animal", Box::new(|row, col| (2..98).contains(&row) && col.abs_diff(80) < 9)),
            ("row", Box::new(|row, col| (60..68).contains(&row) && (10..150).contains(&col))),
            ("speck", Box::new(|row, col| row < 3 && col > 150)),
            ("all", Box::new(|_, _| true)),
        ];
        for (name, is_set) in cases {
            let mask = mask(100, 160, &is_set);
            let [[top, bottom], [left, right]] = extents(&mask).unwrap().map(|ends| ends.map(|end| end as f64));
            let kept = edges(&mask, whole(&mask));
            assert!(kept[0] < top && kept[1] > bottom && kept[2] < left && kept[3] > right, "{name}: {kept:?}");
            // no larger than it must be: a margin on both sides of the longer axis
            let spare = ((kept[1] - kept[0]) / (bottom - top + 1.0)).min((kept[3] - kept[2]) / (right - left + 1.0));
            assert!((spare - 1.06).abs() < 1e-9, "{name}: {spare}");
        }
        let empty = mask(10, 16, |_, _| false);
        assert_eq!(whole(&empty), (1.0, [5.0, 8.0]));
        assert_eq!(closer(&empty), (1.0, [5.0, 8.0]));
    }

    #[test]
    fn a_camera_comes_closer_but_cuts_nothing_off() {
        // half of the height, beside the middle: it would cover enough at 0.7, but would lose its right edge
        let beside = mask(100, 160, |row, col| (25..75).contains(&row) && (80..150).contains(&col));
        let (factor, centre) = closer(&beside);
        assert_eq!(centre, [50.0, 80.0], "a camera's axis stays in the middle");
        assert!(edges(&beside, (factor, centre))[3] >= 150.0, "{factor}");
        // a small thing in the middle comes as close as it may
        let small = mask(100, 160, |row, col| row.abs_diff(50) < 5 && col.abs_diff(80) < 5);
        assert_eq!(closer(&small).0, CLOSEST);
        // one that covers a seventh is moved until it covers a quarter
        let seventh = mask(100, 160, |row, col| row.abs_diff(50) < 24 && col.abs_diff(80) < 24);
        let factor = closer(&seventh).0;
        let covered = seventh.data().iter().sum::<f32>() / 16000.0;
        assert!((f64::from(covered) / factor.powi(2) - COVERAGE).abs() < 1e-6, "{factor}");
        // what runs out of the picture stays as it is
        assert_eq!(closer(&mask(100, 160, |row, _| row > 90)).0, 1.0);
    }
}
