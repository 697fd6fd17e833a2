//! `lumistack display`: writes a display file for the user's own panels, and calibrates it from
//! photographs.

use std::path::{Path, PathBuf};

use clap::{Args as ClapArgs, Subcommand};
use lumistack_display::{LensArray, PanelStack, Transfer};
use lumistack_pipeline::{PipelineError, presets, with_new_seal};
use lumistack_plugin_panels::calibrate::calibrate;
use lumistack_plugin_panels::keep_panels;
use serde_json::json;

use crate::console::{say, tell};
use crate::questions::{Questions, asks};
use crate::values::{Angles, Numbers, Size};

/// Actions on display files.
#[derive(Debug, Subcommand)]
pub(crate) enum DisplayCommand {
    /// Write a display file for your own panels. The command asks questions about missing options,
    /// except --gamma and --contrast
    #[command(
        after_help = "Examples:\n  lumistack display new my-display.toml\n      asks questions, and writes the file\n  lumistack display new my-display.toml --no-questions --gaps-mm 40,40 \\\n      --panel-resolution 1680x1050 --diagonal-inch 22\n      asks nothing\n\nFor a display of a single layer use --gaps-mm 0. With --lens-pitch-mm the display has a lens array, and a panel behind the lenses, in addition to the panels of the layers. The default is then a single layer."
    )]
    New(Box<New>),
    /// Compute the positions of the panels from photographs. Each photograph shows the crosshairs
    /// on one layer, as `lumistack show --pattern crosshairs --only N` draws them
    #[command(
        after_help = "Example:\n  lumistack display calibrate my-display.toml --reference 1=middle.jpg \\\n      --photo 0=rear.jpg --photo 2=front.jpg\n\ndocs/PANELS.md explains how to take the photographs."
    )]
    Calibrate(Calibrate),
}

