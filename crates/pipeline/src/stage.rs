//! Stages of the pipeline, and their table.
//!
//! Each stage has a file with its inputs, the key of its result, the work, and the result. A step
//! of a plan is a stage in a folder.

pub(crate) mod channels;
pub(crate) mod denoise;
pub(crate) mod depth;
pub(crate) mod design;
pub(crate) mod device;
pub(crate) mod expose;
pub(crate) mod factorize;
pub(crate) mod field;
pub(crate) mod fields;
pub(crate) mod flicker;
pub(crate) mod groups;
pub(crate) mod ingest;
pub(crate) mod measure;
pub(crate) mod node;
pub(crate) mod output;
pub(crate) mod paths;
pub(crate) mod place;
pub(crate) mod read;
pub(crate) mod report;
pub(crate) mod samples;
pub(crate) mod score;
pub(crate) mod source;
pub(crate) mod tiles;
pub(crate) mod trace;

use serde_json::{Value, json};

use crate::job::{Background, Denoise, Job, RenderJob};
use crate::store::code::{self, Code};

/// A row of the table of stages.
pub(crate) struct StageInfo {
    pub(crate) name: &'static str,
    /// Name of the stage in reports; `None` if reports do not list the stage.
    pub(crate) label: Option<&'static str>,
    /// Values of the job that the result depends on, in addition to results of other stages. Equal
    /// values give equal results.
    pub(crate) reads: fn(&Job) -> Value,
    /// Files and folders that the stage writes, relative to the folder of its job, such as a run or
    /// a time step.
    pub(crate) writes: &'static [&'static str],
    /// Fingerprints of code that are part of the stage's keys.
    pub(crate) code: Code,
}

/// Reads scene files into a lit scene.
pub(crate) const INGEST: StageInfo = StageInfo {
    name: "ingest",
    label: Some("ingest"),
    reads: |job| {
        let light = &job.light;
        let lamps = (light.environment_strength, light.environment_rotation_deg, light.visible, light.automatic);
        json!([job.pose, job.importer, light.environment, light.from_splats, lamps])
    },
    writes: &["cache/blend-*"],
    code: code::SCENE,
};

/// Places the window in the scene: chooses the side of the scene that the window shows, the
/// window's position, and the depth scale.
pub(crate) const PLACE: StageInfo = StageInfo {
    name: "place",
    label: None,
    reads: |job| json!([job.window, display(job)]),
    writes: &["cache/side-*", "cache/window-*", "cache/fit-*", "cache/focus-*", "cache/samples-*"],
    code: code::VIEWS,
};

/// Traces every view.
pub(crate) const TRACE: StageInfo = StageInfo {
    name: "trace",
    label: Some("render"),
    reads: |job| {
        // Filters that need the same kind of views share cached views. The kinds are halves, split
        // views, and whole views.
        let denoise = job.render.denoise;
        let kept = [denoise.takes_halves(), denoise == Denoise::Shared];
        let render = RenderJob { denoise: Denoise::Off, ..job.render.clone() };
        json!([render, kept, job.seed, job.light.background == Background::Environment, display(job)])
    },
    writes: &["cache/views"],
    code: code::VIEWS,
};

/// Denoises the views.
pub(crate) const DENOISE: StageInfo = StageInfo {
    name: "denoise",
    label: Some("render"),
    reads: |job| json!(job.render.denoise),
    writes: &["cache/views"],
    code: code::VIEWS,
};

/// Applies one exposure and tone curve to all views, which makes the light field.
pub(crate) const EXPOSE: StageInfo = StageInfo {
    name: "expose",
    label: Some("render"),
    reads: |job| {
        let light = &job.light;
        json!([light.exposure_ev, light.automatic_exposure, light.tone, light.background])
    },
    writes: &["target", "held-out", "outside"],
    code: code::FIELDS,
};

/// Renders the scene's pictures over the viewing zone, for the zone score.
pub(crate) const SCORE: StageInfo = StageInfo {
    name: "score",
    label: Some("render for the score"),
    reads: |job| json!([job.report.zone_directions, job.factorize.eyes, job.render.max_bounces, job.seed]),
    writes: &["cache/views"],
    code: code::VIEWS,
};

/// Reads a light field of another renderer.
pub(crate) const READ: StageInfo = StageInfo {
    name: "read",
    label: Some("read"),
    reads: |job| json!([job.geometry, job.light.exposure_ev, job.light.tone, display(job)]),
    writes: &["target"],
    code: code::FIELDS,
};

/// Makes the light field by a plugin.
pub(crate) const SOURCE: StageInfo = StageInfo {
    name: "source",
    label: Some("source"),
    reads: |job| json!([job.source, display(job)]),
    writes: &["target", "cache/source.json"],
    code: code::PLUGINS,
};

