//! `cargo xtask bench zone`: zone scores of displays that choose their views, compared with
//! displays with the 5 × 5 views of the paper's prototypes.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Instant;

use serde_json::Value;

use crate::bench_render::asset;
use crate::tools::{Outcome, absolute, cargo, command, root, text};

/// Samples per pixel, summed over all views, of the displays that are compared with 5 × 5 views.
/// After rounding, each of 13 × 13 views has two samples, and each of 15 × 15 views has one.
const OWN_SAMPLES: u32 = 300;
/// Samples per pixel, summed over all views, in all other runs.
const SAMPLES: u32 = 400;
/// Views, samples, filter and iterations of the displays with 5 × 5 views. They were the defaults
/// of jobs before displays could choose their views.
const FIXED: &str = "views = [5, 5]\n[render]\nsamples = 16\ndenoise = \"guided\"\n[factorize]\niterations = 50\n";
/// Files of other projects, in LUMISTACK_ASSETS.
const ASSETS: [&str; 2] = ["gltf/FlightHelmet/FlightHelmet.gltf", "gltf/2CylinderEngine/2CylinderEngine.glb"];

/// A scene on a display.
#[derive(Clone, Debug)]
struct Case {
    name: String,
    scene: String,
    preset: &'static str,
    resolution: [usize; 2],
    frames: usize,
    /// Further lines for the table `[display]` of the job.
    display: &'static str,
}

impl Case {
    fn new(name: &str, scene: &str) -> Self {
        let preset = if name == "letters" { "paper-directional" } else { "paper-three-layer" };
        let frames = if name == "letters" { 8 } else { 6 };
        Self { name: name.into(), scene: scene.into(), preset, resolution: [420, 262], frames, display: "" }
    }

    /// Makes a case from a scene of this repository.
    fn own(name: &str) -> Self {
        Self::new(name, &text(&root().join("scenes").join(name).join(format!("{name}.gltf"))))
    }

    /// Returns the case with 840 × 525 pixels, the size of the light fields of the paper's
    /// prototypes.
    fn large(self) -> Self {
        Self { name: format!("{}, 840 × 525", self.name), resolution: [840, 525], ..self }
    }

    /// Returns the text of the job. It ends with `rest`, which contains further keys of `[display]`
    /// and then other tables.
    fn job(&self, rest: &str) -> String {
        format!(
            "scene = {:?}\n[window]\nfit_depth = \"compress\"\n[display]\npreset = {:?}\nresolution = {:?}\nframes = {}\n{}\n{rest}",
            self.scene, self.preset, self.resolution, self.frames, self.display
        )
    }
}

/// The result of a run.
#[derive(Clone, Debug)]
struct Run {
    report: Value,
    /// The content of the target's `lightfield.json`.
    target: Value,
    wall: f64,
    cpu: f64,
}

impl Run {
    fn number(&self, key: &str) -> f64 {
        self.report[key].as_f64().unwrap_or(f64::NAN)
    }

    /// Formats zone score, score of the worst tenth of the directions, SSIM and FLIP, as cells of a
    /// table.
    fn quality(&self) -> String {
        let [ssim, flip] = ["ssim", "flip"].map(|key| self.report["zone"][key].as_f64().unwrap_or(f64::NAN));
        let [zone, worst] = ["psnr_zone", "psnr_zone_worst_tenth"].map(|key| self.number(key));
        format!("{zone:.2} | {worst:.2} | {ssim:.3} | {flip:.3}")
    }

    /// Formats the number of the solved views as columns × rows.
    fn views(&self) -> String {
        let count = |key| self.target[key].as_array().map_or(0, Vec::len);
        format!("{} × {}", count("slope_x"), count("slope_y"))
    }

    /// Returns the time of a stage, seconds; 0 if its result was cached.
    fn stage(&self, name: &str) -> f64 {
        let stages = self.report["stages"].as_array().into_iter().flatten();
        let of = stages.filter(|stage| stage["name"] == name && stage["cached"] == false);
        of.filter_map(|stage| stage["seconds"].as_f64()).fold(0.0, |sum, seconds| sum + seconds)
    }
}

/// Runs the cases that the options select; `None` if the options are wrong.
pub fn run(options: &[&str]) -> Option<Outcome> {
    let (mut rounds, mut kinds, mut scenes) = (1, Vec::new(), Vec::new());
    let mut words = options.iter();
    while let Some(&word) = words.next() {
        match word {
            "--rounds" => rounds = words.next()?.parse().ok().filter(|rounds| *rounds > 0)?,
            "--large" | "--views" | "--iterations" => kinds.push(word),
            word if word.starts_with("--") => return None,
            scene => scenes.push(absolute(scene)),
        }
    }
    let mut cases: Vec<Case> = ["still-life", "glass", "letters"].map(Case::own).into();
    let stem =
        |path: &str| PathBuf::from(path).file_stem().map_or_else(|| path.into(), |s| s.to_string_lossy().into_owned());
    if scenes.is_empty() {
        scenes.extend(ASSETS.into_iter().filter_map(asset));
    } else {
        cases.clear();
    }
    cases.extend(scenes.iter().map(|scene| Case::new(&stem(scene), scene)));
    Some(measure(&cases, &kinds, rounds))
}

