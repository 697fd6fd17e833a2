//! Options that several commands share, and what they change about a job.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use lumistack_display::Views;
use lumistack_factorizer::{StartKind, solver_names};
use lumistack_field_io::GeometryFlags;
use lumistack_pipeline::{
    BadValue, DisplayJob, FitDepth, ImporterJob, Job, OutputJob, PipelineError, Place, Tone, WindowFrom, is_usd,
};

use crate::values::{Angles, Numbers, Size};

/// The display of `run` and `render` when nobody names one.
pub const DEFAULT_DISPLAY: &str = "paper-three-layer";

/// Changes to the display.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Display")]
pub(crate) struct DisplayArgs {
    /// A preset (see `lumistack displays`) or a display file
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) display: Option<OsString>,
    /// Columns and rows of the light field; masks scale along
    #[arg(long, value_name = "CxR")]
    pub(crate) resolution: Option<Size>,
    /// Time-multiplexed frames M
    #[arg(long, value_name = "M")]
    pub(crate) frames: Option<usize>,
    /// Brightness scale β, above 0 and at most 1
    #[arg(long, value_name = "B")]
    pub(crate) brightness: Option<f64>,
}

/// Changes to rendering.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Rendering")]
pub(crate) struct RenderArgs {
    /// Views that sample the zone: auto, as many as make the display right between them, or columns and rows
    #[arg(long, value_name = "auto|CxR")]
    pub(crate) views: Option<Views>,
    /// Paths per pixel of all views together, which are spread over them; auto: as many as the display profits from [default: auto]
    #[arg(long, value_name = "auto|N")]
    pub(crate) zone_samples: Option<lumistack_pipeline::ZoneSamples>,
    /// Paths per pixel and view, instead of --zone-samples
    #[arg(long, value_name = "N", conflicts_with = "zone_samples")]
    pub(crate) samples: Option<u32>,
    /// Who renders the views: lumistack, our path tracer; of a .blend scene blender, the file's own engine with its settings; or auto: our path tracer unless a .blend scene has what it cannot show
    #[arg(long, value_name = "NAME")]
    pub(crate) engine: Option<lumistack_pipeline::Engine>,
    /// Bounces after the first hit
    #[arg(long, value_name = "N")]
    pub(crate) max_bounces: Option<u32>,
    /// Takes noise out of views: shared (light that does not depend on the view, over all views that see the point), off, guided (our own filter over all views) or oidn (Open Image Denoise, where installed)
    #[arg(long, value_name = "KIND")]
    pub(crate) denoise: Option<lumistack_pipeline::Denoise>,
    /// Name or number of the camera whose plane of focus the display takes
    #[arg(long, value_name = "NAME|N")]
    pub(crate) camera: Option<String>,
    /// Frames the scene from this azimuth (0 the front, +z; above 0 to its right, +x) and elevation, degrees, even where the file has a camera [default: the
    /// front, or where that shows next to nothing, from where more is seen]
    #[arg(long, value_name = "AZ,EL", allow_hyphen_values = true)]
    pub(crate) look_from: Option<Numbers<2>>,
    /// Nothing nearer to the viewer is seen: auto (a camera's near plane, or what the display can show), off, or a distance before the window, scene units
    #[arg(long, value_name = "auto|off|D", allow_hyphen_values = true)]
    pub(crate) near: Option<lumistack_pipeline::Near>,
    /// Whether light sources with a surface are seen as such [default: as the file says, else not]
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub(crate) lights_visible: Option<bool>,
    /// Time at which the scene's animations are sampled, seconds; without it the scene as its nodes stand, in USD the first time code
    #[arg(long = "time", value_name = "S", allow_hyphen_values = true)]
    pub(crate) time_s: Option<f64>,
    /// Name or number of the animation; default: all that do not conflict, otherwise the first
    #[arg(long, value_name = "NAME|N")]
    pub(crate) animation: Option<String>,
    /// glTF: name or number of the material variant. USD: SET=VARIANT on every prim that has them, /PRIM{SET=VARIANT} on one; may be given
    /// several times
    #[arg(long, value_name = "NAME|N|SET=VARIANT")]
    pub(crate) variant: Vec<String>,
    /// Opposite corners of a box, scene units: splats whose centres lie outside are left out
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub(crate) crop_box: Option<Numbers<6>>,
    /// Centre and radius of a sphere, scene units: splats whose centres lie outside are left out
    #[arg(long, value_name = "X,Y,Z,R", allow_hyphen_values = true)]
    pub(crate) crop_sphere: Option<Numbers<4>>,
    /// Environment map (Radiance HDR or EXR) instead of the scene's
    #[arg(long, value_name = "FILE")]
    pub(crate) environment: Option<PathBuf>,
    /// Factor on the environment's light, the studio light's too
    #[arg(long, value_name = "K")]
    pub(crate) environment_strength: Option<f32>,
    /// Turn of the environment about the up axis, degrees; above 0 what lies straight ahead moves to the left
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(crate) environment_rotation: Option<f64>,
    /// Seen where no surface is: environment, or a colour such as #202028; the light does not depend on it
    #[arg(long, value_name = "COLOUR")]
    pub(crate) background: Option<lumistack_pipeline::Background>,
    /// Stops added to the automatic exposure
    #[arg(long, value_name = "EV", allow_hyphen_values = true)]
    pub(crate) exposure_ev: Option<f64>,
    /// Tone curve of all views: auto, linear, khronos-neutral or agx
    #[arg(long, value_name = "CURVE", value_parser = ["auto", "linear", "khronos-neutral", "agx"])]
    pub(crate) tone: Option<String>,
    /// Bring the scene into the display's depth of field: auto (where it does not fit), off, move the window, or compress depth as well
    #[arg(long, value_name = "HOW", num_args = 0..=1, require_equals = true, default_missing_value = "move", value_parser = ["auto", "off", "move", "compress"])]
    pub(crate) fit_depth: Option<String>,
    /// Factor on parallax between views, and so on depth
    #[arg(long, value_name = "K")]
    pub(crate) depth_scale: Option<f64>,
    /// Angle under which a lens is seen from the window, degrees: what lies off the display's plane blurs [default: 0, no lens]
    #[arg(long, value_name = "DEG")]
    pub(crate) lens_deg: Option<f64>,
    /// Seed of all random streams
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    #[command(flatten)]
    pub(crate) files: FileArgs,
}

