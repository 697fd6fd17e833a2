//! Solves a display tile by tile, to save memory or to use many machines.
//!
//! ```text
//! round 1    each tile, all its pixels:   piece of the light field ─▶ patterns;
//!                                         a warm start is the tile's piece of the given patterns
//! round 2 …  each tile, its free pixels:  patterns of the previous round, from the tile and its
//!                                         neighbours, are the start and the fixed border
//! ```
//!
//! Each pixel belongs to one tile. The free pixels of a tile are its own pixels and all pixels on
//! rays through them. A tile solves its free pixels, but keeps only the result for its own pixels
//! (restricted additive Schwarz). The border consists of all other pixels on rays through free
//! pixels.
//!
//! The result of a tile in a round is cached. Its key is a hash of the tile's inputs, which include
//! the borders. Therefore a stopped run continues, and any machine can solve any tile.

use std::path::PathBuf;
use std::time::Instant;

use lumistack_core::{NoProgress, Task};
use lumistack_display::{Backlight, Display, FieldGeometry, LayerStack, LightField, Region, Tile, Tiling, Weights};
use lumistack_factorizer::{FactorizeError, Problem, Settings, factorize_tile, held_bytes, round_to_levels};

use super::device::SolverDevice;
use super::factorize::{
    Convergence, Solve, Solved, Step, add_stack, prefers_fresh, reuse_or_make, reuse_or_write, run_whole,
    solver_settings, warm_stack,
};
use super::field::add_weights;
use crate::error::{PipelineError, factorize_error, field_error};
use crate::job::FactorizeJob;
use crate::store::code;
use crate::store::files::read_json;
use crate::store::key::KeyBuilder;
use crate::store::stamps::Stamps;
use crate::store::used::TILES;

/// Number of rounds; fewer if there are fewer iterations. Tiles exchange their borders between
/// rounds.
const ROUNDS: usize = 4;
/// Number of threads that estimates of memory assume. It is fixed, so that the cut into tiles does
/// not depend on the machine.
const THREADS: usize = 16;
/// Minimum length of the longer side of a tile, pixels of the light field. If the longer side is
/// below twice this length, a tile is not cut further, even if it needs more memory than allowed.
const SMALLEST: usize = 64;

/// The tiles and rounds of a solve.
pub(crate) struct Tiles {
    tiling: Tiling,
    rounds: usize,
}

impl Tiles {
    /// Returns the tiles of a job's solve; `None` if the display is solved as a whole.
    pub(crate) fn of(job: &FactorizeJob, display: &Display, geometry: &FieldGeometry) -> Option<Self> {
        let tiling = match (job.tiles, job.tile_mib) {
            (Some(tiles), _) => Tiling::new(display, geometry, tiles),
            (None, Some(mib)) if held_bytes(display, geometry, THREADS) > mib << 20 => {
                fitting(display, geometry, mib << 20)
            }
            _ => return None,
        };
        let rounds = ROUNDS.min(job.iterations() as usize).max(1);
        (tiling.count() > 1).then_some(Self { tiling, rounds })
    }

    pub(crate) fn count(&self) -> usize {
        self.tiling.count()
    }

    pub(crate) fn rounds(&self) -> usize {
        self.rounds
    }

    /// Returns the numbers of the tiles whose patterns a tile reads: the tile itself and its
    /// neighbours.
    pub(crate) fn around(&self, number: usize) -> Vec<usize> {
        self.tiling.around(number)
    }

    /// Returns the memory of the largest tile, bytes.
    pub(crate) fn bytes(&self, display: &Display, geometry: &FieldGeometry) -> u64 {
        bytes(&self.tiling, display, geometry)
    }

    /// Returns a tile in the middle of the display, which has the most neighbours.
    fn middle(tiling: &Tiling) -> Tile {
        let [across, down] = tiling.tiles();
        tiling.tile(down / 2 * across + across / 2)
    }

