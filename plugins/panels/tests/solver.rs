//! A solver that stalls costs no frame.

#![cfg(feature = "window")]

#[path = "../../../tests/common/session.rs"]
mod session;

use session::{SWAY, Session};

/// Intervals after which a refresh waited for something: far above what a busy machine does to a thread, far below the solver's 2 s.
const WAITED: f64 = 30.0;

#[test]
fn panels_go_on_while_the_solver_stalls() {
    let Some(session) = Session::sway(&SWAY) else { return };
    // examples lie beside the folder of test programs
    let program = std::env::current_exe().unwrap();
    let program = program.parent().unwrap().parent().unwrap().join("examples/solver");
    let output = session.command(program.to_str().unwrap()).arg("8").output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let rows: Vec<Vec<f64>> =
        text.lines().map(|line| line.split(',').map(|number| number.parse().unwrap()).collect()).collect();
    let interval = 1.0 / 60.0;
    // in order: the next place of the period, whichever stack it belongs to; a new stack only with a new period
    for pair in rows.windows(2) {
        assert_eq!(pair[1][0], pair[0][0] + 1.0);
        assert_eq!(pair[1][1] as usize, (pair[0][1] as usize + 1) % 3, "{pair:?}");
        assert!(pair[1][2] == pair[0][2] || (pair[1][2] > pair[0][2] && pair[1][1] == 0.0), "{pair:?}");
    }
    // the longest time without a new stack is the stall
    let mut starts: Vec<(f64, f64)> = Vec::new();
    for row in &rows {
        if starts.last().is_none_or(|(number, _)| *number != row[2]) {
            starts.push((row[2], row[3]));
        }
    }
    let stall = starts.windows(2).max_by(|a, b| (a[1].1 - a[0].1).total_cmp(&(b[1].1 - b[0].1))).unwrap();
    let (from, to) = (stall[0].1, stall[1].1);
    assert!(to - from > 1.5, "the solver did not stall: {starts:?}");
    let gaps = |from: f64, to: f64| -> Vec<f64> {
        let within = rows.windows(2).filter(|pair| pair[0][3] >= from && pair[1][3] <= to);
        within.map(|pair| (pair[1][3] - pair[0][3]) / interval).collect()
    };
    let during = gaps(from, to);
    let late = during.iter().filter(|gap| **gap > 1.5).count();
    let longest = during.iter().copied().fold(0.0, f64::max);
    println!(
        "{} refreshes during a stall of {:.2} s, {late} late, the longest gap {longest:.2} intervals; {} stacks shown",
        during.len(),
        to - from,
        starts.len()
    );
    assert!(longest < WAITED && starts.len() >= 8);
    // as many as the time has, but for what a loaded machine loses
    assert!(during.len() as f64 > 0.8 * (to - from) / interval, "{} refreshes in {:.2} s", during.len(), to - from);
}