/// Which files a scene may read, and how much memory its pictures may take.
#[derive(Clone, Debug, Default, ClapArgs)]
pub(crate) struct FileArgs {
    /// Let a glTF or OBJ scene read files outside of its own folder
    #[arg(long, help_heading = "Scene files")]
    pub(crate) allow_outside: bool,
    /// Memory for the decoded pictures of a glTF or OBJ scene, MiB [default: 8192]
    #[arg(long, value_name = "MIB", help_heading = "Scene files", value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    pub(crate) picture_budget: Option<u64>,
}

/// Changes to the factorization.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Factorization")]
pub(crate) struct FactorizeArgs {
    /// Full updates of all layers
    #[arg(long, value_name = "N")]
    pub(crate) iterations: Option<u32>,
    #[arg(long, value_name = "NAME", help = format!("Solver: {}", either(solver_names())))]
    pub(crate) solver: Option<String>,
    /// Where: auto, cpu, gpu or gpu:NAME, as `lumistack devices` lists them [default: auto, a graphics processor if there is one]
    #[arg(long, value_name = "DEVICE")]
    pub(crate) device: Option<String>,
    #[arg(long, value_name = "NAME", help = format!("Starting values: {}", either(StartKind::names())))]
    pub(crate) start: Option<String>,
    /// A `layers` folder to start from
    #[arg(long, value_name = "DIR")]
    pub(crate) warm_start: Option<PathBuf>,
    /// Weights ≥ 0 as .npy, one per view or one per ray
    #[arg(long, value_name = "FILE")]
    pub(crate) weights: Option<PathBuf>,
}