    /// Returns the iterations of a round. A round gets about half of the remaining iterations, and
    /// leaves at least one for each later round. The last round gets all remaining iterations.
    /// The first round changes the patterns most, so it is the longest. A short last round leaves
    /// only small differences at the borders.
    fn iterations(&self, job: &FactorizeJob, round: usize) -> std::ops::Range<u32> {
        let all = job.iterations() as usize;
        let left = |round: usize| if round < self.rounds { (all >> round).max(self.rounds - round) } else { 0 };
        let at = |round: usize| all.saturating_sub(left(round)) as u32;
        at(round)..at(round + 1)
    }
}

/// Cuts a display into more and more tiles, until each tile takes at most `most` bytes, or the
/// longer side of a tile is below 2 · [`SMALLEST`].
fn fitting(display: &Display, geometry: &FieldGeometry, most: u64) -> Tiling {
    let mut tiles = [1, 1];
    loop {
        let tiling = Tiling::new(display, geometry, tiles);
        let sides = [geometry.cols / tiles[0], geometry.rows / tiles[1]];
        let longer = usize::from(sides[1] > sides[0]);
        if sides[longer] < 2 * SMALLEST || bytes(&tiling, display, geometry) <= most {
            return tiling;
        }
        tiles[longer] += 1;
    }
}

/// Returns the memory of the largest tile and its piece of the light field, bytes.
fn bytes(tiling: &Tiling, display: &Display, geometry: &FieldGeometry) -> u64 {
    let tile = Tiles::middle(tiling);
    let own = tile.geometry(geometry);
    let [view_rows, view_cols] = own.grid.views();
    let rays = (view_rows * view_cols * own.rows * own.cols) as u64;
    held_bytes(&tile.display(display, geometry), &own, THREADS) + 12 * rays
}

/// Returns the patterns in `layers/`, and true if they were cached. Patterns that are not cached
/// are solved in tiles, or as a whole.
///
/// # Errors
/// If the settings are invalid, the solver fails, a file cannot be written, or the task is
/// cancelled.
pub(crate) fn run(solve: Solve<'_>, stamps: &Stamps, task: Task<'_>) -> Result<(Solved, bool), PipelineError> {
    let Some(tiles) = Tiles::of(solve.job, solve.display, solve.target.geometry()) else {
        return run_whole(solve, stamps, task);
    };
    let warm = warm_stack(solve.job, solve.display)?;
    let mut key = solve.key(warm.as_ref(), &SolverDevice::Processor);
    let Solve { job, seed, display, target, weights } = solve;
    let crop = |tile: &Tile| Ok(tile.light_field(target));
    let solve = CutSolve { job, seed, display, geometry: target.geometry(), weights, crop: &crop };
    // The key contains the cut into tiles, but not the tiles' results, which follow from the same
    // inputs.
    key.add_json("tiles", &(tiles.tiling.tiles(), tiles.rounds));
    let work = Work { solve, tiles: &tiles, stamps };
    reuse_or_write("factorize", &key.finish(), solve.display, stamps, || {
        task.progress.begin("factorize", (tiles.rounds * tiles.count()) as u64, "tiles");
        let mut all = (0..tiles.rounds).flat_map(|round| (0..tiles.count()).map(move |number| [round, number]));
        let done = all.try_for_each(|at| {
            work.tile(at, warm.as_ref(), Task { progress: &NoProgress, ..task })?;
            task.progress.advance(1, &format!("round {} of {}", at[0] + 1, tiles.rounds));
            Ok::<_, PipelineError>(())
        });
        task.progress.end();
        done?;
        work.join()
    })
}

/// Solves a tile in a round; the numbers of the round and of the tile begin at 0. The tiles of the
/// previous round must be done.
///
/// # Errors
/// The errors of [`run`], and an error if the solve is not cut into `count` tiles.
pub(crate) fn run_tile(
    solve: CutSolve<'_>,
    [round, number, count]: [usize; 3],
    stamps: &Stamps,
    task: Task<'_>,
) -> Result<(), PipelineError> {
    let tiles = Tiles::of(solve.job, solve.display, solve.geometry);
    let Some(tiles) = tiles.filter(|tiles| tiles.count() == count && round < tiles.rounds && number < count) else {
        let expected = "a tile of the planned solve";
        return Err(PipelineError::value("plan", "unit", expected, format!("tile {} of {count}", number + 1)));
    };
    let warm = if round == 0 { warm_stack(solve.job, solve.display)? } else { None };
    Work { solve, tiles: &tiles, stamps }.tile([round, number], warm.as_ref(), task)
}

