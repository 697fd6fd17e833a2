//! Prints the PSNR of every combination of solver, start and number of coarser levels, after
//! several numbers of iterations. The function `fixed` lists reference values.
//!
//! ```text
//! cargo bench -p lumistack-factorizer --bench convergence --
//!     [--quick] [--json FILE]
//! ```
//!
//! The light field `main_5x5_160x100_fov20` comes from the folder in `LUMISTACK_LIGHTFIELDS`. The
//! default is the folder `shared/lightfields` next to the workspace. A second light field is
//! computed in closed form, so every machine has at least one. `--quick` stops after 50 iterations.

#[path = "factorize/scene.rs"]
mod scene;

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{Backlight, Display, LayerStack, LensletBacklight, LightField, Weights};
use lumistack_factorizer::{Multiplicative, Problem, Settings, Solver, StartKind, factorize, solver, solvers};
use serde_json::{Value, json};

/// Numbers of iterations after which the objective is evaluated.
const ITERATIONS: [u32; 8] = [1, 3, 5, 10, 20, 50, 200, 500];
/// Number of entries of `ITERATIONS` that `--quick` keeps.
const QUICK: usize = 6;
/// Width of the display, millimetres.
const WIDTH_MM: f64 = 473.76;
const RESOLUTION: [usize; 2] = [160, 100];
const FIELD: &str = "main_5x5_160x100_fov20";

/// Results of an independent implementation on the same light field: pairs of the number of
/// iterations and the PSNR (dB, `psnr_view`).
type Figures = &'static [(u32, f64)];

/// A display, its light field, and reference values.
struct Group {
    name: String,
    display: Display,
    target: LightField,
    references: &'static [(&'static str, Figures)],
}

type Outcome<T = ()> = Result<T, Box<dyn Error>>;

fn main() -> ExitCode {
    // cargo adds `--bench`
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (quick, json) = match arguments.as_slice() {
        [] => (false, None),
        ["--quick"] => (true, None),
        ["--json", file] => (false, Some(*file)),
        ["--quick", "--json", file] | ["--json", file, "--quick"] => (true, Some(*file)),
        _ => {
            eprintln!("usage: convergence [--quick] [--json FILE]");
            return ExitCode::from(2);
        }
    };
    match bench(quick, json) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("convergence: {error}");
            ExitCode::FAILURE
        }
    }
}

fn bench(quick: bool, json: Option<&str>) -> Outcome {
    let iterations = if quick { &ITERATIONS[..QUICK] } else { &ITERATIONS };
    let mut results = Vec::new();
    // measure and print every combination of solver, start and levels
    for group in groups()? {
        print_header(&group, iterations);
        let mut rows: Vec<Row> = Vec::new();
        for settings in combinations() {
            print!("{:<44}", label(&settings));
            std::io::stdout().flush()?;
            let row = curve(&group, settings, iterations, rows.last())?;
            println!(
                "{}{:>10.1}",
                row.figures.iter().map(|psnr| format!("{psnr:>8.2}")).collect::<String>(),
                row.update_ms
            );
            rows.push(row);
        }
        // print the references under Lumistack's rows
        for (name, figures) in group.references {
            let known = iterations.iter().map(|at| figure(figures, *at));
            let cells = known.map(|psnr| psnr.map_or(format!("{:>8}", ""), |psnr| format!("{psnr:>8.1}")));
            println!("{:<44}{}", format!("reference: {name}"), cells.collect::<String>());
        }
        print_verdict(&group, &rows, iterations);
        results.push(group_json(&group, &rows));
    }
    if let Some(path) = json {
        let text = json!({
            "schema": "lumistack/bench-convergence", "version": 1, "iterations": iterations, "groups": results,
        });
        std::fs::write(path, format!("{text:#}\n"))?;
        println!("\nwritten: {path}");
    }
    Ok(())
}

/// Returns the displays with their light fields and reference values.
fn groups() -> Outcome<Vec<Group>> {
    let mut groups = Vec::new();
    let folder = std::env::var_os("LUMISTACK_LIGHTFIELDS").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/lightfields")),
        PathBuf::from,
    );
    let path = folder.join(format!("{FIELD}.npy"));
    match std::fs::read(&path) {
        Ok(bytes) => {
            for (what, display, references) in fixed() {
                let name = format!("{what}, β = {}, {FIELD}", display.brightness);
                groups.push(Group { name, target: light_field(&display, &bytes)?, display, references });
            }
        }
        Err(error) => {
            println!("left out: {}: {error}; set LUMISTACK_LIGHTFIELDS to the folder of this file", path.display())
        }
    }
    for brightness in [0.2, 1.0] {
        let display = three_layers(brightness);
        let name = format!("3 layers × 6 frames, β = {brightness}, light field in closed form");
        groups.push(Group { name, target: scene::light_field(&display)?, display, references: &[] });
    }
    Ok(groups)
}