#[derive(Debug, ClapArgs)]
pub(crate) struct New {
    /// The file to write
    pub(crate) file: PathBuf,
    /// Name of the display
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Gaps between neighbouring layers, from rear to front, millimetres. A display has one gap
    /// fewer than layers; 0 stands for a single layer without a gap
    #[arg(long, value_name = "MM,...", value_delimiter = ',')]
    pub(crate) gaps_mm: Option<Vec<f64>>,
    /// Columns and rows of every panel [default: the resolution of the first of --outputs,
    /// or else of the desktop's first output]
    #[arg(long, value_name = "CxR")]
    pub(crate) panel_resolution: Option<Size>,
    /// Pixel pitch of every panel, millimetres
    #[arg(long, value_name = "MM", conflicts_with = "diagonal_inch")]
    pub(crate) panel_pitch_mm: Option<f64>,
    /// Diagonal of every panel, inches, instead of --panel-pitch-mm
    #[arg(long, value_name = "IN")]
    pub(crate) diagonal_inch: Option<f64>,
    /// Names of the desktop's outputs to which the panels are connected, from rear to front, as
    /// `lumistack show --list` prints them
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub(crate) outputs: Option<Vec<String>>,
    /// Number of panel pixels per mask pixel on each axis. The light field has the masks'
    /// resolution [default: 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=64))]
    pub(crate) panel_pixels: Option<u8>,
    /// Number of views of the light field, horizontal and vertical [default: 5x5]
    #[arg(long, value_name = "HxV")]
    pub(crate) views: Option<Size>,
    /// Full horizontal and vertical field of view, degrees [default: 20x20, or the field of view of
    /// the lenses]
    #[arg(long, value_name = "HxV")]
    pub(crate) fov: Option<Angles>,
    /// Number of frames M that the display shows in quick succession. The default is the largest
    /// number that does not flicker: the refresh rate divided by 60, rounded down, at least 1
    #[arg(long, value_name = "M")]
    pub(crate) frames: Option<usize>,
    /// Refresh rate of the panels, hertz [default: the refresh rate of the first of
    /// --outputs, or else of the desktop's first output; 60 without outputs]
    #[arg(long, value_name = "HZ")]
    pub(crate) refresh_hz: Option<f64>,
    /// Brightness scale β [default: 0.2]
    #[arg(long, value_name = "B")]
    pub(crate) brightness: Option<f64>,
    /// Exponent of the panels' transfer function [default: sRGB]
    #[arg(long, value_name = "G")]
    pub(crate) gamma: Option<f64>,
    /// Contrast of the panels, the ratio of white to black [default: unlimited]
    #[arg(long, value_name = "N")]
    pub(crate) contrast: Option<f64>,
    /// Distance between the axes of neighbouring lenses of a lens array in front of the rearmost
    /// panel, millimetres
    #[arg(long, value_name = "MM", requires_all = ["lens_focal_mm", "lens_gap_mm"])]
    pub(crate) lens_pitch_mm: Option<f64>,
    /// Focal length of the lenses in air, millimetres
    #[arg(long, value_name = "MM", requires = "lens_pitch_mm")]
    pub(crate) lens_focal_mm: Option<f64>,
    /// Distance from the lens array to the layer in front of it, millimetres
    #[arg(long, value_name = "MM", requires = "lens_pitch_mm")]
    pub(crate) lens_gap_mm: Option<f64>,
    /// Replace an existing file
    #[arg(long)]
    pub(crate) force: bool,
    /// Use defaults instead of asking; options without a default are required
    #[arg(long, conflicts_with = "questions")]
    pub(crate) no_questions: bool,
    /// Ask questions even if standard input is not a terminal
    #[arg(long)]
    pub(crate) questions: bool,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Calibrate {
    /// The display file; the calibration is written to it
    pub(crate) file: PathBuf,
    /// Reference layer and its photograph; the other layers are aligned with it
    #[arg(long, value_name = "N=FILE")]
    pub(crate) reference: String,
    /// Another layer and its photograph; the flag may be given several times
    #[arg(long, value_name = "N=FILE", required = true)]
    pub(crate) photo: Vec<String>,
    /// Position of the camera's lens: X right, Y up, Z in front of the display, millimetres. Give
    /// the same value to `lumistack show`, and photograph from this position. The default is
    /// straight ahead at the display's viewing distance, or at 2000 mm if the display has none
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) eye_mm: Option<Numbers<3>>,
    /// Print the result, but do not write it to the display file
    #[arg(long)]
    pub(crate) dry_run: bool,
}

pub(crate) fn display_command(command: &DisplayCommand, json: bool) -> Result<(), PipelineError> {
    match command {
        DisplayCommand::New(new) => {
            let asks = asks(new.questions, new.no_questions);
            let mut stdin = std::io::stdin().lock();
            let mut questions = Questions { command: "display new", input: if asks { Some(&mut stdin) } else { None } };
            let outputs = system_outputs().unwrap_or_else(|reason| {
                if asks {
                    tell!("{reason}");
                }
                Vec::new()
            });
            new_display(new, &outputs, &mut questions, json)
        }
        DisplayCommand::Calibrate(args) => calibrate_display(args, json),
    }
}

/// An output that the system reports: name, [columns, rows], refresh rate in Hz.
type Known = (String, [usize; 2], Option<f64>);

/// Finds the outputs of this session, or returns the reason why there are none.
fn system_outputs() -> Result<Vec<Known>, String> {
    let outputs = lumistack_plugin_panels::window::outputs().map_err(|error| error.to_string())?;
    let known: Vec<Known> = outputs.into_iter().map(|output| (output.name, output.size, output.refresh_hz)).collect();
    if known.is_empty() {
        Err("expected outputs for panels, found none, since no monitor is on".into())
    } else {
        Ok(known)
    }
}

fn positive(text: &str) -> Option<f64> {
    text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0)
}

fn list<T>(text: &str, read: impl Fn(&str) -> Option<T>) -> Option<Vec<T>> {
    text.split(',').map(|word| read(word.trim())).collect()
}

