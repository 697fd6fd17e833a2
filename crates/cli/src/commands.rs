//! The commands.

use std::path::Path;

use clap::CommandFactory;
use lumistack_core::{Cancel, Task};
use lumistack_pipeline::{
    Freed, Job, PipelineError, Registry, RunFolder, SequenceJob, ViewOptions, Viewpoint, clean, plugins, render_views,
    run as run_job, schema, set_threads, simulate_to_file,
};
use serde_json::json;

use crate::args::{Args, Clean, Command, Factorize, Render, Run, Schema, Setup, Simulate};
use crate::console::{Console, say};
use crate::groups::{
    change_display, change_factorize, change_render, geometry, in_place, job_of, job_or_scene, stem, tone_of,
};
use crate::info;
use crate::preview::{preview_command, written_preview};
use crate::program;
use crate::values::size_text;

/// Runs a command. `line` is the command line as typed; reports contain it.
pub(crate) fn run(args: Args, line: &str, cancel: &Cancel) -> Result<(), PipelineError> {
    if let Some(threads) = args.threads {
        set_threads(threads).map_err(|error| {
            PipelineError::option("--threads", "N", "a number of threads that the system can start", error)
        })?;
    }
    // A command whose result is one document must print nothing else to standard output.
    let answers = matches!(args.command, Command::Info(_));
    let console = Console::new(args.json && !answers);
    let task = Task { progress: &console, warnings: &console, cancel };
    #[cfg(feature = "dynamic")]
    let registry = || plugins(&args.plugin_path);
    #[cfg(not(feature = "dynamic"))]
    let registry = || plugins(&[]);
    // A plugin that cannot be loaded causes a warning, and the program works without it.
    let registry_for_work = || {
        let registry = registry()?;
        registry.failed().iter().for_each(|error| task.warn("plugin", error.to_string()));
        Ok::<_, PipelineError>(registry)
    };
    match args.command {
        Command::Run(run) => run_command(&run, line, &registry_for_work()?, args.json, task),
        Command::Render(render) => render_command(&render, &registry_for_work()?, args.json, task),
        Command::Factorize(factorize) => factorize_command(&factorize, line, &registry_for_work()?, args.json, task),
        Command::Simulate(simulate) => simulate_command(&simulate, args.json, task),
        Command::Preview(preview) => preview_command(&preview, &registry_for_work()?, args.json, task),
        Command::Analyze(analyze) => crate::analyze::run(&analyze, &registry_for_work()?, args.json, task),
        Command::Sweep(sweep) => crate::sweep::run(&sweep, &registry_for_work()?, args.json, task),
        Command::Farm(farm) => crate::farm::run(&farm, args.threads, &registry_for_work()?, args.json, task),
        Command::Compare(compare) => crate::compare::run(&compare, args.json, task),
        Command::Clean(args_of) => clean_command(&args_of, args.json, task),
        Command::Show(show) => crate::show::show_command(&show, &registry_for_work()?, args.json, task),
        Command::Live(live) => crate::live::live_command(&live, &registry_for_work()?, args.json, task),
        Command::Info(info) => info::print(&info, &registry_for_work()?, args.json, task),
        Command::Plugins { ids } => info::print_plugins(&ids, &registry()?, args.json),
        Command::Display { what } => crate::display::display_command(&what, args.json),
        Command::Devices => crate::devices::run(args.json),
        Command::Displays => info::print_displays(args.json),
        Command::Doctor => crate::doctor::run(&registry()?, args.json, cancel),
        Command::Setup { what: Setup::Usd { materialx, python } } => {
            let setup = lumistack_usd::Setup { python, materialx, folder: None };
            let mut tell = |line: &str| match args.json {
                true => say!("{}", json!({"event": "setup", "message": line})),
                false => say!("{line}"),
            };
            setup.run(&mut tell, cancel).map(|_| ()).map_err(PipelineError::from)
        }
        Command::New(new) => crate::new::new_command(&new, &registry_for_work()?, args.json),
        Command::Schema { what } => {
            let schema = match what {
                Schema::Job => schema::job(&registry_for_work()?),
                Schema::Display => schema::display(),
            };
            say!("{}", serde_json::to_string_pretty(&schema).expect("a schema is JSON"));
            Ok(())
        }
        Command::Man { folder } => {
            let failed = |source| PipelineError::Write { path: folder.clone(), source };
            std::fs::create_dir_all(&folder).map_err(failed)?;
            clap_mangen::generate_to(Args::command(), &folder).map_err(failed)
        }
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Args::command(), "lumistack", &mut script);
            say!("{}", String::from_utf8_lossy(&script).trim_end());
            Ok(())
        }
    }
}

fn run_command(args: &Run, line: &str, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let input = &args.input;
    let (job, folder) = job_of(input, &args.job)?;
    if args.plan {
        return crate::plan::print(&job, &folder, registry, json).map_err(|error| in_place(error, input));
    }
    finish(&job, &folder, line, registry, json, task).map_err(|error| in_place(error, input))
}

