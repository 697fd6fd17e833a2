//! Search for a design under constraints, without solving every design to the last iteration.
//!
//! Successive halving (Jamieson and Talwalkar 2016) first solves all allowed designs with few
//! iterations. The better designs are solved with more iterations, and only the last few with all
//! iterations. The ranking after few iterations is close to the ranking after many. Rows are
//! cached, so a search reuses the rows of a sweep.

use lumistack_design::table::{Design, Row};

use crate::error::PipelineError;
use crate::job::SearchJob;
use crate::stage::design::Candidate;

/// For each round: fraction of the iterations, and fraction of the candidates that the round keeps.
const RUNGS: [(f64, f64); 2] = [(0.08, 0.5), (0.3, 0.4)];
/// Minimum number of candidates that a round keeps.
const LEAST: usize = 6;
/// Designs whose scores differ by at most this value, dB, are regarded as equally good. The search
/// prefers the cheapest of these designs.
const EQUAL_DB: f64 = 0.3;
/// Margin below the requested PSNR, dB. A design whose PSNR after few iterations is lower by more
/// than this margin ranks behind all other designs of the round.
const DROP_DB: f64 = 8.0;

/// Returns the candidates that satisfy the constraints.
///
/// # Errors
/// If no candidate satisfies them. The message states the smallest thickness, refresh rate and
/// number of panels, and the largest β, of all candidates.
pub(crate) fn allowed(candidates: Vec<Candidate>, search: &SearchJob) -> Result<Vec<Candidate>, PipelineError> {
    let fits = |d: &Design| {
        // A display that shows a single picture does not flicker, so its `refresh_hz` is 0.
        let checks = [
            search.max_thickness_mm.is_none_or(|most| d.thickness_mm <= most * (1.0 + 1e-9)),
            search.max_refresh_hz.is_none_or(|most| d.refresh_hz <= most * (1.0 + 1e-9)),
            search.max_panels.is_none_or(|most| d.panels <= most),
            search.min_brightness.is_none_or(|least| d.brightness >= least * (1.0 - 1e-9)),
        ];
        checks.into_iter().all(|holds| holds)
    };
    let least = |value: fn(&Design) -> f64| candidates.iter().map(|c| value(&c.design)).fold(f64::INFINITY, f64::min);
    let found = format!(
        "designs with a thickness of at least {} mm, a refresh rate of at least {} Hz, a number of panels of at least {}, and a β of at most {}",
        least(|d| d.thickness_mm),
        least(|d| d.refresh_hz),
        least(|d| d.panels as f64),
        -least(|d| -d.brightness)
    );
    let kept: Vec<Candidate> = candidates.into_iter().filter(|candidate| fits(&candidate.design)).collect();
    if kept.is_empty() {
        return Err(PipelineError::job("sweep.search", "constraints that at least one design satisfies", found));
    }
    Ok(kept)
}

/// Solves candidates with a number of iterations. Returns a row for each, and the number of cached
/// rows.
pub(super) type SolveAll<'a> = &'a mut dyn FnMut(&[Candidate], u32) -> Result<(Vec<Row>, usize), PipelineError>;

/// Returns the rows of the candidates that got all iterations, in the order of the candidates. Also
/// returns the number of cached rows, and the proposals, best first.
///
/// # Errors
/// If the solver fails on a design, or the task is cancelled.
pub(super) fn run(
    solve_all: SolveAll<'_>,
    iterations: u32,
    mut candidates: Vec<Candidate>,
    search: &SearchJob,
) -> Result<(Vec<Row>, usize, Vec<(Candidate, Row)>), PipelineError> {
    // Each round keeps the better candidates.
    for (share, on) in RUNGS {
        if candidates.len() <= LEAST {
            break;
        }
        let few = ((share * f64::from(iterations)).round() as u32).max(1);
        let (rows, _) = solve_all(&candidates, few)?;
        let goes_on = ((on * candidates.len() as f64).ceil() as usize).max(LEAST);
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        match search.enough_db {
            None => order.sort_by(|&a, &b| rows[b].quality_db().total_cmp(&rows[a].quality_db())),
            // First come designs that may still reach the requested PSNR, the cheapest first. All
            // other designs follow, by their PSNR.
            Some(enough) => {
                let too_low = |i: usize| rows[i].quality_db() < enough - DROP_DB;
                order.sort_by(|&a, &b| {
                    let by_cost = || {
                        cost(&rows[a].design).partial_cmp(&cost(&rows[b].design)).unwrap_or(std::cmp::Ordering::Equal)
                    };
                    let by_psnr = || rows[b].quality_db().total_cmp(&rows[a].quality_db());
                    too_low(a)
                        .cmp(&too_low(b))
                        .then_with(|| if too_low(a) { by_psnr() } else { by_cost().then_with(by_psnr) })
                });
            }
        }
        // Sort by number, so that the kept candidates stay in their original order.
        let mut chosen: Vec<usize> = order.into_iter().take(goes_on).collect();
        chosen.sort_unstable();
        candidates = chosen.into_iter().map(|i| candidates[i].clone()).collect();
    }
    let (rows, kept) = solve_all(&candidates, iterations)?;
    let ranked = ranked(&rows, search.enough_db);
    let proposed = ranked.into_iter().take(5).map(|i| (candidates[i].clone(), rows[i].clone())).collect();
    Ok((rows, kept, proposed))
}

