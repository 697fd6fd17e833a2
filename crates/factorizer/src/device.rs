//! Where patterns live and are updated: this machine's processor, or another device.
//!
//! Solvers are schedules: which factor is updated when, how far to go beyond a step, when to restart. They hold an [`Updater`], which does the work, and
//! never look at its patterns. [`Processor`](crate::Processor) is the executor of this crate; another one gets the same [`Plan`], whose tables say which
//! pixels every ray reads, and gives the same results up to rounding.

use std::ops::Range;
use std::sync::Arc;

use lumistack_core::Cancel;
use lumistack_display::{Display, Formation, LayerStack, Tap};

use crate::FactorizeError;
use crate::solver::Objective;

pub use crate::errors::ErrorSum;
pub use crate::factor::Factor;
pub use crate::line::Outcome;
pub use crate::plan::Plan;
pub use crate::row::Row;
pub use crate::step::Rule;

/// Makes [`Updater`]s.
pub trait Executor: Sync {
    /// Takes patterns over.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] where the device cannot do this.
    fn begin(&self, begin: Begin) -> Result<Box<dyn Updater>, FactorizeError>;
}

/// What a run begins with.
pub struct Begin {
    /// The problem as tables.
    pub plan: Arc<Plan>,
    /// The display.
    pub display: Display,
    /// The box of each factor's values.
    pub ranges: Vec<[f32; 2]>,
    /// Layers rear to front, then the directional backlight; values within their boxes.
    pub factors: Vec<Factor>,
    /// Where L̃ is not linear in a factor: whether updates try the curvature at the present point before the bound that holds everywhere.
    pub bold: bool,
}

/// Part of the objective that an update must leave for the rest to be known from its gain, whose terms are f32.
const LEAST_LEFT: f64 = 0.01;

/// Patterns under way, wherever they live.
pub trait Updater {
    /// The problem.
    fn plan(&self) -> &Arc<Plan>;

    /// The display.
    fn display(&self) -> &Display;

    /// See [`Begin::bold`].
    fn bold(&self) -> bool;

    /// Asks this before parts of an update; where it is set, what is left stays as it is.
    fn heed(&mut self, cancel: &Cancel);

    /// Updates factor `n` from the present state of all. With `beyond`, rays then read the point that lies so much further along the way from the step
    /// before, within the box. `local` takes the curvature at the present point where L̃ is not linear.
    fn apply(&mut self, n: usize, rule: Rule, beyond: Option<f32>, local: bool);

    /// What the last [`apply`](Self::apply) saw and gained.
    fn outcome(&mut self) -> Outcome;

    /// Keeps factor `n` as it is now.
    fn keep(&mut self, n: usize);

    /// Returns factor `n` to what was kept.
    fn take_back(&mut self, n: usize);

    /// Sums of errors of what rays read.
    fn errors(&mut self) -> ErrorSum;

    /// Exchanges the patterns for where the last steps ended, or back; nothing where no step went beyond.
    fn swap_latest(&mut self);

    /// Drops what lies beyond where the last steps ended.
    fn return_to_latest(&mut self);

    /// Whether the patterns are still there.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if not.
    fn check(&self) -> Result<(), FactorizeError>;

    /// The patterns that are stored.
    fn download(&mut self) -> LayerStack;

    /// The same, at the end.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    fn into_stack(self: Box<Self>) -> Result<LayerStack, FactorizeError>;

    /// The stored values, at the end.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    fn into_factors(self: Box<Self>) -> Result<Vec<Factor>, FactorizeError>;

    /// [`apply`](Self::apply) by the rule's best curvature.
    ///
    /// The local curvature is a guess that pays: where the objective rises all the same, the update is taken back and done by the bound.
    fn update(&mut self, n: usize, rule: Rule, beyond: Option<f32>) {
        if !self.bold() || self.plan().is_bounded(n) || rule == Rule::Probe {
            return self.apply(n, rule, beyond, false);
        }
        let before = self.errors().weighted;
        self.keep(n);
        self.apply(n, rule, None, true);
        if self.errors().weighted > before {
            self.take_back(n);
            self.apply(n, rule, None, false);
        }
    }

    /// The objective of what rays read.
    fn objective(&mut self) -> Objective {
        let sums = self.errors();
        objective_of(self.plan(), self.display(), sums)
    }

    /// The objective after an update of factor `n` with this outcome, where that is known: every ray that counts reads one pixel of the factor, whose
    /// steps are exact, and all count alike.
    fn seen(&self, n: usize, outcome: Outcome) -> Option<Objective> {
        let (plan, map) = (self.plan(), &self.plan().maps[n]);
        let stored_is_met = self.display().layers.get(n).is_none_or(|layer| layer.response().is_none());
        // pixels of a tile that may not change keep their error
        let all_step = map.complete && plan.free(n).is_none();
        let exact = plan.is_product() && map.nearest && all_step && stored_is_met;
        // where next to nothing is left, that is rounding
        let left = outcome.error - outcome.gain;
        let known = exact && plan.target.is_uniform() && left > LEAST_LEFT * outcome.error;
        known.then(|| objective_of(plan, self.display(), ErrorSum { weighted: left, plain: left }))
    }

    /// Root mean square, over all values, of the change of the emission that an exact coordinate step within the box would still make: 0 at a
    /// first-order (KKT) point.
    fn unsettled(&mut self) -> f64 {
        self.over_all(Rule::Probe)
    }

    /// The same, and each value that next to no light reaches becomes the darkest. Only where layers attenuate: elsewhere no value is darkness.
    fn settle(&mut self) -> f64 {
        let rule = if self.plan().is_product() { Rule::Settle } else { Rule::Probe };
        self.over_all(rule)
    }

