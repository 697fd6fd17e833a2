//! The job file: which scene or light field becomes patterns of which display, and what is written.
//!
//! Every key has a default except the input and the display; `docs/JOB.md` lists them all. Relative paths are relative to the job file.

use std::path::{Path, PathBuf};

use lumistack_core::config;
use lumistack_core::tone::ToneCurve;
use lumistack_display::{Display, Missing, Sampling};
use lumistack_field_io::GeometryFlags;
use serde::{Deserialize, Serialize};

use crate::error::{PipelineError, read_to_string};
use crate::presets;

/// A job, as its file says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Format of the file.
    #[serde(default = "schema")]
    pub schema: String,
    /// Version of the format.
    #[serde(default = "version")]
    pub version: u32,
    /// Name for people and for the run folder; default: the file's stem.
    #[serde(default)]
    pub name: String,
    /// Scene to render: `.gltf` or `.glb`. Either this or `light_field`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<PathBuf>,
    /// Light field that somebody else rendered: a folder, `.npy`, a quilt. Either this or `scene`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_field: Option<PathBuf>,
    /// Seed of all random streams.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Geometry that a foreign light field does not state itself.
    #[serde(default, skip_serializing_if = "is_default")]
    pub geometry: GeometryFlags,
    /// The display.
    pub display: DisplayJob,
    /// Where the display stands in the scene.
    #[serde(default)]
    pub window: WindowJob,
    /// The scene's animation and variant.
    #[serde(default)]
    pub pose: PoseJob,
    /// Light and exposure.
    #[serde(default)]
    pub light: LightJob,
    /// Path tracer.
    #[serde(default)]
    pub render: RenderJob,
    /// Factorizer.
    #[serde(default)]
    pub factorize: FactorizeJob,
    /// Times of a sequence; without it the job is a still.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence: Option<SequenceJob>,
    /// Report.
    #[serde(default)]
    pub report: ReportJob,
    /// Importer of a scene that is not glTF, and its parameters.
    #[serde(default, skip_serializing_if = "is_default")]
    pub importer: ImporterJob,
    /// Displays that are fed from one light field; without any, the one display of the job.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeJob>,
    /// Output plugins; default: `images`.
    #[serde(default = "default_outputs")]
    pub outputs: Vec<OutputJob>,
}

/// Which plugin reads the scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImporterJob {
    /// Id of the plugin; default: the one that takes files of this extension.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plugin: Option<String>,
    /// Its parameters.
    #[serde(default)]
    pub params: serde_json::Map<String, serde_json::Value>,
}

/// What makes a layer stack from the light field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeJob {
    /// Name, unique in the job; also that of its folder.
    pub id: String,
    /// `tensor-display`, the factorizer, or the id of a node plugin.
    #[serde(default = "default_node")]
    pub plugin: String,
    /// Its display, which takes the light field's resolution and views; default: the job's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub display: Option<DisplayJob>,
    /// Factorizer of `tensor-display`; default: the job's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factorize: Option<FactorizeJob>,
    /// Parameters of a node plugin.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub params: serde_json::Map<String, serde_json::Value>,
}

/// Which display, and what to change about it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DisplayJob {
    /// Name of a preset; see `lumistack displays`. Either this or `file`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// A display file. Either this or `preset`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// [columns, rows] of the light field; masks scale along, the width in millimetres stays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<[usize; 2]>,
    /// [horizontal, vertical] views.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub views: Option<[usize; 2]>,
    /// [horizontal, vertical] full angles of view, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov_deg: Option<[f64; 2]>,
    /// Frames M.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Brightness scale β.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub brightness: Option<f64>,
    /// How a ray reads a layer between pixel centres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sampling: Option<Sampling>,
    /// What a ray reads that leaves a layer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing: Option<Missing>,
}

