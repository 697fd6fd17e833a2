//! The job file names the input (a scene, a light field or a source plugin), the display and the
//! outputs.
//!
//! Only the input and the display have no default. `docs/JOB.md` lists all keys. Relative paths are
//! relative to the job file. The types of most tables are in the folder `job`; the types of
//! `[window]`, `[light]` and `[render]` are in the crate `shot`.

mod display;
mod factorize;
mod graph;
#[cfg(test)]
mod paths;
mod sequence;
mod sweep;

use std::path::{Path, PathBuf};

use lumistack_core::config;
use lumistack_display::{Display, LEAST_DIRECTIONS, Views};
use lumistack_field_io::GeometryFlags;
use lumistack_pathtracer::Settings;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::display::DisplayJob;
pub use self::factorize::{EyeJob, FactorizeJob};
pub use self::graph::{ImporterJob, NodeJob, OutputJob, SourceJob};
pub use self::sequence::SequenceJob;
pub use self::sweep::{SearchJob, SweepJob};
use crate::error::{PipelineError, read_to_string};
use crate::reader::is_blend;
use lumistack_core::path_text::{PathText, is_default};
pub use lumistack_shot::{
    AngularFilter, Background, Denoise, Engine, FitDepth, LightJob, Near, RenderJob, Tone, WindowFrom, WindowJob,
    ZoneSamples,
};

/// Maximum number of automatic views if Blender may render them. Blender takes minutes per view.
const MOST_OF_BLENDER: usize = 25;

/// A job file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Format of the file.
    #[serde(default = "format")]
    pub schema: String,
    /// Version of the format.
    #[serde(default = "version")]
    pub version: u32,
    /// Name of the job in reports, and name of the run folder. Default: the file's name without
    /// extension; for a file `job.toml`, the name of its folder.
    #[serde(default)]
    pub name: String,
    /// Scene to render: `.gltf`, `.glb`, USD, `.blend`, or a file of an importer plugin. A job has
    /// exactly one of the keys `scene`, `light_field` and `source`.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "lumistack_core::path_text::optional")]
    #[schemars(with = "Option<PathText>")]
    pub scene: Option<PathBuf>,
    /// Light field of another program: a folder of views, a `.npy` file or a quilt. For a sequence,
    /// a folder with a light field for each time step.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "lumistack_core::path_text::optional")]
    #[schemars(with = "Option<PathText>")]
    pub light_field: Option<PathBuf>,
    /// Seed of all random numbers.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Geometry of a light field. A value here overrides the value in the light field's files.
    #[serde(default, skip_serializing_if = "is_default")]
    pub geometry: GeometryFlags,
    /// The display.
    pub display: DisplayJob,
    /// Position of the display in the scene.
    #[serde(default)]
    pub window: WindowJob,
    /// The scene's time, animation, variants and crop.
    #[serde(default)]
    pub pose: PoseJob,
    /// Light and exposure.
    #[serde(default)]
    pub light: LightJob,
    /// Settings of the path tracer.
    #[serde(default)]
    pub render: RenderJob,
    /// Settings of the factorizer.
    #[serde(default)]
    pub factorize: FactorizeJob,
    /// Time steps of a sequence. Without this table the job is a still.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence: Option<SequenceJob>,
    /// Designs to compare, for `lumistack sweep`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweep: Option<SweepJob>,
    /// Settings of the report.
    #[serde(default)]
    pub report: ReportJob,
    /// Plugin, folders and memory for reading the scene's files.
    #[serde(default, skip_serializing_if = "is_default")]
    pub importer: ImporterJob,
    /// Plugin that makes the light field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<SourceJob>,
    /// Displays that share the light field; default: the one display of the job.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeJob>,
    /// Output plugins; default: `images`.
    #[serde(default = "default_outputs")]
    pub outputs: Vec<OutputJob>,
    /// Folder of the job file. Paths in parameters of plugins are relative to this folder.
    #[serde(skip)]
    pub folder: PathBuf,
    /// The job file, if there is one. A run overwrites it only if an earlier run wrote it.
    #[serde(skip)]
    pub file: Option<PathBuf>,
}

