//! The report of a sequence: a page with error, flicker and cost of every time step.
//!
//! Flicker is the unwanted change between time steps. The error of a ray at time t is e_t = L̃_t/β
//! − L_t. Flicker is the rms of e_t − e_(t−1) over rays and channels. `psnr_change` is
//! −20·log10(flicker) in dB: the PSNR of the displayed change against the change of the target.
//! `psnr_still` includes only rays with a constant target.
//!
//! # report.json
//!
//! | key | value |
//! |---|---|
//! | `schema`, `version` | `"lumistack/sequence-report"`, 1 |
//! | `title`, `lumistack_version`, `command` | texts; `command` may be null |
//! | `psnr_view`, `psnr_raw`, `psnr_change`, `psnr_still` | dB over all time steps; null without compared rays |
//! | `brightness` | β |
//! | `times` | list of `name` (its folder), `source`, `psnr_view`, `start`, `psnr_start` (before the first iteration), `psnr_change`, `psnr_still`, `still_share` (fraction of rays with a constant target), `iterations`, `seconds` of the solver, `cached`. `start` is `"warm"` if the solver started from the stack of the previous time step, otherwise the name of the fresh start, or empty if unknown. `psnr_change`, `psnr_still` and `still_share` are null at the first time step |
//! | `nodes` | for a job with several nodes: list of `id` and the keys from `psnr_view` to `times` per node. The keys above then hold the values of the first node |
//! | `settings`, `warnings` | the resolved job; list of `place`, `message` |

use lumistack_core::Warning;
use lumistack_core::metrics::SquaredError;
use serde_json::{Value, json};

use crate::format::figure;
use crate::picture::{Embedded, Encoding, Linear};
use crate::{ReportError, page};

/// Largest length of a thumbnail's longer side, pixels.
const THUMBNAIL: usize = 200;

/// A small picture in linear light. Values outside of 0..1 are clamped when it is encoded.
#[derive(Clone, Debug, PartialEq)]
pub struct Thumbnail(Linear);

impl Thumbnail {
    /// Makes a thumbnail of values `[row][col][rgb]` with `size` = [rows, cols], which are
    /// multiplied by `scale`.
    ///
    /// # Panics
    /// If the number of values does not match the size.
    pub fn new([rows, cols]: [usize; 2], values: &[f32], scale: f32) -> Self {
        assert_eq!(values.len(), rows * cols * 3, "values that fill the size");
        Self(Linear::new(rows, cols, values, scale).shrunk(rows.max(cols).div_ceil(THUMBNAIL)))
    }

    pub(crate) fn embedded(&self) -> Result<Embedded, ReportError> {
        Ok(self.0.encoded().embedded(Encoding::Jpeg)?)
    }
}

/// One time step.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceTime {
    /// Name of the time step's folder, such as "t0001".
    pub name: String,
    /// Text that names the source of the time step's light field.
    pub source: String,
    /// Path of the time step's report relative to the sequence's report, if it has one.
    pub report: Option<String>,
    /// Error of L̃/β against L.
    pub error: SquaredError,
    /// Error of the change since the previous time step: the change of L̃/β against the change of
    /// L. `None` for the first time step.
    pub change: Option<SquaredError>,
    /// The error `change` over rays with a constant target, if there are such rays.
    pub still: Option<SquaredError>,
    /// Start of the solver. It is "warm" if the solver started from the patterns of the previous
    /// time step; otherwise it is the name of a fresh start. Empty if unknown.
    pub start: String,
    /// PSNR before the first iteration, dB; NaN if unknown.
    pub psnr_start: f64,
    /// Iterations of the solver.
    pub iterations: u32,
    /// Time of the solver, seconds; NaN if unknown.
    pub seconds: f64,
    /// True if an earlier run made the patterns.
    pub cached: bool,
    /// Central view of the target.
    pub wanted: Thumbnail,
    /// Central view of the display, L̃/β.
    pub shown: Thumbnail,
}

impl SequenceTime {
    pub(crate) fn psnr_change(&self) -> f64 {
        self.change.map_or(f64::NAN, SquaredError::psnr)
    }

    pub(crate) fn psnr_still(&self) -> f64 {
        self.still.map_or(f64::NAN, SquaredError::psnr)
    }

    /// Returns the fraction of rays with a constant target, 0..1; NaN at the first time step.
    pub(crate) fn still_share(&self) -> f64 {
        self.change.map_or(f64::NAN, |all| self.still.map_or(0, |still| still.count) as f64 / all.count as f64)
    }
}

