//! Options that several commands share, and their effect on a job.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Args as ClapArgs;
use lumistack_display::Views;
use lumistack_factorizer::{StartKind, solver_names};
use lumistack_field_io::GeometryFlags;
use lumistack_pipeline::{
    BadValue, DisplayJob, FitDepth, ImporterJob, Job, OutputJob, PipelineError, Place, Tone, WindowFrom, WindowJob,
    is_usd,
};

use crate::values::{Angles, Numbers, Size};

/// Preset of the display if neither a job nor the command line names a display.
pub const DEFAULT_DISPLAY: &str = "paper-three-layer";

/// Changes to the display.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Display")]
pub(crate) struct DisplayArgs {
    /// The display: a name that `lumistack displays` lists, or a display file [default: the display
    /// of the job file, or paper-three-layer]
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) display: Option<OsString>,
    /// Columns and rows of the views. The resolutions of the display's layers change in proportion
    #[arg(long, value_name = "CxR")]
    pub(crate) resolution: Option<Size>,
    /// Number of frames M that the display shows in quick succession [default: the display's]
    #[arg(long, value_name = "M")]
    pub(crate) frames: Option<usize>,
    /// Scale β of the picture's brightness, above 0 and at most 1 [default: the display's]
    #[arg(long, value_name = "B")]
    pub(crate) brightness: Option<f64>,
}

/// Help of `--denoise`, without the meaning of `auto`.
pub(crate) const DENOISERS: &str = "Filter that removes noise from views: auto, shared, off, guided or oidn. With shared, the diffuse light of each surface point is averaged over the views that see the point, and reflections of rough surfaces over neighbouring views. With guided, Lumistack's filter works on all views together. With oidn, the program Open Image Denoise filters each view; you must install this program";