/// Time, animation, variants and crop of a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PoseJob {
    /// Time at which animations are sampled, seconds. An animation keeps its first values before
    /// its beginning, and its last values after its end. Default: glTF scenes have the pose of the
    /// file, or with `animation` the pose at time 0. USD scenes have the pose at the first time
    /// code, `.blend` scenes the pose at the saved frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// Name or number of the animation of a glTF scene. Default: none if no time is given.
    /// Otherwise all animations together, or only the first if two of them move the same property
    /// of an object.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub animation: Option<String>,
    /// Name or number of glTF's material variant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub variant: Option<String>,
    /// USD's variants: `set=variant` for every prim that has the set, `/prim{set=variant}` for one
    /// prim.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub variants: Vec<String>,
    /// Opposite corners of a box, scene units. Splats whose centres are outside are left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crop_box: Option<[[f64; 3]; 2]>,
    /// Centre and radius of a sphere, `[x, y, z, r]` in scene units. Splats whose centres are
    /// outside are left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crop_sphere: Option<[f64; 4]>,
}

/// Settings of the report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ReportJob {
    /// Pixels of a view per degree of visual angle, for FLIP.
    pub pixels_per_degree: f64,
    /// Number of directions of the viewing zone that the zone score compares; 0 for no zone score.
    pub zone_directions: usize,
}

fn format() -> String {
    Job::SCHEMA.into()
}

fn version() -> u32 {
    1
}

fn default_seed() -> u64 {
    1
}

fn default_outputs() -> Vec<OutputJob> {
    vec![OutputJob::new("images")]
}

impl Default for ReportJob {
    fn default() -> Self {
        Self { pixels_per_degree: 67.02, zone_directions: LEAST_DIRECTIONS }
    }
}

impl Job {
    /// Value of the key `schema`.
    pub const SCHEMA: &'static str = "lumistack/job";
    /// The inputs that a job may have, for messages.
    pub(crate) const INPUTS: &'static str = "exactly one of `scene`, `light_field` and `source`";

    /// Returns a job for a display, with defaults for everything else.
    pub fn new(display: DisplayJob) -> Self {
        Self {
            schema: format(),
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
            sweep: None,
            report: ReportJob::default(),
            importer: ImporterJob::default(),
            source: None,
            nodes: Vec::new(),
            outputs: default_outputs(),
            folder: PathBuf::new(),
            file: None,
        }
    }

