//! `cargo xtask bench design`: compares predicted with solved quality, and tests that a sweep
//! continues after it was killed.
//!
//! First part: a solver factorizes still-life (80 × 50 pixels, 3 × 3 views) for 40 random designs,
//! and [`predicted_db`] predicts the PSNR. Designs are uniform or directional, with 1 to 5 layers
//! and 1 to 8 frames. Their β is 0.1 to 1, their gaps are 15 to 70 mm, and a row has 10 to 80
//! lenslets.
//!
//! Second part: a process sweeps 100 small designs. The process is killed (SIGKILL) and started
//! again several times. In the end its table must have the same bytes as the table of a sweep
//! without interruption.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use lumistack_core::seed::{Stream, derive};
use lumistack_core::{Cancel, Collector, Task};
use lumistack_design::predict::{features, predicted_db, rank_correlation};
use lumistack_display::{Backlight, Display, LightField, Variation, Weights};
use lumistack_factorizer::Problem;
use lumistack_pipeline::{
    FactorizeJob, Job, PipelineError, factorize_field, load_scene, plugins, presets, render_field, sweep,
};
use rayon::prelude::*;

/// Minimum rank correlation of predicted and solved quality.
const LEAST_CORRELATION: f64 = 0.8;
const DESIGNS: usize = 40;

fn main() -> ExitCode {
    // cargo adds `--bench`
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let result = match words.as_slice() {
        // The function `killing` starts this program as a child process with these arguments, and
        // kills the process.
        ["child", job, folder] => child(Path::new(job), Path::new(folder)),
        // Print the data to which the constants of the prediction can be fitted.
        ["features", seed] => print_features(seed.parse().unwrap_or(1000)),
        _ => prediction().and_then(|()| killing()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bench: {error}");
            ExitCode::FAILURE
        }
    }
}

type Outcome = Result<(), Box<dyn std::error::Error>>;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn target_folder() -> PathBuf {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    target.join("bench-design")
}

