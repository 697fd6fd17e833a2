//! `lumistack analyze`: computes the limits of displays from their geometry.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use lumistack_core::Task;
use lumistack_design::contrast::{self, Achieved, Contrast, ContrastError, FactorizeError, Gratings};
use lumistack_design::{Analysis, Scene};
use lumistack_display::{Display, Variation};
use lumistack_pipeline::{FitDepth, PipelineError, Registry, RunFolder, predict_on, presets};
use lumistack_plot as plot;
use serde_json::json;

use crate::console::say;
use crate::groups::{FileArgs, change_importer, job_or_scene};

pub(crate) const EXAMPLES: &str = "\
Examples:
  lumistack analyze paper-directional
      the limits of a built-in display
  lumistack analyze paper-three-layer paper-three-layer:layers=2 -o bounds
      two displays in the same plots; the second display is the first display with two layers
  lumistack analyze paper-three-layer --contrast -o bounds
      also the contrast that a solver reaches, compared with the limit
  lumistack analyze my.toml --scene model.glb
      also the depth of the scene, compared with the depth that the display shows sharply
  lumistack analyze runs/still-life
      the display and the scene of a finished run";

/// Displays to analyze.
#[derive(Debug, clap::Args)]
pub(crate) struct Analyze {
    /// Presets (see `lumistack displays`), display files or run folders. Changes to a display
    /// follow its name after a colon, such as paper-three-layer:layers=2. These keys can be
    /// changed: layers, frames, brightness, gap_mm, fov (HxV), lenslets (CxR)
    #[arg(required = true, value_name = "NAME|FILE|DIR[:KEY=VALUE,...]")]
    displays: Vec<Which>,
    /// A scene (or job) in which every display is placed, to compare the scene's depth with the
    /// display's depth of field
    #[arg(long, value_name = "SCENE|JOB", conflicts_with = "run")]
    scene: Option<PathBuf>,
    /// A finished run. The depth of the run's scene is compared with the depth of field of every
    /// display
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    #[command(flatten)]
    files: FileArgs,
    /// Largest distance from the display plane at which the display's highest spatial frequency is
    /// computed and plotted, millimetres. The default is at least 20 mm, and large enough for the
    /// layers, the lens array, the scene and the depth of field, each with a margin
    #[arg(long, value_name = "MM")]
    reach_mm: Option<f64>,
    /// Also compute patterns of every display for gratings (stripes of one frequency) at many
    /// depths and frequencies, which takes up to a minute per display. For some depths, the command
    /// prints the highest frequency at which a grating keeps half of its contrast. The contrast is
    /// measured in three ways. Two are over the whole viewing zone: after a solve for more views,
    /// and after a solve for the display's own views. The third is at the display's own views
    /// alone. With --json, the command prints the three contrasts of every grating instead
    #[arg(long)]
    contrast: bool,
    /// Folder for analysis.json and the plots, as SVG and PNG
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// An argument NAME:KEY=VALUE,...: the display's name, and the changes to the display.
#[derive(Clone, Debug)]
struct Which {
    name: String,
    change: Variation,
    changes: String,
}

impl FromStr for Which {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // Only a colon before `KEY=VALUE` separates changes; the colon in `C:\display.toml` does
        // not.
        let at = text.rfind(':').filter(|&at| text[at..].contains('='));
        let (name, changes) = at.map_or((text, ""), |at| (&text[..at], &text[at + 1..]));
        let mut change = Variation::default();
        for part in changes.split(',').filter(|part| !part.is_empty()) {
            let (key, value) = part.split_once('=').ok_or_else(|| format!("expected KEY=VALUE, found `{part}`"))?;
            let wrong = || {
                let expected =
                    if matches!(key.trim(), "fov" | "lenslets") { "two numbers such as 20x20" } else { "a number" };
                format!("{key}: expected {expected}, found `{value}`")
            };
            match key.trim() {
                "layers" => change.layers = Some(value.parse().map_err(|_| wrong())?),
                "frames" => change.frames = Some(value.parse().map_err(|_| wrong())?),
                "brightness" => change.brightness = Some(value.parse().map_err(|_| wrong())?),
                "gap_mm" => change.gap_mm = Some(value.parse().map_err(|_| wrong())?),
                "fov" => change.fov_deg = Some(value.parse::<crate::values::Angles>().map_err(|_| wrong())?.0),
                "lenslets" => change.lenslets = Some(value.parse::<crate::values::Size>().map_err(|_| wrong())?.0),
                _ => {
                    return Err(format!(
                        "expected one of the keys layers, frames, brightness, gap_mm, fov and lenslets, found `{key}`"
                    ));
                }
            }
        }
        Ok(Self { name: name.into(), change, changes: changes.into() })
    }
}