    /// Reads a job file; its relative paths become relative to the working folder.
    ///
    /// # Errors
    /// If the file cannot be read, does not parse, has unknown keys, or has another format or
    /// version.
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
            // The job in a file job.toml has the name of the file's folder. For example, the job in
            // scenes/still-life/job.toml is still-life.
            if job.name == "job"
                && let Ok(path) = std::path::absolute(path)
                && let Some(folder) = path.parent().and_then(Path::file_name)
            {
                job.name = folder.to_string_lossy().into_owned();
            }
        }
        let base = path.parent().unwrap_or(Path::new(""));
        for path in job.paths_mut() {
            *path = base.join(&*path);
        }
        job.folder = base.to_owned();
        job.file = Some(path.to_owned());
        Ok(job)
    }

    /// Returns the job's paths, except the paths in parameters of plugins and in `sweep.displays`.
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

    /// Returns the display of the job. If the display's views are automatic, their number is
    /// chosen.
    ///
    /// # Errors
    /// If the job names neither a preset nor a display file, or both. Also if the preset is
    /// unknown, the display file cannot be read, or a value is out of range.
    pub fn resolve_display(&self) -> Result<Display, PipelineError> {
        let display = self.display.resolve()?;
        let most = self.most_views(&display);
        Ok(display.with_views_chosen(most))
    }

    /// Returns the maximum number of views for `views = "auto"`, which limits the time of a run.
    /// The number is lower if Blender may render the views, since Blender takes minutes per view.
    pub(crate) fn most_views(&self, display: &Display) -> usize {
        let [cols, rows] = display.field.resolution;
        let most = self.render.most_chosen_views(cols * rows);
        if self.may_render_in_blender() { most.min(MOST_OF_BLENDER) } else { most }
    }

    /// Returns the job with values for the automatic settings that depend on the display's views.
    ///
    /// If the display does not load, the job stays as it is, and [`Self::resolve_display`] returns
    /// the error.
    pub(crate) fn with_automatic_settings(&self) -> Self {
        let mut job = self.clone();
        if let Ok(display) = job.display.resolve() {
            job.render.denoise = job.denoise_for(&display);
            if !matches!(display.field.views, Views::Fixed(_)) && self.scene.is_some() {
                let of_nodes = job.nodes.iter_mut().filter_map(|node| node.factorize.as_mut());
                for factorize in std::iter::once(&mut job.factorize).chain(of_nodes) {
                    factorize.iterations.get_or_insert(lumistack_factorizer::ZONE_ITERATIONS);
                }
            }
        }
        job
    }

    /// Returns the denoiser. `auto` selects no denoiser if the job or the display fixes the number
    /// of views, or if Blender may render them. Otherwise `auto` selects the filter `shared`.
    pub(crate) fn denoise_for(&self, display: &Display) -> Denoise {
        let fixed = matches!(display.field.views, Views::Fixed(_));
        match self.render.denoise {
            Denoise::Auto if fixed || self.may_render_in_blender() => Denoise::Off,
            Denoise::Auto => Denoise::Shared,
            chosen => chosen,
        }
    }

    /// Adapts the settings of traced views, see [`RenderJob::split_settings`].
    pub(crate) fn split_settings(&self, settings: Settings, display: &Display) -> Settings {
        RenderJob::split_settings(settings, display, self.denoise_for(display))
    }

    /// Returns true if Blender may render the views, which takes minutes per view.
    fn may_render_in_blender(&self) -> bool {
        let is_file = self.scene.as_deref().is_some_and(is_blend);
        self.render.engine == Engine::Blender || is_file && self.render.engine == Engine::Auto
    }

    /// Checks the input, ranges of values, and combinations of keys. The display, `[factorize]` and
    /// `[sweep]` are checked later.
    ///
    /// # Errors
    /// For the first wrong value.
    pub fn check(&self) -> Result<(), PipelineError> {
        let fail = |key: &str, expected: &str, found: String| Err(PipelineError::job(key, expected, found));
        // A job has exactly one input.
        let inputs = [
            self.scene.as_ref().map(|_| "`scene`"),
            self.light_field.as_ref().map(|_| "`light_field`"),
            self.source.as_ref().map(|_| "`source`"),
        ];
        match inputs.into_iter().flatten().collect::<Vec<_>>().as_slice() {
            [_] => {}
            [] => return fail("scene", Self::INPUTS, "none".into()),
            several => return fail("scene", Self::INPUTS, several.join(" and ")),
        }
        // Check ranges of single values. The types allow any number, also NaN.
        if let Some(time_s) = self.source.as_ref().map(|source| source.time_s).filter(|time_s| !time_s.is_finite()) {
            return fail("source.time_s", "a finite number of seconds", time_s.to_string());
        }
        if !(1.0..=1000.0).contains(&self.report.pixels_per_degree) {
            return fail("report.pixels_per_degree", "1 to 1000", self.report.pixels_per_degree.to_string());
        }
        if self.report.zone_directions != 0 && !(LEAST_DIRECTIONS..=4096).contains(&self.report.zone_directions) {
            let expected = format!("0, or {LEAST_DIRECTIONS} to 4096");
            return fail("report.zone_directions", &expected, self.report.zone_directions.to_string());
        }
        if self.pose != PoseJob::default() && self.scene.is_none() {
            return fail("pose", "a job with `scene`, since only scenes have poses", "a job without `scene`".into());
        }
        if let Some(corners) =
            self.pose.crop_box.filter(|corners| !corners.as_flattened().iter().all(|x| x.is_finite()))
        {
            return fail("pose.crop_box", "two corners of finite numbers", format!("{corners:?}"));
        }
        let is_sphere = |sphere: &[f64; 4]| sphere.iter().all(|x| x.is_finite()) && sphere[3] > 0.0;
        if let Some(sphere) = self.pose.crop_sphere.filter(|sphere| !is_sphere(sphere)) {
            return fail("pose.crop_sphere", "a finite centre and a radius above 0", format!("{sphere:?}"));
        }
        if let Some(time_s) = self.pose.time_s.filter(|time_s| !time_s.is_finite()) {
            return fail("pose.time_s", "a finite number of seconds", time_s.to_string());
        }
        if !(1..=1 << 20).contains(&self.importer.picture_mib) {
            return fail("importer.picture_mib", "1 to 1048576 MiB", self.importer.picture_mib.to_string());
        }
        // Check the tables of the job file that have their own checks, then combinations of tables.
        self.render.check()?;
        self.window.check()?;
        self.light.check()?;
        if self.render.engine == Engine::Blender && self.light.background != Background::Environment {
            let expected = "`environment`, since Blender renders its own world as the background";
            return fail("light.background", expected, "a colour".into());
        }
        self.check_graph()?;
        self.sequence
            .as_ref()
            .map_or(Ok(()), |sequence| sequence.check(self.scene.is_some(), self.light_field.is_some()))
    }

    /// Returns the job as JSON, for a report.
    pub(crate) fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).expect("a job holds nothing that JSON cannot")
    }

    /// Returns the text of a job file, with all defaults.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a job holds nothing that TOML cannot")
    }
}