/// Returns true if a fresh start with the settings `fresh` is better than the warm start of
/// `solve`, by the rule of [`lumistack_factorizer::warm_start_pays`]. For a solve in tiles, only
/// the tile in the middle is compared.
///
/// # Errors
/// If the patterns cannot be read, the solver fails, or the task is cancelled.
pub(crate) fn prefers_fresh_start(
    solve: Solve<'_>,
    fresh: &FactorizeJob,
    stamps: &Stamps,
    task: Task<'_>,
) -> Result<bool, PipelineError> {
    let Some(warm) = warm_stack(solve.job, solve.display)? else { return Ok(false) };
    let geometry = solve.target.geometry();
    let Some(tiles) = Tiles::of(solve.job, solve.display, geometry) else {
        return prefers_fresh(solve, fresh, &warm, stamps, task);
    };
    let tile = Tiles::middle(&tiles.tiling);
    let Some(weights) = tile.weights(solve.weights) else { return Ok(false) };
    let (display, target) = (tile.display(solve.display, geometry), tile.light_field(solve.target));
    let solve = Solve { display: &display, target: &target, weights: &weights, ..solve };
    prefers_fresh(solve, fresh, &warm.cut(&held(&tile)), stamps, task)
}

fn held(tile: &Tile) -> Vec<Region> {
    tile.parts.iter().map(|part| part.held.clone()).collect()
}

fn own(tile: &Tile) -> Vec<Region> {
    tile.parts.iter().map(|part| part.own.clone()).collect()
}

/// The input of a solve in tiles. The light field need not be in memory.
#[derive(Clone, Copy)]
pub(crate) struct CutSolve<'a> {
    pub(crate) job: &'a FactorizeJob,
    pub(crate) seed: u64,
    pub(crate) display: &'a Display,
    pub(crate) geometry: &'a FieldGeometry,
    pub(crate) weights: &'a Weights,
    /// Reads a tile's piece of the light field.
    pub(crate) crop: &'a dyn Fn(&Tile) -> Result<LightField, PipelineError>,
}

/// A solve in tiles, and the folder of its results.
struct Work<'a> {
    solve: CutSolve<'a>,
    tiles: &'a Tiles,
    stamps: &'a Stamps,
}

