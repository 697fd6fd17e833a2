//! `lumistack compare`: compares two runs, all displays of a run, or a run with a photograph.

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_pipeline::{
    Likeness, PhotoComparison, PipelineError, Pose, RunFolder, Viewpoint, compare_displays, compare_photo,
    compare_runs, refocused, simulate_to_file,
};
use serde_json::json;

use crate::console::say;
use crate::values::Numbers;

pub(crate) const EXAMPLES: &str = "\
Examples:
  lumistack compare runs/three-layer runs/directional -o compared
      compares two runs with each other, over the viewing zone of the first run, and both with
      the target of the first run
  lumistack compare runs/figure-9 -o compared
      all displays of a run that has several displays, in one picture
  lumistack compare runs/a/nodes/tensor runs/a/nodes/barrier
      two displays of one run
  lumistack compare runs/a photo.png --eye 0,0,2000 \\
      --corners 210,160,1830,150,1850,1170,190,1180
      a run and a photograph of its panels; the photograph's brightness is scaled to the
      simulation's
  lumistack compare runs/a photo.jpg --focal-35mm 28 \\
      --corners 210,160,1830,150,1850,1170,190,1180
      a run and a photograph from an unknown position, which the command computes from the
      corners
  lumistack compare runs/a runs/b --focus -60,0,60 -o compared
      also pictures as seen by an eye that focuses behind, on and in front of the display";

