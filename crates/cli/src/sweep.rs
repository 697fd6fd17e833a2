//! `lumistack sweep`: solves many designs of a display and compares them.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use lumistack_core::Task;
use lumistack_design::table::{Plots, Row};
use lumistack_pipeline::{PipelineError, Registry, SearchJob, sweep};

use crate::console::say;
use crate::groups::{
    DisplayArgs, FactorizeArgs, RenderArgs, change_display, change_factorize, change_render, job_or_scene,
};
use crate::values::{Angles, Size};

pub(crate) const EXAMPLES: &str = "\
An axis is a property of the display with several values, such as --layers 1..5. Every combination of \
values is a design. A property without values keeps the display's value. The lists of --layers, --frames, \
--brightness and --gap-mm have numbers and ranges, separated by commas: 1..5 or 1,2,4..8. A range may have \
a step: 0.1..1:0.1.

The results are sweep.csv, sweep.json and plots in the folder of --output. If a sweep was stopped or killed, \
the same command continues it.

Examples:
  lumistack sweep scenes/sweeps/figure-7.toml
  lumistack sweep model.glb --resolution 105x66 --layers 1..5 --frames 1,2,4,8
  lumistack sweep job.toml --displays fig7-uniform,fig7-directional
  lumistack sweep job.toml --brightness 0.1..1:0.1
  lumistack sweep model.glb --frames 1..8 --max-panels 3 --enough-db 35";

/// The sweep to run.
// The processor solves all designs of a sweep, without a warm start, so two options are hidden.
#[derive(Debug, clap::Args)]
#[command(mut_arg("device", |arg| arg.hide(true)))]
#[command(mut_arg("warm_start", |arg| arg.hide(true)))]
pub(crate) struct Sweep {
    /// Job file (.toml; it may have a table [sweep]) or scene
    input: PathBuf,
    /// Folder for the results [default: sweeps/NAME]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Do not run. Print the steps of the sweep, which of them have cached results, and estimates
    /// of time and memory
    #[arg(long)]
    plan: bool,
    /// Plots of PSNR to write [default: few]. With few, there are at most six plots: maps over one
    /// pair of axes, then curves along the remaining axes. Three pairs are possible: frames and
    /// layers; frames and brightness; layers and brightness. Few takes the first pair whose axes
    /// both vary. With all, there are maps over every pair whose axes both vary, and curves along
    /// every axis that varies, except along --displays
    #[arg(long, value_enum)]
    plots: Option<PlotsArg>,
    #[command(flatten)]
    axes: Axes,
    #[command(flatten)]
    search: Search,
    /// Display to vary, instead of the job's display: a name that `lumistack displays` lists, or a
    /// display file
    #[arg(long, value_name = "NAME|FILE", help_heading = "Display")]
    display: Option<std::ffi::OsString>,
    /// Columns and rows of the views. The resolutions of the display's layers change in proportion
    #[arg(long, value_name = "CxR", help_heading = "Display")]
    resolution: Option<Size>,
    #[command(flatten)]
    render: RenderArgs,
    #[command(flatten)]
    factorize: FactorizeArgs,
}

/// The plots of PSNR that a sweep writes.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum PlotsArg {
    None,
    Few,
    All,
}

/// The axes of a sweep. Examples of a list of numbers: 1..5; 1,2,4..8; with a step, 0.1..1:0.1.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Axes")]
struct Axes {
    /// Several displays to vary: names of built-in displays, or display files, separated by commas
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    displays: Vec<String>,
    /// Numbers of layers N, such as 1..5 or 1,3
    #[arg(long, value_name = "LIST")]
    layers: Option<List>,
    /// Numbers of frames M, such as 1..5 or 1,2,4..8
    #[arg(long, value_name = "LIST")]
    frames: Option<List>,
    /// Brightness scales β, such as 0.2,0.5 or 0.1..1:0.1
    #[arg(long, value_name = "LIST")]
    brightness: Option<List>,
    /// Gap between neighbouring layers, the same for all layers of a design, millimetres; such as
    /// 20,40
    #[arg(long, value_name = "LIST")]
    gap_mm: Option<List>,
    /// Full horizontal and vertical fields of view, HxV, degrees, separated by commas
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    fov: Vec<Angles>,
    /// Columns and rows of lenslets, CxR, separated by commas
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    lenslets: Vec<Size>,
}

