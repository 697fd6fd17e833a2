//! Scene file to a lit [`Scene`] and the [`Window`] through which the display looks at it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use glam::{DVec3, Vec3};
use lumistack_core::{Task, Tensor};
use lumistack_display::{FieldGeometry, ViewGrid};
use lumistack_gltf::{AssetResolver, LoadOptions};
use lumistack_pathtracer::Renderer;
use lumistack_plugin_host::{Origin, PluginError, PluginKind, Registry};
use lumistack_scene::{Camera, Scene, Similarity, Window};
use lumistack_usd::{BlendContents, HandedOver};

use crate::blender;
use crate::cache::{KeyBuilder, remembered};
use crate::code;
use crate::error::{PipelineError, host_error, read};
use crate::file_params;
use crate::job::{ImporterJob, LightJob, PoseJob, WindowFrom, WindowJob};
use crate::light;
use crate::render::render_error;

/// Share of an automatic window that the scene should cover at least.
const COVERAGE: f64 = 0.26;
/// Least width of an automatic window relative to one that holds all of the scene.
const CLOSEST: f64 = 0.58;
/// Largest share of what is seen that may leave an automatic window at the bottom.
const FOOT: f64 = 0.5;
/// Width of what its lower edge may cut through, over the widest of what is seen above it.
const SLENDER: f64 = 0.3;
/// What stays free on each side of what an automatic window shows whole, as a share of it.
const MARGIN: f64 = 0.03;
/// Columns of the straight view by which coverage is measured.
const PROBE_COLS: usize = 168;

/// A loaded scene and what it was made from.
pub struct Ingested {
    /// Lit scene.
    pub scene: Arc<Scene>,
    /// Every file that was read, with a hash of its content.
    pub files: Vec<(PathBuf, String)>,
    /// What was taken of them.
    pub pose: PoseJob,
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
        let renderer = Renderer::new(self.scene.clone(), task).map_err(render_error)?;
        Ok(self.renderer.get_or_init(|| renderer))
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
    let resolver = Files { base: path.parent().unwrap_or(Path::new("")), read: Mutex::default() };
    let bytes = gltf_bytes(path, &reader, importer, registry, &resolver, task)?;
    Ok(SceneContents::Gltf(lumistack_gltf::contents(&path.display().to_string(), &bytes, &resolver, task)?))
}

