//! Reports of a display, of the nodes of a graph, and of a sequence.

use lumistack_core::{Task, Warning};
use lumistack_display::{Display, RayMap, Simulator, Weights};
use lumistack_report::{GraphInput, Output, Report, ReportInput, SequenceInput, SequenceReport, Stage, Thumbnail};

use super::factorize::Solved;
use super::field::Field;
use super::score::References;
use crate::error::PipelineError;
use crate::job::Job;
use crate::store::files::write_report;
use crate::store::stamps::Stamps;

/// Input of a display's report.
pub(crate) struct ReportContent<'a> {
    pub(crate) job: &'a Job,
    pub(crate) display: &'a Display,
    pub(crate) field: &'a Field,
    pub(crate) references: Option<&'a References>,
    pub(crate) weights: &'a Weights,
    pub(crate) solved: &'a Solved,
    pub(crate) outputs: &'a [Output],
    pub(crate) stages: &'a [Stage],
    pub(crate) warnings: &'a [Warning],
    pub(crate) command: Option<&'a str>,
}

/// Makes the report of a display and writes it.
///
/// # Errors
/// If the report cannot be made or written, or the task is cancelled.
pub(crate) fn run(about: &ReportContent<'_>, stamps: &Stamps, task: Task<'_>) -> Result<Report, PipelineError> {
    let ReportContent { job, display, field, solved, .. } = about;
    let settings = job.to_json();
    let denoising = field.denoised.as_ref().map(|denoised| denoised.about());
    let measure = |references: &References| references.measure(display, &solved.stack, task);
    // Score the seen pictures first, since the report has their scores and some of the pictures.
    let zone = about.references.map(measure).transpose()?;
    // The report is made from values in memory, not from the files of the run.
    let report = lumistack_report::build(
        &ReportInput {
            title: &job.name,
            display,
            stack: &solved.stack,
            target: &field.target,
            weights: about.weights,
            held_out: field.held_out.as_ref(),
            outside: field.outside.as_ref(),
            zone: zone.as_ref(),
            pixels_per_degree: job.report.pixels_per_degree,
            convergence: &solved.steps,
            solution: solved.solution.as_ref(),
            stages: about.stages,
            settings: &settings,
            denoising: denoising.as_ref(),
            scene: Some(&field.about),
            depth: field.depth.as_ref(),
            warnings: about.warnings,
            outputs: about.outputs,
            command: about.command,
            version: env!("CARGO_PKG_VERSION"),
        },
        task,
    )
    .map_err(PipelineError::Report)?;
    write_report(stamps.dir(), &report.html, &report.json)?;
    Ok(report)
}

/// Writes the report of a graph.
///
/// # Errors
/// If the report cannot be made or written.
pub(crate) fn graph(input: &GraphInput<'_>, stamps: &Stamps) -> Result<(), PipelineError> {
    let (html, json) = lumistack_report::graph(input).map_err(PipelineError::Report)?;
    write_report(stamps.dir(), &html, &json)
}

/// Writes the report of a sequence.
///
/// # Errors
/// If the report cannot be made or written.
pub(crate) fn sequence(input: &SequenceInput<'_>, stamps: &Stamps) -> Result<SequenceReport, PipelineError> {
    let report = lumistack_report::sequence(input).map_err(PipelineError::Report)?;
    write_report(stamps.dir(), &report.html, &report.json)?;
    Ok(report)
}

/// Returns two pictures: the central view of the target, and the display's emission for this view,
/// divided by β.
pub(crate) fn thumbnails(display: &Display, field: &Field, solved: &Solved) -> [Thumbnail; 2] {
    let geometry = field.target.geometry();
    let middle = geometry.grid.views().map(|count| count / 2);
    let map = RayMap::new(display, geometry);
    let emitted = Simulator::new(display, &solved.stack).view(&map, geometry, middle);
    let size = [geometry.rows, geometry.cols];
    let scale = (1.0 / solved.stack.brightness) as f32;
    [Thumbnail::new(size, field.target.view(middle), 1.0), Thumbnail::new(size, emitted.radiance.data(), scale)]
}
