//! The measurements as a table of text and as JSON.

use std::fmt::Write;

use lumistack_factorizer::Settings;
use serde_json::{Value, json};

use crate::cases::{Case, Needs};
use crate::machine::Machine;

/// Seconds per update of the paper's Matlab solver on a Core i5: 50 updates in about half an hour.
const PAPER_MATLAB_SECONDS: f64 = 36.0;
const PAPER_RESOLUTION: [usize; 2] = [840, 525];
/// On an idle machine, the median multiply-add rate exceeds this fraction of the best rate.
const QUIET: f64 = 0.9;

/// Times in seconds.
#[derive(Clone, Debug, Default)]
pub struct Series(pub Vec<f64>);

impl Series {
    pub fn median(&self) -> f64 {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        match sorted.len() {
            0 => f64::NAN,
            count => 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]),
        }
    }

    pub fn fastest(&self) -> f64 {
        self.0.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn json(&self) -> Value {
        json!({ "median_s": self.median(), "fastest_s": self.fastest(), "all_s": self.0 })
    }
}

/// Times of one kind of Lumistack's updates.
pub struct Row {
    pub what: String,
    pub times: Series,
    /// Smallest number of operations and bytes of an update, if they are counted.
    pub needs: Option<Needs>,
}

/// The multiplicative update of the main case in another library.
pub struct PeerRow {
    pub name: String,
    pub threads: u64,
    pub variant: String,
    /// Largest difference between the library's masks and Lumistack's after one update.
    pub difference: f32,
    pub times: Series,
}

/// Time until the quality of the paper's 50 updates is reached.
#[derive(Default)]
pub struct Quality {
    /// PSNR (dB, `psnr_view`) after 50 multiplicative updates from a random start. `paper_seconds`
    /// is the time of the preparation and these updates.
    pub paper_psnr: f64,
    pub paper_seconds: f64,
    /// The default settings, with every automatic choice replaced by its value.
    pub settings: Settings,
    /// Number of iterations in which the default settings reach `paper_psnr`; `None` if they do
    /// not.
    pub reached: Option<u32>,
    /// Time from the call until the report of the iteration that reaches `paper_psnr`. It includes
    /// preparation, start, coarser levels and all evaluations.
    pub until_reached: Series,
    /// Time of a whole call with `reached` iterations.
    pub whole_call: Series,
    /// PSNR after all iterations of the default settings. `long_seconds` is the time of these
    /// iterations.
    pub long_psnr: f64,
    pub long_seconds: f64,
}

/// All measurements.
pub struct Report {
    case: String,
    resolution: [usize; 2],
    rounds: usize,
    /// The first row is the multiplicative update of the main case.
    pub rows: Vec<Row>,
    /// Times of an evaluation of the objective, for the main case.
    pub objective: Series,
    /// Times of the start of a run, for the main case.
    pub preparation: Series,
    pub peers: Vec<PeerRow>,
    pub quality: Quality,
}

impl Report {
    pub fn new(case: &Case, rounds: usize) -> Self {
        let (display, field) = (&case.display, &case.display.field);
        Self {
            case: format!(
                "{}×{} pixels, {}×{} views, RGB, {} layers, {} frames, β = {}, nearest sampling, without rays that miss a layer",
                field.resolution[0],
                field.resolution[1],
                display.views()[0],
                display.views()[1],
                display.layers.len(),
                display.frames,
                display.brightness
            ),
            resolution: field.resolution,
            rounds,
            rows: Vec::new(),
            objective: Series::default(),
            preparation: Series::default(),
            peers: Vec::new(),
            quality: Quality::default(),
        }
    }