pub(crate) fn run(args: &Analyze, registry: &Registry, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    if let Some(reach) = args.reach_mm.filter(|reach| !(reach.is_finite() && *reach > 0.0)) {
        return Err(PipelineError::option("--reach-mm", "MM", "a distance above 0 in millimetres", reach.to_string()));
    }
    // Load every display, and place it in its scene.
    let (mut displays, mut scenes) = (Vec::new(), Vec::new());
    for which in &args.displays {
        let folder = Path::new(&which.name);
        let is_run = folder.join("display.toml").is_file();
        let display = load(which, is_run.then_some(folder))?;
        let scene = match (&args.scene, &args.run) {
            (Some(scene), _) => Some(looked_at(scene, &args.files, &display, registry, task)?),
            (None, Some(run)) => Some(of_run(run)?),
            (None, None) if is_run => of_run(folder).ok(),
            (None, None) => None,
        };
        displays.push(display);
        scenes.push(scene);
    }
    let analyzed = |reach_mm: Option<f64>| -> Vec<Analysis> {
        displays.iter().zip(&scenes).map(|(display, scene)| Analysis::of(display, scene.clone(), reach_mm)).collect()
    };
    let alone = analyzed(args.reach_mm);
    // Sample all displays up to the same depth, the largest that any of them needs. The plots show
    // the displays together.
    let reach_mm = alone.iter().map(Analysis::reach_mm).fold(0.0, f64::max);
    let all = if alone.len() > 1 { analyzed(Some(reach_mm)) } else { alone };
    let mut files = match &args.output {
        Some(folder) => write(&all, folder)?,
        None => Vec::new(),
    };
    // Solve for gratings on request only, since this is slow.
    let measured = if args.contrast { contrasts(&displays, &all, task)? } else { Vec::new() };
    if let (Some(folder), false) = (&args.output, measured.is_empty()) {
        files.extend(write_contrasts(&measured, folder)?);
    }
    if json {
        let mut event = json!({ "event": "done", "displays": all, "contrast": measured, "files": files });
        if args.output.is_some() {
            // The event omits the long lists of points, since analysis.json contains them.
            for axis in
                event["displays"].as_array_mut().into_iter().flatten().flat_map(|d| d["axes"].as_array_mut()).flatten()
            {
                for key in ["bound", "closed", "lens_array"] {
                    axis[key].take();
                }
            }
        }
        say!("{event}");
    } else {
        for (number, analysis) in all.iter().enumerate() {
            say!("{}", analysis.text());
            if let Some((_, found)) = measured.get(number) {
                for line in achieved(found) {
                    say!("{line}");
                }
            }
        }
        files.iter().for_each(|file| say!("{}", file.display()));
    }
    Ok(())
}

fn load(which: &Which, run: Option<&Path>) -> Result<Display, PipelineError> {
    let base = match run {
        Some(folder) => presets::load_file(&folder.join("display.toml"))?,
        None => lumistack_pipeline::DisplayJob::by_name_or_path(&which.name).resolve()?,
    };
    let changed = which.change.applied_to(&base);
    let mut display = changed.map_err(|source| PipelineError::Display {
        path: which.name.clone().into(),
        text: String::new(),
        source,
    })?;
    if !which.changes.is_empty() {
        display.name = format!("{}, {}", base.name, which.changes.replace(',', ", ").replace('=', " "));
    }
    Ok(display)
}

/// Places a display in a scene, and measures the scene's depth.
fn looked_at(
    scene: &Path,
    files: &FileArgs,
    display: &Display,
    registry: &Registry,
    task: Task<'_>,
) -> Result<Scene, PipelineError> {
    let mut job = job_or_scene(scene)?;
    change_importer(&mut job.importer, files);
    // The analysis needs the scene's own depth, so `auto` must not fit this depth to the display.
    if job.window.fit_depth == FitDepth::Auto {
        job.window.fit_depth = FitDepth::Off;
    }
    let depth = predict_on(&job, display, registry, task)?.depth;
    Ok(Scene::from_budget(&depth.to_json(), depth.sentence()))
}

/// Reads a scene's depth from the report of a run.
fn of_run(folder: &Path) -> Result<Scene, PipelineError> {
    RunFolder::open(folder)?;
    let path = folder.join("report.json");
    let bytes = lumistack_files::read(&path).map_err(|source| PipelineError::Read { path: path.clone(), source })?;
    let report: serde_json::Value = serde_json::from_slice(&bytes).unwrap_or_default();
    let budget = &report["depth"];
    if budget["depth_histogram"].is_null() {
        return Err(PipelineError::value(
            &path,
            "depth",
            "the depths of a rendered scene",
            "none, as in the report of a run without a scene",
        ));
    }
    let title = report["title"].as_str().unwrap_or("the run");
    Ok(Scene::from_budget(budget, format!("the scene of {title}")))
}

type Measured = (String, Vec<Contrast>);