/// A sequence of times instead of a still: the window moves through the scene, or the scene moves.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Sequence")]
pub(crate) struct SequenceArgs {
    /// Number of times; every one is a run folder t0001, t0002, ... and starts from the patterns of the one before
    #[arg(long, value_name = "N")]
    pub(crate) times: Option<usize>,
    /// Turn of the window about its vertical axis from the first time to the last, degrees; above 0 the viewer walks to the right
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(crate) turn_deg: Option<f64>,
    /// Movement of the window from the first time to the last, millimetres of the display: X right, Y up, Z to the viewer
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) shift_mm: Option<Numbers<3>>,
    /// Time of the scene's animations from the first time to the last, seconds, from --time or 0 on
    #[arg(long, value_name = "S", allow_hyphen_values = true)]
    pub(crate) duration_s: Option<f64>,
    /// Full updates at every time after the first [default: 5]
    #[arg(long, value_name = "N")]
    pub(crate) sequence_iterations: Option<u32>,
    /// Times of a chunk; chunks do not depend on each other's patterns, so machines solve them at once [default: all times are one chain]
    #[arg(long, value_name = "N")]
    pub(crate) chunk_times: Option<usize>,
    /// Times before a chunk that are solved once more for its start [default: 2]
    #[arg(long, value_name = "N")]
    pub(crate) warm_up_times: Option<usize>,
}

/// What the command line changes of a job, and where it runs.
#[derive(Debug, ClapArgs)]
pub(crate) struct JobArgs {
    /// Folder for the results [default: runs/NAME]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) display: DisplayArgs,
    #[command(flatten)]
    pub(crate) render: RenderArgs,
    #[command(flatten)]
    pub(crate) factorize: FactorizeArgs,
    #[command(flatten)]
    pub(crate) sequence: SequenceArgs,
}

/// What to do about values beyond 0 to 1. Without these flags values count as they are.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Light field")]
pub(crate) struct FieldLookArgs {
    /// Exposure in stops for all views: values times 2^EV; what is above 1 then is clipped, unless --tone says otherwise
    #[arg(long, value_name = "EV", allow_hyphen_values = true)]
    pub(crate) exposure_ev: Option<f64>,
    /// Tone curve of all views: linear (clips to 0..1), khronos-neutral or agx [default: values as they are]
    #[arg(long, value_name = "CURVE", value_parser = ["linear", "khronos-neutral", "agx"])]
    pub(crate) tone: Option<String>,
}

/// The display; its light field is the one that is read.
#[derive(Debug, ClapArgs)]
#[command(next_help_heading = "Display")]
pub(crate) struct FactorizeDisplayArgs {
    /// A preset (see `lumistack displays`) or a display file; takes the light field's resolution and views
    #[arg(long, value_name = "NAME|FILE", default_value = "paper-three-layer")]
    pub(crate) display: OsString,
    /// Time-multiplexed frames M
    #[arg(long, value_name = "M")]
    pub(crate) frames: Option<usize>,
    /// Brightness scale β, above 0 and at most 1
    #[arg(long, value_name = "B")]
    pub(crate) brightness: Option<f64>,
}

