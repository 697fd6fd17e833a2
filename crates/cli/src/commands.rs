//! The commands.

use std::path::{Path, PathBuf};

use clap::CommandFactory;
use lumistack_core::{Cancel, Task};
use lumistack_field_io::GeometryFlags;
use lumistack_pipeline::{
    DisplayJob, FitDepth, Job, PipelineError, Registry, RunFolder, SequenceJob, Tone, Viewpoint, is_usd, plugins,
    presets, render_only, run as run_job, set_threads, simulate_to_file,
};
use serde_json::json;

use crate::args::{
    Args, Command, DisplayArgs, Factorize, FactorizeArgs, GeometryArgs, Render, RenderArgs, Run, SequenceArgs, Setup,
    Simulate,
};
use crate::console::{Console, say};
use crate::info;
use crate::preview::{preview_command, written_preview};

/// The display of `run` and `render` when nobody names one.
pub const DEFAULT_DISPLAY: &str = "paper-three-layer";

/// Runs a command; `line` is what was typed, for reports.
pub(crate) fn run(args: Args, line: &str, cancel: &Cancel) -> Result<(), PipelineError> {
    if let Some(threads) = args.threads {
        set_threads(threads)
            .map_err(|error| PipelineError::value("--threads", "N", "a number of threads that can start", error))?;
    }
    let console = Console::new(args.json);
    let task = Task { progress: &console, warnings: &console, cancel };
    #[cfg(feature = "dynamic")]
    let registry = || plugins(&args.plugin_path);
    #[cfg(not(feature = "dynamic"))]
    let registry = || plugins(&[]);
    // the program does without what cannot be used
    let registry_for_work = || {
        let registry = registry()?;
        registry.failed().iter().for_each(|error| task.warn("plugin", error.to_string()));
        Ok::<_, PipelineError>(registry)
    };
    match args.command {
        Command::Run(run) => run_command(&run, line, &registry_for_work()?, args.json, task),
        Command::Render(render) => render_command(&render, &registry_for_work()?, args.json, task),
        Command::Factorize(factorize) => factorize_command(&factorize, line, &registry_for_work()?, args.json, task),
        Command::Simulate(simulate) => simulate_command(&simulate, args.json),
        Command::Preview(preview) => preview_command(&preview, &registry_for_work()?, args.json, task),
        Command::Analyze(analyze) => crate::analyze::run(&analyze, &registry_for_work()?, args.json, task),
        Command::Sweep(sweep) => crate::sweep::run(&sweep, &registry_for_work()?, args.json, task),
        Command::Compare(compare) => crate::compare::run(&compare, args.json, task),
        Command::Show(show) => crate::show::show_command(&show, args.json, task),
        Command::Info(info) => info::print(&info, &registry_for_work()?, args.json, task),
        Command::Plugins => {
            info::print_plugins(&registry()?, args.json);
            Ok(())
        }
        Command::Display { what } => crate::display::display_command(&what, args.json),
        Command::Displays => info::print_displays(args.json),
        Command::Setup { what: Setup::Usd { materialx, python } } => {
            let setup = lumistack_usd::Setup { python, materialx, folder: None };
            let mut tell = |line: &str| match args.json {
                true => say!("{}", json!({"event": "setup", "message": line})),
                false => say!("{line}"),
            };
            setup.run(&mut tell, cancel).map(|_| ()).map_err(PipelineError::from)
        }
        Command::Completions { shell } => {
            clap_complete::generate(shell, &mut Args::command(), "lumistack", &mut std::io::stdout());
            Ok(())
        }
    }
}

fn run_command(args: &Run, line: &str, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let mut job = job_or_scene(&args.input)?;
    change_display(&mut job, &args.display);
    change_render(&mut job, &args.render);
    change_factorize(&mut job, &args.factorize);
    change_sequence(&mut job, &args.sequence);
    let folder = args.output.clone().unwrap_or_else(|| Path::new("runs").join(&job.name));
    finish(&job, &folder, line, registry, json, task)
}

fn factorize_command(
    args: &Factorize,
    line: &str,
    registry: &Registry,
    json: bool,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let mut job = Job::new(presets::by_name_or_path(&args.display.display));
    job.name = stem(&args.light_field);
    job.light_field = Some(args.light_field.clone());
    job.geometry = geometry(&args.geometry);
    job.light.exposure_ev = args.look.exposure_ev.unwrap_or(job.light.exposure_ev);
    job.light.tone = args.look.tone.as_deref().map_or(job.light.tone, tone_of);
    job.display.frames = args.display.frames;
    job.display.brightness = args.display.brightness;
    job.seed = args.seed.unwrap_or(job.seed);
    change_factorize(&mut job, &args.factorize);
    if args.sequence {
        let default = SequenceJob::default();
        let iterations = args.sequence_iterations.unwrap_or(default.iterations);
        job.sequence = Some(SequenceJob { iterations, ..default });
    }
    finish(&job, &args.output, line, registry, json, task)
}