/// Returns the displays for the light field on disk, with reference values.
fn fixed() -> [(&'static str, Display, &'static [(&'static str, Figures)]); 4] {
    const MULTIPLICATIVE: &str = "multiplicative, random";
    const CONTENT: &str = "extrapolated, content";
    const COARSE: &str = "extrapolated, 1 coarser level";
    let (stack, lenslets) = ("3 layers × 6 frames", "1 layer × 8 frames, 47×29 lenslets");
    [
        (
            stack,
            three_layers(0.2),
            &[
                (MULTIPLICATIVE, &[(5, 21.5), (10, 23.3), (20, 25.2), (50, 27.7), (200, 30.9), (500, 32.3)]),
                (CONTENT, &[(5, 29.6), (10, 31.3), (20, 32.9), (50, 34.1), (200, 34.8), (500, 35.0)]),
                (COARSE, &[(5, 29.5), (10, 31.1), (20, 32.7), (50, 34.0), (200, 34.8), (500, 35.1)]),
            ],
        ),
        (
            stack,
            three_layers(1.0),
            &[
                (MULTIPLICATIVE, &[(5, 20.9), (20, 23.1), (50, 24.4), (500, 26.1)]),
                (CONTENT, &[(5, 25.6), (20, 26.4), (50, 26.6), (500, 26.7)]),
                (COARSE, &[(5, 25.7), (20, 26.4), (50, 26.6), (500, 26.8)]),
            ],
        ),
        (lenslets, directional(0.2), &[(MULTIPLICATIVE, &[(50, 32.2)]), (CONTENT, &[(50, 42.3), (200, 44.1)])]),
        (lenslets, directional(1.0), &[(MULTIPLICATIVE, &[(50, 27.2)]), (CONTENT, &[(50, 29.7), (200, 29.8)])]),
    ]
}

fn three_layers(brightness: f64) -> Display {
    let pitch_mm = WIDTH_MM / RESOLUTION[0] as f64;
    Display { brightness, ..Display::uniform(RESOLUTION, pitch_mm, [5; 2], [20.0; 2], &[-40.0, 0.0, 40.0], 6) }
}

fn directional(brightness: f64) -> Display {
    let pitch_mm = WIDTH_MM / RESOLUTION[0] as f64;
    let lenslets = LensletBacklight::new(-8.5, [47, 29], WIDTH_MM / 47.0, [5; 2], [20.0; 2]);
    let display = Display::uniform(RESOLUTION, pitch_mm, [5; 2], [20.0; 2], &[0.0], 8);
    Display { brightness, backlight: Backlight::Lenslets(lenslets), ..display }
}

fn light_field(display: &Display, bytes: &[u8]) -> Outcome<LightField> {
    let file = npyz::NpyFile::new(bytes)?;
    let shape: Vec<usize> = file.shape().iter().map(|&count| count as usize).collect();
    let shape = shape.try_into().map_err(|shape| format!("{FIELD}: expected five axes, found the shape {shape:?}"))?;
    let radiance = Tensor::from_vec(LightField::AXES, shape, file.into_vec::<f32>()?)?;
    Ok(LightField::new(display.geometry()?, radiance)?)
}

/// Returns settings for every solver with every start, with and without a coarser level.
fn combinations() -> Vec<Settings> {
    let mut all = Vec::new();
    for solver in solvers() {
        for (_, start) in StartKind::ALL {
            for coarse_levels in [0, 1] {
                all.push(Settings {
                    solver: solver.name().into(),
                    start: Some(start),
                    coarse_levels: Some(coarse_levels),
                    ..Settings::default()
                });
            }
        }
    }
    all
}

/// Results of one combination.
struct Row {
    settings: Settings,
    start: LayerStack,
    /// PSNR after each number of iterations.
    figures: Vec<f64>,
    /// Mean time of an iteration (one update of every factor), milliseconds.
    update_ms: f64,
}

/// Returns the row of one combination, with the PSNR after the given numbers of iterations.
///
/// Rows with 0 and 1 coarser levels follow each other. If the display allows no coarser level, the
/// two rows have equal starts, so the second row copies the values of the first row `before`.
fn curve(group: &Group, settings: Settings, iterations: &[u32], before: Option<&Row>) -> Outcome<Row> {
    let problem = Problem { display: &group.display, target: &group.target, weights: &Weights::Uniform };
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let none = Settings { iterations: 0, ..settings.clone() };
    let start = factorize(&problem, &none, None, Task::quiet(&warnings, &cancel), &mut |_| {})?.stack;
    if let Some(same) = before.filter(|row| row.settings.solver == settings.solver && row.start == start) {
        return Ok(Row { settings, start, figures: same.figures.clone(), update_ms: same.update_ms });
    }
    let mut run = solver(&settings.solver)?.start(&problem, start.clone())?;
    let (mut figures, mut done, mut seconds) = (Vec::new(), 0, 0.0);
    for &at in iterations {
        let begin = Instant::now();
        while done < at {
            run.step(&cancel)?;
            done += 1;
        }
        seconds += begin.elapsed().as_secs_f64();
        figures.push(run.objective().psnr_view);
    }
    Ok(Row { settings, start, figures, update_ms: 1e3 * seconds / f64::from(done) })
}

fn print_header(group: &Group, iterations: &[u32]) {
    println!("\n{}: PSNR (view, dB) after the given numbers of iterations; * default settings", group.name);
    let numbers: String = iterations.iter().map(|at| format!("{at:>8}")).collect();
    println!("{:<44}{numbers}{:>10}", "", "ms/update");
}

fn label(settings: &Settings) -> String {
    let start = settings.start.map_or("", |start| start.name());
    let coarse = if settings.coarse_levels == Some(1) { ", 1 coarser level" } else { "" };
    let mark = if is_default(settings) { " *" } else { "" };
    format!("{}, {start}{coarse}{mark}", settings.solver)
}

fn is_default(settings: &Settings) -> bool {
    *settings == Settings::default().resolved()
}

fn is_paper(settings: &Settings) -> bool {
    let paper = Settings { solver: Multiplicative.name().into(), ..Settings::default() };
    *settings == paper.resolved()
}

fn figure(figures: Figures, iterations: u32) -> Option<f64> {
    figures.iter().find(|(at, _)| *at == iterations).map(|(_, psnr)| *psnr)
}

/// Prints by how many dB the paper's rule and the default settings differ from their references and
/// from each other.
fn print_verdict(group: &Group, rows: &[Row], iterations: &[u32]) {
    let find = |wanted: fn(&Settings) -> bool| rows.iter().find(|row| wanted(&row.settings));
    let (Some(paper), Some(default)) = (find(is_paper), find(is_default)) else { return };
    let at = |row: &Row, count: u32| iterations.iter().position(|i| *i == count).map(|i| row.figures[i]);
    let against = |what: &str, row: &Row, references: &[(&str, Figures)]| {
        let differences: Vec<String> = iterations
            .iter()
            .filter_map(|&count| {
                let best = references.iter().filter_map(|(_, figures)| figure(figures, count)).reduce(f64::max)?;
                Some(format!("{count}: {:+.2}", at(row, count)? - best))
            })
            .collect();
        if !differences.is_empty() {
            println!("{what}, dB: {}", differences.join("  "));
        }
    };
    if let [own, best @ ..] = group.references {
        against("paper's rule minus its reference", paper, std::slice::from_ref(own));
        against("default minus the best reference", default, best);
    }
    if let (Some(paper), Some(default)) = (at(paper, 50), at(default, 50)) {
        println!("default minus the paper's rule at 50 iterations, dB: {:+.2}", default - paper);
    }
}

fn group_json(group: &Group, rows: &[Row]) -> Value {
    let rows = rows.iter().map(|row| {
        json!({
            "solver": row.settings.solver,
            "start": row.settings.start.map(|start| start.name()),
            "coarse_levels": row.settings.coarse_levels,
            "default": is_default(&row.settings),
            "psnr_view": row.figures,
            "update_ms": row.update_ms,
        })
    });
    let references = group.references.iter().map(|(name, figures)| json!({ "name": name, "psnr_view": figures }));
    json!({ "name": group.name, "rows": rows.collect::<Vec<_>>(), "references": references.collect::<Vec<_>>() })
}
