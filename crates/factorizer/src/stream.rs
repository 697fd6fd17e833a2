//! One colour channel of a display whose light field is larger than memory.
//!
//! The target stays in its mapped file and is read row by row. The patterns are returned row by
//! row. One copy of a layer is in memory if all rays of a view read the layer at a constant shift
//! of whole pixels. Otherwise an update needs a second copy. Channels are independent, so a colour
//! display is three such problems in sequence. Updates are block-exact without extrapolation, which
//! would need a further copy of all patterns.

use lumistack_core::seed::{Stream, derive};
use lumistack_core::{Cancel, Cancelled};
use lumistack_display::{Backlight, Display, FieldGeometry, Formation};

use crate::device::Updater;
use crate::engine::Engine;
use crate::factor::PAD;
use crate::line::LineOf;
use crate::plan::Plan;
use crate::start::{CONTENT_NOISE, level, line_means};
use crate::step::Rule;
use crate::target::{LentTarget, Target};
use crate::{FactorizeError, Objective};

/// Number of sweeps of coordinate steps per update.
const SWEEPS: u32 = 2;

/// Size of the storage of one channel, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// The target in its file: half floats.
    pub target: u64,
    /// The patterns in memory.
    pub patterns: u64,
    /// Estimate of all other memory.
    pub working: u64,
}

impl Estimate {
    /// Estimates the storage of one channel of a display, for the rays of a geometry.
    pub fn of(display: &Display, geometry: &FieldGeometry) -> Self {
        let [view_rows, view_cols] = geometry.grid.views();
        let (views, frames) = ((view_rows * view_cols) as u64, display.frames as u64);
        let (rows, cols) = (geometry.rows as u64, geometry.cols as u64);
        let layer = |[layer_cols, layer_rows]: [usize; 2]| {
            // padding per line: an eighth of the columns for the largest shift, and four vectors
            4 * frames * (layer_rows as u64 + 1) * (layer_cols as u64 + cols / 8 + 4 * PAD as u64)
        };
        let mut patterns: u64 = display.layers.iter().map(|l| layer(l.resolution)).sum();
        if let Backlight::Lenslets(b) = &display.backlight {
            patterns += layer([b.lenslets[0] * b.views[0], b.lenslets[1] * b.views[1]]);
        }
        // all other memory: ray tables, and every thread's buffers for a line
        let tables = display.layers.len() as u64 * (view_rows as u64 * rows + view_cols as u64 * cols) * 32;
        Self { target: 2 * views * rows * cols, patterns, working: tables + (64 << 20) }
    }
}

/// A factorization of one colour channel in progress.
pub struct ChannelRun {
    engine: Engine,
}

impl ChannelRun {
    /// Starts a run from the level of [`StartKind::Content`](crate::StartKind::Content) times
    /// noise. `target` has half floats in the order `[view_y][view_x][row][col]`.
    ///
    /// # Errors
    /// If the display is invalid, or if layers have blur, crosstalk, colour filters or tied
    /// channels. Also if the target has another size, fewer than 16 columns, or values that are not
    /// finite.
    pub fn start(
        display: &Display,
        geometry: &FieldGeometry,
        target: LentTarget,
        seed: u64,
    ) -> Result<Self, FactorizeError> {
        // refuse targets of another size or with invalid values, and displays whose layers need all
        // channels together
        display.check()?;
        let [view_rows, view_cols] = geometry.grid.views();
        let count = view_rows * view_cols * geometry.rows * geometry.cols;
        let values = (*target).as_ref();
        let unsuitable = |why: &'static str| Err(FactorizeError::Unsuitable { solver: "one channel", why });
        if values.len() != count || geometry.cols < PAD {
            return unsuitable(
                "expected a target of the geometry's size with at least 16 columns, found another size or fewer columns",
            );
        }
        if display.layers.iter().any(|layer| layer.response().is_some()) {
            return unsuitable(
                "expected layers without blur, crosstalk, colour filters or one value for all channels, found a layer with one of these properties",
            );
        }
        const EXPONENT: u16 = 0x7c00;
        if !crate::bands::all(values, |part| part.iter().all(|half| half & EXPONENT != EXPONENT)) {
            return unsuitable("expected a target of finite values, found values that are not finite");
        }
        // start each line from the mean of its rays
        let plan = Plan::with_target(display, geometry, Target::lent(geometry, display.brightness, target));
        let (factors, formation) = (plan.maps.len() as f32, display.formation);
        let start = |plan: &Plan, range: [f32; 2], at: LineOf, values: &mut [f32]| {
            fill_line(plan, at, formation, factors, range, seed, values);
        };
        Ok(Self { engine: Engine::by_lines(plan, display, start) })
    }

    /// Runs one iteration: updates every layer and the backlight once.
    ///
    /// # Errors
    /// When cancelled; the check is made per line.
    pub fn step(&mut self, cancel: &Cancel) -> Result<(), Cancelled> {
        self.engine.cancel = cancel.clone();
        for n in 0..self.engine.plan().factor_count() {
            self.engine.update(n, Rule::Block { sweeps: SWEEPS }, None);
            cancel.check()?;
        }
        Ok(())
    }

    /// Ends the run, and returns the KKT residual; see [`crate::Run::darken_unlit`].
    pub fn darken_unlit(&mut self) -> f64 {
        self.engine.darken_unlit()
    }

    /// Computes the objective of the current patterns.
    pub fn objective(&mut self) -> Objective {
        self.engine.objective()
    }

    /// Returns the number of valid rays; see [`crate::Run::rays`].
    pub fn rays(&self) -> u64 {
        self.engine.plan().rays
    }

    /// Returns row `line` of layer `n` in frame `frame`. The backlight follows the layers; its
    /// lines are ordered `[bin_y][lenslet_row]` and its columns `[bin_x][lenslet_col]`.
    pub fn row(&self, n: usize, frame: usize, line: usize) -> &[f32] {
        self.engine.row(n, 0, line, frame)
    }
}

/// Fills one line. Each value is the level of the pixel, times noise without blur. The level
/// follows from the mean target of the pixel's rays.
fn fill_line(
    plan: &Plan,
    at: LineOf,
    formation: Formation,
    factors: f32,
    [low, high]: [f32; 2],
    seed: u64,
    values: &mut [f32],
) {
    let layout = &plan.maps[at.factor].layout;
    let means = line_means(plan, at);
    let mut noise = Stream::new(derive(seed, &[at.factor as u64, at.channel as u64, at.line as u64]));
    for row in values.chunks_exact_mut(layout.stride) {
        for (value, [sum, count]) in row[layout.pad..layout.pad + layout.cols()].iter_mut().zip(&means) {
            let level = level(formation, (sum / count.max(1.0)).max(0.0), factors);
            let [least, most] = CONTENT_NOISE;
            *value = (level * (least + (most - least) * noise.next_f32())).clamp(low.max(crate::FLOOR).min(high), high);
        }
    }
}