/// What a foreign light field does not say itself; a flag wins over what the files say.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Light field")]
pub(crate) struct GeometryArgs {
    /// View grid
    #[arg(long, value_name = "KIND", value_parser = ["oblique", "perspective"])]
    pub(crate) grid: Option<String>,
    /// Full horizontal and vertical angle of view, degrees
    #[arg(long, value_name = "HxV")]
    pub(crate) fov: Option<Angles>,
    /// Pixel pitch on the display plane, millimetres
    #[arg(long, value_name = "MM")]
    pub(crate) pitch_mm: Option<f64>,
    /// Viewing distance of a perspective grid, millimetres
    #[arg(long, value_name = "MM")]
    pub(crate) distance_mm: Option<f64>,
    /// Views to keep of a larger set
    #[arg(long, value_name = "HxV")]
    pub(crate) views: Option<Size>,
    /// Columns and rows of a quilt whose name does not say
    #[arg(long, value_name = "CxR")]
    pub(crate) quilt: Option<Size>,
    /// Views of a single picture of tiles, view (0, 0) at the top left
    #[arg(long, value_name = "HxV")]
    pub(crate) tiles: Option<Size>,
    /// Reduce every view to this many columns and rows
    #[arg(long, value_name = "CxR")]
    pub(crate) resolution: Option<Size>,
    /// Disparity that is put on the display plane: pixels by which content moves left per view to the right
    #[arg(long, value_name = "PX", allow_hyphen_values = true)]
    pub(crate) focus_px: Option<f64>,
    /// Reverse the order of views from left to right
    #[arg(long)]
    pub(crate) mirror_x: bool,
    /// Reverse the order of views from top to bottom
    #[arg(long)]
    pub(crate) mirror_y: bool,
    /// Average every view over the slopes that the display cannot tell apart, of all views that are there, before `--views` are chosen
    #[arg(long)]
    pub(crate) prefilter: bool,
}

/// "a, b or c".
fn either(names: impl Iterator<Item = &'static str>) -> String {
    let mut names: Vec<&str> = names.collect();
    let last = names.pop().unwrap_or_default();
    format!("{} or {last}", names.join(", "))
}

/// A job file, or a job around a scene.
pub(crate) fn job_or_scene(path: &Path) -> Result<Job, PipelineError> {
    if is_job(path) {
        return Job::load(path);
    }
    if path.is_dir() {
        let expected = "a scene (.gltf, .glb, USD, .blend, .obj) or a job file (.toml); `lumistack factorize` takes folders of views";
        return Err(PipelineError::value(path, "input", expected, "a folder"));
    }
    let mut job = Job::new(DisplayJob { preset: Some(DEFAULT_DISPLAY.into()), ..DisplayJob::default() });
    job.name = stem(path);
    job.scene = Some(path.to_owned());
    Ok(job)
}

pub(crate) fn is_job(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().map_or("run".into(), |stem| stem.to_string_lossy().into_owned())
}

pub(crate) fn change_display(job: &mut Job, args: &DisplayArgs) {
    if let Some(display) = &args.display {
        let named = lumistack_pipeline::DisplayJob::by_name_or_path(display);
        (job.display.preset, job.display.file) = (named.preset, named.file);
    }
    if let Some(resolution) = args.resolution {
        job.display.resolution = Some(resolution.0);
    }
    job.display.frames = args.frames.or(job.display.frames);
    job.display.brightness = args.brightness.or(job.display.brightness);
}

pub(crate) fn tone_of(name: &str) -> Tone {
    match name {
        "linear" => Tone::Linear,
        "khronos-neutral" => Tone::KhronosNeutral,
        "agx" => Tone::Agx,
        _ => Tone::Auto,
    }
}