/// Where the display stands in the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowJob {
    /// `auto`: the first camera's plane of focus, or framed on the bounds when there is none; `camera`; `bounds`; `given`.
    #[serde(default)]
    pub from: WindowFrom,
    /// Name or number of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// Distance of the camera's plane of focus, scene units, instead of the file's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focus_distance: Option<f32>,
    /// `given`: centre in the scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub centre: Option<[f64; 3]>,
    /// `given`: viewing direction, into the scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forward: Option<[f64; 3]>,
    /// `given`: upward direction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// `given`: width in scene units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<f64>,
    /// Whether the window is moved, or depth compressed as well, so that the scene lies in the display's depth of field.
    #[serde(default)]
    pub fit_depth: FitDepth,
    /// Factor on the parallax between views, and so on depth: views are traced at slopes this much smaller. The central view stays.
    #[serde(default = "default_depth_scale")]
    pub depth_scale: f64,
}

/// How the scene is brought into the display's depth of field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FitDepth {
    /// The window stays where it is.
    #[default]
    Off,
    /// The window moves along its normal.
    Move,
    /// It moves, and depth is compressed where it still does not fit.
    Compress,
}

/// How the window is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WindowFrom {
    /// A camera where the file has one, otherwise the bounds.
    #[default]
    Auto,
    /// A camera.
    Camera,
    /// The scene's bounds, seen from the front.
    Bounds,
    /// `centre`, `forward`, `up`, `width`.
    Given,
}

/// What to take of a scene that has a choice.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseJob {
    /// Time at which animations are sampled, seconds; they hold beyond their ends. Without it the scene as its nodes stand, or, with
    /// `animation`, time 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// Name or number of the animation; without it all of them together where no two move the same thing, otherwise the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub animation: Option<String>,
    /// Name or number of the material variant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variant: Option<String>,
}

/// Light and exposure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightJob {
    /// Radiance HDR or EXR environment map that replaces the scene's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<PathBuf>,
    /// Factor on the environment's radiance.
    #[serde(default = "one")]
    pub environment_strength: f32,
    /// Whether a scene without any light gets the built-in studio light.
    #[serde(default = "yes")]
    pub automatic: bool,
    /// Exposure in stops added to the automatic one, or to scene radiance when `automatic_exposure` is off.
    #[serde(default)]
    pub exposure_ev: f64,
    /// Whether exposure follows the brightness of all views together.
    #[serde(default = "yes")]
    pub automatic_exposure: bool,
    /// Curve from exposed radiance to what the display shows; one for all views.
    #[serde(default)]
    pub tone: Tone,
}

/// Tone curve of all views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tone {
    /// `linear` where next to nothing is brighter than white, else `khronos-neutral`.
    #[default]
    Auto,
    /// Clips what is brighter than white.
    Linear,
    /// Khronos PBR Neutral.
    KhronosNeutral,
    /// AgX base look.
    Agx,
}

impl From<ToneCurve> for Tone {
    fn from(curve: ToneCurve) -> Self {
        match curve {
            ToneCurve::Linear => Self::Linear,
            ToneCurve::KhronosNeutral => Self::KhronosNeutral,
            ToneCurve::Agx => Self::Agx,
        }
    }
}

/// Path tracer settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderJob {
    /// Paths per pixel and view.
    #[serde(default = "default_samples")]
    pub samples: u32,
    /// Bounces after the first hit.
    #[serde(default = "default_bounces")]
    pub max_bounces: u32,
    /// Largest value of a single path, which dims brighter ones and so loses light; none keeps all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clamp: Option<f32>,
    /// `point`: rays at the view's slope; `bin`: spread over the view's bin.
    #[serde(default)]
    pub angular_filter: AngularFilter,
    /// Full angle under which a lens focused on the window is seen from it, degrees; 0 for a pinhole. Instead of `angular_filter`.
    #[serde(default)]
    pub lens_deg: f64,
    /// In-between views per axis that are rendered for the report only; 0 for none.
    #[serde(default = "default_held_out")]
    pub held_out: usize,
    /// Views on either side beyond the outermost ones, one view spacing apart, that are rendered for the report only; 0 for none.
    #[serde(default = "default_outside")]
    pub outside: usize,
}

