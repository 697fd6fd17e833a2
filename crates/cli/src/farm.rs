//! `lumistack farm`: executes a run on many machines.

use std::io::Read;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::str::FromStr;
use std::time::Duration;

use clap::builder::PossibleValue;
use lumistack_core::Task;
use lumistack_farm::{Format, Graph, Prediction, paths, predict};
use lumistack_pipeline::{BlockSize, FarmPlan, Job, PipelineError, Registry, code, farm_plan, farm_unit};
use serde_json::{Value, json};

use crate::console::say;
use crate::groups::{JobArgs, in_place, job_of};
use crate::values::{duration_text, size_text};

pub(crate) const EXAMPLES: &str = "\
Examples:
  lumistack farm job.toml -o runs/shot
      runs the job on two workers of this machine, which Python's package dask.distributed starts
  lumistack farm job.toml -o /mnt/shots/one --dask tls://head:8786 \\
      --tls-ca ca.pem --tls-cert me.pem --tls-key me-key.pem
      runs the job on the workers of a Dask scheduler, which share the folder /mnt/shots/one
  lumistack farm plan job.toml -o runs/shot
      lists the units of work with their inputs, times and memory
  lumistack farm export makefile job.toml -o runs/shot --to Makefile
      writes a Makefile; `make -j8` then runs the units
  lumistack farm export openjd job.toml -o /mnt/shots/one --to jobs
      writes a job for farm managers that read Open Job Description

Patterns, outputs and tables are the same as on one machine, byte for byte; reports differ in their times. If a run was stopped or killed, the same command continues it. docs/FARM.md has recipes.";

/// Assumed time to start a unit of work, seconds. Predictions add it to the time of each unit.
const OVERHEAD_SECONDS: f64 = 0.1;

#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Farm {
    #[command(subcommand)]
    what: Option<What>,
    /// Job file (.toml; it may have a table [sweep]) or scene
    #[arg(required = true)]
    input: Option<PathBuf>,
    #[command(flatten)]
    job: JobArgs,
    #[command(flatten)]
    cut: CutArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

/// Default of `--workers` in `plan` and `show`: numbers of workers for which the total time is
/// predicted.
const WORKERS: &str = "1,2,10,100,1000";

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Divide a run into units of work, write the list of the units into the run folder, and print
    /// the list
    Plan {
        /// Job file (.toml; it may have a table [sweep]) or scene
        input: PathBuf,
        #[command(flatten)]
        job: JobArgs,
        #[command(flatten)]
        cut: CutArgs,
        /// Numbers of workers, separated by commas. The total time is predicted for each
        #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = WORKERS)]
        workers: Vec<usize>,
    },
    /// List the units of a planned run, and which of them are done
    Show {
        /// The run folder
        dir: PathBuf,
        /// Numbers of workers, separated by commas. The total time is predicted for each, from the
        /// measured times of finished units and the estimated times of all other units
        #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = WORKERS)]
        workers: Vec<usize>,
    },
    /// Execute one unit of work. Farm managers call this command
    Unit {
        /// The run folder
        dir: PathBuf,
        /// Id of the unit
        id: String,
        /// Replace the folder /THERE of the planning machine by /HERE of this machine, in all
        /// paths. The flag may be given several times
        #[arg(long, value_name = "/THERE=/HERE")]
        map: Vec<Map>,
        /// Time to wait for the results of other units, seconds; a network file system may show
        /// files late
        #[arg(long, value_name = "SECONDS", default_value_t = 60)]
        patience: u64,
        /// End the unit when standard input closes, so that no unit outlives its worker
        #[arg(long)]
        attached: bool,
    },
    /// Write the units of a run as a job for a farm manager
    Export {
        /// Format of the written job: that of a farm manager, a Makefile, or a shell script
        format: FormatArg,
        /// Job file (.toml; it may have a table [sweep]) or scene
        input: PathBuf,
        #[command(flatten)]
        job: JobArgs,
        #[command(flatten)]
        cut: CutArgs,
        /// Folder for the files of the job for the farm manager. For a format that writes a single
        /// file, give a folder or the path of the file. A path counts as the path of the file if
        /// the path has an extension, or ends with the format's own file name, such as Makefile
        #[arg(long, value_name = "FILE|DIR", default_value = ".")]
        to: PathBuf,
        /// Command line that starts the program on a worker; spaces separate its words [default:
        /// this program for makefile and shell, otherwise lumistack]
        #[arg(long, value_name = "WORDS")]
        program: Option<String>,
        /// Replace the folder /HERE of this machine by /THERE of the workers, in all paths. The
        /// flag may be given several times
        #[arg(long, value_name = "/HERE=/THERE")]
        map: Vec<Map>,
    },
    /// Print this program's version and fingerprint (a hash of the code that results depend on).
    /// All workers of a run need the same version and fingerprint
    Code,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Farm")]
