//! The interface of devices that hold and update patterns, such as this machine's processor.
//!
//! A solver is a schedule: it chooses the factor to update, the extrapolation, and restarts. An
//! [`Updater`] does all computation; the solver never reads the updater's patterns.
//! [`Processor`](crate::Processor) is the executor of this crate. An executor of another crate gets
//! the same [`Plan`], whose tables define the pixels that every ray reads. So the results of all
//! executors agree up to rounding.

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

/// A device that can run factorizations.
pub trait Executor: Sync {
    /// Receives the patterns of a run and returns their updater.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if the device cannot solve the problem.
    fn begin(&self, begin: Begin) -> Result<Box<dyn Updater>, FactorizeError>;
}

/// The initial state of a run.
pub struct Begin {
    /// The problem as tables.
    pub plan: Arc<Plan>,
    /// The display, whose hardware limits the values.
    pub display: Display,
    /// Box [low, high] of each factor's values.
    pub ranges: Vec<[f32; 2]>,
    /// Layers rear to front, then the directional backlight; values within their boxes.
    pub factors: Vec<Factor>,
    /// True if an update first takes the curvature at the current point, and an upper bound of the
    /// curvature only if the objective rises. This matters only if L̃ is not linear in a factor.
    pub tries_local: bool,
}

/// If a step leaves more than this fraction of the error, error − gain is used as the objective. A
/// smaller difference would be mostly rounding, since the gain's terms are f32.
const LEAST_LEFT: f64 = 0.01;

/// The patterns of a run, on any device.
pub trait Updater {
    /// Returns the problem's tables.
    fn plan(&self) -> &Arc<Plan>;

    /// Returns the display.
    fn display(&self) -> &Display;

    /// Returns [`Begin::tries_local`].
    fn tries_local(&self) -> bool;

    /// Sets the flag that cancels updates. An update reads the flag before it begins, and on the
    /// processor before every line. After a cancellation, values that are not updated yet stay as
    /// they are.
    fn set_cancel(&mut self, cancel: &Cancel);

    /// Updates factor `n` by the current values of all factors.
    ///
    /// With `extrapolation` = β_k, rays then read the extrapolated values x + β_k (x − x'), clamped
    /// to the box. x is the new iterate, and x' the previous iterate. If L̃ is not linear, `local`
    /// selects the curvature at the current point instead of its upper bound.
    fn apply(&mut self, n: usize, rule: Rule, extrapolation: Option<f32>, local: bool);

    /// Returns error and gain of the last [`apply`](Self::apply).
    fn outcome(&mut self) -> Outcome;

    /// Saves the values of factor `n`.
    fn save(&mut self, n: usize);

    /// Restores the saved values of factor `n`.
    fn restore(&mut self, n: usize);

    /// Sums the squared errors over all rays, at the values that rays read.
    fn errors(&mut self) -> ErrorSum;

    /// Exchanges the extrapolated patterns and the last iterate; does nothing without an
    /// extrapolation.
    fn swap_latest(&mut self);

    /// Replaces the extrapolated patterns by the last iterate.
    fn restart(&mut self);

    /// Checks that the patterns still exist.
    ///
    /// # Errors
    /// [`FactorizeError::Device`] if the device has lost the patterns.
    fn check(&self) -> Result<(), FactorizeError>;

    /// Returns the stored patterns.
    fn download(&mut self) -> LayerStack;

    /// Ends the run and returns its stored patterns.
    ///
    /// # Errors
    /// The errors of [`check`](Self::check).
    fn into_stack(self: Box<Self>) -> Result<LayerStack, FactorizeError>;

    /// Ends the run and returns the stored values of its factors.
    ///
    /// # Errors
    /// The errors of [`check`](Self::check).
    fn into_factors(self: Box<Self>) -> Result<Vec<Factor>, FactorizeError>;

    /// Runs [`apply`](Self::apply), and chooses the curvature.
    ///
    /// The update runs once, with the upper bound of the curvature, in three cases:
    /// [`tries_local`](Self::tries_local) is false, L̃ is linear in factor `n`, or the rule is
    /// [`Rule::KktResidual`]. Otherwise the update does not extrapolate. It runs first with the
    /// curvature at the current point, which usually gains more. If this step raises the objective,
    /// it is undone, and repeated with the upper bound.
    fn update(&mut self, n: usize, rule: Rule, extrapolation: Option<f32>) {
        if !self.tries_local() || self.plan().is_bounded(n) || rule == Rule::KktResidual {
            return self.apply(n, rule, extrapolation, false);
        }
        let before = self.errors().weighted;
        self.save(n);
        self.apply(n, rule, None, true);
        if self.errors().weighted > before {
            self.restore(n);
            self.apply(n, rule, None, false);
        }
    }