/// Angular extent of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AngularFilter {
    /// One slope per view.
    #[default]
    Point,
    /// Slopes spread over the view's bin.
    Bin,
}

/// Factorizer settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FactorizeJob {
    /// Name of the solver.
    #[serde(default = "default_solver")]
    pub solver: String,
    /// Full updates.
    #[serde(default = "default_iterations")]
    pub iterations: u32,
    /// Starting values: `auto`, `random`, `smooth` or `content`.
    #[serde(default = "default_start")]
    pub start: String,
    /// Levels of half the resolution to begin at; without it what suits the solver.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coarse_levels: Option<u32>,
    /// Iterations at each coarser level.
    #[serde(default = "default_coarse_iterations")]
    pub coarse_iterations: u32,
    /// Whether patterns of layers with few `bits` are re-optimized on the levels that the panel can show.
    #[serde(default = "default_true")]
    pub levels: bool,
    /// A `layers` folder to start from instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_start: Option<PathBuf>,
    /// `.npy` of weights, `[view_y][view_x]` or `[view_y][view_x][row][col]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
    /// Weight of rays far from every eye of `eyes`.
    #[serde(default = "default_eye_floor")]
    pub eye_floor: f64,
    /// Where viewers' eyes are expected; rays count by how near they pass.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub eyes: Vec<EyeJob>,
}

/// A Gaussian around an expected eye.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EyeJob {
    /// [x, y, z] in display space, millimetres; z > 0.
    pub eye_mm: [f64; 3],
    /// Standard deviation, millimetres.
    pub sigma_mm: f64,
    /// Weight of rays through its centre.
    #[serde(default = "default_eye_weight")]
    pub weight: f64,
}

/// A sequence: light fields of one geometry, or a window that moves through the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequenceJob {
    /// Number of times; without it one for every light field in the folder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<usize>,
    /// Full updates at every time after the first, which starts from nothing and takes `factorize.iterations`.
    #[serde(default = "default_sequence_iterations")]
    pub iterations: u32,
    /// Angle by which the window turns about its vertical axis from the first time to the last, degrees; above 0 the viewer walks to the right.
    #[serde(default)]
    pub turn_deg: f64,
    /// [right, up, to the viewer] by which the window moves from the first time to the last, millimetres of display space at the first time.
    #[serde(default)]
    pub shift_mm: [f64; 3],
    /// Time of the scene's animations from the first time to the last, seconds; the first is `pose.time_s`, or 0.
    #[serde(default)]
    pub duration_s: f64,
    /// Whether every time gets a whole report of its own; the sequence's is always written.
    #[serde(default)]
    pub reports: bool,
}

/// Report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReportJob {
    /// Pixels of a view per degree of visual angle, for FLIP.
    #[serde(default = "default_pixels_per_degree")]
    pub pixels_per_degree: f64,
}

/// One output plugin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputJob {
    /// Id of the plugin; see `lumistack plugins`.
    pub plugin: String,
    /// Name of its folder; default: the plugin's id.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// What it takes: `light_field`, or a node; default: the one node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    /// Its parameters.
    #[serde(default)]
    pub params: serde_json::Map<String, serde_json::Value>,
}

impl OutputJob {
    /// `from` of an output that takes the light field itself.
    pub const LIGHT_FIELD: &'static str = "light_field";

    /// An output with default parameters.
    pub fn new(plugin: &str) -> Self {
        Self { plugin: plugin.into(), name: None, from: None, params: serde_json::Map::new() }
    }

    /// Name of its folder.
    pub fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.plugin)
    }
}

impl NodeJob {
    /// The factorizer, which is no plugin.
    pub const TENSOR_DISPLAY: &'static str = "tensor-display";
}

