//! The commands.

use std::path::{Path, PathBuf};

use clap::CommandFactory;
use lumistack_core::{Cancel, Task};
use lumistack_field_io::GeometryFlags;
use lumistack_pipeline::{
    DisplayJob, Job, PipelineError, RunFolder, SequenceJob, Viewpoint, presets, render_only, run as run_job,
    set_threads, simulate_to_file,
};
use serde_json::json;

use crate::args::{
    Args, Command, DisplayArgs, Factorize, FactorizeArgs, GeometryArgs, Render, RenderArgs, Run, SequenceArgs, Simulate,
};
use crate::console::{Console, say};
use crate::info;

/// The display of `run` and `render` when nobody names one.
const DEFAULT_DISPLAY: &str = "paper-three-layer";

pub(crate) fn run(args: Args, cancel: &Cancel) -> Result<(), PipelineError> {
    if let Some(threads) = args.threads {
        set_threads(threads)
            .map_err(|error| PipelineError::value("--threads", "N", "a number of threads that can start", error))?;
    }
    let console = Console::new(args.json);
    let task = Task { progress: &console, warnings: &console, cancel };
    match args.command {
        Command::Run(run) => run_command(&run, args.json, task),
        Command::Render(render) => render_command(&render, args.json, task),
        Command::Factorize(factorize) => factorize_command(&factorize, args.json, task),
        Command::Simulate(simulate) => simulate_command(&simulate, args.json),
        Command::Info(info) => info::print(&info, args.json, task),
        Command::Plugins => info::print_plugins(args.json),
        Command::Displays => info::print_displays(args.json),
        Command::Completions { shell } => {
            clap_complete::generate(shell, &mut Args::command(), "lumistack", &mut std::io::stdout());
            Ok(())
        }
    }
}

fn run_command(args: &Run, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let mut job = job_or_scene(&args.input)?;
    change_display(&mut job, &args.display);
    change_render(&mut job, &args.render);
    change_factorize(&mut job, &args.factorize);
    change_sequence(&mut job, &args.sequence);
    let folder = args.output.clone().unwrap_or_else(|| Path::new("runs").join(&job.name));
    finish(&job, &folder, json, task)
}

fn factorize_command(args: &Factorize, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let mut job = Job::new(presets::by_name_or_path(&args.display.display));
    job.name = stem(&args.light_field);
    job.light_field = Some(args.light_field.clone());
    job.geometry = geometry(&args.geometry);
    job.display.frames = args.display.frames;
    job.display.brightness = args.display.brightness;
    job.seed = args.seed.unwrap_or(job.seed);
    change_factorize(&mut job, &args.factorize);
    if args.sequence {
        let default = SequenceJob::default();
        let iterations = args.sequence_iterations.unwrap_or(default.iterations);
        job.sequence = Some(SequenceJob { iterations, ..default });
    }
    finish(&job, &args.output, json, task)
}

fn finish(job: &Job, folder: &Path, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let command = format!("lumistack {}", words.join(" "));
    let summary = run_job(job, folder, Some(&command), task)?;
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
    } else {
        let others = [("in between", summary.psnr_held_out), ("outside", summary.psnr_outside)];
        let others = others.map(|(name, psnr)| psnr.map_or(String::new(), |psnr| format!(", {name} {psnr:.1} dB")));
        say!("PSNR {:.1} dB at the target views{}; {:.0} s", summary.psnr_view, others.concat(), summary.seconds);
        say!("{}", summary.report.display());
    }
    Ok(())
}

fn render_command(args: &Render, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let mut job = job_or_scene(&args.scene)?;
    change_display(&mut job, &args.display);
    change_render(&mut job, &args.render);
    render_only(&job, &args.output, task)?;
    let index = args.output.join("lightfield.json");
    if json {
        say!("{}", json!({"event": "done", "light_field": index}));
    } else {
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
fn job_or_scene(path: &Path) -> Result<Job, PipelineError> {
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

fn change_display(job: &mut Job, args: &DisplayArgs) {
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

fn change_render(job: &mut Job, args: &RenderArgs) {
    job.render.samples = args.samples.unwrap_or(job.render.samples);
    job.render.max_bounces = args.max_bounces.unwrap_or(job.render.max_bounces);
    job.light.exposure_ev = args.exposure_ev.unwrap_or(job.light.exposure_ev);
    job.seed = args.seed.unwrap_or(job.seed);
    if args.camera.is_some() {
        job.window.camera = args.camera.clone();
    }
    if args.environment.is_some() {
        job.light.environment = args.environment.clone();
    }
}

fn change_factorize(job: &mut Job, args: &FactorizeArgs) {
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
    let SequenceArgs { times, turn_deg, shift_mm, sequence_iterations } = args;
    if times.is_none() && turn_deg.is_none() && shift_mm.is_none() && sequence_iterations.is_none() {
        return;
    }
    let sequence = job.sequence.get_or_insert_default();
    sequence.times = times.or(sequence.times);
    sequence.turn_deg = turn_deg.unwrap_or(sequence.turn_deg);
    sequence.shift_mm = shift_mm.map_or(sequence.shift_mm, |shift| shift.0);
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
    }
}