fn quietly<T>(work: impl FnOnce(Task<'_>) -> Result<T, PipelineError>) -> Result<T, PipelineError> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    work(Task::quiet(&warnings, &cancel))
}

/// Renders the light field of the sweep for the paper's Figure 7, with 80 × 50 pixels per view.
fn light_field() -> Result<LightField, PipelineError> {
    let mut job = Job::load(&root().join("scenes/sweeps/figure-7.toml"))?;
    job.display.resolution = Some([80, 50]);
    let display = job.resolve_display()?;
    job.sweep = None;
    let registry = plugins(&[])?;
    quietly(|task| {
        let scene = job.scene.clone().unwrap_or_default();
        let ingested = load_scene(&scene, &job.pose, &job.importer, &registry, &job.light, None, task)?;
        Ok(render_field(&job, &display, &ingested, &target_folder().join("views"), task)?.field)
    })
}

fn random_display(seed: u64, number: u64, field: &LightField) -> Result<Display, PipelineError> {
    let mut stream = Stream::new(derive(seed, &[number]));
    let mut between = |low: f64, high: f64| low + (high - low) * f64::from(stream.next_f32());
    let directional = between(0.0, 1.0) < 0.5;
    let wrong =
        |error: &dyn std::fmt::Display| PipelineError::value("bench", "design", "a valid design", error.to_string());
    let base = presets::load(if directional { "fig7-directional" } else { "fig7-uniform" })?;
    let base = base.adapted_to(field.geometry()).map_err(|error| wrong(&error))?;
    let cols = between(10.0, 80.99).floor();
    let change = Variation {
        layers: Some(between(1.0, 5.999) as usize),
        frames: Some(between(1.0, 8.999) as usize),
        brightness: Some(0.1f64.powf(between(0.0, 1.0))),
        gap_mm: Some(between(15.0, 70.0)),
        lenslets: directional.then_some([cols as usize, (cols * 50.0 / 80.0).round() as usize]),
        fov_deg: None,
    };
    change.applied_to(&base).map_err(|error| wrong(&error))
}

/// Returns random designs, each with the PSNR in dB that a solver reaches.
fn solved(seed: u64, count: usize) -> Result<Vec<(Display, f64)>, PipelineError> {
    let field = light_field()?;
    let solve = |number: u64| {
        let display = random_display(seed, number, &field)?;
        let problem = Problem { display: &display, target: &field, weights: &Weights::Uniform };
        let psnr = quietly(|task| {
            let found = factorize_field(&problem, &FactorizeJob::default(), 1, None, task, &mut |_| {})?;
            Ok(found.history.last().map_or(f64::NAN, |last| last.psnr_view))
        })?;
        Ok((display, psnr))
    };
    (0..count as u64).into_par_iter().map(solve).collect()
}

fn print_features(seed: u64) -> Outcome {
    for (display, psnr) in solved(seed, 80)? {
        let [freedom, dark, detail] = features(&display);
        println!("{freedom},{dark},{detail},{psnr}");
    }
    Ok(())
}

fn prediction() -> Outcome {
    let designs = solved(1, DESIGNS)?;
    println!("backlight    N  M     β    Δd  lenslets  predicted   solved");
    for (display, psnr) in &designs {
        let lenslets = match &display.backlight {
            Backlight::Lenslets(backlight) => backlight.lenslets[0].to_string(),
            Backlight::Uniform => "-".into(),
        };
        let gap = display.layers.windows(2).next().map_or(0.0, |pair| pair[1].d_mm - pair[0].d_mm);
        let kind = if lenslets == "-" { "uniform" } else { "directional" };
        println!(
            "{kind:11} {:2} {:2} {:5.2} {gap:5.1} {lenslets:>9} {:10.1} {psnr:8.1}",
            display.layers.len(),
            display.frames,
            display.brightness,
            predicted_db(display)
        );
    }
    let (predicted, found): (Vec<f64>, Vec<f64>) =
        designs.iter().map(|(display, psnr)| (predicted_db(display), *psnr)).unzip();
    let correlation = rank_correlation(&predicted, &found);
    println!(
        "predicted against solved quality, {DESIGNS} random designs: Spearman's rank correlation {correlation:.3}"
    );
    if correlation < LEAST_CORRELATION {
        return Err(format!("expected a rank correlation of at least {LEAST_CORRELATION}; see above").into());
    }
    Ok(())
}

const SMALL: &str = "\
[source]\nplugin = \"test_views\"\nparams = { pattern = \"cards\", depth_mm = 120.0 }\n
[display]\npreset = \"fig7-uniform\"\nresolution = [64, 40]\n
[factorize]\niterations = 30\n
[sweep]\nlayers = [1, 2, 3, 4, 5]\nframes = [1, 2, 3, 4, 5]\nbrightness = [0.1, 0.2, 0.5, 1.0]\ngap_mm = [120.0]\n";

fn child(job: &Path, folder: &Path) -> Outcome {
    let (job, registry) = (Job::load(job)?, plugins(&[])?);
    let summary = quietly(|task| sweep(&job, folder, &registry, task))?;
    println!("{} designs, {} of them solved before", summary.designs, summary.kept);
    Ok(())
}

/// Kills the sweep after 1, 15, 30, ... designs, and starts it again each time. In the end its
/// table must equal the table of an uninterrupted sweep.
fn killing() -> Outcome {
    let folder = target_folder().join("kill");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder)?;
    let job = folder.join("small.toml");
    std::fs::write(&job, SMALL)?;
    let (whole, killed) = (folder.join("whole"), folder.join("killed"));
    let program = std::env::current_exe()?;
    let start = |out: &Path| {
        let mut command = Command::new(&program);
        command.arg("child").arg(&job).arg(out).stdout(Stdio::null());
        command.spawn()
    };
    // Sweep once without interruption, as the reference.
    if !start(&whole)?.wait()?.success() {
        return Err("the uninterrupted sweep ended with an error; expected it to finish".into());
    }
    // Kill the process as soon as the folder has the wanted number of designs.
    let done = || {
        let entries = std::fs::read_dir(killed.join("designs"));
        entries.map_or(0, |entries| {
            entries.flatten().filter(|e| e.path().extension().is_some_and(|e| e == "json")).count()
        })
    };
    let mut kills = 0;
    for wanted in [1, 15, 30, 45, 60, 75, 90] {
        let mut child = start(&killed)?;
        let since = Instant::now();
        while done() < wanted && child.try_wait()?.is_none() && since.elapsed() < Duration::from_secs(300) {
            std::thread::sleep(Duration::from_millis(1));
        }
        if child.try_wait()?.is_none() {
            child.kill()?;
            kills += 1;
        }
        child.wait()?;
    }
    // The last process finishes the sweep.
    if !start(&killed)?.wait()?.success() {
        return Err("the restarted sweep ended with an error; expected it to continue from its finished designs".into());
    }
    for name in ["sweep.csv", "sweep.json"] {
        if std::fs::read(whole.join(name))? != std::fs::read(killed.join(name))? {
            return Err(format!(
                "{name}: expected the bytes of the uninterrupted sweep, found other bytes after {kills} kills"
            )
            .into());
        }
    }
    println!("100 designs, killed {kills} times: the table has the same bytes as without kills");
    Ok(())
}
