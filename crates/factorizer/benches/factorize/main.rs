//! Times the factorizer on the paper's main case: 840×525 pixels, 5×5 views, RGB, 3 layers, 6
//! frames, β = 0.2, nearest sampling.
//!
//! ```text
//! cargo bench -p lumistack-factorizer --bench factorize --
//!     [--quick] [--rounds N] [--json FILE] [--folder DIR] [--peer PYTHON SCRIPT]...
//! ```
//!
//! Every round times all cases. So other programs slow all cases alike, and ratios of medians stay
//! valid. A peer computes the same multiplicative update with another library, from the same data.
//! Its update is timed next to Lumistack's update. Its masks must agree with Lumistack's except for
//! rounding.
//!
//! `cargo xtask bench factorize` passes NumPy and PyTorch as peers. Files for peers go into
//! `--folder` (default: the system's folder of temporary files). `--quick` uses a quarter of the
//! resolution per axis.

mod cases;
mod machine;
mod peers;
mod scene;
mod table;

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use lumistack_core::{Cancel, Collector, Task};
use lumistack_factorizer::{FactorizeError, Problem, Run, Settings, factorize, random_start, solver};

use cases::{Case, NATIVE_VIEWS, PAPER_VIEWS, Update};
use machine::Machine;
use peers::Peer;
use table::{PeerRow, Quality, Report, Row, Series};

/// Seed of all starts.
const SEED: u64 = 1;
/// Number of updates by the paper's rule. The PSNR after these updates is the quality that the
/// default settings must reach.
const PAPER_UPDATES: u32 = 50;
/// Largest difference in transmittance that rounding may cause between masks after one update.
const SAME_MASKS: f32 = 1e-4;
/// Smallest number of Lumistack's multiplicative updates of the main case in one round. Every other
/// run of Lumistack makes one update in a round.
const OWN_UPDATES: usize = 3;

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

struct Arguments {
    resolution: [usize; 2],
    rounds: usize,
    json: Option<PathBuf>,
    folder: PathBuf,
    /// For each peer, the paths of the Python program and of the script.
    peers: Vec<[PathBuf; 2]>,
}

fn main() -> ExitCode {
    match arguments().map_err(Into::into).and_then(|arguments| bench(&arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("factorize: {error}");
            ExitCode::FAILURE
        }
    }
}

fn arguments() -> Result<Arguments, String> {
    let folder = std::env::temp_dir();
    let mut parsed = Arguments { resolution: [840, 525], rounds: 9, json: None, folder, peers: Vec::new() };
    // cargo adds `--bench`
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word}: expected a value, found none"));
        match word.as_str() {
            "--quick" => parsed.resolution = [210, 131],
            "--rounds" => {
                parsed.rounds = value()?.parse().map_err(|_| "--rounds: expected a number, found other text")?
            }
            "--json" => parsed.json = Some(value()?.into()),
            "--folder" => parsed.folder = value()?.into(),
            "--peer" => parsed.peers.push([value()?.into(), value()?.into()]),
            _ => return Err(format!("expected --quick, --rounds, --json, --folder or --peer, found {word}")),
        }
    }
    if parsed.rounds < 3 { Err(format!("--rounds: expected at least 3, found {}", parsed.rounds)) } else { Ok(parsed) }
}