/// A display over all time steps.
#[derive(Clone, Copy, Debug)]
pub struct SequenceSeries<'a> {
    /// Id of the node; `None` if there is a single display.
    pub id: Option<&'a str>,
    /// All time steps, in order.
    pub times: &'a [SequenceTime],
    /// Brightness scale β.
    pub brightness: f64,
}

/// Input of a sequence's report.
#[derive(Clone, Copy, Debug)]
pub struct SequenceInput<'a> {
    /// Title.
    pub title: &'a str,
    /// Every display over all time steps: one display, or one for each node.
    pub series: &'a [SequenceSeries<'a>],
    /// The resolved job.
    pub settings: &'a Value,
    /// Warnings of all time steps.
    pub warnings: &'a [Warning],
    /// The command line of the run.
    pub command: Option<&'a str>,
    /// Version of Lumistack.
    pub version: &'a str,
}

/// The two files of a sequence's report, and the scores of every display.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceReport {
    /// Text of `report.html`.
    pub html: String,
    /// Content of `report.json`.
    pub json: Value,
    /// Scores of the displays, in the order of the input.
    pub series: Vec<SequenceFigures>,
}

/// Scores of a display over all time steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SequenceFigures {
    /// Number of time steps.
    pub times: usize,
    /// PSNR of L̃/β against L, dB.
    pub psnr_view: f64,
    /// PSNR of L̃ against βL, dB.
    pub psnr_raw: f64,
    /// PSNR of the change of L̃/β against the change of L, dB; `None` for a single time step.
    pub psnr_change: Option<f64>,
    /// `psnr_change` over rays with a constant target, dB; `None` if there are no such rays.
    pub psnr_still: Option<f64>,
}

/// Makes the report of a sequence. Writes no files.
///
/// # Errors
/// If a picture or a plot cannot be made.
pub fn sequence(input: &SequenceInput) -> Result<SequenceReport, ReportError> {
    let mut report = SequenceReport {
        html: String::new(),
        json: Value::Null,
        series: input.series.iter().map(SequenceFigures::of).collect(),
    };
    report.json = to_json(input, &report);
    report.html = page::sequence::render(input, &report)?;
    Ok(report)
}

impl SequenceFigures {
    fn of(series: &SequenceSeries<'_>) -> Self {
        let together = |errors: &mut dyn Iterator<Item = SquaredError>| errors.reduce(SquaredError::merged);
        let error = together(&mut series.times.iter().map(|time| time.error)).unwrap_or_default();
        let psnr_of = |error: Option<SquaredError>| error.map(SquaredError::psnr);
        Self {
            times: series.times.len(),
            psnr_view: error.psnr(),
            psnr_raw: error.psnr() - 20.0 * series.brightness.log10(),
            psnr_change: psnr_of(together(&mut series.times.iter().filter_map(|time| time.change))),
            psnr_still: psnr_of(together(&mut series.times.iter().filter_map(|time| time.still))),
        }
    }

    fn to_json(self, series: &SequenceSeries<'_>) -> Value {
        json!({
            "psnr_view": figure(self.psnr_view),
            "psnr_raw": figure(self.psnr_raw),
            "psnr_change": self.psnr_change.map(figure),
            "psnr_still": self.psnr_still.map(figure),
            "brightness": series.brightness,
            "times": series.times.iter().map(|time| json!({
                "name": time.name,
                "source": time.source,
                "psnr_view": figure(time.error.psnr()),
                "start": time.start,
                "psnr_start": figure(time.psnr_start),
                "psnr_change": figure(time.psnr_change()),
                "psnr_still": figure(time.psnr_still()),
                "still_share": figure(time.still_share()),
                "iterations": time.iterations,
                "seconds": figure(time.seconds),
                "cached": time.cached,
            })).collect::<Vec<_>>(),
        })
    }
}