/// Changes to rendering.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Rendering")]
pub(crate) struct RenderArgs {
    /// Number of views, as columns and rows. With auto, the number follows from the display, and is
    /// so large that the display also shows correct pictures between the views
    #[arg(long, value_name = "auto|CxR")]
    pub(crate) views: Option<Views>,
    /// Number of paths (samples of the light) per pixel, summed over all views. With auto, the
    /// number is so large that more paths would hardly improve the display's picture [default:
    /// auto]
    #[arg(long, value_name = "auto|N")]
    pub(crate) zone_samples: Option<lumistack_pipeline::ZoneSamples>,
    /// Number of paths per pixel of each view. This option cannot be combined with --zone-samples
    #[arg(long, value_name = "N", conflicts_with = "zone_samples")]
    pub(crate) samples: Option<u32>,
    /// Program that renders the views: lumistack, blender or auto. Blender renders only .blend
    /// scenes, with the file's own engine and settings. With auto, Blender renders each .blend
    /// scene that has content lumistack cannot show. In the exceptions that docs/BLENDER.md lists,
    /// lumistack renders the scene without that content. Lumistack renders all other scenes
    #[arg(long, value_name = "NAME")]
    pub(crate) engine: Option<lumistack_pipeline::Engine>,
    /// Largest number of bounces of a path; the first hit counts as a bounce. With 0 only the
    /// background and the light that surfaces emit are visible [default: 6]
    #[arg(long, value_name = "N")]
    pub(crate) max_bounces: Option<u32>,
    #[arg(long, value_name = "KIND", help = format!("{DENOISERS}. Auto means shared if the number of views is automatic and Lumistack's path tracer renders the views, otherwise off"))]
    pub(crate) denoise: Option<lumistack_pipeline::Denoise>,
    /// Camera that sees the scene, by its name or its number from 0. If the camera has a plane of
    /// focus, this plane becomes the display plane
    #[arg(long, value_name = "NAME|N")]
    pub(crate) camera: Option<String>,
    /// View the scene from this azimuth and elevation, degrees, even if the file has a camera.
    /// Azimuth 0 is the front, +z; positive azimuths lie to the right of the front, towards +x.
    /// Without this flag and without a camera, the scene is seen from the front, or from another
    /// side if that side shows much more
    #[arg(long, value_name = "AZ,EL", allow_hyphen_values = true)]
    pub(crate) look_from: Option<Numbers<2>>,
    /// Hide content that is farther in front of the window (the display's place in the scene) than
    /// this distance: auto, off, or a number of scene units. If a camera determines the window,
    /// auto takes the camera's near plane. If the job has `window.from = "given"`, auto takes the
    /// distance at which the display shows hardly any detail. Otherwise auto hides nothing
    #[arg(long, value_name = "auto|off|D", allow_hyphen_values = true)]
    pub(crate) near: Option<lumistack_pipeline::Near>,
    /// Show light sources that have a surface, such as area lights, in the views [default: as the
    /// file states, otherwise no]
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub(crate) lights_visible: Option<bool>,
    /// Time at which the scene's animations are shown, seconds. Without this flag, glTF scenes have
    /// the pose of the file, or the pose at time 0 with --animation. USD scenes have the pose at
    /// the first time code, and .blend scenes the pose at the saved frame
    #[arg(long = "time", value_name = "S", allow_hyphen_values = true)]
    pub(crate) time_s: Option<f64>,
    /// Animation of a glTF scene, by name or number. Without this flag and without a time, no
    /// animation plays. With a time but without this flag, all animations play together, or only
    /// the first if two of them move the same property of an object
    #[arg(long, value_name = "NAME|N")]
    pub(crate) animation: Option<String>,
    /// Variant of the scene. For glTF, give the name or number of a material variant. For USD, give
    /// SET=VARIANT for every prim that has the variant set SET, or /PRIM{SET=VARIANT} for one prim.
    /// For USD the flag may be given several times
    #[arg(long, value_name = "NAME|N|SET=VARIANT")]
    pub(crate) variant: Vec<String>,
    /// Keep only the splats whose centres lie in this box, given by two opposite corners in scene
    /// units
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub(crate) crop_box: Option<Numbers<6>>,
    /// Keep only the splats whose centres lie in this sphere, given by centre and radius in scene
    /// units
    #[arg(long, value_name = "X,Y,Z,R", allow_hyphen_values = true)]
    pub(crate) crop_sphere: Option<Numbers<4>>,
    /// Environment map (Radiance HDR or EXR) that replaces the scene's environment
    #[arg(long, value_name = "FILE")]
    pub(crate) environment: Option<PathBuf>,
    /// Factor that multiplies the light of the environment, or of the built-in studio light. A
    /// scene with too little light of its own gets the studio light
    #[arg(long, value_name = "K")]
    pub(crate) environment_strength: Option<f32>,
    /// Rotation of the environment about the up axis, degrees. A positive angle turns the
    /// environment to the left, as seen by a viewer who looks straight ahead
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(crate) environment_rotation: Option<f64>,
    /// Background behind all surfaces: environment, or a colour such as #202028. A colour does not
    /// light the surfaces
    #[arg(long, value_name = "COLOUR")]
    pub(crate) background: Option<lumistack_pipeline::Background>,
    /// Number of stops by which the views are brighter than with the automatic exposure. A number
    /// below 0 makes the views darker
    #[arg(long, value_name = "EV", allow_hyphen_values = true)]
    pub(crate) exposure_ev: Option<f64>,
    /// Tone curve of all views: auto, linear, khronos-neutral or agx. Auto means linear if hardly
    /// anything is brighter than white, or if the scene has splats; otherwise khronos-neutral
    #[arg(long, value_name = "CURVE", value_parser = ["auto", "linear", "khronos-neutral", "agx"])]
    pub(crate) tone: Option<String>,
    /// How the scene is brought into the display's depth of field: auto, off, move or compress.
    /// With move, the window (the display's place in the scene) moves along its normal. With
    /// compress, depth is also compressed if the scene still does not fit. Auto acts as compress,
    /// with these exceptions. In a sweep, auto changes nothing. Auto also changes nothing if the
    /// scene fits, or if the depth of field does not lie on both sides of the display plane. Auto
    /// does not move the window if the job has `window.from = "given"`, or if the job or the camera
    /// states a focus distance. Auto does not compress depth if a depth scale other than 1 is set.
    /// Without this option, HOW is the job's, or auto; `--fit-depth` alone means move
    #[arg(long, value_name = "HOW", num_args = 0..=1, require_equals = true, default_missing_value = "move", value_parser = ["auto", "off", "move", "compress"])]
    pub(crate) fit_depth: Option<String>,
    /// Factor that multiplies the parallax between views, and so the visible depth
    #[arg(long, value_name = "K")]
    pub(crate) depth_scale: Option<f64>,
    /// Render every view through a lens that is focused on the display plane, so that content off
    /// the plane blurs. DEG is the full angle of the lens's aperture, seen from the display plane,
    /// degrees [default: 0, no blur]
    #[arg(long, value_name = "DEG")]
    pub(crate) lens_deg: Option<f64>,
    /// Seed of the random numbers; the same seed gives the same results [default: the job's, or 1]
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    #[command(flatten)]
    pub(crate) files: FileArgs,
}