/// The scene as glTF: the file itself, or what an importer makes of it.
fn gltf_bytes(
    path: &Path,
    reader: &Reader,
    importer: &ImporterJob,
    registry: &Registry,
    resolver: &Files<'_>,
    task: Task<'_>,
) -> Result<Vec<u8>, PipelineError> {
    let Reader::Plugin(id) = reader else {
        let bytes = read(path)?;
        resolver.remember(path.to_owned(), &bytes);
        return Ok(bytes);
    };
    // so that a missing file is told like any other
    std::fs::metadata(path).map_err(|source| PipelineError::Read { path: path.to_owned(), source })?;
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    let read = |name: &str| {
        resolver
            .read(name)
            .map_err(|error| PluginError::Failed(format!("{}: {error}", resolver.base.join(name).display())))
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
            let (read, contents) = load_blend(path, pose, cache_dir, task)?;
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
    let mut dark = !scene.is_lit();
    if light_job.automatic && !dark {
        let shared = Arc::new(scene);
        dark = light::leaves_dark(&shared, task)?;
        if dark {
            let message = "the surfaces that glow leave most of what is seen dark, so the studio light is added; `light.automatic = false` does without";
            task.warn(&shared.name, message);
        }
        scene = Arc::unwrap_or_clone(shared);
    }
    if light_job.automatic && dark {
        scene = light::edited(scene, task, |parts| {
            light::add_studio_light(parts);
            if let Some(environment) = &mut parts.environment {
                environment.strength = Vec3::splat(light_job.environment_strength);
            }
            Ok(())
        })?;
    }
    Ok(Ingested { scene: Arc::new(scene), files, pose: pose.clone(), known: None, renderer: OnceLock::new() })
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
    let resolver = Files { base: path.parent().unwrap_or(Path::new("")), read: Mutex::default() };
    let bytes = gltf_bytes(path, reader, importer, registry, &resolver, task)?;
    let options = LoadOptions { time_s, animation, variant, ..LoadOptions::default() };
    let scene = lumistack_gltf::load_with(&path.display().to_string(), &bytes, &resolver, &options, task)?;
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
    let resolver = Files { base: path.parent().unwrap_or(Path::new("")), read: Mutex::default() };
    let options = LoadOptions::default();
    let scene = lumistack_gltf::load_with(&path.display().to_string(), &glb, &resolver, &options, task)?;
    let mut files = hashed(&[&[path.to_owned()], &account.files[..]].concat())?;
    files.push(("blender".into(), account.blender));
    Ok(((scene, files), account.contents))
}

/// Files with hashes of their content.
fn hashed(files: &[PathBuf]) -> Result<Vec<(PathBuf, String)>, PipelineError> {
    files.iter().map(|file| Ok((file.clone(), hash(&read(file)?)))).collect()
}

/// Places the display in the scene.
///
/// A window that nobody asked for (no camera named, no focus distance, no numbers) is moved closer until the scene covers a quarter of it.
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
        return Window::given(centre, forward, up, width, size_mm).map_err(error);
    }
    let camera = match (job.from, &job.camera) {
        (WindowFrom::Bounds, _) => None,
        (_, Some(wanted)) => Some(find_camera(scene, wanted)?),
        (_, None) => scene.cameras.first(),
    };
    if job.from == WindowFrom::Camera && camera.is_none() {
        return Err(PipelineError::value(&scene.name, "window.from", "a camera in the scene", "none"));
    }
    let Some(camera) = camera else {
        let framed = Window::framing(scene.bounds(), size_mm).map_err(error)?;
        return close_up(ingested, framed, geometry, true, cache_dir, task);
    };
    let focus_distance = job.focus_distance.or(camera.focus_distance);
    match Window::from_camera(&Camera { focus_distance, ..camera.clone() }, scene.bounds(), size_mm) {
        Ok(window) if focus_distance.is_some() || job.from == WindowFrom::Camera || job.camera.is_some() => Ok(window),
        Ok(window) => close_up(ingested, window, geometry, false, cache_dir, task),
        // a camera that nobody asked for must not stand in the way
        Err(_) if job.from == WindowFrom::Auto && job.camera.is_none() => {
            Window::framing(scene.bounds(), size_mm).map_err(error)
        }
        Err(source) => Err(error(source)),
    }
}

/// Moves an automatic window closer until the scene covers [`COVERAGE`] of it, by no more than [`CLOSEST`]. With `recentre` it also
/// moves to where the scene is seen, and nothing leaves it but a foot below a slender neck: the stand of a bust, but no animal's paws or ears.
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
    let (centre, scale): ([f64; 3], f64) = remembered(cache_dir, &format!("window-{}.json", &key[..16]), || {
        let renderer = ingested.renderer(task)?;
        // a coarse straight view is enough to measure an area
        let cols = geometry.cols.min(PROBE_COLS);
        let pitch_mm = window.size_mm[0] / cols as f64;
        let rows = ((window.size_mm[1] / pitch_mm).round() as usize).max(1);
        let grid = ViewGrid::single(geometry.grid.projection, [0.0, 0.0]);
        let probe = FieldGeometry { rows, cols, pitch_mm, grid };
        let mask = renderer.hit_mask(&window, &probe, [0, 0], task).map_err(render_error)?;
        let (factor, [row, col]) = best_crop(&mask, recentre);
        let half = 0.5 * pitch_mm;
        let place = [probe.x_mm(0) - half + col * pitch_mm, probe.y_mm(0) + half - row * pitch_mm];
        let map = window.scaled_about(place, factor).scene_from_display;
        Ok((map.translation.to_array(), map.scale))
    })?;
    let map = Similarity { translation: centre.into(), scale, ..window.scene_from_display };
    Ok(Window { scene_from_display: map, ..window })
}