    /// Computes the objective of the values that rays read.
    fn objective(&mut self) -> Objective {
        let sums = self.errors();
        objective_of(self.plan(), self.display(), sums)
    }

    /// Computes the objective after an update of factor `n` from the update's outcome.
    ///
    /// Returns `None` unless the outcome determines the objective. For this, layers must attenuate,
    /// and all weights must be 1. Every ray must read exactly one pixel of the factor, and this
    /// pixel must be free to step. Rays must read the stored values, and more than 1 % of the error
    /// must remain.
    fn objective_after(&self, n: usize, outcome: Outcome) -> Option<Objective> {
        let (plan, map) = (self.plan(), &self.plan().maps[n]);
        let stored_is_read = self.display().layers.get(n).is_none_or(|layer| layer.response().is_none());
        // The outcome is exact only if the update steps the pixel of every ray. Fixed pixels of a
        // tile make no step; `sees_all_rays` excludes tiles with such pixels.
        let exact = plan.is_product() && map.nearest && plan.sees_all_rays(n) && stored_is_read;
        // a remainder much smaller than the error is only rounding
        let left = outcome.error - outcome.gain;
        let known = exact && plan.target.is_uniform() && left > LEAST_LEFT * outcome.error;
        known.then(|| objective_of(plan, self.display(), ErrorSum { weighted: left, plain: left }))
    }

    /// Computes the KKT residual. For every value, an exact coordinate step within the box would
    /// change the emission by some amount. The residual is the root mean square of these amounts
    /// over all values that may change. It is 0 at a first-order (KKT) point.
    fn kkt_residual(&mut self) -> f64 {
        self.over_all(Rule::KktResidual)
    }

    /// Computes the [`kkt_residual`](Self::kkt_residual), and darkens unlit values if layers
    /// attenuate. In other formations no value is unlit.
    fn darken_unlit(&mut self) -> f64 {
        let rule = if self.plan().is_product() { Rule::Darken } else { Rule::KktResidual };
        self.over_all(rule)
    }

    /// Updates every factor by a rule. Returns the root of the mean gain per value that may change.
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

/// Computes the objective from sums whose weights are relative to the largest weight.
fn objective_of(plan: &Plan, display: &Display, sums: ErrorSum) -> Objective {
    let target = &plan.target;
    let mean = sums.plain / (target.channels as u64 * plan.rays) as f64;
    Objective {
        value: target.weight_scale * sums.weighted,
        psnr_view: -10.0 * mean.log10() + 20.0 * display.brightness.log10(),
    }
}

/// The tables for executors in other crates.
impl Plan {
    /// Returns the numbers of view rows and view columns.
    pub fn views(&self) -> [usize; 2] {
        self.views
    }

    /// Returns the numbers of field rows and field columns.
    pub fn field(&self) -> [usize; 2] {
        [self.rows, self.cols]
    }

    /// Returns the number of colour channels.
    pub fn channels(&self) -> usize {
        self.target.channels
    }

    /// Returns the number of frames M.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Returns the number of layers N, without a directional backlight.
    pub fn layer_count(&self) -> usize {
        self.layers
    }

    /// Returns the image formation: the rule by which layers form the light of a ray.
    pub fn formation(&self) -> Formation {
        self.formation
    }

    /// Returns the brightness β, 0..1.
    pub fn brightness(&self) -> f32 {
        self.target.brightness
    }

    /// For [`Rule::Darken`], returns the largest Σ w a_m² at which a pixel's value is unlit,
    /// divided by Σ w over the pixel's rays. Here a_m is M times the derivative of L̃ by the
    /// pixel's value in frame m.
    pub fn unlit_share(&self) -> f32 {
        crate::unlit::share(self)
    }

    /// Returns the numbers of lines and columns of factor `n`. For a directional backlight, each is
    /// the product of bins and lenslets along that axis.
    pub fn size(&self, n: usize) -> [usize; 2] {
        [self.maps[n].layout.lines(), self.maps[n].layout.cols()]
    }