fn new_display(args: &New, outputs: &[Known], ask: &mut Questions<'_>, json: bool) -> Result<(), PipelineError> {
    if args.file.exists() && !args.force {
        return Err(PipelineError::value(
            &args.file,
            "file",
            "a path without a file (--force replaces the file)",
            "a file",
        ));
    }
    for (name, [cols, rows], rate) in outputs {
        let rate = rate.map_or(String::new(), |rate| format!(", {rate:.2} Hz"));
        tell!("found output {name}: {cols} × {rows} pixels{rate}");
    }
    let name = ask.value(
        "--name",
        "Name of the display",
        args.name.clone(),
        Some(("my display".into(), "my display".into())),
        |text| Some(text.into()),
    )?;
    // Gaps and lenses define the number of panels, so they are requested before the panels'
    // settings.
    let lens_pitch_mm = match args.lens_pitch_mm {
        Some(pitch) => pitch,
        None => ask.value(
            "--lens-pitch-mm",
            "Pitch of a lens array in front of the rearmost panel, mm (0 for a plain white backlight)",
            None,
            Some(("0".into(), 0.0)),
            |text| text.parse().ok().filter(|value: &f64| *value >= 0.0 && value.is_finite()),
        )?,
    };
    let gaps_mm = ask.value(
        "--gaps-mm",
        "Gaps between neighbouring layers, from rear to front, mm, separated by commas (0 for a single layer)",
        args.gaps_mm.clone(),
        (lens_pitch_mm > 0.0).then(|| ("0".into(), Vec::new())),
        |text| if text == "0" { Some(Vec::new()) } else { list(text, positive) },
    )?;
    let gaps_mm = if gaps_mm == [0.0] { Vec::new() } else { gaps_mm };
    if let Some(bad) = gaps_mm.iter().find(|gap| !(gap.is_finite() && **gap > 0.0)) {
        return Err(PipelineError::value(
            "--gaps-mm",
            "MM",
            "distances above 0, or 0 alone for a single layer",
            bad.to_string(),
        ));
    }
    // Request the settings of the panels. Default values come from the outputs that the system
    // reports.
    let layers = gaps_mm.len() + 1;
    let panels = layers + usize::from(lens_pitch_mm > 0.0);
    let known: Vec<String> = outputs.iter().take(panels).map(|(name, ..)| name.clone()).collect();
    let default = match known.len() == panels {
        true => Some((known.join(","), known)),
        false => Some(("from left to right".into(), Vec::new())),
    };
    let names = ask.value(
        "--outputs",
        "Names of the panels' outputs, from rear to front, separated by commas",
        args.outputs.clone(),
        default,
        |text| list(text, |word| (!word.is_empty()).then(|| word.to_string())),
    )?;
    if !names.is_empty() && names.len() != panels {
        return Err(PipelineError::value(
            "--outputs",
            "NAME",
            format!("{panels} names, one for each panel"),
            names.len().to_string(),
        ));
    }
    let first = names.first().and_then(|name| outputs.iter().find(|output| output.0 == *name)).or(outputs.first());
    let resolution = ask.value(
        "--panel-resolution",
        "Pixels of a panel, columns x rows",
        args.panel_resolution.map(|size| size.0),
        first.map(|(_, [cols, rows], _)| (format!("{cols}x{rows}"), [*cols, *rows])),
        |text| text.parse::<Size>().ok().map(|size| size.0),
    )?;
    let from_diagonal = |inches: f64| 25.4 * inches / (resolution[0] as f64).hypot(resolution[1] as f64);
    let pitch_mm = ask.value(
        "--panel-pitch-mm or --diagonal-inch",
        "Diagonal of a panel in inches (22) or its pixel pitch in millimetres (0.2827 mm)",
        args.panel_pitch_mm.or(args.diagonal_inch.map(from_diagonal)),
        None,
        |text| match text.strip_suffix("mm") {
            Some(pitch) => positive(pitch.trim()),
            None => positive(text).map(from_diagonal),
        },
    )?;
    // Request the settings of the light field, and of the lenses if there are any.
    let scale = ask.value(
        "--panel-pixels",
        "Panel pixels per mask pixel on each axis (1 gives the sharpest picture; with 2, patterns are computed four times as fast)",
        args.panel_pixels.map(usize::from),
        Some(("2".into(), 2)),
        |text| text.parse().ok().filter(|count| (1..=64).contains(count)),
    )?;
    let size = |text: &str| text.parse::<Size>().ok().map(|size| size.0);
    let views = ask.value(
        "--views",
        "Views of the light field",
        args.views.map(|size| size.0),
        Some(("5x5".into(), [5, 5])),
        size,
    )?;
    let lenses = match lens_pitch_mm > 0.0 {
        false => None,
        true => {
            let focal_mm = ask.value(
                "--lens-focal-mm",
                "Focal length of the lenses in air, mm",
                args.lens_focal_mm,
                None,
                positive,
            )?;
            let gap_mm = ask.value(
                "--lens-gap-mm",
                "Distance from the lenses to the next layer, mm",
                args.lens_gap_mm,
                None,
                positive,
            )?;
            Some(LensArray { pitch_mm: lens_pitch_mm, focal_mm, gap_mm })
        }
    };
    let fov_default = lenses.as_ref().map_or(20.0, LensArray::fov_deg);
    let fov = ask.value(
        "--fov",
        "Full horizontal and vertical field of view, degrees",
        args.fov.map(|fov| fov.0),
        Some((format!("{fov_default:.1}x{fov_default:.1}"), [fov_default; 2])),
        |text| text.parse::<Angles>().ok().map(|angles| angles.0),
    )?;
    // Request refresh rate, frames and brightness.
    let rate = first.and_then(|output| output.2).unwrap_or(60.0);
    let refresh_hz = ask.value(
        "--refresh-hz",
        "Refresh rate of the panels, Hz",
        args.refresh_hz,
        Some((format!("{rate:.2}"), rate)),
        positive,
    )?;
    let steady = PanelStack::steady_frames(refresh_hz);
    let frames = ask.value(
        "--frames",
        "Number of frames (more frames improve the picture, but the display flickers if all frames repeat less than 60 times a second)",
        args.frames,
        Some((steady.to_string(), steady)),
        |text| text.parse().ok().filter(|count| (1..=1000).contains(count)),
    )?;
    let brightness = ask.value(
        "--brightness",
        "Brightness scale β, above 0 and at most 1",
        args.brightness,
        Some(("0.2".into(), 0.2)),
        positive,
    )?;

    // Compute the display, and write its file with comments.
    let stack = PanelStack {
        name,
        gaps_mm,
        panel_resolution: resolution,
        panel_pitch_mm: pitch_mm,
        panel_pixels: scale,
        outputs: names,
        views,
        fov_deg: fov,
        frames,
        refresh_hz,
        brightness,
        transfer: args.gamma.map_or(Transfer::Srgb, Transfer::gamma),
        black_level: args.contrast.map_or(0.0, |contrast| 1.0 / contrast),
        lenses,
    };
    let display = stack.display().map_err(|source| PipelineError::Display {
        path: args.file.clone(),
        text: String::new(),
        source,
    })?;
    let text = format!(
        "# Made by `lumistack display new`. Lengths are in millimetres, angles in degrees. docs/JOB.md explains every key.\n\
         # Put measured values here (black_level, transfer tables, offset_mm, crosstalk). `lumistack show` saves shifts of panels (nudge_px) here.\n{}",
        display.to_toml()
    );
    lumistack_field_io::atomic::write_bytes(&args.file, text.as_bytes()).map_err(PipelineError::Field)?;
    if let Some(warning) = display.flicker_warning() {
        tell!("warning: {warning}");
    }
    match json {
        true => say!("{}", json!({"event": "done", "display": args.file.to_string_lossy()})),
        false => {
            say!("{}", args.file.display());
            let (file, program) = (args.file.display(), crate::program::name());
            tell!("next: {program} show {file} --pattern identify           shows which panel is which");
            tell!("      {program} run SCENE --display {file} -o runs/mine   computes patterns for this display");
            tell!("      {program} show runs/mine");
        }
    }
    Ok(())
}