impl Work<'_> {
    /// Returns the folder with the result of a tile in a round: the pixels that belong to the tile.
    fn place(&self, [round, number]: [usize; 2]) -> PathBuf {
        let tile = format!("round-{}/tile-{}", round + 1, number + 1);
        self.stamps.dir().join("cache").join(TILES).join(tile)
    }

    /// Solves a tile in a round, unless its result is current.
    fn tile(&self, at: [usize; 2], warm: Option<&LayerStack>, task: Task<'_>) -> Result<(), PipelineError> {
        let ([round, number], CutSolve { job, seed, display: whole, geometry, .. }) = (at, self.solve);
        task.cancel.check()?;
        // Cut display, target, weights and start to the tile.
        let tile = self.tiles.tiling.tile(number);
        let (display, target) = (tile.display(whole, geometry), (self.solve.crop)(&tile)?);
        let weights = tile.weights(self.solve.weights);
        let start = match round {
            0 => warm.map(|warm| warm.cut(&held(&tile))),
            _ => Some(self.borders(at, &tile, &display)?),
        };
        // Round values to the grey levels of the panel only in the last round.
        let is_last = round + 1 == self.tiles.rounds;
        let settings = Settings {
            iterations: self.tiles.iterations(job, round).len() as u32,
            levels: job.levels && is_last,
            report_every: Settings::curve_interval(job.iterations()),
            ..solver_settings(job, seed)?
        };
        // The key contains everything that the tile depends on, including its borders.
        let mut key = KeyBuilder::new("tile", code::PATTERNS);
        key.add("display", whole.without_panels().to_toml().as_bytes())
            .add("geometry", format!("{geometry:?}").as_bytes())
            .add("tile", format!("{tile:?}, {round}").as_bytes())
            .add("settings", format!("{settings:?}").as_bytes())
            .add_json("counts", &weights.is_some())
            .add_field("target", &target);
        add_weights(&mut key, weights.as_ref().unwrap_or(&Weights::Uniform));
        if let Some(start) = &start {
            add_stack(&mut key, start);
        }
        // Make a display of only the pixels that belong to the tile, since only these are kept.
        let mut of_own = display.clone();
        for (layer, part) in of_own.layers.iter_mut().zip(&tile.parts) {
            layer.resolution = [part.own.cols.len(), part.own.rows.len()];
        }
        if let (Backlight::Lenslets(lenslets), Some(part)) = (&mut of_own.backlight, tile.parts.last()) {
            lenslets.lenslets = [part.own.cols.len(), part.own.rows.len()];
        }
        let within: Vec<Region> = tile.parts.iter().map(|part| part.own.within(&part.held)).collect();
        let make = || {
            let (begun, mut steps) = (Instant::now(), Vec::new());
            let solved = match &weights {
                None => Err(FactorizeError::NoRays),
                Some(weights) => {
                    let problem = Problem { display: &display, target: &target, weights };
                    let tile = (&tile, self.tiles.tiling.map());
                    let start = (start.as_ref(), round > 0);
                    factorize_tile(&problem, tile, &settings, start, task, &mut |step| {
                        steps.push(Step::of(step, begun.elapsed().as_secs_f64()));
                    })
                }
            };
            match solved {
                Ok(solved) => Ok((solved.stack.cut(&within), Some(Convergence::of(&solved, steps, warm.is_some())))),
                // If no rays go through the tile, its pixels keep the values of the start. Without
                // a start they become clear.
                Err(FactorizeError::NoRays) => {
                    let unlit = start.clone().unwrap_or_else(|| clear(&display));
                    let problem = Problem { display: &display, target: &target, weights: &Weights::Uniform };
                    let unlit = if settings.levels { round_to_levels(&problem, &unlit) } else { unlit };
                    Ok((unlit.cut(&within), None))
                }
                Err(error) => Err(factorize_error(error)),
            }
        };
        let place = self.place(at);
        std::fs::create_dir_all(place.join("cache")).map_err(PipelineError::write(&place))?;
        reuse_or_make("tile", &key.finish(), &of_own, &Stamps::new(&place), make).map(drop)
    }

    /// Returns the patterns of the previous round, for all pixels that a tile solves or reads.
    fn borders(
        &self,
        [round, number]: [usize; 2],
        tile: &Tile,
        display: &Display,
    ) -> Result<LayerStack, PipelineError> {
        let mut patterns = LayerStack::filled(display, 0.0);
        for other in self.tiles.around(number) {
            let found = self.patterns([round - 1, other])?;
            patterns.paste(&held(tile), &found, &own(&self.tiles.tiling.tile(other)));
        }
        Ok(patterns)
    }

    fn patterns(&self, at: [usize; 2]) -> Result<LayerStack, PipelineError> {
        lumistack_field_io::read_stack(&self.place(at).join("layers")).map_err(field_error)
    }

    /// Writes the patterns of all tiles into one folder, and returns them.
    fn join(&self) -> Result<(LayerStack, Option<Convergence>), PipelineError> {
        let (layers, last) = (self.stamps.dir().join("layers"), self.tiles.rounds - 1);
        let mut writer = lumistack_field_io::StackWriter::begin(&layers, self.solve.display).map_err(field_error)?;
        for number in 0..self.tiles.count() {
            let patterns = self.patterns([last, number])?;
            writer.write(&own(&self.tiles.tiling.tile(number)), &patterns).map_err(field_error)?;
        }
        writer.finish().map_err(field_error)?;
        let kept = self.kept().ok_or_else(|| factorize_error(FactorizeError::NoRays))?;
        Ok((lumistack_field_io::read_stack(&layers).map_err(field_error)?, Some(kept)))
    }

    /// Joins the convergence of all tiles. Objectives are summed, so a ray through two tiles is
    /// counted twice. Times are summed as if the tiles were solved one after another. PSNR and KKT
    /// residual follow from mean squares over the pixels of all tiles.
    fn kept(&self) -> Option<Convergence> {
        let mut all: Option<Convergence> = None;
        let mut before = 0.0;
        for round in 0..self.tiles.rounds {
            let notes = (0..self.tiles.count()).filter_map(|number| {
                let path = self.place([round, number]).join("cache/convergence.json");
                let pixels = self.tiles.tiling.tile(number).field.size().iter().product::<usize>();
                Some((read_json::<Option<Convergence>>(&path)??, pixels as f64))
            });
            let notes: Vec<_> = notes.collect();
            let (first, _) = notes.first()?;
            let pixels: f64 = notes.iter().map(|(_, pixels)| pixels).sum();
            // This closure averages over tiles. The weights are the tiles' numbers of pixels.
            let mean = |of: &dyn Fn(&Convergence) -> f64| {
                notes.iter().map(|(kept, pixels)| pixels * of(kept)).sum::<f64>() / pixels
            };
            let psnr = |of: &dyn Fn(&Convergence) -> Option<f64>| {
                let error = mean(&|kept| of(kept).map_or(0.0, |psnr| 10f64.powf(-0.1 * psnr)));
                (error > 0.0).then(|| -10.0 * error.log10())
            };
            let begun = self.tiles.iterations(self.solve.job, round).start;
            // Skip the first point of a later round, which is the last point of the previous round.
            let steps = (usize::from(round > 0)..first.steps.len()).map(|i| Step {
                iteration: begun + first.steps[i].iteration,
                objective: notes.iter().filter_map(|(kept, _)| Some(kept.steps.get(i)?.objective)).sum(),
                psnr_view: psnr(&|kept| kept.steps.get(i)?.psnr_view),
                seconds: before + notes.iter().filter_map(|(kept, _)| Some(kept.steps.get(i)?.seconds)).sum::<f64>(),
            });
            let steps: Vec<_> = steps.collect();
            before = steps.last().map_or(before, |step| step.seconds);
            let level = |i: usize| psnr(&|kept| kept.levels?[i]);
            let levels = first.levels.is_some().then(|| [0, 1, 2].map(level));
            let kkt_residual = mean(&|kept| kept.kkt_residual.powi(2)).sqrt();
            let mut kept = all.take().unwrap_or_else(|| Convergence { steps: Vec::new(), ..first.clone() });
            (kept.kkt_residual, kept.levels) = (kkt_residual, levels);
            kept.steps.extend(steps);
            all = Some(kept);
        }
        all
    }
}

/// Returns patterns with maximum transmittance.
fn clear(display: &Display) -> LayerStack {
    let mut stack = LayerStack::filled(display, 1.0);
    for (layer, values) in display.layers.iter().zip(&mut stack.layers) {
        values.data_mut().fill(layer.range()[1]);
    }
    stack
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_share_the_iterations() {
        let display = Display::uniform([64, 48], 1.0, [3, 3], [10.0, 10.0], &[-1.0, 1.0], 2);
        let shares = |iterations: u32| {
            let job = FactorizeJob { iterations: Some(iterations), tiles: Some([2, 2]), ..Default::default() };
            let tiles = Tiles::of(&job, &display, &display.geometry().unwrap()).unwrap();
            (0..tiles.rounds()).map(|round| tiles.iterations(&job, round).len()).collect::<Vec<_>>()
        };
        assert_eq!([20, 16].map(shares), [vec![10, 5, 3, 2], vec![8, 4, 2, 2]]);
        assert_eq!([5, 2, 0].map(shares), [vec![2, 1, 1, 1], vec![1, 1], vec![0]]);
    }
}