struct EngineArgs {
    /// Address of a running Dask scheduler, such as tls://host:8786 [default: a new
    /// scheduler with workers on this machine]
    #[arg(long, value_name = "ADDRESS")]
    dask: Option<String>,
    /// Number of workers on this machine, if --dask is not given [default: 2]
    #[arg(long, value_name = "N")]
    workers: Option<usize>,
    /// Replace the folder /HERE of this machine by /THERE of the workers, in all paths. The flag
    /// may be given several times
    #[arg(long, value_name = "/HERE=/THERE")]
    map: Vec<Map>,
    /// Certificate of the authority that signed the certificates of scheduler and workers, PEM
    #[arg(long, value_name = "FILE", requires_all = ["tls_cert", "tls_key"])]
    tls_ca: Option<PathBuf>,
    /// Client certificate, PEM
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_cert: Option<PathBuf>,
    /// Key of the client certificate, PEM
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    tls_key: Option<PathBuf>,
    /// Connect to a scheduler on another machine without TLS. Then every user who can reach the
    /// scheduler can run programs on its workers
    #[arg(long)]
    insecure: bool,
    /// Object store through which workers without a shared folder exchange files, such as
    /// s3://bucket/shots
    #[arg(long, value_name = "URL")]
    store: Option<String>,
    /// Folder of this machine whose files are also copied to the store, such as the scene's folder;
    /// the flag may be given several times
    #[arg(long, value_name = "DIR", requires = "store")]
    send: Vec<PathBuf>,
}

#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Units of work")]
struct CutArgs {
    /// Expected time of a block of views, seconds. Each block is a unit of work [default: 20]
    #[arg(long, value_name = "SECONDS")]
    block_seconds: Option<f64>,
    /// Number of blocks into which the views of every light field are divided, instead of
    /// --block-seconds
    #[arg(long, value_name = "N", conflicts_with = "block_seconds")]
    blocks: Option<NonZeroUsize>,
}

impl CutArgs {
    fn cut(&self) -> Result<BlockSize, PipelineError> {
        let default = BlockSize::default();
        let block_seconds = self.block_seconds.unwrap_or(default.block_seconds);
        if !(block_seconds > 0.0 && block_seconds.is_finite()) {
            let found = block_seconds.to_string();
            return Err(PipelineError::option("--block-seconds", "SECONDS", "a time above 0", found));
        }
        Ok(BlockSize { block_seconds, blocks: self.blocks.map(NonZeroUsize::get) })
    }
}

/// A path mapping: a folder, and the folder that replaces it in all paths.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Map([PathBuf; 2]);

impl FromStr for Map {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let pair = text.split_once('=').map(|(from, to)| [PathBuf::from(from), PathBuf::from(to)]);
        let absolute = pair.filter(|pair| pair.iter().all(|path| path.has_root()));
        absolute.map(Self).ok_or_else(|| format!("expected two absolute folders such as /here=/there, found `{text}`"))
    }
}

impl Map {
    fn word(&self) -> String {
        let [from, to] = &self.0;
        format!("{}={}", from.display(), to.display())
    }

    fn of(&self, path: &str) -> Option<String> {
        let [from, to] = &self.0;
        Path::new(path).strip_prefix(from).ok().map(|rest| to.join(rest).to_string_lossy().into_owned())
    }
}

/// A format, named on the command line.
#[derive(Clone, Copy, Debug)]
struct FormatArg(Format);

impl clap::ValueEnum for FormatArg {
    fn value_variants<'a>() -> &'a [Self] {
        const ALL: [FormatArg; Format::ALL.len()] = {
            let mut all = [FormatArg(Format::Makefile); Format::ALL.len()];
            let mut i = 0;
            while i < all.len() {
                all[i] = FormatArg(Format::ALL[i]);
                i += 1;
            }
            all
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()))
    }
}