fn bench(arguments: &Arguments) -> Outcome {
    // prepare five cases: the paper's case, the paper's case with bilinear sampling, two cases with
    // few and with many views, and a lens array
    let resolution = arguments.resolution;
    println!(
        "preparing light fields in closed form; the main case has {}×{} pixels and 5×5 views",
        resolution[0], resolution[1]
    );
    let (three, between) = (cases::three_layers(resolution, PAPER_VIEWS), cases::bilinear(resolution));
    let target = scene::light_field(&three)?;
    let mut cases = vec![
        Case { name: "3 layers".into(), target: target.clone(), display: three },
        Case { name: "3 layers, bilinear".into(), target, display: between },
    ];
    // many views are compared with few views, at half the resolution
    let half = resolution.map(|n| n / 2);
    let others = [PAPER_VIEWS, NATIVE_VIEWS].map(|views| {
        let name = format!("{}×{}, {views}×{views} views", half[0], half[1]);
        (name, cases::three_layers(half, views))
    });
    for (name, display) in others.into_iter().chain([("1 layer, directional".into(), cases::directional(resolution))]) {
        cases.push(Case { name, target: scene::light_field(&display)?, display });
    }
    // start all solvers and libraries before the first timing
    let main = &cases[0];
    let mut peers = start_peers(arguments, main)?;
    let mut runs = own_runs(&cases)?;
    let mut quality = quality_to_reach(main)?;
    let mut machine = Machine::new();
    let mut report = Report::new(main, arguments.rounds);

    for round in 1..=arguments.rounds {
        println!("round {round} of {}", arguments.rounds);
        let theirs: usize = peers.iter().map(|peer| peer.rows.len()).sum();
        for TimedPeer { peer, rows } in &mut peers {
            for row in rows {
                machine.measure();
                runs[0].step()?;
                row.times.0.push(peer.update(&row.variant)?);
            }
        }
        for _ in theirs..OWN_UPDATES {
            machine.measure();
            runs[0].step()?;
        }
        // then time the other solvers, an evaluation of the objective, a start, and the default
        // settings
        for run in &mut runs[1..] {
            run.step()?;
        }
        report.objective.0.push(seconds(|| runs[0].run.objective()).1);
        let start = random_start(&main.display, SEED);
        let (prepared, time) = seconds(|| solver("multiplicative")?.start(&main.problem(), start));
        drop(prepared?);
        report.preparation.0.push(time);
        quality.repeat(main)?;
    }
    report.rows = runs.into_iter().map(|run| run.row).collect();
    report.peers = peers.into_iter().flat_map(|peer| peer.rows).collect();
    report.quality = quality;
    print!("{}", report.text(&machine));
    if let Some(path) = &arguments.json {
        std::fs::write(path, format!("{:#}\n", report.json(&machine)))?;
        println!("\nwritten: {}", path.display());
    }
    Ok(())
}

/// Runs `work`, and measures its time in seconds.
fn seconds<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let begin = Instant::now();
    let result = work();
    (result, begin.elapsed().as_secs_f64())
}

/// A run of one of Lumistack's solvers, and the times of its updates.
struct TimedRun<'a> {
    run: Box<dyn Run + 'a>,
    row: Row,
}

impl TimedRun<'_> {
    fn step(&mut self) -> Outcome {
        let (result, time) = seconds(|| self.run.step(&Cancel::default()));
        self.row.times.0.push(time);
        Ok(result?)
    }
}

/// Starts all solvers on all cases. The first run is the paper's rule on the paper's main case.
fn own_runs(cases: &[Case]) -> Outcome<Vec<TimedRun<'_>>> {
    let mut runs = Vec::new();
    for case in cases {
        for (name, update) in [
            ("multiplicative", Some(Update::Multiplicative)),
            ("block-exact", Some(Update::BlockExact)),
            ("extrapolated", None),
        ] {
            let mut run = solver(name)?.start(&case.problem(), random_start(&case.display, SEED))?;
            // the first update also allocates, so it is not timed
            run.step(&Cancel::default())?;
            // bilinear sampling needs more operations per ray than the formula counts
            let counted = update.filter(|_| case.display.sampling == Default::default());
            let needs = counted.map(|update| case.needs(update, run.rays()));
            let row = Row { what: format!("{}: {name} update", case.name), times: Series::default(), needs };
            runs.push(TimedRun { run, row });
        }
    }
    Ok(runs)
}

/// A peer, and a row of the table for each variant of its update.
struct TimedPeer {
    peer: Peer,
    rows: Vec<PeerRow>,
}

/// Starts the peers. Their data is in files, which are removed once all peers have read them.
fn start_peers(arguments: &Arguments, case: &Case) -> Outcome<Vec<TimedPeer>> {
    if arguments.peers.is_empty() {
        return Ok(Vec::new());
    }
    let folder = arguments.folder.join(format!("lumistack-bench-{}", std::process::id()));
    let started = start_peers_in(&folder, &arguments.peers, case);
    let removed = std::fs::remove_dir_all(&folder);
    let started = started?;
    removed?;
    Ok(started)
}