fn default_node() -> String {
    NodeJob::TENSOR_DISPLAY.into()
}

fn schema() -> String {
    Job::SCHEMA.into()
}

fn version() -> u32 {
    1
}

fn default_seed() -> u64 {
    1
}

fn one() -> f32 {
    1.0
}

fn default_depth_scale() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

fn default_samples() -> u32 {
    32
}

fn default_bounces() -> u32 {
    6
}

fn default_held_out() -> usize {
    2
}

fn default_outside() -> usize {
    1
}

fn default_sequence_iterations() -> u32 {
    5
}

fn default_pixels_per_degree() -> f64 {
    67.02
}

fn default_solver() -> String {
    lumistack_factorizer::AUTO.into()
}

fn default_coarse_iterations() -> u32 {
    lumistack_factorizer::Settings::default().coarse_iterations
}

fn default_true() -> bool {
    true
}

fn default_eye_floor() -> f64 {
    0.05
}

fn default_eye_weight() -> f64 {
    1.0
}

fn default_iterations() -> u32 {
    lumistack_factorizer::Settings::default().iterations
}

fn default_start() -> String {
    lumistack_factorizer::AUTO.into()
}

fn default_outputs() -> Vec<OutputJob> {
    vec![OutputJob::new("images")]
}

/// Whether a text can be a folder on every system.
fn is_folder_name(name: &str) -> bool {
    !name.is_empty() && name.len() <= 100 && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Default for WindowJob {
    fn default() -> Self {
        Self {
            from: WindowFrom::Auto,
            camera: None,
            focus_distance: None,
            centre: None,
            forward: None,
            up: None,
            width: None,
            fit_depth: FitDepth::Off,
            depth_scale: default_depth_scale(),
        }
    }
}

impl Default for LightJob {
    fn default() -> Self {
        Self {
            environment: None,
            environment_strength: one(),
            automatic: true,
            exposure_ev: 0.0,
            automatic_exposure: true,
            tone: Tone::Auto,
        }
    }
}

impl Default for RenderJob {
    fn default() -> Self {
        Self {
            samples: default_samples(),
            max_bounces: default_bounces(),
            clamp: None,
            angular_filter: AngularFilter::Point,
            lens_deg: 0.0,
            held_out: default_held_out(),
            outside: default_outside(),
        }
    }
}

impl Default for SequenceJob {
    fn default() -> Self {
        Self {
            times: None,
            iterations: default_sequence_iterations(),
            turn_deg: 0.0,
            shift_mm: [0.0; 3],
            duration_s: 0.0,
            reports: false,
        }
    }
}

impl Default for ReportJob {
    fn default() -> Self {
        Self { pixels_per_degree: default_pixels_per_degree() }
    }
}

impl Default for FactorizeJob {
    fn default() -> Self {
        Self {
            solver: default_solver(),
            iterations: default_iterations(),
            start: default_start(),
            coarse_levels: None,
            coarse_iterations: default_coarse_iterations(),
            levels: true,
            warm_start: None,
            weights: None,
            eye_floor: default_eye_floor(),
            eyes: Vec::new(),
        }
    }
}

impl Job {
    /// Value of the key `schema`.
    pub const SCHEMA: &'static str = "lumistack/job";

    /// A job with nothing set but its display.
    pub fn new(display: DisplayJob) -> Self {
        Self {
            schema: schema(),
            version: version(),
            name: String::new(),
            scene: None,
            light_field: None,
            seed: default_seed(),
            geometry: GeometryFlags::default(),
            display,
            window: WindowJob::default(),
            pose: PoseJob::default(),
            light: LightJob::default(),
            render: RenderJob::default(),
            factorize: FactorizeJob::default(),
            sequence: None,
            report: ReportJob::default(),
            importer: ImporterJob::default(),
            nodes: Vec::new(),
            outputs: default_outputs(),
        }
    }

    /// Reads a job file; its relative paths become relative to the working folder.
    ///
    /// # Errors
    /// When the file cannot be read, does not parse, or has unknown keys.
    pub fn load(path: &Path) -> Result<Self, PipelineError> {
        let text = read_to_string(path)?;
        let mut job: Self = config::parse(&text).map_err(|source| PipelineError::Config {
            path: path.to_owned(),
            text: text.clone(),
            source,
        })?;
        if job.schema != Self::SCHEMA || job.version != 1 {
            return Err(PipelineError::value(
                path,
                "schema",
                "lumistack/job, version 1",
                format!("{}, version {}", job.schema, job.version),
            ));
        }
        if job.name.is_empty() {
            job.name = path.file_stem().map_or("job".into(), |stem| stem.to_string_lossy().into_owned());
            // scenes/still-life/job.toml is called still-life
            if job.name == "job"
                && let Some(folder) = path.parent().and_then(Path::file_name)
            {
                job.name = folder.to_string_lossy().into_owned();
            }
        }
        let base = path.parent().unwrap_or(Path::new(""));
        for path in job.paths_mut() {
            *path = base.join(&*path);
        }
        Ok(job)
    }

    /// Every path in the job.
    pub fn paths_mut(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let own = [
            &mut self.scene,
            &mut self.light_field,
            &mut self.display.file,
            &mut self.light.environment,
            &mut self.factorize.warm_start,
            &mut self.factorize.weights,
        ];
        let of_nodes = self.nodes.iter_mut().flat_map(|node| {
            let display = node.display.iter_mut().map(|display| &mut display.file);
            display.chain(node.factorize.iter_mut().flat_map(|job| [&mut job.warm_start, &mut job.weights]))
        });
        own.into_iter().chain(of_nodes).flatten()
    }

    /// The display that the job asks for.
    ///
    /// # Errors
    /// When the preset is unknown, the file does not parse, or a changed value is out of range.
    pub fn resolve_display(&self) -> Result<Display, PipelineError> {
        self.display.resolve()
    }

    /// Checks values that no parser checks.
    ///
    /// # Errors
    /// On the first value that makes no sense.
    pub fn check(&self) -> Result<(), PipelineError> {
        let fail = |key: &str, expected: &str, found: String| Err(PipelineError::value("job", key, expected, found));
        match (&self.scene, &self.light_field) {
            (Some(_), None) | (None, Some(_)) => {}
            (Some(_), Some(_)) => return fail("scene", "either `scene` or `light_field`", "both".into()),
            (None, None) => return fail("scene", "either `scene` or `light_field`", "neither".into()),
        }
        if !(1..=65536).contains(&self.render.samples) {
            return fail("render.samples", "1 to 65536", self.render.samples.to_string());
        }
        if self.render.max_bounces > 1024 {
            return fail("render.max_bounces", "0 to 1024", self.render.max_bounces.to_string());
        }
        if !(0.0..=90.0).contains(&self.render.lens_deg) {
            return fail("render.lens_deg", "0 to 90", self.render.lens_deg.to_string());
        }
        if self.render.lens_deg > 0.0 && self.render.angular_filter == AngularFilter::Bin {
            return fail("render.lens_deg", "either a lens or `angular_filter = \"bin\"`", "both".into());
        }
        if !(1e-3..=10.0).contains(&self.window.depth_scale) {
            return fail("window.depth_scale", "0.001 to 10", self.window.depth_scale.to_string());
        }
        if let Some(limit) = self.render.clamp.filter(|limit| !(*limit > 0.0 && limit.is_finite())) {
            return fail("render.clamp", "a number above 0", limit.to_string());
        }
        for (key, count) in [("render.held_out", self.render.held_out), ("render.outside", self.render.outside)] {
            if count > 64 {
                return fail(key, "0 to 64", count.to_string());
            }
        }
        if !(1.0..=1000.0).contains(&self.report.pixels_per_degree) {
            return fail("report.pixels_per_degree", "1 to 1000", self.report.pixels_per_degree.to_string());
        }
        if self.pose != PoseJob::default() && self.scene.is_none() {
            return fail("pose", "a scene to pose", "a light field".into());
        }
        if let Some(time_s) = self.pose.time_s.filter(|time_s| !time_s.is_finite()) {
            return fail("pose.time_s", "a finite time", time_s.to_string());
        }
        if !(self.light.exposure_ev.is_finite() && self.light.exposure_ev.abs() <= 100.0) {
            return fail("light.exposure_ev", "-100 to 100", self.light.exposure_ev.to_string());
        }
        if !(self.light.environment_strength.is_finite() && self.light.environment_strength >= 0.0) {
            return fail("light.environment_strength", "a number ≥ 0", self.light.environment_strength.to_string());
        }
        self.check_graph()?;
        self.sequence.as_ref().map_or(Ok(()), |sequence| sequence.check(self.scene.is_some()))
    }

    /// Checks that nodes and outputs have names of their own, and that every output takes something that is there.
    fn check_graph(&self) -> Result<(), PipelineError> {
        let fail = |key: String, expected: &str, found: String| Err(PipelineError::value("job", key, expected, found));
        if !self.nodes.is_empty() && self.sequence.is_some() {
            return fail("nodes".into(), "either `nodes` or `sequence`", "both".into());
        }
        let mut ids: Vec<&str> = Vec::new();
        for (i, node) in self.nodes.iter().enumerate() {
            if !is_folder_name(&node.id) || node.id == OutputJob::LIGHT_FIELD || ids.contains(&node.id.as_str()) {
                let expected = "a name of its own: letters, digits, `-` and `_`, and not `light_field`";
                return fail(format!("nodes[{i}].id"), expected, format!("`{}`", node.id));
            }
            ids.push(&node.id);
            let (unused, owner) = match (node.plugin == NodeJob::TENSOR_DISPLAY, &node.factorize) {
                (true, _) if !node.params.is_empty() => ("params", "a node plugin"),
                (false, Some(_)) => ("factorize", "`tensor-display`"),
                _ => continue,
            };
            return fail(format!("nodes[{i}].{unused}"), &format!("nothing, as only {owner} has it"), "a table".into());
        }
        if self.nodes.is_empty() {
            ids.push(NodeJob::TENSOR_DISPLAY);
        }
        let mut taken: Vec<(&str, &str)> = Vec::new();
        for (i, output) in self.outputs.iter().enumerate() {
            let known = || format!("`{}` or one of {}", OutputJob::LIGHT_FIELD, ids.join(", "));
            let from = match (&output.from, ids.as_slice()) {
                (Some(from), _) if from == OutputJob::LIGHT_FIELD || ids.contains(&from.as_str()) => from.as_str(),
                (Some(from), _) => return fail(format!("outputs[{i}].from"), &known(), format!("`{from}`")),
                (None, [only]) => only,
                (None, _) => return fail(format!("outputs[{i}].from"), &known(), "nothing".into()),
            };
            if !is_folder_name(output.name()) {
                return fail(
                    format!("outputs[{i}].name"),
                    "letters, digits, `-` and `_`",
                    format!("`{}`", output.name()),
                );
            }
            if taken.contains(&(from, output.name())) {
                let expected = "a `name` of its own beside another of the same plugin";
                return fail(format!("outputs[{i}]"), expected, format!("`{}` twice", output.name()));
            }
            taken.push((from, output.name()));
        }
        Ok(())
    }

    /// The outputs that take what `from` makes.
    pub(crate) fn outputs_of(&self, from: &str) -> impl Iterator<Item = &OutputJob> {
        let only = self.nodes.len() < 2;
        self.outputs
            .iter()
            .filter(move |output| output.from.as_deref().map_or(only && from != OutputJob::LIGHT_FIELD, |f| f == from))
    }

    /// The job as a file, every default written out.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a job holds nothing that TOML cannot")
    }
}