pub(crate) fn run(
    args: &Farm,
    threads: Option<usize>,
    registry: &Registry,
    json: bool,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    match (&args.what, &args.input) {
        (Some(What::Plan { input, job, cut, workers }), _) => {
            let (plan, dir) = planned(input, job, cut, registry, task)?;
            print(&plan, &dir, workers, json);
            Ok(())
        }
        (Some(What::Show { dir, workers }), _) => {
            print(&FarmPlan::load(dir)?, dir, workers, json);
            Ok(())
        }
        (Some(What::Unit { dir, id, map, patience, attached }), _) => {
            if *attached {
                end_with_input();
            }
            unit(dir, id, map, *patience, registry, json, task)
        }
        (Some(What::Export { format, input, job, cut, to, program, map }), _) => {
            let (plan, dir) = planned(input, job, cut, registry, task)?;
            export(format.0, &plan, &dir, to, program.as_deref(), map, json)
        }
        (Some(What::Code), _) => {
            let version = env!("CARGO_PKG_VERSION");
            match json {
                true => say!("{}", json!({ "event": "code", "version": version, "code": code() })),
                false => say!("{version} {}", code()),
            }
            Ok(())
        }
        (None, Some(input)) => {
            // Find Python before planning, which may take a minute, so that a missing Python is
            // reported early.
            let python = python()?;
            let (_, dir) = planned(input, &args.job, &args.cut, registry, task)?;
            engine(&args.engine, &python, &dir, threads, json, task)
        }
        (None, None) => Err(PipelineError::value("command line", "JOB", "a job file, a scene or a subcommand", "none")),
    }
}

/// Plans a job, and writes the plan into its folder.
fn planned(
    input: &Path,
    args: &JobArgs,
    cut: &CutArgs,
    registry: &Registry,
    task: Task<'_>,
) -> Result<(FarmPlan, PathBuf), PipelineError> {
    let cut = cut.cut()?;
    let (job, dir): (Job, PathBuf) = job_of(input, args)?;
    let plan = farm_plan(&job, &dir, registry, cut, task).map_err(|error| in_place(error, input))?;
    Ok((plan, dir))
}

/// Returns the beginning of a command line that starts this program again.
fn own_words() -> Vec<String> {
    let program = std::env::current_exe().map_or("lumistack".into(), |path| path.to_string_lossy().into_owned());
    let stem = Path::new(&program).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    // In a Python interpreter the program is Python, so the command line must also name the module.
    if !stem.starts_with("python") {
        return vec![program];
    }
    // In a virtual environment `python` is a link to a Python outside of it. Only the link finds
    // the environment's packages, so the link is started.
    #[cfg(feature = "dynamic")]
    let program = lumistack_pipeline::Launcher::of_process()
        .map_or(program, |launcher| launcher.program.to_string_lossy().into_owned());
    vec![program, "-m".into(), "lumistack".into()]
}

fn print(plan: &FarmPlan, dir: &Path, workers: &[usize], json: bool) {
    let graph = plan.graph(dir, Vec::new());
    let to_end = paths(&graph, OVERHEAD_SECONDS);
    let predictions: Vec<Prediction> = workers.iter().map(|&count| predict(&graph, count, OVERHEAD_SECONDS)).collect();
    let done: Vec<bool> = graph.units.iter().map(|unit| plan.done(dir, &unit.id).is_some()).collect();
    if json {
        let units = graph.units.iter().zip(&to_end).zip(&done).map(|((unit, to_end), done)| {
            let mut value = serde_json::to_value(unit).expect("units serialize");
            (value["to_end_seconds"], value["done"]) = ((*to_end).into(), (*done).into());
            value
        });
        let units: Vec<Value> = units.collect();
        say!(
            "{}",
            json!({
                "event": "farm_plan",
                "id": plan.id,
                "name": plan.name,
                "folder": graph.folder,
                "version": plan.version,
                "code": plan.code,
                "units": units,
                "predictions": predictions,
            })
        );
        return;
    }
    // Print a table for the user, and the prediction after it.
    let width = graph.units.iter().map(|unit| unit.id.chars().count()).max().unwrap_or(0).max(4);
    say!("{:width$}  {:8}  {:4}  {:>8}  {:>8}  inputs", "unit", "kind", "done", "time", "memory");
    for (unit, done) in graph.units.iter().zip(&done) {
        let done = if *done { "yes" } else { "no" };
        let (time, memory) = (duration_text(unit.seconds), size_text(unit.memory_bytes));
        let inputs = match unit.inputs.as_slice() {
            [a, .., b] if unit.inputs.len() > 4 => format!("{a} ... {b} ({} units)", unit.inputs.len()),
            inputs => inputs.join(", "),
        };
        say!("{:width$}  {:8}  {done:4}  {time:>8}  {memory:>8}  {inputs}", unit.id, unit.kind.name());
    }
    let text = |p: &Prediction| format!("{} on {}", duration_text(p.makespan_seconds), p.workers);
    let count = graph.units.len();
    let folder = dir.display();
    let predicted = predictions.iter().map(text).collect::<Vec<_>>().join(", ");
    say!("number of units in {folder}: {count}; predicted total time by number of workers: {predicted}");
}