/// Measures the contrast of gratings at many depths. The largest depth is the maximum of three
/// values: 1.5 times the limits of the depth of field, twice the distance of the outermost layer,
/// and 10 mm.
fn contrasts(displays: &[Display], all: &[Analysis], task: Task<'_>) -> Result<Vec<Measured>, PipelineError> {
    let measure = |(display, analysis): (&Display, &Analysis)| {
        let ends = analysis.depth_of_field_mm.into_iter().flatten().map(|z| 1.5 * z.abs());
        let reach = ends.chain(analysis.layers_mm.iter().map(|d| 2.0 * d.abs())).fold(10.0, f64::max);
        let found = Gratings::up_to(reach).measure(display, 0, task).map_err(|error| match error {
            ContrastError::Factorize(FactorizeError::Cancelled(_)) => PipelineError::Cancelled,
            other => PipelineError::value(
                &display.name,
                "contrast",
                "a display for which patterns of gratings can be computed",
                other.to_string(),
            ),
        })?;
        Ok((analysis.name.clone(), found))
    };
    displays.iter().zip(all).map(measure).collect()
}

/// Formats one line per [`Achieved`]. Each line states, for some depths, the highest frequency of a
/// grating that is shown with a contrast of at least ½.
fn achieved(found: &[Contrast]) -> [String; 3] {
    let at = |[z, frequency]: &[f64; 2]| format!("{frequency:.2} at {z:.0} mm").replace('-', "−");
    let line = |head: &str, of: &str, achieved| {
        let cutoffs = contrast::achieved_cutoff(found, achieved);
        let cutoffs: Vec<String> = cutoffs.iter().step_by(4).map(at).collect();
        format!("  {head:15} {of}: {}", cutoffs.join(", "))
    };
    [
        line(
            "Achieved",
            "highest frequencies that keep half of the grating's contrast (a frequency of 1 is the finest detail of the pixels), with patterns for more views, seen from the whole zone",
            Achieved::WithMoreViews,
        ),
        line("", "patterns for the display's own views, seen from the whole zone", Achieved::InBetween),
        line("", "patterns for the display's own views, seen from its own views alone", Achieved::AtTheViews),
    ]
}

fn write_contrasts(measured: &[Measured], folder: &Path) -> Result<Vec<PathBuf>, PipelineError> {
    let mut plots = vec![("achieved".to_string(), contrast::all_achieved_plot(measured))];
    for (number, (name, found)) in measured.iter().enumerate() {
        plots.push((format!("achieved-{}", number + 1), contrast::achieved_plot(name, found)));
        plots.push((format!("contrast-{}", number + 1), contrast::contrast_plot(name, found)));
    }
    let mut files = Vec::new();
    for (stem, svg) in plots {
        let svg = svg.map_err(PipelineError::Plot)?;
        let path = folder.join(format!("{stem}.svg"));
        let save = |path: &Path, bytes: &[u8]| {
            lumistack_field_io::atomic::write_bytes(path, bytes).map_err(PipelineError::Field)
        };
        save(&path, svg.as_bytes())?;
        save(&path.with_extension("png"), &plot::png(&svg, 1.5).map_err(PipelineError::Plot)?)?;
        files.push(path);
    }
    Ok(files)
}

fn write(all: &[Analysis], folder: &Path) -> Result<Vec<PathBuf>, PipelineError> {
    std::fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
    let save = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        lumistack_field_io::atomic::write_bytes(&path, bytes).map_err(PipelineError::Field)?;
        Ok::<_, PipelineError>(path)
    };
    let text = serde_json::to_vec_pretty(&json!({ "schema": "lumistack/analysis", "version": 1, "displays": all }));
    let mut files = vec![save("analysis.json", &text.expect("analyses serialize"))?];
    for (axis, suffix) in [(0, ""), (1, "-vertical")] {
        let plots = [
            ("depth-of-field", Analysis::depth_of_field_plot(all, axis)),
            ("spectral-support", Analysis::support_plot(all, axis)),
        ];
        for (stem, svg) in plots {
            let svg = svg.map_err(PipelineError::Plot)?;
            files.push(save(&format!("{stem}{suffix}.svg"), svg.as_bytes())?);
            save(&format!("{stem}{suffix}.png"), &plot::png(&svg, 1.5).map_err(PipelineError::Plot)?)?;
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_stand_after_a_colon() {
        let which: Which = "paper-directional:layers=2,gap_mm=8.5,fov=40x20,lenslets=47x29".parse().unwrap();
        assert_eq!(
            (which.name.as_str(), which.change.layers, which.change.gap_mm),
            ("paper-directional", Some(2), Some(8.5))
        );
        assert_eq!((which.change.fov_deg, which.change.lenslets), (Some([40.0, 20.0]), Some([47, 29])));
        let plain: Which = "C:\\displays\\a.toml".parse().unwrap();
        assert_eq!((plain.name.as_str(), plain.change), ("C:\\displays\\a.toml", Variation::default()));
        assert!("a:layer=2".parse::<Which>().unwrap_err().contains("expected one of the keys layers, frames"));
        assert!("a:layers=two".parse::<Which>().is_err());
    }
}