fn calibrate_display(args: &Calibrate, json: bool) -> Result<(), PipelineError> {
    let mut display = presets::load_file(&args.file)?;
    let eye_mm = args.eye_mm.map_or([0.0, 0.0, display.field.distance_mm.unwrap_or(2000.0)], |eye| eye.0);
    // Read the photographs.
    let photograph = |flag: &str, text: &str| {
        let wrong = || {
            let expected =
                format!("a layer from 0 to {} and a picture, such as 1=middle.jpg", display.layers.len() - 1);
            PipelineError::value(flag, "N=FILE", expected, text)
        };
        let (layer, file) = text.split_once('=').ok_or_else(wrong)?;
        let layer = layer.parse().ok().filter(|layer| *layer < display.layers.len()).ok_or_else(wrong)?;
        let path = Path::new(file);
        let picture = image::ImageReader::open(path)
            .and_then(image::ImageReader::with_guessed_format)
            .map_err(|source| PipelineError::Read { path: path.to_owned(), source })?
            .decode()
            .map_err(|error| PipelineError::value(path, "picture", "PNG, JPEG or WebP", error.to_string()))?;
        Ok::<_, PipelineError>((layer, picture.to_luma8()))
    };
    let reference = photograph("--reference", &args.reference)?;
    let others = args.photo.iter().map(|text| photograph("--photo", text)).collect::<Result<Vec<_>, _>>()?;
    let lent: Vec<_> = others.iter().map(|(layer, picture)| (*layer, picture)).collect();
    // Compute the homographies, and report their errors.
    let (camera, found) =
        calibrate(&display, eye_mm, (reference.0, &reference.1), &lent).map_err(PipelineError::command)?;
    for found in &found {
        let panel = display.layers[found.layer].panel.get_or_insert_default();
        panel.homography = Some(found.homography.0);
        match json {
            true => say!(
                "{}",
                json!({"event": "calibrated", "layer": found.layer, "crosses": found.crosses, "moved_mm": found.moved_mm, "rms_mm": found.rms_mm, "homography": found.homography.0})
            ),
            false => say!(
                "layer {}: number of crosses {}; their error (root mean square) was {:.3} mm, and is {:.3} mm with the new homography",
                found.layer,
                found.crosses,
                found.moved_mm,
                found.rms_mm
            ),
        }
    }
    if !json {
        say!("radial distortion of the camera's lens: k1 {:.4}, k2 {:.4}", camera.distortion[0], camera.distortion[1]);
    }
    if args.dry_run {
        return Ok(());
    }
    // Write only the calibration. Comments and other keys of the file stay as they are.
    let read = lumistack_files::read_text(&args.file);
    let text = read.map_err(|source| PipelineError::Read { path: args.file.clone(), source })?;
    let text = with_new_seal(&text, &keep_panels(&text, &display).map_err(PipelineError::command)?);
    lumistack_field_io::atomic::write_bytes(&args.file, text.as_bytes()).map_err(PipelineError::Field)
}