    /// Formats the measurements as a table.
    pub fn text(&self, machine: &Machine) -> String {
        let mut text = format!("\n{}\n", self.case);
        let line = |text: &mut String, what: &str, times: &Series, rest: &str| {
            let (median, fastest) = (1e3 * times.median(), 1e3 * times.fastest());
            let _ = writeln!(text, "{what:<48}{median:>9.1} ms{fastest:>9.1} ms{rest}");
        };
        let _ = writeln!(text, "{:<48}{:>12}{:>12}{:>17}{:>9}", "", "median", "fastest", "multiply-adds", "memory");
        // list Lumistack's updates, then the objective and the preparation, then the peers' updates
        for row in &self.rows {
            let rest = row.needs.map_or(String::new(), |needs| {
                let [arithmetic, memory] = shares(&needs, &row.times, machine);
                format!("{:>15.0} %{:>7.0} %", 100.0 * arithmetic, 100.0 * memory)
            });
            line(&mut text, &row.what, &row.times, &rest);
        }
        line(&mut text, "3 layers: objective evaluation", &self.objective, "");
        line(&mut text, "3 layers: preparation", &self.preparation, "");
        for peer in &self.peers {
            let threads = format!("{} thread{}", peer.threads, if peer.threads == 1 { "" } else { "s" });
            let what = format!("{}, {}, {threads}", peer.name, peer.variant);
            let [medians, fastest] = self.ratios(peer);
            let difference = peer.difference;
            let rest =
                format!("   {medians:.1} × Lumistack's time (fastest {fastest:.1} ×); masks within {difference:.0e}");
            line(&mut text, &what, &peer.times, &rest);
        }
        if self.resolution == PAPER_RESOLUTION {
            let note = "its 50 updates: about 30 minutes";
            let _ = writeln!(text, "{:<48}{PAPER_MATLAB_SECONDS:>9.0} s {:>16}{note}", "paper, Matlab, Core i5", "");
        }
        self.describe_quality(&mut text);
        self.describe_machine(&mut text, machine);
        text
    }

    /// Returns the time of a peer's update divided by the time of Lumistack's update: the ratio of
    /// the medians, and the ratio of the fastest times.
    fn ratios(&self, peer: &PeerRow) -> [f64; 2] {
        let ours = &self.rows[0].times;
        [peer.times.median() / ours.median(), peer.times.fastest() / ours.fastest()]
    }

    fn describe_quality(&self, text: &mut String) {
        // first the quality of the paper's rule, then the time in which the default reaches it
        let quality = &self.quality;
        let settings = &quality.settings;
        let _ = writeln!(
            text,
            "\n50 multiplicative updates, random start: {:.2} dB in {:.2} s",
            quality.paper_psnr, quality.paper_seconds
        );
        let _ = writeln!(
            text,
            "default settings ({}, {} start, {} coarser level(s)):",
            settings.solver,
            settings.start.map_or("", |start| start.name()),
            settings.coarse_levels.unwrap_or(0),
        );
        match quality.reached {
            Some(iterations) => {
                let _ = writeln!(
                    text,
                    "  reach that PSNR after {iterations} iterations: {:.3} s (fastest {:.3}) from the call until it is reported,\n  \
                     {:.3} s (fastest {:.3}) for a call with this number of iterations, until the patterns are returned",
                    quality.until_reached.median(),
                    quality.until_reached.fastest(),
                    quality.whole_call.median(),
                    quality.whole_call.fastest()
                );
            }
            None => {
                let _ = writeln!(text, "  do not reach that PSNR in {} iterations", settings.iterations);
            }
        }
        let _ = writeln!(
            text,
            "  {:.2} dB after {} iterations in {:.2} s",
            quality.long_psnr, settings.iterations, quality.long_seconds
        );
    }