/// Constraints. With any of them the sweep becomes a search for a design.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Search")]
struct Search {
    /// Search for the best design and propose it. All permitted designs are solved with few
    /// iterations, and only the promising designs are solved to the end
    #[arg(long)]
    search: bool,
    /// Largest distance from the rearmost to the frontmost layer or lens array, millimetres
    #[arg(long, value_name = "MM")]
    max_thickness_mm: Option<f64>,
    /// Highest refresh rate of the panels, hertz. A design is allowed if its frames repeat at least
    /// 60 times a second at this rate
    #[arg(long, value_name = "HZ")]
    max_refresh_hz: Option<f64>,
    /// Number of available panels. A design needs one panel for each layer, and one panel behind
    /// the lenslets of a directional backlight
    #[arg(long, value_name = "N")]
    max_panels: Option<usize>,
    /// Smallest brightness scale β
    #[arg(long, value_name = "B")]
    min_brightness: Option<f64>,
    /// Sufficient PSNR, dB. The proposed design is then the design that reaches this PSNR with the
    /// fewest panels and frames
    #[arg(long, value_name = "DB")]
    enough_db: Option<f64>,
}

/// Numbers and ranges of numbers, separated by commas.
#[derive(Clone, Debug, PartialEq)]
struct List(Vec<f64>);

impl FromStr for List {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let parsed = text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
            parsed.ok_or_else(|| format!("expected numbers and ranges such as 1,2,4..8 or 0.1..1:0.1, found `{text}`"))
        };
        let mut numbers = Vec::new();
        for part in text.split(',') {
            let Some((from, rest)) = part.split_once("..") else {
                numbers.push(number(part)?);
                continue;
            };
            let (to, step) = rest.split_once(':').unwrap_or((rest, "1"));
            let (from, to, step) = (number(from)?, number(to)?, number(step)?);
            let count = ((to - from) / step + 1e-9).floor();
            if !(step > 0.0 && (0.0..1e6).contains(&count)) {
                return Err(format!(
                    "expected a rising range, with a step above 0 and at most a million numbers, found `{part}`"
                ));
            }
            // Round to 9 decimals, since 0.1 + 2 · 0.1 is not exactly 0.3 in binary.
            numbers.extend((0..=count as usize).map(|i| ((from + i as f64 * step) * 1e9).round() / 1e9));
        }
        Ok(Self(numbers))
    }
}

impl List {
    fn whole(&self, option: &str) -> Result<Vec<usize>, PipelineError> {
        let whole = |number: &f64| {
            let is_whole = number.fract() == 0.0 && (1.0..1e6).contains(number);
            is_whole
                .then_some(*number as usize)
                .ok_or_else(|| PipelineError::value(option, "LIST", "integers from 1 to 999999", number.to_string()))
        };
        self.0.iter().map(whole).collect()
    }
}