#[cfg(test)]
mod tests {
    use std::io::BufRead;

    use super::*;
    use clap::Parser;
    use lumistack_display::{Backlight, Display};

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        new: New,
    }

    fn made(folder: &Path, words: &[&str], outputs: &[Known], answers: Option<&str>) -> Result<Display, PipelineError> {
        let file = folder.join("made.toml");
        let _ = std::fs::remove_file(&file);
        let line = Line::parse_from([&["new", file.to_str().unwrap()], words].concat());
        let mut input = answers.map(str::as_bytes);
        let mut questions =
            Questions { command: "display new", input: input.as_mut().map(|input| input as &mut dyn BufRead) };
        new_display(&line.new, outputs, &mut questions, true)?;
        Ok(Display::from_toml(&std::fs::read_to_string(file).unwrap()).unwrap())
    }

    fn outputs() -> Vec<Known> {
        ["DP-1", "DP-2", "HDMI-1"].map(|name| (name.to_string(), [1680, 1050], Some(120.0))).to_vec()
    }

    #[test]
    fn flags_alone_make_the_papers_three_layers() {
        let folder = tempfile::tempdir().unwrap();
        let words = ["--gaps-mm", "40,40", "--diagonal-inch", "22", "--no-questions", "--frames", "12"];
        let display = made(folder.path(), &words, &outputs(), None).unwrap();
        assert_eq!(display.layers.iter().map(|layer| layer.d_mm).collect::<Vec<_>>(), [-40.0, 0.0, 40.0]);
        assert_eq!((display.frames, display.refresh_hz, display.brightness), (12, 120.0, 0.2));
        assert_eq!(display.layers[0].resolution, [840, 525]);
        assert!((display.layers[0].panel_pitch_mm.unwrap() - 0.2821).abs() < 1e-4);
        let names = display.layers.iter().map(|layer| layer.panel.as_ref().unwrap().output.as_deref());
        assert!(names.eq([Some("DP-1"), Some("DP-2"), Some("HDMI-1")]));
    }

    #[test]
    fn options_without_default_are_required() {
        let folder = tempfile::tempdir().unwrap();
        let error = made(folder.path(), &["--no-questions"], &outputs(), None).unwrap_err().to_string();
        assert!(error.contains("--gaps-mm"), "{error}");
        let words = ["--gaps-mm", "40", "--panel-resolution", "8x6", "--no-questions"];
        let error = made(folder.path(), &words, &[], None).unwrap_err().to_string();
        assert!(error.contains("--panel-pitch-mm or --diagonal-inch"), "{error}");
        let words = ["--gaps-mm", "0", "--panel-resolution", "8x6", "--panel-pitch-mm", "0.3", "--no-questions"];
        assert_eq!(made(folder.path(), &words, &[], None).unwrap().layers.len(), 1);
        let words = ["--gaps-mm", "40", "--outputs", "A", "--no-questions"];
        let error = made(folder.path(), &words, &outputs(), None).unwrap_err().to_string();
        assert!(error.contains("expected 2 names, one for each panel, found 1"), "{error}");
    }

    #[test]
    fn answers_make_a_directional_display() {
        let folder = tempfile::tempdir().unwrap();
        // The lines answer the questions in turn: name, lens pitch, gaps, outputs, resolution,
        // panel pitch, and so on. The first panel pitch, `large`, is a mistake, which repeats the
        // question. An empty line takes the default.
        let answers = "bench\n2.54\n\nDP-2,DP-1\n\nlarge\n0.2827 mm\n\n\n2.85\n8.5\n\n\n\n\n";
        let display = made(folder.path(), &[], &outputs(), Some(answers)).unwrap();
        let Backlight::Lenslets(backlight) = &display.backlight else { panic!("directional") };
        assert_eq!((display.name.as_str(), display.layers.len(), backlight.d_mm), ("bench", 1, -8.5));
        assert_eq!(backlight.lenslets, [186, 116]);
        assert!((backlight.fov_deg[0] - 48.04).abs() < 0.01 && (display.field.fov_deg[0] - 48.04).abs() < 0.01);
        assert_eq!(backlight.panel.as_ref().unwrap().output.as_deref(), Some("DP-2"));
        assert_eq!(display.layers[0].panel.as_ref().unwrap().output.as_deref(), Some("DP-1"));
        // The eye sees no flicker at 60 Hz, so panels of 120 Hz show two frames by default.
        assert_eq!(display.frames, 2);
        assert!(made(folder.path(), &[], &outputs(), Some("bench\n")).is_err());
    }
}
