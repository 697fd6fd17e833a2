//! One colour channel of a display that is too large to hold everything: the target stays where it lies (a mapped file) and is read row by row, the
//! patterns exist once, and leave row by row.
//!
//! Channels are independent, so a colour display is three such problems, one after another. Block-exact steps without extrapolation, which
//! would need the patterns a second time.

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

/// Rounds of coordinate steps per update.
const SWEEPS: u32 = 2;

/// What one channel takes, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// The target where it lies: half floats.
    pub target: u64,
    /// Patterns in memory.
    pub patterns: u64,
    /// All else in memory, about.
    pub working: u64,
}

impl Estimate {
    /// For one channel of a display and the rays of a geometry.
    pub fn of(display: &Display, geometry: &FieldGeometry) -> Self {
        let [view_rows, view_cols] = geometry.grid.views();
        let (views, frames) = ((view_rows * view_cols) as u64, display.frames as u64);
        let (rows, cols) = (geometry.rows as u64, geometry.cols as u64);
        let layer = |[layer_cols, layer_rows]: [usize; 2]| {
            // lines are padded by the largest shift and two vectors
            4 * frames * (layer_rows as u64 + 1) * (layer_cols as u64 + cols / 8 + 4 * PAD as u64)
        };
        let mut patterns: u64 = display.layers.iter().map(|l| layer(l.resolution)).sum();
        if let Backlight::Lenslets(b) = &display.backlight {
            patterns += layer([b.lenslets[0] * b.views[0], b.lenslets[1] * b.views[1]]);
        }
        // ray tables, and per thread the buffers of a line
        let tables = display.layers.len() as u64 * (view_rows as u64 * rows + view_cols as u64 * cols) * 32;
        Self { target: 2 * views * rows * cols, patterns, working: tables + (64 << 20) }
    }
}

/// A factorization of one channel under way.
pub struct ChannelRun {
    engine: Engine,
}

impl ChannelRun {
    /// Begins near the content; target half floats `[view_y][view_x][row][col]`.
    ///
    /// # Errors
    /// If the display makes no sense, layers mix channels or neighbours, or the target has another size or values that are not finite.
    pub fn start(
        display: &Display,
        geometry: &FieldGeometry,
        target: LentTarget,
        seed: u64,
    ) -> Result<Self, FactorizeError> {
        display.check()?;
        let [view_rows, view_cols] = geometry.grid.views();
        let count = view_rows * view_cols * geometry.rows * geometry.cols;
        let values = (*target).as_ref();
        let unsuitable = |why: &'static str| Err(FactorizeError::Unsuitable { solver: "one channel", why });
        if values.len() != count || geometry.cols < PAD {
            return unsuitable("the target has not the size of the geometry, or fewer than 16 columns");
        }
        if display.layers.iter().any(|layer| layer.response().is_some()) {
            return unsuitable("layers with blur, crosstalk or tied channels need all channels at once");
        }
        const EXPONENT: u16 = 0x7c00;
        if !crate::bands::all(values, |part| part.iter().all(|half| half & EXPONENT != EXPONENT)) {
            return unsuitable("the target has values that are not finite");
        }
        let plan = Plan::with_target(display, geometry, Target::lent(geometry, display.brightness, target));
        let (factors, formation) = (plan.maps.len() as f32, display.formation);
        let start = |plan: &Plan, range: [f32; 2], at: LineOf, values: &mut [f32]| {
            fill_line(plan, at, formation, factors, range, seed, values);
        };
        Ok(Self { engine: Engine::by_lines(plan, display, start) })
    }

    /// One iteration: every layer, and the backlight, once.
    ///
    /// # Errors
    /// When cancelled, which is asked for every line.
    pub fn step(&mut self, cancel: &Cancel) -> Result<(), Cancelled> {
        self.engine.cancel = cancel.clone();
        for n in 0..self.engine.plan().factor_count() {
            self.engine.update(n, Rule::Block { sweeps: SWEEPS }, None);
            cancel.check()?;
        }
        Ok(())
    }

    /// Ends the run, see [`crate::Run::settle`].
    pub fn settle(&mut self) -> f64 {
        self.engine.settle()
    }

    /// The objective of the present patterns.
    pub fn objective(&mut self) -> Objective {
        self.engine.objective()
    }

    /// Number of rays that meet the display.
    pub fn rays(&self) -> u64 {
        self.engine.plan().rays
    }

    /// Row `line` of layer `n` in frame `frame`; the backlight follows the layers, its lines ordered `[bin_y][lenslet_row]` and its columns
    /// `[bin_x][lenslet_col]`.
    pub fn row(&self, n: usize, frame: usize, line: usize) -> &[f32] {
        self.engine.row(n, 0, line, frame)
    }
}

/// The content start of one line, with noise that is not blurred.
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