/// The largest part of a picture, as a factor on its size and its centre [row, column] in pixels, of which [`COVERAGE`] is set in the mask. Where even
/// [`CLOSEST`] is not enough, that. With `recentre` what is seen stays whole, but for a foot below a slender neck; where less than [`COVERAGE`] is to
/// be had, it keeps a [margin](MARGIN).
fn best_crop(mask: &Tensor<2>, recentre: bool) -> (f64, [f64; 2]) {
    let [rows, cols] = mask.shape();
    let per_row: Vec<f64> = (0..rows).map(|row| mask.block([row]).iter().map(|&hit| f64::from(hit)).sum()).collect();
    let middle = [rows as f64 / 2.0, cols as f64 / 2.0];
    let seen = |axis: usize| {
        let hit = |i: usize| match axis {
            0 => per_row[i] > 0.0,
            _ => (0..rows).any(|row| mask.get([row, i]) > 0.0),
        };
        let count = [rows, cols][axis];
        Some([(0..count).find(|&i| hit(i))?, (0..count).rfind(|&i| hit(i))? + 1])
    };
    let (Some([first_row, end_row]), Some([first_col, end_col])) = (seen(0), seen(1)) else { return (1.0, middle) };
    // where a window of `size` goes of `count` pixels, so that it stands as near to `wanted` as it can
    let place =
        |wanted: f64, size: usize, count: usize| wanted.clamp(0.5 * size as f64, count as f64 - 0.5 * size as f64);
    let framed = |count: usize, seen: usize| (1.0 + 2.0 * MARGIN) * seen as f64 / count as f64;
    let whole = framed(rows, end_row - first_row).max(framed(cols, end_col - first_col)).max(CLOSEST);
    let mut best = if recentre {
        (whole, [0.5 * (first_row + end_row) as f64, 0.5 * (first_col + end_col) as f64])
    } else {
        (1.0, middle)
    };
    let mut factor = 1.0;
    loop {
        let [height, width] = [rows, cols].map(|n| ((n as f64 * factor).round() as usize).max(1));
        let centre = if recentre {
            if width < end_col - first_col {
                return best;
            }
            // all of it in the middle, or its top at the top
            let row = if height >= end_row - first_row { first_row + end_row } else { 2 * first_row + height };
            let col = first_col + end_col;
            [place(0.5 * row as f64, height, rows), place(0.5 * col as f64, width, cols)]
        } else {
            middle
        };
        let [top, left] =
            [centre[0] - 0.5 * height as f64, centre[1] - 0.5 * width as f64].map(|edge| edge.round() as usize);
        let (bottom, right) = ((top + height).min(rows), (left + width).min(cols));
        let shown: f64 = (top..bottom)
            .map(|row| mask.block([row])[left..right].iter().map(|&hit| f64::from(hit)).sum::<f64>())
            .sum();
        let enough = shown >= COVERAGE * (height * width) as f64;
        let is_fine = if !recentre {
            true
        } else if bottom < end_row {
            cuts_through_a_neck(&per_row[..end_row], bottom)
        } else {
            enough
        };
        if is_fine {
            best = (factor, centre);
            if enough {
                return best;
            }
        }
        if factor <= CLOSEST {
            return best;
        }
        factor = (factor - 0.02).max(CLOSEST);
    }
}

/// Whether a window that ends before row `bottom` cuts off a foot below a slender neck.
fn cuts_through_a_neck(per_row: &[f64], bottom: usize) -> bool {
    let cut = per_row[bottom];
    let foot: f64 = per_row[bottom..].iter().sum();
    // of what stays: a piece of chess is widest at its foot, and that is no stand
    let widest = per_row[..bottom].iter().copied().fold(0.0, f64::max);
    cut <= SLENDER * widest && foot <= FOOT * per_row.iter().sum::<f64>()
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
enum Reader {
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

fn reader_of(path: &Path, importer: &ImporterJob, registry: &Registry) -> Result<Reader, PipelineError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if let Some(id) = &importer.plugin {
        registry.get_kind(id, PluginKind::Importer).map_err(PipelineError::Output)?;
        return Ok(Reader::Plugin(id.clone()));
    }
    if matches!(extension.as_str(), "gltf" | "glb") {
        return Ok(Reader::Gltf);
    }
    if is_usd(path) {
        return Ok(Reader::Usd);
    }
    if is_blend(path) {
        return Ok(Reader::Blend);
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
struct Files<'a> {
    base: &'a Path,
    read: Mutex<Vec<(PathBuf, String)>>,
}

impl Files<'_> {
    fn remember(&self, path: PathBuf, bytes: &[u8]) {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = (path, hash(bytes));
        if !read.contains(&entry) {
            read.push(entry);
        }
    }
}

impl AssetResolver for Files<'_> {
    fn read(&self, uri: &str) -> Result<Vec<u8>, String> {
        let path = self.base.join(uri);
        let bytes = std::fs::read(&path).map_err(|error| error.to_string())?;
        self.remember(path, &bytes);
        Ok(bytes)
    }
}