/// Starts the peers and compares their first update with Lumistack's. A peer that does not start is
/// reported and left out.
fn start_peers_in(folder: &Path, peers: &[[PathBuf; 2]], case: &Case) -> Outcome<Vec<TimedPeer>> {
    // write the problem, and compute Lumistack's first update
    let start = random_start(&case.display, SEED);
    peers::write_problem(folder, case, &start)?;
    let saved = folder.join("after-one-update");
    std::fs::create_dir_all(&saved)?;
    let mut run = solver("multiplicative")?.start(&case.problem(), start)?;
    run.step(&Cancel::default())?;
    let ours = run.download();
    // start each peer, and compare the first update of each variant
    let mut started = Vec::new();
    for [python, script] in peers {
        let mut peer = match Peer::start(python, script, folder) {
            Ok(peer) => peer,
            Err(error) => {
                println!("left out: {} does not run: {error}", script.display());
                continue;
            }
        };
        let mut rows = Vec::new();
        for variant in peer.variants.clone() {
            peer.save(&variant, &saved)?;
            let difference = peers::largest_difference(&saved, &ours)?;
            println!("{}, {variant}: masks after one update differ by at most {difference:.1e}", peer.name);
            if difference >= SAME_MASKS {
                return Err(format!(
                    "{}, {variant}: expected masks within {SAME_MASKS:e} of Lumistack's, found {difference:.1e}",
                    peer.name
                )
                .into());
            }
            let (name, threads) = (peer.name.clone(), peer.threads);
            rows.push(PeerRow { name, threads, variant, difference, times: Series::default() });
        }
        started.push(TimedPeer { peer, rows });
    }
    Ok(started)
}

/// Measures PSNR and time of 50 updates by the paper's rule, and of all iterations of the default
/// settings. Also finds the iteration at which the default settings reach the first PSNR.
fn quality_to_reach(case: &Case) -> Outcome<Quality> {
    let begin = Instant::now();
    let mut run = solver("multiplicative")?.start(&case.problem(), random_start(&case.display, SEED))?;
    for _ in 0..PAPER_UPDATES {
        run.step(&Cancel::default())?;
    }
    let paper_seconds = begin.elapsed().as_secs_f64();
    let paper_psnr = run.objective().psnr_view;
    drop(run);
    let settings = Settings::default();
    let mut reached = None;
    let mut last_psnr = f64::NAN;
    let call = run_default(&case.problem(), &settings, &mut |iteration, psnr, _| {
        last_psnr = psnr;
        if psnr >= paper_psnr && reached.is_none() {
            reached = Some(iteration);
        }
    })?;
    Ok(Quality {
        paper_psnr,
        paper_seconds,
        settings: settings.resolved(),
        reached,
        long_psnr: last_psnr,
        long_seconds: call,
        ..Quality::default()
    })
}

impl Quality {
    /// Times the default settings again, with the number of iterations that reaches the quality.
    fn repeat(&mut self, case: &Case) -> Outcome {
        let Some(iterations) = self.reached else { return Ok(()) };
        let settings = Settings { iterations, ..Settings::default() };
        let mut at = f64::NAN;
        let call = run_default(&case.problem(), &settings, &mut |iteration, _, seconds| {
            if iteration == iterations {
                at = seconds;
            }
        })?;
        self.until_reached.0.push(at);
        self.whole_call.0.push(call);
        Ok(())
    }
}

/// Times a call of [`factorize`] in seconds. `see` receives every evaluation: iterations, PSNR, and
/// seconds since the call.
fn run_default(
    problem: &Problem,
    settings: &Settings,
    see: &mut dyn FnMut(u32, f64, f64),
) -> Result<f64, FactorizeError> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let begin = Instant::now();
    factorize(problem, settings, None, Task::quiet(&warnings, &cancel), &mut |at| {
        see(at.iteration, at.psnr_view, begin.elapsed().as_secs_f64());
    })?;
    Ok(begin.elapsed().as_secs_f64())
}