pub(crate) fn change_render(job: &mut Job, args: &RenderArgs) {
    job.display.views = args.views.or(job.display.views);
    if let Some(zone_samples) = args.zone_samples {
        (job.render.samples, job.render.zone_samples) = (None, zone_samples);
    }
    job.render.samples = args.samples.or(job.render.samples);
    job.render.engine = args.engine.unwrap_or(job.render.engine);
    job.render.max_bounces = args.max_bounces.unwrap_or(job.render.max_bounces);
    job.render.denoise = args.denoise.unwrap_or(job.render.denoise);
    job.light.exposure_ev = args.exposure_ev.unwrap_or(job.light.exposure_ev);
    job.seed = args.seed.unwrap_or(job.seed);
    job.window.depth_scale = args.depth_scale.unwrap_or(job.window.depth_scale);
    job.render.lens_deg = args.lens_deg.unwrap_or(job.render.lens_deg);
    job.light.tone = args.tone.as_deref().map_or(job.light.tone, tone_of);
    match args.fit_depth.as_deref() {
        Some("move") => job.window.fit_depth = FitDepth::Move,
        Some("compress") => job.window.fit_depth = FitDepth::Compress,
        Some("off") => job.window.fit_depth = FitDepth::Off,
        Some(_) => job.window.fit_depth = FitDepth::Auto,
        None => {}
    }
    change_importer(&mut job.importer, &args.files);
    // what stands on the command line goes before what the job says
    if args.camera.is_some() {
        job.window.camera = args.camera.clone();
        job.window.look_from = None;
    }
    if let Some(look_from) = args.look_from {
        job.window.look_from = Some(look_from.0);
        if args.camera.is_none() {
            (job.window.from, job.window.camera) = (WindowFrom::Bounds, None);
        }
    }
    job.window.near = args.near.unwrap_or(job.window.near);
    job.light.visible = args.lights_visible.or(job.light.visible);
    if args.environment.is_some() {
        job.light.environment = args.environment.clone();
    }
    let light = &mut job.light;
    light.environment_strength = args.environment_strength.unwrap_or(light.environment_strength);
    light.environment_rotation_deg = args.environment_rotation.unwrap_or(light.environment_rotation_deg);
    light.background = args.background.unwrap_or(light.background);
    job.pose.time_s = args.time_s.or(job.pose.time_s);
    if args.animation.is_some() {
        job.pose.animation.clone_from(&args.animation);
    }
    if let Some(Numbers([x0, y0, z0, x1, y1, z1])) = args.crop_box {
        job.pose.crop_box = Some([[x0, y0, z0], [x1, y1, z1]]);
    }
    job.pose.crop_sphere = args.crop_sphere.map(|sphere| sphere.0).or(job.pose.crop_sphere);
    let is_usd = job.scene.as_deref().is_some_and(is_usd);
    if is_usd && !args.variant.is_empty() {
        job.pose.variants.clone_from(&args.variant);
    } else if let Some(variant) = args.variant.last() {
        job.pose.variant = Some(variant.clone());
    }
}

/// What the command line says of the scene's files.
pub(crate) fn change_importer(importer: &mut ImporterJob, args: &FileArgs) {
    importer.allow_outside |= args.allow_outside;
    importer.picture_mib = args.picture_budget.unwrap_or(importer.picture_mib);
}

pub(crate) fn change_factorize(job: &mut Job, args: &FactorizeArgs) {
    let factorize = &mut job.factorize;
    factorize.iterations = args.iterations.or(factorize.iterations);
    if let Some(solver) = &args.solver {
        factorize.solver = solver.clone();
    }
    if let Some(device) = &args.device {
        factorize.device = device.clone();
    }
    if let Some(start) = &args.start {
        factorize.start = start.clone();
    }
    let path = |new: &Option<PathBuf>, old: &mut Option<PathBuf>| {
        if new.is_some() {
            *old = new.clone();
        }
    };
    path(&args.warm_start, &mut factorize.warm_start);
    path(&args.weights, &mut factorize.weights);
}

pub(crate) fn change_sequence(job: &mut Job, args: &SequenceArgs) {
    let SequenceArgs { times, turn_deg, shift_mm, duration_s, sequence_iterations, chunk_times, warm_up_times } = args;
    let moves = turn_deg.is_some() || shift_mm.is_some() || duration_s.is_some();
    let chunks = chunk_times.is_some() || warm_up_times.is_some();
    if times.is_none() && !moves && !chunks && sequence_iterations.is_none() {
        return;
    }
    let sequence = job.sequence.get_or_insert_default();
    sequence.times = times.or(sequence.times);
    sequence.turn_deg = turn_deg.unwrap_or(sequence.turn_deg);
    sequence.shift_mm = shift_mm.map_or(sequence.shift_mm, |shift| shift.0);
    sequence.duration_s = duration_s.unwrap_or(sequence.duration_s);
    sequence.iterations = sequence_iterations.unwrap_or(sequence.iterations);
    sequence.chunk_times = chunk_times.or(sequence.chunk_times);
    sequence.warm_up_times = warm_up_times.or(sequence.warm_up_times);
}