    /// Root mean square of what a rule finds in all factors.
    fn over_all(&mut self, rule: Rule) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for n in 0..self.plan().factor_count() {
            self.update(n, rule, None);
            sum += self.outcome().gain;
            let plan = self.plan();
            count += plan.target.channels * plan.changing(n) * plan.maps[n].layout.frames;
        }
        (sum / count as f64).sqrt()
    }
}

/// From sums with weights relative to the largest.
fn objective_of(plan: &Plan, display: &Display, sums: ErrorSum) -> Objective {
    let target = &plan.target;
    let mean = sums.plain / (target.channels as u64 * plan.rays) as f64;
    Objective {
        value: target.weight_scale * sums.weighted,
        psnr_view: -10.0 * mean.log10() + 20.0 * display.brightness.log10(),
    }
}

/// The tables, as other crates read them.
impl Plan {
    /// View rows and view columns.
    pub fn views(&self) -> [usize; 2] {
        self.views
    }

    /// Field rows and field columns.
    pub fn field(&self) -> [usize; 2] {
        [self.rows, self.cols]
    }

    /// Colour channels.
    pub fn channels(&self) -> usize {
        self.target.channels
    }

    /// Frames M.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Layers N, without a directional backlight.
    pub fn layer_count(&self) -> usize {
        self.layers
    }

    /// How layers act together.
    pub fn formation(&self) -> Formation {
        self.formation
    }

    /// β.
    pub fn brightness(&self) -> f32 {
        self.target.brightness
    }

    /// Σ w a_m² of a pixel, relative to Σ w over its rays, up to which [`Rule::Settle`] takes it as unlit.
    pub fn unlit_share(&self) -> f32 {
        crate::unlit::share(self)
    }

    /// Lines and columns of factor `n`: of a directional backlight bins times lenslets.
    pub fn size(&self, n: usize) -> [usize; 2] {
        [self.maps[n].layout.lines(), self.maps[n].layout.cols()]
    }

    /// What a ray reads that misses factor `n`.
    pub fn outside(&self, n: usize) -> f32 {
        self.maps[n].layout.outside
    }

    /// Whether every ray reads one pixel of factor `n` alone.
    pub fn is_nearest(&self, n: usize) -> bool {
        self.maps[n].nearest
    }

    /// Whether few enough rays meet every pixel of factor `n` for a plain sum in f32.
    pub fn has_short_sums(&self, n: usize) -> bool {
        self.maps[n].short_sums
    }

    /// Column of factor `n` that rays of a view column and field column read; `None` where they miss it.
    pub fn column(&self, n: usize, view_x: usize, col: usize) -> Option<Tap> {
        let (x, pad) = (&self.maps[n].x[view_x], self.maps[n].layout.pad as u32);
        // a miss reads the first value of the padding
        let own = |at: u32| at.checked_sub(pad);
        Some(Tap { first: own(x.first[col])?, second: own(x.second[col])?, t: x.t[col] })
    }

    /// Line of factor `n` that rays of a view row and field row read; `None` where they miss it.
    pub fn line(&self, n: usize, view_y: usize, row: usize) -> Option<Tap> {
        let tap = self.maps[n].y[view_y][row];
        let hit = (tap.first as usize) < self.maps[n].layout.lines();
        hit.then_some(Tap { first: tap.first, second: tap.second, t: tap.t })
    }

    /// Field columns whose rays count in a view column.
    pub fn counted_columns(&self, view_x: usize) -> &[Range<usize>] {
        &self.runs[view_x]
    }

    /// Whether the rays of a field row count in a view row.
    pub fn counts_row(&self, view_y: usize, row: usize) -> bool {
        self.valid_rows[view_y][row]
    }

    /// Whether L is kept in half floats.
    pub fn has_half_target(&self) -> bool {
        matches!(self.target.row(0, 0, 0), Row::Half(_))
    }

    /// One row of L of a view.
    pub fn target_row(&self, channel: usize, view: [usize; 2], row: usize) -> Row<'_> {
        self.target.row(channel, self.view(view[0], view[1]), row).part(0..self.cols)
    }

    /// One row of √w of a view, weights relative to the largest; `None` where all are 1.
    pub fn weights_row(&self, view: [usize; 2], row: usize) -> Option<&[f32]> {
        let weights = self.target.weights(self.view(view[0], view[1]), row)?;
        Some(&weights[crate::factor::PAD..][..self.cols])
    }
}

/// Values, as other crates read and write them.
impl Factor {
    /// Values of factor `n` of a plan, all as where rays miss it.
    pub fn of(plan: &Plan, n: usize) -> Self {
        Self::blank(&plan.maps[n].layout, plan.target.channels)
    }

    /// One row of one frame.
    pub fn values(&self, channel: usize, line: usize, frame: usize) -> &[f32] {
        &self.row(channel, line, frame)[self.layout.pad..][..self.layout.cols()]
    }

    /// The same, to be written.
    pub fn values_mut(&mut self, channel: usize, line: usize, frame: usize) -> &mut [f32] {
        let layout = &self.layout;
        let at = (channel * layout.stored_lines() + line) * layout.line_len() + frame * layout.stride + layout.pad;
        let cols = layout.cols();
        &mut self.values[at..at + cols]
    }
}

/// The patterns of a display from the values of its factors.
pub fn stack_of<'a>(display: &Display, factors: impl Iterator<Item = &'a Factor>) -> LayerStack {
    // zeros that nobody has touched are no memory yet
    let mut stack = LayerStack::filled(display, 0.0);
    let layers = stack.layers.iter_mut().map(|layer| layer.data_mut());
    for (factor, tensor) in factors.zip(layers.chain(stack.emission.iter_mut().map(|e| e.data_mut()))) {
        lumistack_core::pages::prefer_large_pages(tensor);
        factor.download(tensor);
    }
    stack
}