fn to_json(input: &SequenceInput, report: &SequenceReport) -> Value {
    let mut all = json!({
        "schema": "lumistack/sequence-report",
        "version": 1,
        "title": input.title,
        "lumistack_version": input.version,
        "command": input.command,
        "settings": input.settings,
        "warnings": input.warnings.iter().map(|w| json!({ "place": w.place, "message": w.message })).collect::<Vec<_>>(),
    });
    let mut of_series =
        input.series.iter().zip(&report.series).map(|(series, figures)| (series.id, figures.to_json(series)));
    let mut nodes = Vec::new();
    for (number, (id, mut figures)) in of_series.by_ref().enumerate() {
        if let (0, Some(figures)) = (number, figures.as_object()) {
            figures.iter().for_each(|(key, value)| all[key] = value.clone());
        }
        if let Some(id) = id {
            figures["id"] = id.into();
            nodes.push(figures);
        }
    }
    if !nodes.is_empty() {
        all["nodes"] = nodes.into();
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(name: &str, error: f64, change: Option<f64>) -> SequenceTime {
        let of = |mse: f64, count: u64| SquaredError { sum: mse * count as f64, count };
        SequenceTime {
            name: name.into(),
            source: "views <1>.npy".into(),
            report: None,
            error: of(error, 100),
            change: change.map(|change| of(change, 100)),
            still: change.map(|change| of(change / 10.0, 25)),
            start: "warm".into(),
            psnr_start: 12.0,
            iterations: 5,
            seconds: 0.25,
            cached: false,
            wanted: Thumbnail::new([3, 4], &[0.5; 36], 1.0),
            shown: Thumbnail::new([3, 4], &[0.1; 36], 5.0),
        }
    }

    fn report(times: &[SequenceTime]) -> SequenceReport {
        let settings = json!({ "seed": 1 });
        let input = SequenceInput {
            title: "walk",
            series: &[SequenceSeries { id: None, times, brightness: 0.1 }],
            settings: &settings,
            warnings: &[],
            command: Some("lumistack run walk.toml"),
            version: "0",
        };
        sequence(&input).unwrap()
    }

    #[test]
    fn figures_of_all_times_are_of_all_rays_together() {
        let report = report(&[time("t0001", 0.01, None), time("t0002", 0.03, Some(0.001))]);
        let figures = report.series[0];
        assert!((figures.psnr_view - -10.0 * 0.02f64.log10()).abs() < 1e-9);
        assert!((figures.psnr_raw - figures.psnr_view - 20.0).abs() < 1e-9);
        assert!(
            (figures.psnr_change.unwrap() - 30.0).abs() < 1e-9 && (figures.psnr_still.unwrap() - 40.0).abs() < 1e-9
        );
        let times = &report.json["times"];
        assert_eq!((&times[0]["psnr_change"], &times[1]["still_share"]), (&Value::Null, &json!(0.25)));
        assert!(report.html.contains("t0002") && report.html.contains("views &lt;1&gt;.npy"));
        assert_eq!(report.html.matches("<svg").count(), 3, "error, flicker and flicker where still are plotted");
        assert!(!report.html.contains("src=\"http") && !report.html.contains("href=\"http"), "nothing is fetched");
    }

    #[test]
    fn one_time_alone_has_no_flicker() {
        let report = report(&[time("t0001", 0.0, None)]);
        assert_eq!((report.series[0].psnr_change, report.series[0].psnr_still), (None, None));
        assert_eq!(report.json["psnr_view"], "Infinity");
        assert!(!report.html.contains("<svg"), "no finite figure to plot");
    }

    #[test]
    fn every_node_has_its_figures_and_its_section() {
        let (good, bad) = ([time("t0001", 0.01, None)], [time("t0001", 0.03, None)]);
        let series = [("a", &good), ("b", &bad)];
        let series = series.map(|(id, times)| SequenceSeries { id: Some(id), times, brightness: 0.1 });
        let settings = json!({});
        let input = SequenceInput {
            title: "both",
            series: &series,
            settings: &settings,
            warnings: &[],
            command: None,
            version: "0",
        };
        let report = sequence(&input).unwrap();
        assert_eq!(report.json["psnr_view"], report.json["nodes"][0]["psnr_view"]);
        assert_eq!((&report.json["nodes"][1]["id"], report.series.len()), (&json!("b"), 2));
        assert!(report.html.contains("id=\"views-b\"") && report.html.contains("Node b"), "{}", report.html);
    }

    #[test]
    fn thumbnails_are_small_and_scaled() {
        let thumbnail = Thumbnail::new([300, 1000], &vec![0.1; 900_000], 5.0);
        assert_eq!((thumbnail.0.rows, thumbnail.0.cols), (60, 200));
        assert!(thumbnail.0.data.iter().all(|value| (value - 0.5).abs() < 1e-6));
    }
}
