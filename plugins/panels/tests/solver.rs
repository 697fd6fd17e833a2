//! Tests that panels continue while a solver stalls.

#![cfg(feature = "window")]

#[path = "../../../tests/common/session.rs"]
mod session;

use session::{SWAY, Session};

/// Time between two new stacks, seconds, above which the solver is regarded as stalled. A run with
/// a stall has a gap of at least 2 s. In a run without a stall, a stack arrives every 0.3 s.
const STALL_S: f64 = 1.5;
/// Allowed number of additional lost refreshes in a run with a stall, since the machine may be
/// busy. A present loop that waited for the solver would lose 120 refreshes in 2 s.
const NOISE: usize = 20;
/// Rows of the log: refresh number, position in the period, number of the stack, seconds.
type Log = Vec<[f64; 4]>;

fn run(session: &Session, words: &[&str]) -> Log {
    // the folder of examples is next to the folder of test programs
    let program = std::env::current_exe().unwrap();
    let program = program.parent().unwrap().parent().unwrap().join("examples/solver");
    let output = session.command(program.to_str().unwrap()).args(words).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let numbers = |line: &str| line.split(',').map(|number| number.parse().unwrap()).collect::<Vec<f64>>();
    let log: Log = text.lines().map(|line| numbers(line).try_into().unwrap()).collect();
    // Frames must be in order: each refresh shows the next frame of the period, and a new stack
    // begins only with a new period.
    for pair in log.windows(2) {
        assert_eq!(pair[1][0], pair[0][0] + 1.0);
        assert_eq!(pair[1][1] as usize, (pair[0][1] as usize + 1) % 3, "{pair:?}");
        assert!(pair[1][2] == pair[0][2] || (pair[1][2] > pair[0][2] && pair[1][1] == 0.0), "{pair:?}");
    }
    assert!(log.len() > 100, "{} refreshes: {}", log.len(), String::from_utf8_lossy(&output.stderr));
    log
}

/// Returns the longest time span without a new stack, [from, to] in seconds.
fn longest_without(log: &Log) -> [f64; 2] {
    let mut starts = vec![log[0]];
    starts.extend(log.windows(2).filter(|pair| pair[1][2] != pair[0][2]).map(|pair| pair[1]));
    let spans = starts.windows(2).map(|pair| [pair[0][3], pair[1][3]]);
    spans.max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0]))).unwrap_or([0.0; 2])
}

/// Returns the number of refreshes in a time span, the number of gaps between two refreshes that
/// exceed 1.5 refresh intervals, and the longest gap. The unit of the longest gap is the refresh
/// interval.
fn within(log: &Log, [from, to]: [f64; 2]) -> (usize, usize, f64) {
    let interval = 1.0 / 60.0;
    let rows: Vec<_> = log.iter().filter(|row| row[3] >= from && row[3] <= to).collect();
    let gaps: Vec<f64> = rows.windows(2).map(|pair| (pair[1][3] - pair[0][3]) / interval).collect();
    let late = gaps.iter().filter(|gap| **gap > 1.5).count();
    (rows.len(), late, gaps.iter().copied().fold(0.0, f64::max))
}

/// Compares runs with and without a stall: a stall must not cost more refreshes than [`NOISE`].
/// `LUMISTACK_PANELS_TURNS` sets the number of runs of each kind.
#[test]
fn panels_go_on_while_the_solver_stalls() {
    let Some(session) = Session::sway(&SWAY) else { return };
    let turns = std::env::var("LUMISTACK_PANELS_TURNS").ok().and_then(|turns| turns.parse().ok()).unwrap_or(1);
    let (mut with, mut without) = ((0, 0), (0, 0));
    for _ in 0..turns {
        let (stalled, steady) = (run(&session, &["7", "stalls"]), run(&session, &["7", "steady"]));
        let stall = longest_without(&stalled);
        let length = |[from, to]: [f64; 2]| to - from;
        assert!(length(stall) > STALL_S && length(longest_without(&steady)) < STALL_S, "{stall:?}");
        for (log, kind, sum) in [(&stalled, "stalled", &mut with), (&steady, "steady", &mut without)] {
            let (refreshes, late, longest) = within(log, stall);
            println!(
                "{kind}: {refreshes} refreshes in {:.2} s, {late} late, the longest gap {longest:.2} intervals",
                length(stall)
            );
            (sum.0, sum.1) = (sum.0 + refreshes, sum.1 + late);
        }
    }
    println!(
        "all of {turns}: {} refreshes and {} late with a stall, {} and {} without",
        with.0, with.1, without.0, without.1
    );
    let noise = NOISE * turns;
    assert!(with.0 + noise >= without.0 && with.1 <= without.1 + noise, "{with:?} with a stall, {without:?} without");
}