pub(crate) fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slender_figure_is_framed_where_it_is_widest() {
        let mut mask = Tensor::zeros(["row", "col"], [100, 160]);
        for row in 0..100 {
            // a head above a thin stand
            let half = if row < 40 { 22 } else { 3 };
            (80 - half..80 + half).for_each(|col| *mask.at_mut([row, col]) = 1.0);
        }
        let (factor, [row, col]) = best_crop(&mask, true);
        assert!(factor < 0.9 && factor > CLOSEST, "{factor}");
        assert!((row - 50.0 * factor).abs() < 3.0, "the head stays whole: {row} at {factor}");
        assert!((col - 80.0).abs() < 2.0);
        let (_, [row, _]) = best_crop(&mask, false);
        assert!((row - 50.0).abs() <= 1.0, "a camera's axis stays in the middle");
    }

    #[test]
    fn what_covers_enough_stays_as_it_is() {
        let full = Tensor::filled(["row", "col"], [10, 16], 1.0);
        assert_eq!(best_crop(&full, true), (1.0, [5.0, 8.0]));
        let empty = Tensor::zeros(["row", "col"], [10, 16]);
        assert_eq!(best_crop(&empty, true), (1.0, [5.0, 8.0]));
        assert_eq!(best_crop(&empty, false), (1.0, [5.0, 8.0]));
    }

    /// Ears, a body, legs, all about as wide: closer would cut some of it off.
    #[test]
    fn a_slender_animal_stays_whole() {
        let mut mask = Tensor::zeros(["row", "col"], [100, 160]);
        for row in 2..98 {
            let half = if row < 12 { 4 } else { 9 };
            (80 - half..80 + half).for_each(|col| *mask.at_mut([row, col]) = 1.0);
        }
        let (factor, [row, col]) = best_crop(&mask, true);
        assert!(factor >= 0.96, "{factor}");
        assert!((row - 50.0).abs() <= 2.0 && (col - 80.0).abs() <= 1.0);
        // one that does not fill the window's height is framed with a margin above and below
        let mut mask = Tensor::zeros(["row", "col"], [100, 160]);
        (15..85).for_each(|row| (70..90).for_each(|col| *mask.at_mut([row, col]) = 1.0));
        let (factor, [row, _]) = best_crop(&mask, true);
        let [top, bottom] = [row - 50.0 * factor, row + 50.0 * factor];
        assert!((11.0..13.5).contains(&top) && (86.5..89.0).contains(&bottom), "{top} to {bottom}");
        // one that covers enough is not moved away for it
        let mut mask = Tensor::zeros(["row", "col"], [100, 160]);
        (15..85).for_each(|row| (54..84).for_each(|col| *mask.at_mut([row, col]) = 1.0));
        let (factor, _) = best_crop(&mask, true);
        assert!((0.68..0.72).contains(&factor), "{factor}");
        // nor does a piece of chess lose its foot: a head, a stem that is slender beside the foot, and the foot
        let mut mask = Tensor::zeros(["row", "col"], [100, 160]);
        for row in 2..98 {
            let half = if row < 30 {
                14
            } else if row < 70 {
                6
            } else {
                24
            };
            (80 - half..80 + half).for_each(|col| *mask.at_mut([row, col]) = 1.0);
        }
        let (factor, _) = best_crop(&mask, true);
        assert!(factor >= 0.96, "{factor}");
        // a wide row of small things is not cut at its ends
        let mut mask = Tensor::zeros(["row", "col"], [100, 160]);
        (10..150).for_each(|col| (60..68).for_each(|row| *mask.at_mut([row, col]) = 1.0));
        let (factor, [row, _]) = best_crop(&mask, true);
        assert!((0.92..0.94).contains(&factor), "{factor}, with a margin at both ends");
        assert!((row - 55.0).abs() < 10.0, "it stands in the middle as far as that goes: {row}");
    }
}