pub(crate) fn run(args: &Sweep, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    // Apply the command line to the job, and to its table [sweep].
    let mut job = job_or_scene(&args.input)?;
    let display = DisplayArgs { display: args.display.clone(), resolution: args.resolution, ..DisplayArgs::default() };
    change_display(&mut job, &display);
    change_render(&mut job, &args.render);
    change_factorize(&mut job, &args.factorize);
    let table = job.sweep.get_or_insert_default();
    let Axes { displays, layers, frames, brightness, gap_mm, fov, lenslets } = &args.axes;
    if !displays.is_empty() {
        // Paths on the command line are relative to the working folder, not to the job's folder.
        table.displays = displays.iter().map(|name| typed(name)).collect();
    }
    if let Some(layers) = layers {
        table.layers = layers.whole("--layers")?;
    }
    if let Some(frames) = frames {
        table.frames = frames.whole("--frames")?;
    }
    if let Some(List(brightness)) = brightness {
        table.brightness.clone_from(brightness);
    }
    if let Some(List(gap_mm)) = gap_mm {
        table.gap_mm.clone_from(gap_mm);
    }
    if !fov.is_empty() {
        table.fov_deg = fov.iter().map(|fov| fov.0).collect();
    }
    if !lenslets.is_empty() {
        table.lenslets = lenslets.iter().map(|size| size.0).collect();
    }
    table.plots = args.plots.map_or(table.plots, |plots| match plots {
        PlotsArg::None => Plots::None,
        PlotsArg::Few => Plots::Few,
        PlotsArg::All => Plots::All,
    });
    change_search(&mut table.search, &args.search);
    // Run the sweep, and print the proposed designs or the best design.
    let folder = args.output.clone().unwrap_or_else(|| Path::new("sweeps").join(&job.name));
    if args.plan {
        return crate::plan::print(&job, &folder, registry, json);
    }
    let summary = sweep(&job, &folder, registry, task)?;
    if json {
        let mut event = serde_json::to_value(&summary).expect("summaries serialize");
        event["event"] = "done".into();
        say!("{event}");
        return Ok(());
    }
    for (place, row) in summary.proposed.iter().enumerate() {
        let rank = if place == 0 { "Proposed:".to_string() } else { format!("{:8}:", place + 1) };
        say!("{rank} {}", text_of(row));
    }
    if let Some(display) = &summary.display {
        say!("{}", display.display());
    }
    if let (Some(best), true) = (&summary.best, summary.proposed.is_empty()) {
        say!("Best: {}", text_of(best));
    }
    summary.plots.iter().for_each(|plot| say!("{}", plot.display()));
    if summary.more_plots > 0 {
        say!("number of further plots that --plots all writes: {}", summary.more_plots);
    }
    say!("number of designs: {}, of which an earlier sweep solved: {}", summary.designs, summary.kept);
    say!("{}", summary.csv.display());
    Ok(())
}

fn typed(name: &str) -> String {
    let is_file = name.ends_with(".toml");
    let path = is_file.then(|| std::path::absolute(name).ok()).flatten();
    path.map_or(name.into(), |path| path.to_string_lossy().into_owned())
}

fn change_search(old: &mut Option<SearchJob>, args: &Search) {
    let given = [args.max_thickness_mm, args.max_refresh_hz, args.min_brightness, args.enough_db];
    if !args.search && args.max_panels.is_none() && given.iter().all(Option::is_none) {
        return;
    }
    let search = old.get_or_insert_default();
    search.max_thickness_mm = args.max_thickness_mm.or(search.max_thickness_mm);
    search.max_refresh_hz = args.max_refresh_hz.or(search.max_refresh_hz);
    search.max_panels = args.max_panels.or(search.max_panels);
    search.min_brightness = args.min_brightness.or(search.min_brightness);
    search.enough_db = args.enough_db.or(search.enough_db);
}

fn text_of(row: &Row) -> String {
    let d = &row.design;
    let lenses =
        if d.lenslets == [0, 0] { String::new() } else { format!(", {} × {} lenslets", d.lenslets[0], d.lenslets[1]) };
    let of = if row.psnr_zone_db.is_some() { " over the zone" } else { "" };
    format!(
        "{}{of}: {}; layers: {}, frames: {}{lenses}, β = {}, {:.1} mm thick, {:.0} Hz, panels: {}",
        row.quality_text(),
        d.display,
        d.layers,
        d.frames,
        d.brightness,
        d.thickness_mm,
        d.refresh_hz,
        d.panels
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_numbers_and_ranges() {
        let list = |text: &str| text.parse::<List>().map(|list| list.0);
        assert_eq!(list("1..3,8").unwrap(), [1.0, 2.0, 3.0, 8.0]);
        assert_eq!(list("0.1..0.4:0.1").unwrap(), [0.1, 0.2, 0.3, 0.4]);
        assert_eq!(list("5..5").unwrap(), [5.0]);
        assert!(list("3..1").is_err() && list("a").is_err() && list("1..3:0").is_err() && list("inf").is_err());
        assert!(List(vec![1.5]).whole("--layers").is_err());
    }
}