impl Job {
    /// Checks names of nodes and outputs, tables that a node does not use, and inputs of outputs.
    fn check_graph(&self) -> Result<(), PipelineError> {
        let fail = |key: String, expected: &str, found: String| Err(PipelineError::job(key, expected, found));
        // Names of nodes are names of folders, so they must be unique and allowed on every system.
        // Some systems ignore the case of names.
        let is_taken = |ids: &[&str], id: &str| ids.iter().any(|taken| taken.eq_ignore_ascii_case(id));
        let mut ids: Vec<&str> = Vec::new();
        for (i, node) in self.nodes.iter().enumerate() {
            if !is_folder_name(&node.id) || is_taken(&[OutputJob::LIGHT_FIELD], &node.id) || is_taken(&ids, &node.id) {
                let expected = "a unique name of letters, digits, `-` and `_`, other than `light_field` and names of devices such as `nul`; case does not make names different";
                return fail(format!("nodes[{i}].id"), expected, format!("`{}`", node.id));
            }
            ids.push(&node.id);
            // A table that the node does not use is a mistake, so it is an error.
            let (unused, owner) = match (node.plugin == NodeJob::TENSOR_DISPLAY, &node.factorize) {
                (true, _) if !node.params.is_empty() => ("params", "a node plugin"),
                (false, Some(_)) => ("factorize", "`tensor-display`"),
                _ => continue,
            };
            return fail(
                format!("nodes[{i}].{unused}"),
                &format!("no table `{unused}` in this node, since only {owner} has a table `{unused}`"),
                "a table".into(),
            );
        }
        if self.nodes.is_empty() {
            ids.push(NodeJob::TENSOR_DISPLAY);
        }
        // Two outputs of one node must not write into the same folder.
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
                    "a name of letters, digits, `-` and `_`, other than names of devices such as `nul`",
                    format!("`{}`", output.name()),
                );
            }
            if taken.iter().any(|(other, name)| *other == from && name.eq_ignore_ascii_case(output.name())) {
                let expected = "a `name` that no other output of the same node has, also if case is ignored";
                return fail(format!("outputs[{i}]"), expected, format!("`{}` twice", output.name()));
            }
            taken.push((from, output.name()));
        }
        Ok(())
    }

    /// For each plugin of the job, returns the key in the job file, the plugin's id and its
    /// parameters. The id of an importer is empty if the scene's extension selects the plugin.
    pub(crate) fn plugins_mut(
        &mut self,
    ) -> impl Iterator<Item = (String, &str, &mut serde_json::Map<String, serde_json::Value>)> {
        let importer = self.importer.plugin.as_deref().unwrap_or_default();
        let importer = [("importer".into(), importer, &mut self.importer.params)];
        let source = self.source.iter_mut().map(|job| ("source".into(), job.plugin.as_str(), &mut job.params));
        let nodes = self.nodes.iter_mut().enumerate().filter(|(_, node)| node.plugin != NodeJob::TENSOR_DISPLAY);
        let nodes = nodes.map(|(i, job)| (format!("nodes[{i}]"), job.plugin.as_str(), &mut job.params));
        let outputs = self.outputs.iter_mut().enumerate();
        let outputs = outputs.map(|(i, job)| (format!("outputs[{i}]"), job.plugin.as_str(), &mut job.params));
        importer.into_iter().chain(source).chain(nodes).chain(outputs)
    }

    /// Returns the outputs whose input is `from`: a node's id or `light_field`.
    pub(crate) fn outputs_of(&self, from: &str) -> impl Iterator<Item = &OutputJob> {
        let only = self.nodes.len() < 2;
        self.outputs
            .iter()
            .filter(move |output| output.from.as_deref().map_or(only && from != OutputJob::LIGHT_FIELD, |f| f == from))
    }
}