fn finish(
    job: &Job,
    folder: &Path,
    line: &str,
    registry: &Registry,
    json: bool,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let summary = run_job(job, folder, registry, Some(line), task)?;
    if json {
        let mut event = serde_json::to_value(&summary).expect("summaries serialize");
        event["event"] = "done".into();
        say!("{event}");
    } else if let Some(sequence) = &summary.sequence {
        let times = sequence.times;
        let others = [(", flicker", sequence.psnr_change), (", where still", sequence.psnr_still)];
        let others = others.map(|(name, psnr)| psnr.map_or(String::new(), |psnr| format!("{name} {psnr:.1} dB")));
        say!("PSNR {:.1} dB over {times} times{}; {:.0} s", summary.psnr_view, others.concat(), summary.seconds);
        say!("{}", summary.report.display());
    } else if !summary.nodes.is_empty() {
        for node in &summary.nodes {
            say!("{}: PSNR {:.1} dB at the target views", node.id, node.psnr_view);
        }
        say!("{} displays; {:.0} s", summary.nodes.len(), summary.seconds);
        say!("{}", summary.report.display());
    } else {
        let others = [("in between", summary.psnr_held_out), ("outside", summary.psnr_outside)];
        let others = others.map(|(name, psnr)| psnr.map_or(String::new(), |psnr| format!(", {name} {psnr:.1} dB")));
        if let Some(sentence) = &summary.depth_sentence {
            say!("Depth: {sentence}");
        }
        say!("PSNR {:.1} dB at the target views{}; {:.0} s", summary.psnr_view, others.concat(), summary.seconds);
        if let Some(preview) = written_preview(folder) {
            say!("Look into the display: lumistack preview {}", folder.display());
            let single = preview.join("preview.html");
            if single.is_file() {
                say!("or open {} by a double click", single.display());
            }
        }
        say!("{}", summary.report.display());
    }
    Ok(())
}

fn render_command(args: &Render, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let mut job = job_or_scene(&args.scene)?;
    change_display(&mut job, &args.display);
    change_render(&mut job, &args.render);
    let depth = render_only(&job, &args.output, registry, task)?;
    let index = args.output.join("lightfield.json");
    if json {
        say!("{}", json!({"event": "done", "light_field": index, "depth": depth.to_json()}));
    } else {
        say!("Depth: {}", depth.sentence());
        say!("{}", index.display());
    }
    Ok(())
}

fn simulate_command(args: &Simulate, json: bool) -> Result<(), PipelineError> {
    let viewpoint = match (args.view, args.eye, args.sweep) {
        (_, Some(eye), _) => Viewpoint::Eye(eye.0),
        (_, _, Some(count)) => Viewpoint::Sweep(count),
        (view, None, None) => Viewpoint::Angle(view.map_or([0.0, 0.0], |view| view.0)),
    };
    let picture = RunFolder::open(&args.dir)?.picture(viewpoint, args.raw)?;
    simulate_to_file(&picture, &args.output)?;
    if json {
        say!("{}", json!({"event": "done", "picture": args.output}));
    } else {
        say!("{}", args.output.display());
    }
    Ok(())
}

/// A job file, or a job around a scene.
pub(crate) fn job_or_scene(path: &Path) -> Result<Job, PipelineError> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml")) {
        return Job::load(path);
    }
    let mut job = Job::new(DisplayJob { preset: Some(DEFAULT_DISPLAY.into()), ..DisplayJob::default() });
    job.name = stem(path);
    job.scene = Some(path.to_owned());
    Ok(job)
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or("run".into(), |stem| stem.to_string_lossy().into_owned())
}

pub(crate) fn change_display(job: &mut Job, args: &DisplayArgs) {
    if let Some(display) = &args.display {
        let named = presets::by_name_or_path(display);
        (job.display.preset, job.display.file) = (named.preset, named.file);
    }
    if let Some(resolution) = args.resolution {
        job.display.resolution = Some(resolution.0);
    }
    job.display.frames = args.frames.or(job.display.frames);
    job.display.brightness = args.brightness.or(job.display.brightness);
}

fn tone_of(name: &str) -> Tone {
    match name {
        "linear" => Tone::Linear,
        "khronos-neutral" => Tone::KhronosNeutral,
        "agx" => Tone::Agx,
        _ => Tone::Auto,
    }
}

pub(crate) fn change_render(job: &mut Job, args: &RenderArgs) {
    job.render.samples = args.samples.unwrap_or(job.render.samples);
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
        Some(_) => job.window.fit_depth = FitDepth::Off,
        None => {}
    }
    if args.camera.is_some() {
        job.window.camera = args.camera.clone();
    }
    if args.environment.is_some() {
        job.light.environment = args.environment.clone();
    }
    job.pose.time_s = args.time_s.or(job.pose.time_s);
    if args.animation.is_some() {
        job.pose.animation.clone_from(&args.animation);
    }
    let is_usd = job.scene.as_deref().is_some_and(is_usd);
    if is_usd && !args.variant.is_empty() {
        job.pose.variants.clone_from(&args.variant);
    } else if let Some(variant) = args.variant.last() {
        job.pose.variant = Some(variant.clone());
    }
}

pub(crate) fn change_factorize(job: &mut Job, args: &FactorizeArgs) {
    let factorize = &mut job.factorize;
    factorize.iterations = args.iterations.unwrap_or(factorize.iterations);
    if let Some(solver) = &args.solver {
        factorize.solver = solver.clone();
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

fn change_sequence(job: &mut Job, args: &SequenceArgs) {
    let SequenceArgs { times, turn_deg, shift_mm, duration_s, sequence_iterations } = args;
    let moves = turn_deg.is_some() || shift_mm.is_some() || duration_s.is_some();
    if times.is_none() && !moves && sequence_iterations.is_none() {
        return;
    }
    let sequence = job.sequence.get_or_insert_default();
    sequence.times = times.or(sequence.times);
    sequence.turn_deg = turn_deg.unwrap_or(sequence.turn_deg);
    sequence.shift_mm = shift_mm.map_or(sequence.shift_mm, |shift| shift.0);
    sequence.duration_s = duration_s.unwrap_or(sequence.duration_s);
    sequence.iterations = sequence_iterations.unwrap_or(sequence.iterations);
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
