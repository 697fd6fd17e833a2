//! A sequence: one run folder per time, each factorized from the patterns of the time before.
//!
//! ```text
//! job ─▶ t0001/ ─layers─▶ t0002/ ─layers─▶ t0003/ ─▶ ...      every folder holds a plain job that runs on its own
//!          └──────────────── error, flicker ──────────────▶ report.html, report.json
//! ```
//!
//! A time for which those are no start, as after a cut, starts fresh. What a time is stands in one place, [`Times::job`]. Two times are in memory at once, since flicker compares them.

mod times;

use std::path::{Path, PathBuf};
use std::time::Instant;

use lumistack_core::metrics::SquaredError;
use lumistack_core::{Progress, Task};
use lumistack_display::{FieldGeometry, Projection, RayMap, Simulator};
use lumistack_plugin_host::Registry;
use lumistack_report::{SequenceInput, SequenceTime, Thumbnail};
use serde::{Deserialize, Serialize};

use crate::error::PipelineError;
use crate::job::{Job, SequenceJob};
use crate::run::{Made, Moment, Run, Summary, Tee, add_stack, add_weights};
use crate::stage::flicker;
use crate::stage::flicker::{Shown, TimeError};
use crate::stage::look::Look;
use crate::store::code;
use crate::store::files::{read_json, remove_reports, write_json, write_report};
use crate::store::folder;
use crate::store::key::KeyBuilder;
use crate::store::names::Work;
use crate::store::settings::write_job;
use crate::store::used;
use times::Times;

/// What the summary of a sequence adds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SequenceSummary {
    /// Number of times.
    pub times: usize,
    /// Flicker over time: PSNR of the change shown against the change wanted, dB; higher is steadier. `None` of a single time.
    pub psnr_change: Option<f64>,
    /// The same over rays whose target stands still; `None` where there are none.
    pub psnr_still: Option<f64>,
}

/// Runs every time, then writes the report of the sequence. A rerun takes the times that are finished from their folders.
///
/// # Errors
/// When a light field has another geometry than the first, when any stage fails, or when cancelled.
pub(crate) fn run(
    job: &Job,
    sequence: &SequenceJob,
    dir: &Path,
    registry: &Registry,
    command: Option<&str>,
    task: Task<'_>,
) -> Result<Summary, PipelineError> {
    let start = Instant::now();
    let warnings = Tee::new(task.warnings);
    let task = Task { warnings: &warnings, ..task };
    job.check()?;
    // found out before an hour of rendering, not after
    let whole = Run::open(job, dir, registry)?;
    if job.scene.is_some() {
        whole.check_outputs(task)?;
    }
    let times = Times::find(job, sequence, &dir.join(name(0)).join("cache"), registry, task)?;
    let (mut list, mut last): (Vec<SequenceTime>, Option<Last>) = (Vec::new(), None);
    let mut failed = Vec::new();
    for time in 0..times.count() {
        task.cancel.check()?;
        let job = times.job(time, last.as_ref());
        let (entry, this) = run_time(&times, time, &job, dir, registry, last.as_ref(), command, task)?;
        failed.extend(this.made.failed_outputs(&format!("{}/", entry.name)));
        list.push(entry);
        last = Some(this);
    }
    write_job(job, dir)?;
    let settings = job.to_json();
    let report = lumistack_report::sequence(&SequenceInput {
        title: &job.name,
        times: &list,
        brightness: last.map_or(1.0, |last| last.made.stack.brightness),
        settings: &settings,
        warnings: &warnings.list.take(),
        command,
        version: env!("CARGO_PKG_VERSION"),
    })
    .map_err(PipelineError::Report)?;
    write_report(dir, &report.html, &report.json)?;
    let (psnr_change, psnr_still) = (report.psnr_change, report.psnr_still);
    Ok(Summary {
        failed_outputs: failed,
        sequence: Some(SequenceSummary { times: list.len(), psnr_change, psnr_still }),
        ..Summary::new(dir, [report.psnr_view, report.psnr_raw], None, start)
    })
}

/// What the next time needs of the one before.
struct Last {
    made: Made,
    /// Its patterns on disk.
    layers: PathBuf,
    /// Where its light field came from, for people.
    source: String,
    /// Of the first time.
    look: Option<Look>,
}

impl Made {
    fn shown(&self) -> Shown<'_> {
        Shown { stack: &self.stack, target: &self.input.target }
    }
}

/// Folder of a time.
fn name(time: usize) -> String {
    format!("t{:04}", time + 1)
}