    /// Returns the value that rays read if they miss factor `n`.
    pub fn outside(&self, n: usize) -> f32 {
        self.maps[n].layout.outside
    }

    /// Returns true if every ray that hits factor `n` reads one of its pixels, not a mixture.
    pub fn is_nearest(&self, n: usize) -> bool {
        self.maps[n].nearest
    }

    /// Returns true if so few rays read each pixel of factor `n` that a plain sum in f32 is
    /// precise.
    pub fn has_short_sums(&self, n: usize) -> bool {
        self.maps[n].short_sums
    }

    /// Returns the columns of factor `n` that rays of a view column and field column read; `None`
    /// if they miss it.
    pub fn column(&self, n: usize, view_x: usize, col: usize) -> Option<Tap> {
        let (x, pad) = (&self.maps[n].x[view_x], self.maps[n].layout.pad as u32);
        // a miss has the index 0, which is in the padding
        let own = |at: u32| at.checked_sub(pad);
        Some(Tap { first: own(x.first[col])?, second: own(x.second[col])?, t: x.t[col] })
    }

    /// Returns the lines of factor `n` that rays of a view row and field row read; `None` if they
    /// miss it.
    pub fn line(&self, n: usize, view_y: usize, row: usize) -> Option<Tap> {
        let tap = self.maps[n].y[view_y][row];
        let hit = (tap.first as usize) < self.maps[n].layout.lines();
        hit.then_some(Tap { first: tap.first, second: tap.second, t: tap.t })
    }

    /// Returns the field columns whose rays are valid in a view column.
    pub fn counted_columns(&self, view_x: usize) -> &[Range<usize>] {
        &self.runs[view_x]
    }

    /// Returns true if the rays of a field row are valid in a view row.
    pub fn counts_row(&self, view_y: usize, row: usize) -> bool {
        self.valid_rows[view_y][row]
    }

    /// Returns true if L is stored in half floats.
    pub fn has_half_target(&self) -> bool {
        matches!(self.target.row(0, 0, 0), Row::Half(_))
    }

    /// Returns one row of L of a view `[view_y, view_x]`.
    pub fn target_row(&self, channel: usize, view: [usize; 2], row: usize) -> Row<'_> {
        self.target.row(channel, self.view(view[0], view[1]), row).part(0..self.cols)
    }

    /// Returns one row of √w of a view, with weights relative to the largest weight. `None` for
    /// [`Weights::Uniform`](lumistack_display::Weights::Uniform).
    pub fn weights_row(&self, view: [usize; 2], row: usize) -> Option<&[f32]> {
        let weights = self.target.weights(self.view(view[0], view[1]), row)?;
        Some(&weights[crate::factor::PAD..][..self.cols])
    }
}

/// Values for executors in other crates.
impl Factor {
    /// Allocates factor `n` of a plan; every value is the value that rays read if they miss the
    /// factor.
    pub fn of(plan: &Plan, n: usize) -> Self {
        Self::blank(&plan.maps[n].layout, plan.target.channels)
    }

    /// Returns one row of one frame.
    pub fn values(&self, channel: usize, line: usize, frame: usize) -> &[f32] {
        &self.row(channel, line, frame)[self.layout.pad..][..self.layout.cols()]
    }

    /// Returns the row of [`values`](Self::values) for writing.
    pub fn values_mut(&mut self, channel: usize, line: usize, frame: usize) -> &mut [f32] {
        let layout = &self.layout;
        let at = (channel * layout.stored_lines() + line) * layout.line_len() + frame * layout.stride + layout.pad;
        let cols = layout.cols();
        &mut self.values[at..at + cols]
    }
}

/// Copies the values of a display's factors into a layer stack.
pub fn stack_of<'a>(display: &Display, factors: impl Iterator<Item = &'a Factor>) -> LayerStack {
    // the new zeros occupy no memory before the first write, so large pages can still be requested
    let mut stack = LayerStack::filled(display, 0.0);
    let layers = stack.layers.iter_mut().map(|layer| layer.data_mut());
    for (factor, tensor) in factors.zip(layers.chain(stack.emission.iter_mut().map(|e| e.data_mut()))) {
        lumistack_core::pages::prefer_large_pages(tensor);
        factor.download(tensor);
    }
    stack
}
