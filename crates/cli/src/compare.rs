//! `lumistack compare`: two runs, or a run and a photograph.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_pipeline::{
    Likeness, PipelineError, RunFolder, Viewpoint, compare_photo, compare_runs, refocused, simulate_to_file,
};
use serde_json::json;

use crate::args::Numbers;
use crate::console::say;

pub(crate) const EXAMPLES: &str = "\
Examples:
  lumistack compare runs/three-layer runs/directional -o compared         both at the first one's views, against its target and each other
  lumistack compare runs/a/nodes/tensor runs/a/nodes/barrier              two displays of one run
  lumistack compare runs/a photo.png --eye 0,0,2000 --corners 210,160,1830,150,1850,1170,190,1180 -o compared
                                                                          a photograph of the panels, brought to the simulation's exposure
  lumistack compare runs/a runs/b --focus -60,0,60 --eye 0,0,600 --pupil-mm 4 -o compared
                                                                          what an eye sees that focuses behind, on and before the display";

/// What to compare.
#[derive(Debug, clap::Args)]
pub(crate) struct Compare {
    /// A run folder
    run: PathBuf,
    /// Another run folder, or a photograph (PNG, JPEG, EXR, ...)
    other: PathBuf,
    /// Where the photograph was taken from: angles right and up, degrees, of a distant camera
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, conflicts_with = "eye")]
    view: Option<Numbers<2>>,
    /// Where the photograph was taken from, or the eye is: right, up and in front of the display's centre, millimetres
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    eye: Option<Numbers<3>>,
    /// Corners of the display in the photograph, pixels right and down: left top, right top, right bottom, left bottom [default: the photograph's]
    #[arg(long, value_name = "X,Y,X,Y,X,Y,X,Y", allow_hyphen_values = true)]
    corners: Option<Numbers<8>>,
    /// Depths on which the eye focuses, millimetres towards the viewer, between commas: a picture of each run at each
    #[arg(long, value_name = "LIST", value_delimiter = ',', allow_hyphen_values = true, requires = "output")]
    focus: Vec<f64>,
    /// Diameter of the pupil, millimetres
    #[arg(long, value_name = "MM", default_value = "4")]
    pupil_mm: f64,
    /// Folder for the pictures
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Where an eye is when nobody says.
const EYE_MM: [f64; 3] = [0.0, 0.0, 600.0];

pub(crate) fn run(args: &Compare, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let out = args.output.as_deref();
    if !args.other.is_dir() {
        let viewpoint = match (args.eye, args.view) {
            (Some(eye), _) => Viewpoint::Eye(eye.0),
            (None, view) => Viewpoint::Angle(view.map_or([0.0, 0.0], |view| view.0)),
        };
        let corners = args.corners.map(|Numbers([a, b, c, d, e, f, g, h])| [[a, b], [c, d], [e, f], [g, h]]);
        let found = compare_photo(&args.run, &args.other, viewpoint, corners, out)?;
        if json {
            say!("{}", json!({ "event": "done", "photograph": found }));
        } else {
            say!("Photograph against simulation: {}", told(&found.likeness));
            say!("Exposure of the photograph: × {:.4} ({:+.2} stops) to match", found.gain, found.gain.log2());
            found.pictures.iter().for_each(|path| say!("{}", path.display()));
        }
        return Ok(());
    }
    let found = compare_runs(&args.run, &args.other, out, task)?;
    let focused = match out {
        Some(out) => focus(args, out)?,
        None => Vec::new(),
    };
    if json {
        say!("{}", json!({ "event": "done", "runs": found, "focused": focused }));
        return Ok(());
    }
    for (name, likeness) in [("First against its target", &found.first), ("Second against it", &found.second)] {
        if let Some(likeness) = likeness {
            say!("{:26} {}", format!("{name}:"), told(likeness));
        }
    }
    say!("{:26} {}", "Second against the first:", told(&found.between));
    say!("at {} views", found.views);
    found.pictures.iter().chain(&focused).for_each(|path| say!("{}", path.display()));
    Ok(())
}

/// A picture of each run for each depth of focus.
fn focus(args: &Compare, out: &Path) -> Result<Vec<PathBuf>, PipelineError> {
    let eye = args.eye.map_or(EYE_MM, |eye| eye.0);
    let mut files = Vec::new();
    for (name, folder) in [("first", &args.run), ("second", &args.other)] {
        let run = RunFolder::open(folder)?;
        for &z in &args.focus {
            let path = out.join(format!("{name}-focus-{z}mm.png"));
            simulate_to_file(&refocused(&run.display, &run.stack, eye, args.pupil_mm, z)?, &path)?;
            files.push(path);
        }
    }
    Ok(files)
}

fn told(likeness: &Likeness) -> String {
    let psnr = likeness.psnr_db.map_or("equal".into(), |psnr| format!("PSNR {psnr:.2} dB"));
    format!("{psnr}, SSIM {:.4}, FLIP {:.4}", likeness.ssim, likeness.flip)
}
