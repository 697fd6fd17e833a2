//! Compares the displays of one run, if its job has `[[nodes]]` that share one light field.

use std::path::{Path, PathBuf};

use lumistack_core::{Task, colour};
use lumistack_design::sheet::{Cell, Sheet};
use lumistack_display::{RayMap, Simulator};
use serde::Serialize;

use super::likeness::{Likeness, Sums, ZoneLikeness, along_rays, middle_views, seen, some_views, target_of, zone_of};
use crate::error::PipelineError;
use crate::job::Job;
use crate::simulate::RunFolder;
use crate::store::files::write;

/// JPEG quality of `displays.jpg`. A PNG would be four times as large.
const JPEG_QUALITY: u8 = 92;

/// A display of the run, compared with the target.
#[derive(Clone, Debug, Serialize)]
pub struct DisplayLikeness {
    /// Id of the display's node.
    pub id: String,
    /// Number of layers and frames, the backlight and β, in words.
    pub display: String,
    /// Zone score, if the display's report has one.
    pub zone: Option<ZoneLikeness>,
    /// Scores of the display against the target, ray by ray, over a selection of the target's
    /// views.
    pub likeness: Likeness,
    /// PSNR of each compared view, dB, `[view row][view column]`; `None` if the emitted light
    /// equals the target, or no ray goes through the display.
    pub views_db: Vec<Vec<Option<f64>>>,
}

/// The displays of one run.
#[derive(Clone, Debug, Serialize)]
pub struct DisplaysComparison {
    /// The displays, in the order of the job's nodes.
    pub displays: Vec<DisplayLikeness>,
    /// Written pictures.
    #[serde(serialize_with = "lumistack_core::path_text::told_each")]
    pub pictures: Vec<PathBuf>,
}

/// Compares all displays of a run whose job has `[[nodes]]` with the target.
///
/// If `out` is given, writes `displays.jpg` into the folder `out`. The picture has a column for the
/// target and one for each display, with views from the left, the middle and the right.
///
/// # Errors
/// If the run has no nodes or no target, or files cannot be read or written.
pub fn compare_displays(run: &Path, out: Option<&Path>, task: Task<'_>) -> Result<DisplaysComparison, PipelineError> {
    if run.is_dir() && !run.join("job.toml").exists() {
        return Err(PipelineError::value(
            run,
            "folder",
            "a run folder, which contains job.toml",
            "a folder without job.toml",
        ));
    }
    let job = Job::load(&run.join("job.toml"))?;
    if job.nodes.is_empty() {
        let expected = "the run of a job with `[[nodes]]`, or a second run or photograph to compare with";
        return Err(PipelineError::value(
            run,
            "nodes",
            expected,
            "a run without nodes, and nothing to compare the run with",
        ));
    }
    let target = target_of(run)?
        .ok_or_else(|| PipelineError::value(run, "target", "a light field in the run folder", "none"))?;
    let geometry = target.geometry();
    let (shape, [views_y, views_x]) = ([geometry.rows, geometry.cols], geometry.grid.views());
    let (shown, views) = (middle_views(&geometry.grid), some_views(&geometry.grid));
    // Draw the target in the first column of the sheet.
    let codes = |linear: &mut dyn Iterator<Item = f32>| linear.map(colour::srgb_code).collect::<Vec<u8>>();
    let mut sheet = Sheet {
        size: [geometry.cols, geometry.rows],
        columns: vec![vec!["Target".into(), format!("{views_x} × {views_y} views")]],
        rows: shown
            .iter()
            .map(|&view| {
                let degrees = geometry.grid.slope_x[view[1]].atan().to_degrees();
                let name =
                    if degrees.abs() < 0.05 { "ahead".into() } else { format!("{degrees:+.1}°").replace('-', "−") };
                let cell = Cell { caption: String::new(), rgb: codes(&mut target.view(view).iter().copied()) };
                (name, vec![cell])
            })
            .collect(),
    };
    let mut displays = Vec::new();
    task.progress.begin("compare", (job.nodes.len() * (views.len() + shown.len())) as u64, "views");
    for node in &job.nodes {
        let folder = run.join("nodes").join(&node.id);
        let made = RunFolder::open(&folder)?;
        let (simulator, map) = (Simulator::new(&made.display, &made.stack), RayMap::new(&made.display, geometry));
        // Compute scores along the target's rays, for each view and for all views together.
        let mut sums = Sums::new();
        let mut views_db: Vec<Vec<Option<f64>>> = Vec::new();
        for row in views.chunk_by(|a, b| a[0] == b[0]) {
            let mut of_row = Vec::new();
            for &view in row {
                task.cancel.check()?;
                let (shows, counts) = along_rays(&simulator, &map, made.stack.brightness, geometry, view);
                let mut own = Sums::new();
                own.add(target.view(view), &shows, shape, &counts);
                sums.merge(&own);
                of_row.push(own.likeness().psnr_db);
                task.progress.advance(1, "");
            }
            views_db.push(of_row);
        }
        // Draw seen pictures for the display's column of the sheet.
        for (&view, (_, cells)) in shown.iter().zip(&mut sheet.rows) {
            let (rgb, counts) = seen(&simulator, made.stack.brightness, geometry, view);
            let mut own = Sums::new();
            own.add(target.view(view), &rgb, shape, &counts);
            let caption = own.psnr_text("");
            cells.push(Cell { caption, rgb: codes(&mut rgb.iter().copied()) });
            task.progress.advance(1, "");
        }
        let likeness = sums.likeness();
        // Make the column's heading.
        let plural = |count: usize, one: &str| format!("{count} {one}{}", if count == 1 { "" } else { "s" });
        let lenses = if made.stack.emission.is_some() { ", directional" } else { "" };
        let layers = format!("{}{lenses}", plural(made.display.layers.len(), "layer"));
        let frames = format!("{}, β = {:.2}", plural(made.display.frames, "frame"), made.stack.brightness);
        let zone = zone_of(&folder);
        let psnr = match zone {
            Some(zone) => format!("{:.1} dB over the viewing zone", zone.psnr_db),
            None => sums.psnr_text(" at the target's views"),
        };
        displays.push(DisplayLikeness {
            id: node.id.clone(),
            display: format!("{layers}, {frames}"),
            zone,
            likeness,
            views_db,
        });
        // A column is narrow, so each fact has its own line.
        sheet.columns.push(vec![node.id.clone(), layers, frames, psnr]);
    }
    task.progress.end();
    let mut pictures = Vec::new();
    if let Some(out) = out {
        std::fs::create_dir_all(out).map_err(PipelineError::write(out))?;
        let path = out.join("displays.jpg");
        let ([width, height], rgb) = sheet.drawn().map_err(PipelineError::Plot)?;
        let mut bytes = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
            .encode(&rgb, width as u32, height as u32, image::ExtendedColorType::Rgb8)
            .map_err(|error| {
                PipelineError::value(&path, "picture", "a picture that JPEG can hold", error.to_string())
            })?;
        write(&path, &bytes)?;
        pictures.push(path);
    }
    Ok(DisplaysComparison { displays, pictures })
}