    fn describe_machine(&self, text: &mut String, machine: &Machine) {
        // the best rates of the machine, and a warning if other programs ran
        let _ = writeln!(
            text,
            "\n{} threads, {}: {:.0} G multiply-adds/s, {:.0} GB/s read: the best of many measurements between the updates",
            machine.threads,
            machine.instructions,
            machine.multiply_adds.best() * 1e-9,
            machine.bandwidth.best() * 1e-9,
        );
        let share = machine.multiply_adds.median_share();
        if share < QUIET {
            let _ = writeln!(
                text,
                "The median of these measurements was {:.0} % of the best, so other programs ran. Only ratios and percentages are reliable.",
                100.0 * share
            );
        }
        // the shortest possible times of two updates at these rates
        for row in &self.rows[..2] {
            let Some(needs) = row.needs else { continue };
            let _ = writeln!(
                text,
                "{}: {:.2} G operations, {:.1} ms at best; {:.0} MB, {:.1} ms at best",
                row.what,
                needs.operations * 1e-9,
                1e3 * needs.operations / machine.multiply_adds.best(),
                needs.bytes * 1e-6,
                1e3 * needs.bytes / machine.bandwidth.best()
            );
        }
        let _ = writeln!(
            text,
            "Percentages are fractions of these rates, for the fastest time. Operations per ray and channel with F factors and M frames: F M (F+1) multiplicative,\n\
             F (M (F−1) + M (M+1)/2) block-exact. Bytes: for each factor, an update reads the target in 16 bits and all factors in 32 bits, and writes one factor."
        );
    }

    /// Returns the measurements as JSON, with all single times.
    pub fn json(&self, machine: &Machine) -> Value {
        // list Lumistack's updates, then the peers' updates, then all other values
        let quality = &self.quality;
        let rows = self.rows.iter().map(|row| {
            let mut value = json!({ "what": row.what, "times": row.times.json() });
            if let Some(needs) = row.needs {
                let [arithmetic, memory] = shares(&needs, &row.times, machine);
                value["operations"] = needs.operations.into();
                value["bytes"] = needs.bytes.into();
                value["share_of_multiply_adds"] = arithmetic.into();
                value["share_of_bandwidth"] = memory.into();
            }
            value
        });
        let peers = self.peers.iter().map(|peer| {
            let [medians, fastest] = self.ratios(peer);
            json!({
                "name": peer.name,
                "variant": peer.variant,
                "threads": peer.threads,
                "times": peer.times.json(),
                "ratio_of_medians": medians,
                "ratio_of_fastest": fastest,
                "largest_difference": peer.difference,
            })
        });
        json!({
            "schema": "lumistack/bench-factorize",
            "version": 1,
            "case": self.case,
            "resolution": self.resolution,
            "rounds": self.rounds,
            "machine": {
                "threads": machine.threads,
                "instructions": machine.instructions,
                "multiply_adds_per_s": machine.multiply_adds.best(),
                "bytes_read_per_s": machine.bandwidth.best(),
                "median_share_of_multiply_adds": machine.multiply_adds.median_share(),
                "median_share_of_bandwidth": machine.bandwidth.median_share(),
            },
            "updates": rows.collect::<Vec<_>>(),
            "objective": self.objective.json(),
            "preparation": self.preparation.json(),
            "peers": peers.collect::<Vec<_>>(),
            "quality": {
                "multiplicative_50_psnr_view": quality.paper_psnr,
                "multiplicative_50_s": quality.paper_seconds,
                "default_solver": quality.settings.solver,
                "default_start": quality.settings.start.map(|start| start.name()),
                "default_coarse_levels": quality.settings.coarse_levels,
                "default_iterations_to_that": quality.reached,
                "default_until_reached": quality.until_reached.json(),
                "default_whole_call": quality.whole_call.json(),
                "default_psnr_view": quality.long_psnr,
                "default_s": quality.long_seconds,
            },
        })
    }
}

/// Returns the fractions of the machine's multiply-add rate and memory rate that the fastest update
/// reaches.
fn shares(needs: &Needs, times: &Series, machine: &Machine) -> [f64; 2] {
    let fastest = times.fastest();
    [needs.operations / fastest / machine.multiply_adds.best(), needs.bytes / fastest / machine.bandwidth.best()]
}