/// The arguments of `lumistack compare`.
#[derive(Debug, clap::Args)]
pub(crate) struct Compare {
    /// A run folder
    run: PathBuf,
    /// Another run folder, or a photograph (PNG, JPEG, EXR, ...). Without this argument, all
    /// displays of the first run are compared
    other: Option<PathBuf>,
    /// Direction from the display to the camera of the photograph, if the camera was far away. X is
    /// to the right, Y up, degrees [default, without --eye and --focal-35mm: 0,0]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, conflicts_with = "eye")]
    view: Option<Numbers<2>>,
    /// Position of the camera of the photograph, or of the eye of --focus. Millimetres from the
    /// display's centre: X to the right, Y up, Z to the front [default for --focus: 0,0,600]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    eye: Option<Numbers<3>>,
    /// Focal length of the photograph's lens, converted to 35-mm film, millimetres (in EXIF data
    /// FocalLengthIn35mmFilm). The position of the camera is then computed from the corners. The
    /// photograph must not be cropped
    #[arg(long = "focal-35mm", value_name = "MM", requires = "corners", conflicts_with_all = ["eye", "view"])]
    focal_35mm: Option<f64>,
    /// Corners of the display in the photograph, pixels right and down: top left, top right, bottom
    /// right, bottom left [default: the whole photograph]
    #[arg(long, value_name = "X,Y,X,Y,X,Y,X,Y", allow_hyphen_values = true)]
    corners: Option<Numbers<8>>,
    /// Also write pictures as seen by an eye that focuses at these distances, one picture for each
    /// run and distance. LIST has distances in front of the display plane, millimetres, separated
    /// by commas. Distances behind the display plane are negative. This option works for two runs
    /// only
    #[arg(long, value_name = "LIST", value_delimiter = ',', allow_hyphen_values = true, requires = "output")]
    focus: Vec<f64>,
    /// Diameter of the pupil of the eye of --focus, millimetres
    #[arg(long, value_name = "MM", default_value = "4")]
    pupil_mm: f64,
    /// Folder for the pictures
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Default position of the eye, display space, mm.
const EYE_MM: [f64; 3] = [0.0, 0.0, 600.0];

pub(crate) fn run(args: &Compare, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let out = args.output.as_deref();
    if !args.focus.is_empty() && !args.other.as_ref().is_some_and(|other| other.is_dir()) {
        let found = args
            .other
            .as_ref()
            .map_or("one run folder".into(), |other| format!("one run folder and {}", other.display()));
        return Err(PipelineError::option("--focus", "LIST", "two run folders", found));
    }
    let Some(other) = &args.other else {
        return displays(args, json, task);
    };
    // A file is a photograph; a folder is another run.
    if !other.is_dir() {
        let pose = match (args.focal_35mm, args.eye, args.view) {
            (Some(focal), ..) => Pose::FocalMm(focal),
            (_, Some(eye), _) => Pose::Known(Viewpoint::Eye(eye.0)),
            (.., view) => Pose::Known(Viewpoint::Angle(view.map_or([0.0, 0.0], |view| view.0))),
        };
        let corners = args.corners.map(|Numbers([a, b, c, d, e, f, g, h])| [[a, b], [c, d], [e, f], [g, h]]);
        let found = compare_photo(&args.run, other, pose, corners, out)?;
        if json {
            say!("{}", json!({ "event": "done", "photograph": found }));
        } else {
            print_photo(&found);
        }
        return Ok(());
    }
    // Compare two runs, and write their pictures for each distance of focus.
    let found = compare_runs(&args.run, other, out, task)?;
    let focused = match out {
        Some(out) => focus(args, out)?,
        None => Vec::new(),
    };
    if json {
        say!("{}", json!({ "event": "done", "runs": found, "focused": focused }));
        return Ok(());
    }
    for (name, zone) in [("First run", &found.first_zone), ("Second run", &found.second_zone)] {
        let text = zone.as_ref().map_or("the run's report has no zone score".into(), |zone| {
            format!("PSNR {:.2} dB, in the worst tenth of the directions {:.2} dB", zone.psnr_db, zone.worst_tenth_db)
        });
        say!("{:42} {text}", format!("{name} over its viewing zone:"));
    }
    say!("{:42} {} ({} directions)", "Second run against the first run:", text_of(&found.between), found.directions);
    for (name, likeness) in
        [("First run against its target", &found.first), ("Second run against the first run's target", &found.second)]
    {
        if let Some(likeness) = likeness {
            say!("{:42} {} (views: {})", format!("{name}:"), text_of(likeness), found.views);
        }
    }
    found.pictures.iter().chain(&focused).for_each(|path| say!("{}", path.display()));
    Ok(())
}

/// Compares all displays of one run.
fn displays(args: &Compare, json: bool, task: Task<'_>) -> Result<(), PipelineError> {
    let found = compare_displays(&args.run, args.output.as_deref(), task)?;
    if json {
        say!("{}", json!({ "event": "done", "run": found }));
        return Ok(());
    }
    let widest = found.displays.iter().map(|one| one.id.chars().count()).max().unwrap_or(0);
    for one in &found.displays {
        let zone = one
            .zone
            .map_or(String::new(), |zone| format!("PSNR {:.2} dB over the viewing zone; at the views: ", zone.psnr_db));
        say!("{:widest$}  {zone}{}  ({})", one.id, text_of(&one.likeness), one.display);
    }
    found.pictures.iter().for_each(|path| say!("{}", path.display()));
    Ok(())
}

fn print_photo(found: &PhotoComparison) {
    say!("Photograph against simulation: {}", text_of(&found.likeness));
    say!(
        "Factor that makes the photograph as bright as the simulation: {:.4} ({:+.2} stops)",
        found.gain,
        found.gain.log2()
    );
    if let Some([x, y, z]) = found.eye_mm {
        let text = format!("Taken from: {x:.0} mm right, {y:.0} mm up, {z:.0} mm in front of the display's centre");
        say!("{}", text.replace('-', "−"));
    }
    if found.clipped > 0.0 {
        say!("Clipped in the photograph, and not compared: {:.1} % of the display's pixels", 100.0 * found.clipped);
    }
    found.pictures.iter().for_each(|path| say!("{}", path.display()));
}

/// Writes a picture of each run for each distance of focus.
fn focus(args: &Compare, out: &Path) -> Result<Vec<PathBuf>, PipelineError> {
    let eye = args.eye.map_or(EYE_MM, |eye| eye.0);
    let mut files = Vec::new();
    let runs = std::iter::once(("first", &args.run)).chain(args.other.as_ref().map(|other| ("second", other)));
    for (name, folder) in runs {
        let run = RunFolder::open(folder)?;
        for &z in &args.focus {
            let path = out.join(format!("{name}-focus-{z}mm.png"));
            simulate_to_file(&refocused(&run.display, &run.stack, eye, args.pupil_mm, z)?, &path)?;
            files.push(path);
        }
    }
    Ok(files)
}

fn text_of(likeness: &Likeness) -> String {
    let psnr = likeness.psnr_db.map_or("equal".into(), |psnr| format!("PSNR {psnr:.2} dB"));
    format!("{psnr}, SSIM {:.4}, FLIP {:.4}", likeness.ssim, likeness.flip)
}