/// Ends the process when standard input ends, since the worker that started this process is then
/// gone. The process may end at any time, since files appear only when they are complete.
fn end_with_input() {
    std::thread::spawn(|| {
        let mut rest = [0; 64];
        while matches!(std::io::stdin().read(&mut rest), Ok(1..)) {}
        std::process::exit(130);
    });
}

fn unit(
    dir: &Path,
    id: &str,
    maps: &[Map],
    patience: u64,
    registry: &Registry,
    json: bool,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    // Execute the unit, with the paths of this machine.
    let maps: Vec<(PathBuf, PathBuf)> = maps.iter().map(|Map([from, to])| (from.clone(), to.clone())).collect();
    let done = farm_unit(dir, id, &maps, Duration::from_secs(patience), registry, task);
    if json {
        let event = match &done {
            Ok(done) => json!({
                "event": "unit", "id": id, "outcome": "done", "seconds": done.seconds, "cached": done.cached,
            }),
            Err(error) => {
                let outcome = match error {
                    error if error.is_machine_specific() => "refused",
                    error if error.is_storage_failure() => "store",
                    PipelineError::Cancelled => "cancelled",
                    _ => "failed",
                };
                json!({ "event": "unit", "id": id, "outcome": outcome, "message": error.to_string() })
            }
        };
        say!("{event}");
    } else if let Ok(done) = &done {
        let before = if done.cached { "; the unit was already done" } else { "" };
        say!("{id}: {}{before}", duration_text(done.seconds));
    }
    done.map(|_| ())
}

fn export(
    format: Format,
    plan: &FarmPlan,
    dir: &Path,
    to: &Path,
    program: Option<&str>,
    maps: &[Map],
    json: bool,
) -> Result<(), PipelineError> {
    // Make the command line that executes a unit on a worker.
    let is_local = matches!(format, Format::Makefile | Format::Shell);
    let mut command = match program {
        Some(words) => words.split_whitespace().map(str::to_owned).collect(),
        None if is_local => own_words(),
        None => vec!["lumistack".into()],
    };
    command.extend(["farm", "unit"].map(String::from));
    command.extend(maps.iter().flat_map(|map| ["--map".to_owned(), map.word()]));
    let graph = plan.graph(dir, command);
    let folder = maps.iter().find_map(|map| map.of(&graph.folder)).unwrap_or_else(|| graph.folder.clone());
    let files = format.export(&Graph { folder, ..graph });
    // If the export has a single file, decide whether `to` names this file or its folder.
    let single = match files.as_slice() {
        [file] => to.file_name().is_some_and(|name| name == file.name.as_str()) || to.extension().is_some(),
        _ => false,
    };
    let folder = if single { to.parent().unwrap_or(Path::new("")) } else { to };
    lumistack_field_io::atomic::create_folder(folder).map_err(PipelineError::command)?;
    for file in &files {
        let path = if single { to.to_owned() } else { folder.join(&file.name) };
        lumistack_field_io::atomic::write_bytes(&path, file.text.as_bytes()).map_err(PipelineError::command)?;
        #[cfg(unix)]
        if file.executable {
            use std::os::unix::fs::PermissionsExt;
            let all = std::fs::Permissions::from_mode(0o755);
            std::fs::set_permissions(&path, all).map_err(PipelineError::write(&path))?;
        }
        if !json {
            say!("{}", path.display());
        }
    }
    if json {
        let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
        say!(
            "{}",
            json!({ "event": "done", "format": format.name(), "folder": folder.to_string_lossy(), "files": names })
        );
    }
    Ok(())
}