/// Returns the cost of a design for lexicographic comparison: panels, frames, thickness, and the
/// negative of the brightness β.
fn cost(design: &Design) -> [f64; 4] {
    [design.panels as f64, design.frames as f64, design.thickness_mm, -design.brightness]
}

/// Returns row numbers by rank. Rows that reach `enough_db` come first, the cheapest first. The
/// other rows follow by PSNR. If PSNRs differ by at most [`EQUAL_DB`], the cheapest row comes
/// first.
fn ranked(rows: &[Row], enough_db: Option<f64>) -> Vec<usize> {
    let by_cost = |a: usize, b: usize| {
        cost(&rows[a].design).partial_cmp(&cost(&rows[b].design)).unwrap_or(std::cmp::Ordering::Equal)
    };
    let mut left: Vec<usize> = (0..rows.len()).collect();
    let mut order = Vec::new();
    if let Some(enough) = enough_db {
        let mut reach: Vec<usize> = left.iter().copied().filter(|&i| rows[i].quality_db() >= enough).collect();
        reach.sort_by(|&a, &b| by_cost(a, b));
        left.retain(|i| !reach.contains(i));
        order.extend(reach);
    }
    while !left.is_empty() {
        let best = left.iter().map(|&i| rows[i].quality_db()).fold(f64::MIN, f64::max);
        let near = left.iter().copied().filter(|&i| rows[i].quality_db() >= best - EQUAL_DB);
        let Some(next) = near.min_by(|&a, &b| by_cost(a, b)) else { break };
        left.retain(|&i| i != next);
        order.push(next);
    }
    order
}

#[cfg(test)]
mod tests {
    use lumistack_display::Display;

    use super::*;

    fn candidate(layers: usize, frames: usize) -> Candidate {
        let d_mm: Vec<f64> = (0..layers).map(|n| 10.0 * n as f64).collect();
        let display = Display::uniform([4, 4], 1.0, [3, 3], [20.0, 20.0], &d_mm, frames);
        Candidate { design: Design::of("a", &display), display, field: 0 }
    }

    fn row(layers: usize, frames: usize, psnr: f64) -> Row {
        let design = candidate(layers, frames).design;
        Row {
            design,
            psnr_view_db: Some(psnr),
            psnr_raw_db: Some(psnr),
            psnr_zone_db: None,
            psnr_zone_worst_tenth_db: None,
            psnr_between_db: None,
            psnr_worst_db: None,
            nodes: Vec::new(),
        }
    }

    #[test]
    fn constraints_leave_out_what_they_say() {
        let all = || vec![candidate(1, 1), candidate(2, 2), candidate(3, 1), candidate(3, 4)];
        let left = |search: &SearchJob| allowed(all(), search).map(|kept| kept.len());
        assert_eq!(left(&SearchJob::default()).unwrap(), 4);
        assert_eq!(left(&SearchJob { max_refresh_hz: Some(120.0), ..SearchJob::default() }).unwrap(), 3);
        assert_eq!(left(&SearchJob { max_thickness_mm: Some(10.0), ..SearchJob::default() }).unwrap(), 2);
        assert_eq!(left(&SearchJob { max_panels: Some(1), ..SearchJob::default() }).unwrap(), 1);
        let error = left(&SearchJob { max_panels: Some(0), ..SearchJob::default() }).unwrap_err().to_string();
        assert!(
            error.contains(
                "thickness of at least 0 mm, a refresh rate of at least 0 Hz, a number of panels of at least 1, and a β of at most 1"
            ),
            "{error}"
        );
    }

    #[test]
    fn the_cheapest_of_the_good_is_proposed() {
        let rows = [row(1, 1, 20.0), row(3, 4, 40.1), row(2, 4, 40.0), row(2, 6, 42.0)];
        assert_eq!(ranked(&rows, None), [3, 2, 1, 0], "0.1 dB are not worth a layer");
        assert_eq!(ranked(&rows, Some(35.0)), [2, 3, 1, 0]);
        assert_eq!(ranked(&rows, Some(50.0)), [3, 2, 1, 0], "none reaches it: the best");
    }
}