/// Factorizes the light field into the patterns of a tensor display.
pub(crate) const FACTORIZE: StageInfo = StageInfo {
    name: "factorize",
    label: Some("factorize"),
    reads: |job| json!([job.factorize, job.seed, display(job)]),
    writes: &["layers", "cache/convergence.json", "job.toml", "display.toml"],
    code: code::PATTERNS,
};

/// Makes the patterns by a plugin.
pub(crate) const NODE: StageInfo = StageInfo {
    name: "node",
    label: Some("node"),
    reads: |job| json!([job.seed, job.factorize.eyes, job.factorize.eye_floor, display(job)]),
    writes: &["layers", "display.toml"],
    code: code::PATTERNS,
};

/// Writes patterns or a light field through an output plugin.
pub(crate) const OUTPUT: StageInfo = StageInfo {
    name: "output",
    label: Some("output"),
    reads: |_| Value::Null,
    writes: &["outputs"],
    code: code::PLUGINS,
};

/// Measures error and flicker of a time step.
pub(crate) const MEASURE: StageInfo = StageInfo {
    name: "measure",
    label: Some("measure"),
    reads: |_| Value::Null,
    writes: &["cache/measure-figures.json"],
    code: code::FIELDS,
};

/// Solves a design of a sweep and scores it.
pub(crate) const DESIGN: StageInfo = StageInfo {
    name: "design",
    label: None,
    reads: |job| json!([job.factorize, job.seed, job.sweep]),
    writes: &["designs"],
    code: code::DESIGNS,
};

/// Writes a report, or the table of a sweep.
pub(crate) const REPORT: StageInfo = StageInfo {
    name: "report",
    label: None,
    reads: Job::to_json,
    writes: &["report.html", "report.json"],
    code: code::REPORTS,
};

/// Files and folders that the table of a sweep writes instead of a report.
pub(crate) const SWEEP_FILES: &[&str] = &["job.toml", "sweep.csv", "sweep.json", "plots"];
/// Files and folders that the table of a search writes.
pub(crate) const SEARCH_FILES: &[&str] = &["job.toml", "sweep.csv", "sweep.json", "plots", "proposed.toml"];

/// Returns the display of a job as TOML, without panels: a preset or a file, with the values that
/// the job changes. `None` if the display cannot be loaded.
fn display(job: &Job) -> Option<String> {
    job.resolve_display().ok().map(|display| display.without_panels().to_toml())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DisplayJob, ZoneSamples};

    const STAGES: [&StageInfo; 14] = [
        &INGEST, &PLACE, &TRACE, &DENOISE, &EXPOSE, &SCORE, &READ, &SOURCE, &FACTORIZE, &NODE, &OUTPUT, &MEASURE,
        &DESIGN, &REPORT,
    ];

    #[test]
    fn stages_have_names_and_files_of_their_own_and_hold_the_code_of_this_crate() {
        for (number, stage) in STAGES.iter().enumerate() {
            assert!(STAGES[..number].iter().all(|other| other.name != stage.name), "{}", stage.name);
            assert!(!stage.writes.is_empty() && stage.code.contains(&env!("LUMISTACK_FINGERPRINT")), "{}", stage.name);
        }
    }

    /// A value that a stage reads changes the stage's key; other values do not.
    #[test]
    fn a_stage_depends_on_the_values_that_it_reads() {
        let job = Job { scene: Some("a.glb".into()), ..Job::new(DisplayJob::by_name_or_path("fig7-uniform")) };
        let changed = |change: fn(&mut Job)| {
            let mut other = job.clone();
            change(&mut other);
            let names = STAGES.iter().filter(|stage| (stage.reads)(&job) != (stage.reads)(&other));
            names.map(|stage| stage.name).filter(|name| *name != "report").collect::<Vec<_>>()
        };
        assert_eq!(changed(|job| job.render.zone_samples = ZoneSamples::Count(7)), ["trace"]);
        assert_eq!(changed(|job| job.light.exposure_ev += 1.0), ["expose", "read"]);
        assert_eq!(changed(|job| job.factorize.iterations = Some(7)), ["factorize", "design"]);
        assert_eq!(changed(|job| job.factorize.eye_floor += 0.1), ["factorize", "node", "design"]);
        assert_eq!(changed(|job| job.seed += 1), ["trace", "score", "factorize", "node", "design"]);
        assert_eq!(changed(|job| job.pose.time_s = Some(1.0)), ["ingest"]);
        assert_eq!(changed(|job| job.render.denoise = Denoise::Guided), ["trace", "denoise"]);
        assert_eq!(
            changed(|job| job.display.frames = Some(2)),
            ["place", "trace", "read", "source", "factorize", "node"]
        );
    }
}