fn factorize_command(
    args: &Factorize,
    line: &str,
    registry: &Registry,
    json: bool,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let mut job = Job::new(lumistack_pipeline::DisplayJob::by_name_or_path(&args.display.display));
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
    finish(&job, &args.output, line, registry, json, task).map_err(|error| in_place(error, &args.light_field))
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
    // Print the result as JSON, or as text for a sequence, for several displays or for one display.
    if !json {
        summary.lacking.iter().for_each(|lacking| say!("Scene: {lacking}"));
    }
    if json {
        let mut event = serde_json::to_value(&summary).expect("summaries serialize");
        event["event"] = "done".into();
        say!("{event}");
    } else if let Some(sequence) = &summary.sequence {
        for node in &summary.nodes {
            say!("{}: PSNR {:.1} dB at the solver's views of {} time steps", node.id, node.psnr_view, sequence.times);
        }
        let times = sequence.times;
        let others =
            [("flicker", sequence.psnr_change), ("flicker where the target does not change", sequence.psnr_still)];
        let others = others.map(|(name, psnr)| psnr.map_or(String::new(), |psnr| format!("; {name} {psnr:.1} dB")));
        say!(
            "PSNR {:.1} dB at the solver's views of {times} time steps{}; time {:.0} s",
            summary.psnr_view,
            others.concat(),
            summary.seconds
        );
        let preview = format!("{} preview {}", program::name(), folder.display());
        say!("Look into the display at the first time step: {preview}");
        if times > 1 {
            say!(
                "Look into the display at the last time step: {preview}/t{times:04}; each time step has its own folder"
            );
        }
        say!("{}", summary.report.display());
    } else if !summary.nodes.is_empty() {
        for node in &summary.nodes {
            let zone = node.psnr_zone.map_or(String::new(), |psnr| format!("{psnr:.1} dB over the zone, "));
            say!("{}: PSNR {zone}{:.1} dB at the solver's views", node.id, node.psnr_view);
        }
        say!("number of displays: {}; time {:.0} s", summary.nodes.len(), summary.seconds);
        say!("{}", summary.report.display());
    } else {
        let zone = match (summary.psnr_zone, summary.psnr_zone_worst) {
            (Some(zone), Some(worst)) => {
                format!("{zone:.1} dB over the zone (in the worst tenth of its directions {worst:.1} dB), ")
            }
            _ => String::new(),
        };
        let others = [("between these views", summary.psnr_held_out), ("outside of these views", summary.psnr_outside)];
        let others = others.map(|(name, psnr)| psnr.map_or(String::new(), |psnr| format!(", {psnr:.1} dB {name}")));
        if let Some(sentence) = &summary.depth_sentence {
            say!("Depth: {sentence}");
        }
        say!(
            "PSNR {zone}{:.1} dB at the solver's views{}; time {:.0} s",
            summary.psnr_view,
            others.concat(),
            summary.seconds
        );
        say!("Look into the display: {} preview {}", program::name(), folder.display());
        if let Some(single) = written_preview(folder).map(|preview| preview.join("preview.html"))
            && single.is_file()
        {
            say!("or open the page {} by a double click", single.display());
        }
        say!("{}", summary.report.display());
    }
    // An output that could not be written does not prevent the report, but the command must fail.
    match summary.failed_outputs {
        failed if failed.is_empty() => Ok(()),
        failed => Err(PipelineError::Outputs { failed }),
    }
}

fn clean_command(args: &Clean, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    for dir in &args.dirs {
        let cleaned = clean(dir, args.all, args.dry_run, task)?;
        if json {
            let mut event = serde_json::to_value(&cleaned).expect("what was cleaned serializes");
            (event["event"], event["dry_run"]) = ("done".into(), args.dry_run.into());
            event["freed_bytes"] = cleaned.bytes().into();
            say!("{event}");
            continue;
        }
        for Freed { kind, files, bytes, .. } in &cleaned.freed {
            say!("{:>10}  {kind}, {files} file{}", size_text(*bytes), if *files == 1 { "" } else { "s" });
        }
        let (freed, kept) = (size_text(cleaned.bytes()), size_text(cleaned.kept_bytes));
        let done = if args.dry_run { "would be freed" } else { "freed" };
        let hint = if args.all || cleaned.kept_bytes == 0 { "" } else { "; --all also removes cached views" };
        say!("{:>10}  {done} in {}; {kept} of cached results stay there{hint}", freed, dir.display());
    }
    Ok(())
}

fn render_command(args: &Render, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let mut job = job_or_scene(&args.scene)?;
    change_display(&mut job, &args.display);
    change_render(&mut job, &args.render);
    let options = ViewOptions { linear: args.linear, channels: args.layers.clone(), only: args.only_views.clone() };
    let depth =
        render_views(&job, &args.output, &options, registry, task).map_err(|error| in_place(error, &args.scene))?;
    let index = args.output.join("lightfield.json");
    if json {
        say!("{}", json!({"event": "done", "light_field": index.to_string_lossy(), "depth": depth.to_json()}));
    } else {
        say!("Depth: {}", depth.sentence());
        say!("{}", index.display());
    }
    Ok(())
}

fn simulate_command(args: &Simulate, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let viewpoint = match (args.view, args.eye, args.sweep) {
        (_, Some(eye), _) => Viewpoint::Eye(eye.0),
        (_, _, Some(count)) => Viewpoint::Sweep(count),
        (view, None, None) => Viewpoint::Angle(view.map_or([0.0, 0.0], |view| view.0)),
    };
    let run = RunFolder::open(&args.dir)?;
    if let Some(message) = run.zone_warning(viewpoint) {
        task.warn(if args.eye.is_some() { "--eye" } else { "--view" }, message);
    }
    let picture = run.picture(viewpoint, args.raw)?;
    simulate_to_file(&picture, &args.output)?;
    if json {
        say!("{}", json!({"event": "done", "picture": args.output.to_string_lossy()}));
    } else {
        say!("{}", args.output.display());
    }
    Ok(())
}