fn measure(cases: &[Case], kinds: &[&str], rounds: usize) -> Outcome {
    cargo(&["build", "--release", "--quiet", "--package", "lumistack-cli"])?;
    if kinds.is_empty() {
        beside_fixed(cases, rounds)?;
    }
    for kind in kinds {
        let first = cases[0].clone();
        match *kind {
            "--large" => {
                let wide =
                    Case {
                        name: format!("{}, 50° × 20°", first.name), display: "fov_deg = [50, 20]", ..first.clone()
                    };
                let directional = Case { preset: "paper-directional", frames: 8, ..first.clone() };
                let directional = Case { name: format!("{}, directional", first.name), ..directional.large() };
                let mut all = vec![wide, directional];
                all.extend(cases.iter().filter(|case| case.preset == "paper-three-layer").cloned().map(Case::large));
                beside_fixed(&all, rounds)?;
            }
            "--views" => by_views(&first)?,
            _ => by_iterations(&first)?,
        }
    }
    Ok(())
}

/// Compares displays that choose their views with displays of 5 × 5 views. The runs of both kinds
/// alternate.
fn beside_fixed(cases: &[Case], rounds: usize) -> Outcome {
    println!("\n| scene | views | psnr_zone | worst tenth | SSIM | FLIP | wall s | CPU s | render s | factorize s |");
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let own = format!("[render]\nzone_samples = {OWN_SAMPLES}\n");
    for case in cases {
        let mut runs = [Vec::new(), Vec::new()];
        for _ in 0..rounds {
            for (runs, rest) in runs.iter_mut().zip([FIXED, &own]) {
                runs.push(once(&case.job(rest), true)?);
            }
        }
        for runs in &runs {
            let median = |value: &dyn Fn(&Run) -> f64| {
                let mut all: Vec<f64> = runs.iter().map(value).collect();
                all.sort_by(f64::total_cmp);
                all[all.len() / 2]
            };
            let (wall, cpu) = (median(&|run| run.wall), median(&|run| run.cpu));
            let (render, solve) = (median(&|run| run.stage("render")), median(&|run| run.stage("factorize")));
            let (views, quality) = (runs[0].views(), runs[0].quality());
            println!("| {} | {views} | {quality} | {wall:.0} | {cpu:.0} | {render:.1} | {solve:.1} |", case.name);
        }
    }
    Ok(())
}

/// Measures the zone score for several numbers of views, with the same number of samples summed
/// over all views.
fn by_views(case: &Case) -> Outcome {
    println!("\n{}: {SAMPLES} samples per pixel, divided among the views and rounded (at least one)", case.name);
    println!("| views | psnr_zone | worst tenth | SSIM | FLIP | wall s | factorize s |\n|---|---|---|---|---|---|---|");
    let fixed = [3, 5, 7, 9, 11, 15, 19].map(|count| format!("views = [{count}, {count}]\n"));
    for views in fixed.into_iter().chain(["views = \"auto\"\n".to_owned()]) {
        let rest =
            format!("{views}[render]\nzone_samples = {SAMPLES}\ndenoise = \"shared\"\n[factorize]\niterations = 16\n");
        let run = once(&case.job(&rest), true)?;
        let chosen = if views.contains("auto") { " (the display's own)" } else { "" };
        let (quality, solve) = (run.quality(), run.stage("factorize"));
        println!("| {}{chosen} | {quality} | {:.0} | {solve:.1} |", run.views(), run.wall);
    }
    Ok(())
}

/// Measures the zone score and the solver's time for several numbers of iterations.
fn by_iterations(case: &Case) -> Outcome {
    println!("\n{}: the solver's time", case.name);
    println!("| iterations | psnr_zone | worst tenth | SSIM | FLIP | factorize s |\n|---|---|---|---|---|---|");
    for (i, iterations) in [1, 2, 4, 8, 16, 32, 64].into_iter().enumerate() {
        let rest = format!("[render]\nzone_samples = {SAMPLES}\n[factorize]\niterations = {iterations}\n");
        // later runs reuse the views of the first run
        let run = once(&case.job(&rest), i == 0)?;
        println!("| {iterations} | {} | {:.1} |", run.quality(), run.stage("factorize"));
    }
    Ok(())
}

/// Runs a job; `fresh` empties the run folder first.
fn once(job: &str, fresh: bool) -> Outcome<Run> {
    let folder = root().join("target/bench-zone");
    let out = folder.join("run");
    if fresh {
        let _ = std::fs::remove_dir_all(&out);
    }
    let written = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(folder.join("job.toml"), job));
    written.map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut program: Command = command(root().join("target/release/lumistack"));
    program.arg("run").arg(folder.join("job.toml")).arg("--output").arg(&out).stdout(Stdio::null());
    let (begun, cpu) = (Instant::now(), cpu_of_children());
    let output = program.output().map_err(|error| format!("lumistack did not start: {error}"))?;
    let (wall, cpu) = (begun.elapsed().as_secs_f64(), cpu_of_children() - cpu);
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(format!("`lumistack run` of\n{job}\nended with {}: {said}", output.status));
    }
    let read = |name: &str| -> Outcome<Value> {
        let text = std::fs::read_to_string(out.join(name)).map_err(|error| format!("{name}: {error}"))?;
        serde_json::from_str(&text).map_err(|error| format!("{name}: {error}"))
    };
    Ok(Run { report: read("report.json")?, target: read("target/lightfield.json")?, wall, cpu })
}

/// Returns the processor seconds of all child processes that have ended; NaN except on Linux.
fn cpu_of_children() -> f64 {
    /// Clock ticks per second, which Linux fixes for programs.
    const PER_SECOND: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The program's name is in parentheses, and may contain any character. cutime and cstime are
    // the words with the indices 13 and 14 after the name.
    let behind = stat.rsplit(')').next().unwrap_or_default();
    let ticks = |word: usize| behind.split_whitespace().nth(word).and_then(|text| text.parse::<f64>().ok());
    ticks(13).zip(ticks(14)).map_or(f64::NAN, |(user, system)| (user + system) / PER_SECOND)
}