/// Starts the Python module that runs the planned units through Dask.
fn engine(
    args: &EngineArgs,
    python: &Path,
    dir: &Path,
    threads: Option<usize>,
    json: bool,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let mut command = Command::new(python);
    command.args(["-m", "lumistack.farm"]).arg(dir);
    let program = serde_json::to_string(&own_words()).expect("words serialize");
    command.args(["--program", &program]);
    let mut add = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            command.args([name, &value]);
        }
    };
    let text = |path: &Option<PathBuf>| path.as_ref().map(|path| path.to_string_lossy().into_owned());
    add("--dask", args.dask.clone());
    add("--workers", args.workers.map(|count| count.to_string()));
    add("--threads", threads.map(|count| count.to_string()));
    add("--tls-ca", text(&args.tls_ca));
    add("--tls-cert", text(&args.tls_cert));
    add("--tls-key", text(&args.tls_key));
    add("--store", args.store.clone());
    args.send.iter().for_each(|folder| add("--send", Some(folder.to_string_lossy().into_owned())));
    args.map.iter().for_each(|map| add("--map", Some(map.word())));
    if args.insecure {
        command.arg("--insecure");
    }
    if json {
        command.arg("--json");
    }
    // Ctrl-C also reaches the Python module, which then ends cleanly. So this process only waits.
    let status = command.status().map_err(PipelineError::command)?;
    task.cancel.check()?;
    match status.success() {
        true => Ok(()),
        false => {
            Err(PipelineError::value("farm", "run", "all units finished", "unfinished units, which are listed above"))
        }
    }
}

/// Finds a Python that has this package and Dask.
fn python() -> Result<PathBuf, PipelineError> {
    let own = own_words();
    let own = (own.len() > 1).then(|| (PathBuf::from(&own[0]), "this Python"));
    let all = own.into_iter().chain(lumistack_usd::pythons());
    let mut tried = Vec::new();
    for (program, from) in all {
        let mut look = Command::new(&program);
        look.args(["-c", "import lumistack.farm, distributed"]).stdin(Stdio::null());
        match look.output() {
            Ok(found) if found.status.success() => return Ok(program),
            Ok(found) => {
                let said = String::from_utf8_lossy(&found.stderr);
                let last = said.trim().lines().last().unwrap_or("the import failed without a message").to_owned();
                tried.push(format!("{} ({from}): {last}", program.display()));
            }
            Err(error) => tried.push(format!("{} ({from}): {error}", program.display())),
        }
    }
    let expected =
        "a Python with the packages `lumistack` and `distributed` (install them with `pip install 'lumistack[farm]'`)";
    Err(PipelineError::value(
        "farm",
        "Python",
        expected,
        format!("only Pythons that cannot import both packages: {}", tried.join("; ")),
    ))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Args, Command};

    #[test]
    fn a_job_alone_is_run_and_words_are_commands() {
        let farm = |words: &[&str]| match Args::parse_from(["lumistack", "farm"].iter().chain(words)).command {
            Command::Farm(farm) => farm,
            other => panic!("{other:?}"),
        };
        let run = farm(&["a.toml", "-o", "runs/a", "--times", "3", "--blocks", "2", "--dask", "tls://a:1"]);
        assert_eq!(
            (run.input.as_deref(), run.job.output.as_deref()),
            (Some(Path::new("a.toml")), Some(Path::new("runs/a")))
        );
        assert_eq!((run.cut.blocks.map(NonZeroUsize::get), run.engine.dask.as_deref()), (Some(2), Some("tls://a:1")));
        assert!(run.what.is_none() && farm(&["a.toml"]).input.is_some());
        assert!(matches!(farm(&["plan", "a.toml"]).what, Some(What::Plan { .. })));
        assert!(matches!(farm(&["export", "openjd", "a.toml"]).what, Some(What::Export { .. })));
    }

    #[test]
    fn maps_are_two_absolute_folders() {
        let map: Map = "/mnt/a=/srv/b".parse().unwrap();
        assert_eq!(map.of("/mnt/a/shot/one").map(PathBuf::from), Some("/srv/b/shot/one".into()));
        assert_eq!(map.of("/mnt/ab"), None);
        assert_eq!(map.word(), "/mnt/a=/srv/b");
        for text in ["/a", "a=/b", "/a=b", ""] {
            assert!(text.parse::<Map>().unwrap_err().contains("/here=/there"), "{text}");
        }
    }
}