/// A job as the command line changes it, and its folder.
pub(crate) fn job_of(input: &Path, args: &JobArgs) -> Result<(Job, PathBuf), PipelineError> {
    let mut job = job_or_scene(input)?;
    change_display(&mut job, &args.display);
    change_render(&mut job, &args.render);
    change_factorize(&mut job, &args.factorize);
    change_sequence(&mut job, &args.sequence);
    if !is_job(input) && job.sequence.is_none() {
        // nobody chose outputs: one that shows the display to its maker, without a word of the command line
        let params = serde_json::Map::from_iter([("title".into(), job.name.clone().into())]);
        job.outputs.push(OutputJob { name: Some("preview".into()), params, ..OutputJob::new("web_simulator") });
    }
    let runs = if job.sweep.is_some() { "sweeps" } else { "runs" };
    let folder = args.output.clone().unwrap_or_else(|| Path::new(runs).join(&job.name));
    Ok((job, folder))
}

/// An error about a value of a job, with the place where it was given instead of the word job.
pub(crate) fn in_place(error: PipelineError, input: &Path) -> PipelineError {
    match error {
        PipelineError::Value(value) if value.place == Place::Job => {
            let place = if is_job(input) { Place::File(input.to_owned()) } else { Place::CommandLine };
            PipelineError::Value(Box::new(BadValue { place, ..*value }))
        }
        other => other,
    }
}

/// The geometry flags as the job has them.
pub(crate) fn geometry(args: &GeometryArgs) -> GeometryFlags {
    GeometryFlags {
        grid: args.grid.as_deref().map(|grid| match grid {
            "perspective" => lumistack_display::ProjectionKind::Perspective,
            _ => lumistack_display::ProjectionKind::Oblique,
        }),
        fov_deg: args.fov.map(|fov| fov.0),
        pitch_mm: args.pitch_mm,
        distance_mm: args.distance_mm,
        views: args.views.map(|views| views.0),
        quilt: args.quilt.map(|quilt| quilt.0),
        tiles: args.tiles.map(|tiles| tiles.0),
        resolution: args.resolution.map(|resolution| resolution.0),
        focus_px: args.focus_px,
        mirror: [args.mirror_x, args.mirror_y],
        prefilter: args.prefilter,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Help is made of the names; what is written by hand must hold the same.
    #[test]
    fn solvers_and_starts_are_named_alike_everywhere() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap();
        let (stub, python) =
            (read("crates/python/python/lumistack/_lumistack.pyi"), read("crates/python/src/functions.rs"));
        let job = read("docs/JOB.md");
        let line = |text: &str, start: &str| {
            let found = text.lines().find(|line| line.trim_start().starts_with(start));
            found.unwrap_or_else(|| panic!("no line begins with {start}")).to_string()
        };
        let quoted = |names: &[&str]| names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>();
        for (key, names) in
            [("solver", solver_names().collect::<Vec<_>>()), ("start", StartKind::names().collect::<Vec<_>>())]
        {
            let literal = format!("{key}: Literal[{}] | None = None,", quoted(&names).join(", "));
            assert_eq!(line(&stub, &format!("{key}: Literal[")).trim(), literal);
            let (told, row) =
                (line(&python, &format!("/// * {key}: ")), line(&job, &format!("| `{key}` | `\"auto\"`")));
            for name in &names {
                assert!(told.contains(&format!("\"{name}\"")), "crates/python/src/functions.rs: {name}: {told}");
                assert!(row.contains(&format!("`{name}`")), "docs/JOB.md: {name}: {row}");
            }
        }
        assert_eq!(either(["a", "b", "c"].into_iter()), "a, b or c");
    }
}