fn run_time(
    times: &Times<'_>,
    time: usize,
    job: &Job,
    dir: &Path,
    registry: &Registry,
    last: Option<&Last>,
    command: Option<&str>,
    task: Task<'_>,
) -> Result<(SequenceTime, Last), PipelineError> {
    let progress = TimeProgress { next: task.progress, place: format!("{}/{}", time + 1, times.count()) };
    let warnings = Tee::new(task.warnings);
    let task = Task { progress: &progress, warnings: &warnings, ..task };
    let folder = dir.join(name(time));
    // somebody may run this time alone
    let _owned = folder::take(&folder, Work::Run, job, registry, task)?;
    let fresh = last.map(|_| times.fresh());
    let moment = Moment {
        ingested: times.ingested(),
        geometry: last.map(|last| (last.made.input.target.geometry(), last.source.as_str())),
        fresh: fresh.as_ref(),
    };
    let (mut run, made) = Run::make(job, &folder, registry, &moment, task)?;
    let cached = run.stages.iter().any(|stage| stage.name == "factorize" && stage.cached);
    if !cached {
        // of older patterns
        remove_reports(dir)?;
    }
    let key = key(&run, &made, last);
    let error = measure(&mut run, &folder, &made, last, &key, task)?;
    let mut of_report = KeyBuilder::new("report", code::REPORTS);
    of_report.add("measure", key.as_bytes()).add_json("job", job);
    let key = of_report.add_json("failed outputs", &made.failed_outputs("")).finish();
    if times.sequence.reports && !run.stamps.is_current("report", &key) {
        run.stamps.clear("report")?;
        run.report(&made, &warnings.list.take(), command, task)?;
        run.stamps.write("report", &key, &["report.html".into(), "report.json".into()])?;
    }
    used::keep_only_views(&folder, &made.input.views)?;
    let steps = &made.steps;
    let [wanted, shown] = thumbnails(&run, &made);
    let compared = |error: SquaredError| (error.count > 0).then_some(error);
    let entry = SequenceTime {
        name: name(time),
        source: times.source(time),
        report: times.sequence.reports.then(|| format!("{}/report.html", name(time))),
        error: error.error,
        change: compared(error.change),
        still: compared(error.still),
        start: made.solution.as_ref().map_or_else(String::new, |solution| solution.start.clone()),
        psnr_start: steps.first().map_or(f64::NAN, |step| step.psnr_view),
        iterations: steps.last().map_or(0, |step| step.iteration),
        seconds: steps.last().map_or(f64::NAN, |step| step.seconds),
        cached,
        wanted,
        shown,
    };
    let look = last.and_then(|last| last.look).or(made.input.look);
    Ok((entry, Last { made, layers: folder.join("layers"), source: times.source(time), look }))
}

/// Everything that the figures of a time depend on.
fn key(run: &Run<'_>, made: &Made, last: Option<&Last>) -> String {
    let mut key = KeyBuilder::new("measure", code::FIELDS);
    key.add("display", run.display.without_panels().to_toml().as_bytes());
    add_weights(&mut key, &made.weights);
    for Made { input, stack, .. } in last.map(|last| &last.made).into_iter().chain([made]) {
        key.add_f32("target", input.target.radiance().data());
        add_stack(&mut key, stack);
    }
    key.finish()
}

/// Sums of squares and counts, as they are kept between runs.
#[derive(Serialize, Deserialize)]
struct Kept {
    error: (f64, u64),
    change: (f64, u64),
    still: (f64, u64),
}

fn measure(
    run: &mut Run<'_>,
    folder: &Path,
    made: &Made,
    last: Option<&Last>,
    key: &str,
    task: Task<'_>,
) -> Result<TimeError, PipelineError> {
    let file = Path::new("cache/measure-figures.json");
    run.timed("measure", |run| {
        if run.stamps.is_current("measure", key)
            && let Some(Kept { error, change, still }) = read_json(&folder.join(file))
        {
            let [error, change, still] = [error, change, still].map(|(sum, count)| SquaredError { sum, count });
            return Ok((TimeError { error, change, still }, true));
        }
        run.stamps.clear("measure")?;
        let before = last.map(|last| last.made.shown());
        let found = flicker::measure(&run.display, made.shown(), before, &made.weights, task)?;
        let pair = |error: SquaredError| (error.sum, error.count);
        let kept = Kept { error: pair(found.error), change: pair(found.change), still: pair(found.still) };
        write_json(&folder.join(file), &kept)?;
        run.stamps.write("measure", key, &[file.to_owned()])?;
        Ok((found, false))
    })
}

/// The central view as it should be and as it is shown.
pub(crate) fn thumbnails(run: &Run<'_>, made: &Made) -> [Thumbnail; 2] {
    let geometry = made.input.target.geometry();
    let middle = geometry.grid.views().map(|count| count / 2);
    let map = RayMap::new(&run.display, geometry);
    let emitted = Simulator::new(&run.display, &made.stack).view(&map, geometry, middle);
    let size = [geometry.rows, geometry.cols];
    let scale = (1.0 / made.stack.brightness) as f32;
    [Thumbnail::new(size, made.input.target.view(middle), 1.0), Thumbnail::new(size, emitted.radiance.data(), scale)]
}

/// Refuses a light field whose rays are not those of the time before, which stand at `place`.
pub(crate) fn check_geometry(
    path: &Path,
    found: &FieldGeometry,
    expected: &FieldGeometry,
    place: &str,
) -> Result<(), PipelineError> {
    if found == expected {
        return Ok(());
    }
    let text = |geometry: &FieldGeometry| {
        let [view_rows, view_cols] = geometry.grid.views();
        let projection = match geometry.grid.projection {
            Projection::Oblique => "oblique".into(),
            Projection::Perspective { distance_mm } => format!("perspective from {distance_mm} mm"),
        };
        format!(
            "{view_cols} × {view_rows} views of {} × {} pixels of {} mm, {projection}, slopes x {:?}, y {:?}",
            geometry.cols, geometry.rows, geometry.pitch_mm, geometry.grid.slope_x, geometry.grid.slope_y
        )
    };
    let expected = format!("that of {place}: {}", text(expected));
    Err(PipelineError::value(path, "geometry", expected, text(found)))
}

/// Says which time a stage belongs to.
struct TimeProgress<'a> {
    next: &'a dyn Progress,
    place: String,
}

impl Progress for TimeProgress<'_> {
    fn begin(&self, stage: &str, total: u64, unit: &str) {
        self.next.begin(&format!("{stage} {}", self.place), total, unit);
    }

    fn advance(&self, steps: u64, note: &str) {
        self.next.advance(steps, note);
    }

    fn end(&self) {
        self.next.end();
    }
}