/// Returns true if every system allows a text as the name of a folder. Such a text has 1 to 100
/// characters: ASCII letters, ASCII digits, `-` and `_`. Names of devices of Windows are excluded.
fn is_folder_name(name: &str) -> bool {
    const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];
    const NUMBERED_DEVICES: [&str; 2] = ["com", "lpt"];
    let lower = name.to_ascii_lowercase();
    let is_numbered = |rest: &str| rest.len() == 1 && rest.bytes().all(|b| b.is_ascii_digit());
    let is_device = DEVICES.contains(&lower.as_str())
        || NUMBERED_DEVICES.iter().any(|device| lower.strip_prefix(device).is_some_and(is_numbered));
    let is_plain = name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_');
    (1..=100).contains(&name.len()) && is_plain && !is_device
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the keys of a table, as the parser's message about an unknown key lists them.
    fn keys<T: serde::de::DeserializeOwned>() -> Vec<String> {
        let Err(error) = config::parse::<T>("no_such_key = 1") else { panic!("unknown keys are accepted") };
        let names: Vec<String> = error.message.split('`').skip(1).step_by(2).map(String::from).collect();
        assert_eq!(names[0], "no_such_key", "{}", error.message);
        names[1..].to_vec()
    }

    /// The display has 13 × 13 native slopes. A lower limit selects every second, every third or
    /// every fourth slope.
    #[test]
    fn the_number_of_chosen_views_has_a_limit_that_can_be_set() {
        let views = |render: &str| {
            let display = "[display]\npreset = \"paper-three-layer\"\nresolution = [420, 262]\n";
            let job = config::parse::<Job>(&format!("{display}[render]\n{render}")).ok().unwrap();
            job.resolve_display().unwrap().views()
        };
        assert_eq!(views(""), [13, 13]);
        assert_eq!(views("most_views = 169"), [13, 13]);
        assert_eq!(views("most_views = 168"), [7, 7]);
        assert_eq!(views("most_views = 25"), [5, 5]);
        assert_eq!(views("most_views = 9"), [3, 3]);
    }

    /// With the filter `shared`, fixed views get further paths. Automatic views get sparse paths
    /// and, with one path per pixel, a further ray.
    #[test]
    fn views_that_share_light_have_more_or_fewer_paths() {
        let of = |views: &str, render: &str| {
            let text = format!("[display]\npreset = \"paper-three-layer\"\n{views}\n[render]\n{render}");
            let job = config::parse::<Job>(&text).ok().unwrap();
            let of = |display| job.split_settings(Settings { samples: 1, ..Settings::default() }, &display);
            let given = of(job.display.resolve().unwrap());
            assert_eq!(given, of(job.resolve_display().unwrap()), "{text}");
            [given.further_paths, given.sparse_paths, given.further_rays == 1]
        };
        let (shared, fixed) = ("denoise = \"shared\"", "views = [5, 5]");
        assert_eq!(of(fixed, shared), [true, false, false]);
        for chosen in ["", "views = \"auto\"", "views = { step = [0.07, 0.07] }"] {
            assert_eq!(of(chosen, shared), [false, true, true], "{chosen}");
        }
        assert_eq!(of("", ""), [false, true, true]);
        for (views, render) in [(fixed, ""), (fixed, "denoise = \"guided\""), ("", "denoise = \"off\"")] {
            assert_eq!(of(views, render), [false; 3], "{views} {render}");
        }
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
            keys::<SweepJob>(),
            keys::<SearchJob>(),
            keys::<ReportJob>(),
            keys::<OutputJob>(),
            keys::<ImporterJob>(),
            keys::<SourceJob>(),
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
        let job = Job {
            scene: Some("a.glb".into()),
            name: "a".into(),
            ..Job::new(DisplayJob::by_name_or_path("fig7-uniform"))
        };
        assert_eq!(config::parse::<Job>(&job.to_toml()).unwrap(), job);
    }

    #[test]
    fn a_display_is_changed_by_the_job() {
        let mut job = Job::new(DisplayJob::by_name_or_path("paper-three-layer"));
        job.display.resolution = Some([420, 262]);
        job.display.frames = Some(6);
        let display = job.resolve_display().unwrap();
        assert_eq!((display.layers[0].resolution, display.frames, display.brightness), ([420, 262], 6, 0.2));
        job.display.brightness = Some(0.0);
        assert!(job.resolve_display().unwrap_err().to_string().contains("brightness"));
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
            (format!("{nodes}[[nodes]]\nid = \"a\"\n"), "nodes[2].id: expected a unique name"),
            (format!("{nodes}[[nodes]]\nid = \"../a\"\n"), "nodes[2].id: expected a unique name"),
            (format!("{nodes}[[nodes]]\nid = \"A\"\n"), "nodes[2].id: expected a unique name"),
            (format!("{nodes}[[nodes]]\nid = \"Light_Field\"\n"), "nodes[2].id: expected a unique name"),
            (format!("{nodes}[[nodes]]\nid = \"Lpt1\"\n"), "nodes[2].id: expected a unique name"),
            (
                format!("{nodes}params = {{ x = 1 }}\nfactorize = {{ }}\n"),
                "nodes[1].factorize: expected no table `factorize` in this node, since only `tensor-display` has a table `factorize`",
            ),
            (format!("{display}{}{}", output(""), output("")), "outputs[1]: expected a `name` that no other output"),
            (format!("{display}{}", output("name = \"a/b\"")), "outputs[0].name: expected a name of letters"),
        ] {
            let error = job(&text).unwrap_err();
            assert!(error.contains(message), "{error}\n{message}");
        }
    }
}