impl DisplayJob {
    /// The display that is asked for.
    ///
    /// # Errors
    /// As [`Job::resolve_display`].
    pub fn resolve(&self) -> Result<Display, PipelineError> {
        let job = self;
        let (place, mut display) = match (&job.preset, &job.file) {
            (Some(name), None) => (PathBuf::from(name), presets::load(name)?),
            (None, Some(path)) => (path.clone(), presets::load_file(path)?),
            _ => {
                let found = if job.preset.is_some() { "both" } else { "neither" };
                return Err(PipelineError::value("job", "display", "either `preset` or `file`", found));
            }
        };
        if let Some(views) = job.views {
            display.field.views = views;
        }
        if let Some(fov_deg) = job.fov_deg {
            display.field.fov_deg = fov_deg;
        }
        display.frames = job.frames.unwrap_or(display.frames);
        display.brightness = job.brightness.unwrap_or(display.brightness);
        display.sampling = job.sampling.unwrap_or(display.sampling);
        display.missing = job.missing.unwrap_or(display.missing);
        if let Some(resolution) = job.resolution {
            if resolution.contains(&0) {
                let found = format!("{resolution:?}");
                return Err(PipelineError::value("job", "display.resolution", "at least [1, 1]", found));
            }
            display = display.with_resolution(resolution);
        }
        display.check().map_err(|source| PipelineError::Display { path: place, text: String::new(), source })?;
        Ok(display)
    }
}