/// Limits on the files that a scene may read, and on the memory of its pictures.
#[derive(Clone, Debug, Default, ClapArgs)]
pub(crate) struct FileArgs {
    /// Let a glTF scene, or a scene of an importer plugin such as OBJ, read files outside of its
    /// own folder
    #[arg(long, help_heading = "Scene files")]
    pub(crate) allow_outside: bool,
    /// Largest memory for the decoded pictures of a scene, MiB; no effect on USD files [default:
    /// 8192]
    #[arg(long, value_name = "MIB", help_heading = "Scene files", value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    pub(crate) picture_budget: Option<u64>,
}

/// Help of `--iterations`, without the default.
pub(crate) const ITERATIONS: &str = "Number of iterations of the solver. Each iteration updates every layer once, and a directional backlight, if there is one";

/// Changes to the factorization.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Factorization")]
pub(crate) struct FactorizeArgs {
    #[arg(long, value_name = "N", help = format!("{ITERATIONS} [default: 50; 16 if a scene is rendered with an automatic number of views]"))]
    pub(crate) iterations: Option<u32>,
    #[arg(long, value_name = "NAME", help = format!("Solver, which computes the patterns: {}", either(solver_names())))]
    pub(crate) solver: Option<String>,
    /// Device that computes the patterns: auto, cpu, gpu or gpu:NAME. `lumistack devices` lists the
    /// names [default: auto, a graphics processor if there is one and this build supports it]
    #[arg(long, value_name = "DEVICE")]
    pub(crate) device: Option<String>,
    #[arg(long, value_name = "NAME", help = format!("Initial patterns of the solver: {}", either(StartKind::names())))]
    pub(crate) start: Option<String>,
    /// Start from the patterns of another run: DIR is the folder `layers` of that run
    #[arg(long, value_name = "DIR")]
    pub(crate) warm_start: Option<PathBuf>,
    /// A .npy file with weights ≥ 0, one per view or one per ray, by which the solver multiplies
    /// the squared errors of the rays
    #[arg(long, value_name = "FILE")]
    pub(crate) weights: Option<PathBuf>,
}

/// A sequence of time steps instead of a still: the window moves through the scene, or the scene
/// moves.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Sequence")]
pub(crate) struct SequenceArgs {
    /// Number of time steps. Each time step has a run folder (t0001, t0002, ...). Each time step
    /// after the first starts from the patterns of the previous time step, unless a fresh start is
    /// better
    #[arg(long, value_name = "N")]
    pub(crate) times: Option<usize>,
    /// Angle by which the window turns about its vertical axis from the first time step to the
    /// last, degrees. With a positive angle, the scene looks as if the viewer walked to the right
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub(crate) turn_deg: Option<f64>,
    /// Movement of the window from the first time step to the last, millimetres of the display: X
    /// right, Y up, Z to the viewer
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) shift_mm: Option<Numbers<3>>,
    /// Time that the scene's animations advance from the first time step to the last, seconds. The
    /// animations start at --time, or at 0 [default: 0, so the animations stand still]
    #[arg(long, value_name = "S", allow_hyphen_values = true)]
    pub(crate) duration_s: Option<f64>,
    /// Number of iterations at every time step after the first [default: 5]
    #[arg(long, value_name = "N")]
    pub(crate) sequence_iterations: Option<u32>,
    /// Divide the sequence into chunks of N time steps. Chunks do not need each other's patterns,
    /// so several machines can solve them at the same time [default: one chunk of all time steps]
    #[arg(long, value_name = "N")]
    pub(crate) chunk_times: Option<usize>,
    /// Number of time steps that are solved again before each chunk except the first, so that the
    /// chunk starts from good patterns [default: 2]
    #[arg(long, value_name = "N")]
    pub(crate) warm_up_times: Option<usize>,
}