impl SequenceJob {
    /// Most times of a sequence: their folders have four digits.
    pub const MOST: usize = 9999;

    fn check(&self, of_scene: bool) -> Result<(), PipelineError> {
        let fail = |key: &str, expected: &str, found: String| Err(PipelineError::value("job", key, expected, found));
        match self.times {
            Some(times) if !(1..=Self::MOST).contains(&times) => {
                return fail("sequence.times", "1 to 9999", times.to_string());
            }
            None if of_scene => {
                return fail("sequence.times", "the number of times, as a scene does not say", "nothing".into());
            }
            _ => {}
        }
        let moves = self.turn_deg != 0.0 || self.shift_mm != [0.0; 3] || self.duration_s != 0.0;
        if moves && !of_scene {
            let expected = "`turn_deg`, `shift_mm` and `duration_s` for a scene only";
            return fail("sequence", expected, "them with light fields".into());
        }
        if !self.duration_s.is_finite() {
            return fail("sequence.duration_s", "a finite time", self.duration_s.to_string());
        }
        if !self.turn_deg.is_finite() {
            return fail("sequence.turn_deg", "a finite angle", self.turn_deg.to_string());
        }
        if !self.shift_mm.iter().all(|shift| shift.is_finite()) {
            return fail("sequence.shift_mm", "finite lengths", format!("{:?}", self.shift_mm));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The keys that a table takes: what the parser offers when it meets one that it does not know.
    fn keys<T: serde::de::DeserializeOwned>() -> Vec<String> {
        let Err(error) = config::parse::<T>("no_such_key = 1") else { panic!("unknown keys are accepted") };
        let names: Vec<String> = error.message.split('`').skip(1).step_by(2).map(String::from).collect();
        assert_eq!(names[0], "no_such_key", "{}", error.message);
        names[1..].to_vec()
    }

    #[test]
    fn every_key_is_documented() {
        let text = include_str!("../../../docs/JOB.md");
        let documented = |key: &str| text.contains(&format!("`{key}`")) || text.contains(&format!(".{key}`"));
        let tables = [
            keys::<DisplayJob>(),
            keys::<WindowJob>(),
            keys::<PoseJob>(),
            keys::<LightJob>(),
            keys::<RenderJob>(),
            keys::<FactorizeJob>(),
            keys::<SequenceJob>(),
            keys::<ReportJob>(),
            keys::<OutputJob>(),
            keys::<ImporterJob>(),
            keys::<NodeJob>(),
            keys::<GeometryFlags>(),
            keys::<lumistack_display::Layer>(),
            keys::<lumistack_display::FieldConfig>(),
            keys::<lumistack_display::LensletBacklight>(),
        ];
        for key in tables.iter().flatten() {
            assert!(documented(key), "docs/JOB.md does not list `{key}`");
        }
        for key in ["schema", "version", "name", "scene", "light_field", "seed"] {
            assert!(documented(key), "docs/JOB.md does not list `{key}`");
        }
    }

    #[test]
    fn a_written_job_reads_back_the_same() {
        let job =
            Job { scene: Some("a.glb".into()), name: "a".into(), ..Job::new(presets::by_name_or_path("fig7-uniform")) };
        assert_eq!(config::parse::<Job>(&job.to_toml()).unwrap(), job);
    }

    #[test]
    fn a_graph_names_what_it_joins() {
        let job = |text: &str| {
            let job: Job = config::parse(&format!("scene = \"a.glb\"\n{text}")).unwrap();
            job.check().map(|()| job).map_err(|error| error.to_string())
        };
        let display = "[display]\npreset = \"fig7-uniform\"\n";
        let nodes = format!("{display}[[nodes]]\nid = \"a\"\n[[nodes]]\nid = \"b\"\nplugin = \"parallax_barrier\"\n");
        let output = |keys: &str| format!("[[outputs]]\nplugin = \"images\"\n{keys}\n");
        let graph = job(&format!("{nodes}{}{}", output("from = \"a\""), output("from = \"light_field\""))).unwrap();
        assert_eq!(["a", "b", "light_field"].map(|from| graph.outputs_of(from).count()), [1, 0, 1]);
        assert_eq!(config::parse::<Job>(&graph.to_toml()).unwrap(), graph);
        let plain = job(&format!("{display}{}", output("name = \"other\""))).unwrap();
        assert_eq!(["tensor-display", "light_field"].map(|from| plain.outputs_of(from).count()), [1, 0]);
        for (text, message) in [
            (format!("{nodes}{}", output("")), "outputs[0].from: expected `light_field` or one of a, b, found nothing"),
            (
                format!("{nodes}{}", output("from = \"c\"")),
                "outputs[0].from: expected `light_field` or one of a, b, found `c`",
            ),
            (format!("{nodes}[[nodes]]\nid = \"a\"\n"), "nodes[2].id: expected a name of its own"),
            (format!("{nodes}[[nodes]]\nid = \"../a\"\n"), "nodes[2].id: expected a name of its own"),
            (
                format!("{nodes}params = {{ x = 1 }}\nfactorize = {{ }}\n"),
                "nodes[1].factorize: expected nothing, as only `tensor-display` has it",
            ),
            (format!("{display}{}{}", output(""), output("")), "outputs[1]: expected a `name` of its own"),
            (format!("{display}{}", output("name = \"a/b\"")), "outputs[0].name: expected letters"),
            (format!("{nodes}[sequence]\ntimes = 2\n"), "nodes: expected either `nodes` or `sequence`, found both"),
        ] {
            let error = job(&text).unwrap_err();
            assert!(error.contains(message), "{error}\n{message}");
        }
    }

    #[test]
    fn a_display_is_changed_by_the_job() {
        let mut job = Job::new(presets::by_name_or_path("paper-three-layer"));
        job.display.resolution = Some([420, 262]);
        job.display.frames = Some(6);
        let display = job.resolve_display().unwrap();
        assert_eq!((display.layers[0].resolution, display.frames, display.brightness), ([420, 262], 6, 0.2));
        job.display.brightness = Some(0.0);
        assert!(job.resolve_display().unwrap_err().to_string().contains("brightness"));
    }
}