/// The run folder of a job, and changes to the job.
#[derive(Debug, ClapArgs)]
pub(crate) struct JobArgs {
    /// Folder for the results [default: runs/NAME; sweeps/NAME for a sweep]
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

/// Exposure and tone curve of a given light field. Without these flags its values stay as they are.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Light field")]
pub(crate) struct FieldLookArgs {
    /// Exposure of all views, stops: values are multiplied by 2^EV
    #[arg(long, value_name = "EV", allow_hyphen_values = true)]
    pub(crate) exposure_ev: Option<f64>,
    /// Tone curve of all views: linear (clips to 0..1), khronos-neutral or agx [default: none, or
    /// linear if --exposure-ev changes the exposure]
    #[arg(long, value_name = "CURVE", value_parser = ["linear", "khronos-neutral", "agx"])]
    pub(crate) tone: Option<String>,
}

/// The display of a light field that is read from files.
#[derive(Debug, ClapArgs)]
#[command(next_help_heading = "Display")]
pub(crate) struct FactorizeDisplayArgs {
    /// The display: a name that `lumistack displays` lists, or a display file. The
    /// resolution and the views of the light field replace those of the display
    #[arg(long, value_name = "NAME|FILE", default_value = "paper-three-layer")]
    pub(crate) display: OsString,
    /// Number of frames M that the display shows in quick succession [default: the display's]
    #[arg(long, value_name = "M")]
    pub(crate) frames: Option<usize>,
    /// Scale β of the picture's brightness, above 0 and at most 1 [default: the display's]
    #[arg(long, value_name = "B")]
    pub(crate) brightness: Option<f64>,
}

/// Geometry of a light field, for files that do not state the geometry. A flag takes precedence
/// over the files.
#[derive(Debug, Default, ClapArgs)]
#[command(next_help_heading = "Light field")]
pub(crate) struct GeometryArgs {
    /// Projection of the views: oblique (each view is a parallel projection) or perspective (each
    /// view is the picture of a pinhole camera)
    #[arg(long, value_name = "KIND", value_parser = ["oblique", "perspective"])]
    pub(crate) grid: Option<String>,
    /// Full horizontal and vertical angle of the viewing zone that the views cover, degrees
    #[arg(long, value_name = "HxV")]
    pub(crate) fov: Option<Angles>,
    /// Distance between neighbouring pixels on the display plane, millimetres
    #[arg(long, value_name = "MM")]
    pub(crate) pitch_mm: Option<f64>,
    /// Distance of the eyes from the display plane, for perspective views, millimetres
    #[arg(long, value_name = "MM")]
    pub(crate) distance_mm: Option<f64>,
    /// Use only this number of views of a larger set, horizontal and vertical, evenly spaced around
    /// the centre
    #[arg(long, value_name = "HxV")]
    pub(crate) views: Option<Size>,
    /// Columns and rows of views in a quilt, if the name of the file does not state them
    #[arg(long, value_name = "CxR")]
    pub(crate) quilt: Option<Size>,
    /// Read a picture that contains all views as tiles. View (0, 0), the leftmost and topmost
    /// viewpoint, is at the top left of the picture. HxV is the number of views, horizontal and
    /// vertical
    #[arg(long, value_name = "HxV")]
    pub(crate) tiles: Option<Size>,
    /// Columns and rows of every view. Views are cropped to this aspect ratio, then reduced
    #[arg(long, value_name = "CxR")]
    pub(crate) resolution: Option<Size>,
    /// Disparity of the display plane, pixels. From a view to its right neighbour, a point of the
    /// display plane moves this far to the left
    #[arg(long, value_name = "PX", allow_hyphen_values = true)]
    pub(crate) focus_px: Option<f64>,
    /// Reverse the order of views from left to right
    #[arg(long)]
    pub(crate) mirror_x: bool,
    /// Reverse the order of views from top to bottom
    #[arg(long)]
    pub(crate) mirror_y: bool,
    /// Replace every used view by an average over the directions that the display cannot separate.
    /// The average also uses the views that --views leaves out
    #[arg(long)]
    pub(crate) prefilter: bool,
}

/// Joins names: "a, b or c".
fn either(names: impl Iterator<Item = &'static str>) -> String {
    let mut names: Vec<&str> = names.collect();
    let last = names.pop().unwrap_or_default();
    format!("{} or {last}", names.join(", "))
}

/// Loads a job file, or makes a job for a scene.
pub(crate) fn job_or_scene(path: &Path) -> Result<Job, PipelineError> {
    if is_job(path) {
        return Job::load(path);
    }
    if path.is_dir() {
        let expected = "a scene (.gltf, .glb, USD, .blend, .obj, .ply, .spz, .sog or meta.json) or a job file (.toml); for a folder of views use `lumistack factorize`";
        return Err(PipelineError::value(path, "input", expected, "a folder"));
    }
    if path.extension().is_none() && !path.exists() {
        let expected = "a scene (.gltf, .glb, USD, .blend, .obj, .ply, .spz, .sog or meta.json) or a job file (.toml)";
        return Err(PipelineError::value(path, "input", expected, "no such file"));
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

/// Resets the keys `from`, `centre`, `forward`, `up` and `width` of a window, so that options can
/// place the window.
fn unplace(window: &mut WindowJob) {
    let WindowJob { from, centre, forward, up, width, .. } = WindowJob::default();
    (window.from, window.centre, window.forward, window.up, window.width) = (from, centre, forward, up, width);
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
    // The command line takes precedence over the job file.
    if args.camera.is_some() {
        unplace(&mut job.window);
        (job.window.camera, job.window.look_from) = (args.camera.clone(), None);
    }
    if let Some(look_from) = args.look_from {
        job.window.look_from = Some(look_from.0);
        if args.camera.is_none() {
            unplace(&mut job.window);
            (job.window.from, job.window.camera, job.window.focus_distance) = (WindowFrom::Bounds, None, None);
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

/// Applies the options about the scene's files.
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

/// Returns the job that the command line describes, and the path of its run folder.
pub(crate) fn job_of(input: &Path, args: &JobArgs) -> Result<(Job, PathBuf), PipelineError> {
    let mut job = job_or_scene(input)?;
    change_display(&mut job, &args.display);
    change_render(&mut job, &args.render);
    change_factorize(&mut job, &args.factorize);
    change_sequence(&mut job, &args.sequence);
    if !is_job(input) && job.sequence.is_none() {
        // Without a job file the user has chosen no outputs. The default output is a preview, which
        // a browser shows.
        job.outputs.push(OutputJob { name: Some("preview".into()), ..OutputJob::new("web_simulator") });
    }
    let runs = if job.sweep.is_some() { "sweeps" } else { "runs" };
    let folder = args.output.clone().unwrap_or_else(|| Path::new(runs).join(&job.name));
    Ok((job, folder))
}

/// Corrects an error whose place is "job". The place becomes the job file, or the command line if
/// `input` is a scene.
pub(crate) fn in_place(error: PipelineError, input: &Path) -> PipelineError {
    match error {
        PipelineError::Value(value) if value.place == Place::Job => {
            let place = if is_job(input) { Place::File(input.to_owned()) } else { Place::CommandLine };
            PipelineError::Value(Box::new(BadValue { place, ..*value }))
        }
        other => other,
    }
}

/// Converts the geometry options to the form that the pipeline reads.
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

    /// Options of the command line replace a window that the job places by numbers or at a camera's
    /// plane of focus.
    #[test]
    fn options_place_the_window_of_any_job() {
        #[derive(clap::Parser)]
        struct Command {
            #[command(flatten)]
            render: RenderArgs,
        }
        let given = WindowJob {
            from: WindowFrom::Given,
            centre: Some([0.0; 3]),
            forward: Some([0.0, 0.0, -1.0]),
            up: Some([0.0, 1.0, 0.0]),
            width: Some(2.0),
            depth_scale: 0.5,
            ..WindowJob::default()
        };
        let camera = WindowJob { camera: Some("a".into()), focus_distance: Some(2.0), ..WindowJob::default() };
        for window in [given, camera] {
            for options in [["--camera", "1"], ["--look-from", "10,20"]] {
                let mut job = Job::new(DisplayJob::by_name_or_path("fig7-uniform"));
                (job.scene, job.window) = (Some("a.glb".into()), window.clone());
                let command = <Command as clap::Parser>::parse_from(["run"].iter().chain(&options));
                change_render(&mut job, &command.render);
                job.check().unwrap();
                assert_eq!(job.window.depth_scale, window.depth_scale);
                let placed = (job.window.camera.as_deref(), job.window.look_from);
                let expected = if options[0] == "--camera" { (Some("1"), None) } else { (None, Some([10.0, 20.0])) };
                assert_eq!(placed, expected);
            }
        }
    }

    /// Help is generated from the names of solvers and starts. Texts that are written by hand must
    /// contain the same names.
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
