//! The state of a run on the processor (CPU), and the update of one factor.

use std::sync::Arc;

use lumistack_core::{Cancel, Tensor};
use lumistack_display::{Display, LayerStack, Response};

use crate::aligned::Aligned;
use crate::between::{self, BetweenBand, BetweenFunctions};
use crate::device::{Begin, Executor, Updater, stack_of};
use crate::errors::{ErrorFunctions, ErrorSum, RowErrors};
use crate::factor::{Factor, Layout};
use crate::gather::{self, GatherFunctions, GatherLine};
use crate::line::{LineOf, LineStep, Outcome, StepFunctions};
use crate::plan::Plan;
use crate::prepared::ranges_of;
use crate::respond::{self, AdjointSums, StepLine};
use crate::scatter::{self, ScatterBand, ScatterFunctions};
use crate::scratch::Scratch;
use crate::step::{Block, Levels, Rule};
use crate::sums::SumLine;
use crate::{FactorizeError, bands, unlit};

/// The executor that runs on this machine's processor.
#[derive(Clone, Copy, Debug, Default)]
pub struct Processor;

impl Executor for Processor {
    fn begin(&self, begin: Begin) -> Result<Box<dyn Updater>, FactorizeError> {
        Ok(Box::new(Engine::begin(begin)))
    }
}

/// The patterns of a run on the processor.
pub struct Engine {
    plan: Arc<Plan>,
    display: Display,
    /// Values that rays read: layers rear to front, then the backlight.
    factors: Vec<Factor>,
    /// For each factor with a response, such as blur: the response and the stored values. Rays read
    /// the values that the response makes of the stored values.
    stored: Vec<Option<(Response, Factor)>>,
    /// For each factor whose values are confined to levels: these levels, and the frames that are
    /// confined.
    pub(crate) levels: Vec<Option<Levels>>,
    /// The last iterate, if rays read extrapolated values; otherwise empty.
    latest: Vec<Aligned>,
    /// Memory for the new values of factors that cannot be updated in place.
    spare: Aligned,
    /// Box [low, high] of each factor's values.
    ranges: Vec<[f32; 2]>,
    fast: bool,
    /// The flag that cancels updates. It is read before every line; once it is set, the remaining
    /// lines keep their values.
    pub(crate) cancel: Cancel,
    tries_local: bool,
    outcome: Outcome,
    /// The values that [`Updater::save`] saved: the values that rays read, and the stored values if
    /// they differ.
    saved: Option<(Aligned, Option<Aligned>)>,
}

impl Engine {
    pub(crate) fn begin(begin: Begin) -> Self {
        let Begin { plan, display, ranges, factors, tries_local } = begin;
        Self { tries_local, ..Self::with_factors(plan, &display, ranges, factors) }
    }

    fn with_factors(plan: Arc<Plan>, display: &Display, ranges: Vec<[f32; 2]>, mut factors: Vec<Factor>) -> Self {
        let responses = display.layers.iter().map(|layer| layer.response()).chain(std::iter::repeat(None));
        let stored = factors.iter_mut().zip(responses).map(|(effective, response)| {
            let response = response?;
            let mut stored = effective.clone();
            if response.is_tied() {
                respond::tie(&mut stored);
            }
            respond::respond(&response, &stored, &mut effective.values);
            Some((response, stored))
        });
        Self {
            stored: stored.collect(),
            levels: vec![None; plan.maps.len()],
            display: display.clone(),
            latest: Vec::new(),
            spare: Aligned::default(),
            ranges,
            fast: true,
            cancel: Cancel::default(),
            tries_local: false,
            outcome: Outcome::default(),
            saved: None,
            plan,
            factors,
        }
    }

    /// Allocates the patterns of one channel. `start(plan, range, line, values)` fills one line in
    /// all frames.
    pub(crate) fn by_lines(
        plan: Plan,
        display: &Display,
        start: impl Fn(&Plan, [f32; 2], LineOf, &mut [f32]) + Sync,
    ) -> Self {
        let ranges = ranges_of(display);
        let start_factor = |(n, range): (usize, &[f32; 2])| {
            let layout = &plan.maps[n].layout;
            let mut factor = Factor::blank(layout, plan.target.channels);
            bands::for_each_chunk(
                &mut factor.values,
                layout.line_len(),
                || (),
                |(), index, values| {
                    let at = LineOf {
                        factor: n,
                        channel: index / layout.stored_lines(),
                        line: index % layout.stored_lines(),
                    };
                    if at.line < layout.lines() {
                        start(&plan, *range, at, values);
                    }
                },
            );
            factor
        };
        let factors = ranges.iter().enumerate().map(start_factor).collect();
        Self::with_factors(Arc::new(plan), display, ranges, factors)
    }

    /// Returns the stored values of every factor.
    pub(crate) fn own(&self) -> impl Iterator<Item = &Factor> {
        self.factors
            .iter()
            .zip(&self.stored)
            .map(|(effective, stored)| stored.as_ref().map_or(effective, |(_, stored)| stored))
    }

    /// Returns one row of one frame, without padding.
    pub(crate) fn row(&self, n: usize, channel: usize, line: usize, frame: usize) -> &[f32] {
        let layout = &self.factors[n].layout;
        &self.factors[n].row(channel, line, frame)[layout.pad..layout.pad + layout.cols()]
    }

    /// Selects the instruction set. `fast` permits the kernels of `gather` and `between`, for
    /// factors that all rays of a view read at a constant shift. Without `fast`, `scatter` updates
    /// these factors too.
    pub fn use_kernel(&mut self, backend: lumistack_simd::Backend, fast: bool) {
        Arc::make_mut(&mut self.plan).use_backend(backend);
        self.fast = fast;
    }

    /// Prepares a problem and starts its run. All values, now and later, are at least `floor`.
    ///
    /// # Errors
    /// [`FactorizeError`] if the problem or the start does not fit the display.
    pub fn new(problem: &crate::Problem, start: LayerStack, floor: f32) -> Result<Self, FactorizeError> {
        let prepared = crate::prepared::Prepared::new(problem, start, &Processor)?;
        Ok(Self::begin(prepared.into_begin(floor, false)))
    }

    /// Returns the number by which sums of weighted errors are multiplied to give the objective.
    /// Weights in the sums are relative to the largest weight.
    pub fn weight_scale(&self) -> f64 {
        self.plan.target.weight_scale
    }

    /// Returns true if the kernel of [`gather`] updates factor `n`: layers attenuate, and all rays
    /// of a view read the factor at a constant shift. This kernel is also chosen if rays read
    /// other factors between columns, since the kernel of [`between`] was no faster there.
    pub fn is_fast(&self, n: usize) -> bool {
        self.fast && self.plan.is_product() && self.plan.maps[n].shifted
    }

    fn update_by(&mut self, n: usize, rule: Rule, extrapolation: Option<f32>, local: bool) -> Outcome {
        // the first extrapolation takes the current values as the previous iterate
        if extrapolation.is_some() && self.latest.is_empty() {
            self.latest = self.own().map(|factor| factor.values.clone()).collect();
        }
        if self.stored[n].is_some() {
            return self.update_stored(n, rule, extrapolation, local);
        }
        // Update in place if the rays through a line read no other line of the factor. Otherwise
        // write into the spare memory.
        let in_place = self.is_fast(n);
        let mut values = std::mem::take(&mut self.factors[n].values);
        if !in_place {
            // rays through a line may read other lines of the factor, which must keep their values
            // during the update
            let mut next = std::mem::take(&mut self.spare);
            if next.len() != values.len() {
                next = Aligned::filled(0.0, values.len());
            }
            next.copy_from_slice(&values);
            self.factors[n].values = std::mem::replace(&mut values, next);
        }
        // step all lines, then exchange the storage
        let outcome = self.update_lines(n, rule, extrapolation, local, &mut values, None);
        let before = std::mem::replace(&mut self.factors[n].values, values);
        if !in_place {
            self.spare = before;
        }
        outcome
    }

    /// Updates a factor whose stored values differ from the values that rays read.
    fn update_stored(&mut self, n: usize, rule: Rule, extrapolation: Option<f32>, local: bool) -> Outcome {
        let layout = self.plan.maps[n].layout.clone();
        // collect the sums of all pixels that rays read
        let line_sums = rule.sums().count(layout.frames) * layout.stride;
        let mut sums = vec![0.0; self.plan.target.channels * layout.stored_lines() * line_sums];
        let mut effective = self.factors[n].values.clone();
        let outcome = self.update_lines(n, rule, None, local, &mut effective, Some(&mut sums));
        // after a cancellation, sums are missing, so no stored pixel may step
        if self.cancel.is_cancelled() {
            return outcome;
        }
        let Some((response, stored)) = &mut self.stored[n] else { return outcome };
        // apply the adjoint, which gives the sums of the stored pixels, then step the stored pixels
        let adjoint = AdjointSums::of(response, &layout, rule.sums(), &sums);
        let limits = (rule == Rule::Darken).then(|| unlit::limits(&self.plan, n));
        let steps = Steps::new(&self.plan, n, rule, self.ranges[n], self.levels[n].as_ref(), limits);
        let latest = extrapolation.map(|_| &mut self.latest[n]);
        let mut lines = lines_of(&layout, &mut stored.values, extrapolation.zip(latest), None);
        let functions = steps.functions(&self.plan, layout.frames);
        bands::for_each_chunk(
            &mut lines,
            1,
            || (Block::new(layout.frames), vec![0.0; line_sums]),
            |(block, sums), index, line| {
                let (channel, at) = (index / layout.stored_lines(), index % layout.stored_lines());
                if at < layout.lines() && self.plan.may_change(n, at) {
                    let step = steps.of(at, &mut line[0]);
                    let line_of =
                        StepLine { adjoint: &adjoint, channel, line: at, step, functions: &functions, block, sums };
                    line[0].outcome = line_of.update();
                }
            },
        );
        let gain: f64 = lines.iter().map(|line| line.outcome.gain).sum();
        // the three channels of a tied response share one value, so `gain` has the gain of each
        // value three times
        let gain = if response.is_tied() { gain / 3.0 } else { gain };
        respond::respond(response, stored, &mut self.factors[n].values);
        Outcome { error: outcome.error, gain }
    }

    /// Sums and steps the lines of a factor. If `sums` is given, the sums of all lines are stored
    /// in it, and no line steps.
    fn update_lines(
        &mut self,
        n: usize,
        rule: Rule,
        extrapolation: Option<f32>,
        local: bool,
        values: &mut [f32],
        sums: Option<&mut [f32]>,
    ) -> Outcome {
        let (plan, factors, fast) = (&self.plan, &self.factors, self.is_fast(n));
        let layout = &plan.maps[n].layout;
        let latest = extrapolation.map(|_| &mut self.latest[n]);
        // if the sums are stored, every line must be summed, since the later step needs the sums of
        // all lines
        let all = sums.is_some();
        // split the factor into lines, which are distributed to the threads
        let mut lines = lines_of(layout, values, extrapolation.zip(latest), sums);
        let line_of = |index: usize| LineOf {
            factor: n,
            channel: index / layout.stored_lines(),
            line: index % layout.stored_lines(),
        };
        // if the sums are stored, no value is stepped or darkened here, so no limits are needed
        let limits =
            (rule == Rule::Darken && lines.iter().all(|line| line.sums.is_none())).then(|| unlit::limits(plan, n));
        // prepare the conditions and the functions that all lines share
        let steps = Steps::new(plan, n, rule, self.ranges[n], self.levels[n].as_ref(), limits);
        let cancel = &self.cancel;
        let may_change = |at: &LineOf| at.line < layout.lines() && (all || plan.may_change(n, at.line));
        let is_line = |at: &LineOf| may_change(at) && !cancel.is_cancelled();
        let functions = steps.functions(plan, layout.frames);
        // use the fastest kernel that the factor's tables allow
        if fast {
            let functions = GatherFunctions::new(plan.backend, rule, layout.frames, factors.len() - 1, functions);
            bands::for_each_chunk(
                &mut lines,
                1,
                || gather::Scratch::new(plan),
                |scratch, index, line| {
                    let at = line_of(index);
                    if is_line(&at) {
                        let step = steps.of(at.line, &mut line[0]);
                        let gathered = GatherLine { plan, factors, at, functions: &functions, step, scratch };
                        line[0].outcome = gathered.update();
                    }
                },
            );
        } else if plan.is_product() && plan.maps[n].between && self.fast {
            let functions = BetweenFunctions::new(plan.backend, functions);
            bands::for_each_chunk(
                &mut lines,
                scatter::BAND,
                || between::Scratch::new(plan, n, rule),
                |scratch, index, lines| {
                    let mut band = BetweenBand { plan, factors, functions: &functions, scratch, before: None };
                    for (i, line) in lines.iter_mut().enumerate() {
                        let at = line_of(index * scatter::BAND + i);
                        if is_line(&at) {
                            let step = steps.of(at.line, line);
                            line.outcome = band.update(at, step);
                        }
                    }
                },
            );
        } else if plan.is_product() {
            let functions = ScatterFunctions::new(plan.backend, functions);
            bands::for_each_chunk(
                &mut lines,
                scatter::BAND,
                || scatter::Scratch::new(plan, n, rule),
                |scratch, index, lines| {
                    let mut band = ScatterBand { plan, factors, functions: &functions, scratch, before: None };
                    for (i, line) in lines.iter_mut().enumerate() {
                        let at = line_of(index * scatter::BAND + i);
                        if is_line(&at) {
                            let step = steps.of(at.line, line);
                            line.outcome = band.update(at, step);
                        }
                    }
                },
            );
        } else {
            bands::for_each_chunk(
                &mut lines,
                1,
                || Scratch::new(plan, n),
                |scratch, index, line| {
                    let at = line_of(index);
                    if is_line(&at) {
                        let step = steps.of(at.line, &mut line[0]);
                        let summed = SumLine { plan, factors, at, local, functions: &functions, step, scratch };
                        line[0].outcome = summed.update();
                    }
                },
            );
        }
        lines.iter().fold(Outcome::default(), |sum, line| sum.merged(line.outcome))
    }
}

impl Updater for Engine {
    fn plan(&self) -> &Arc<Plan> {
        &self.plan
    }

    fn display(&self) -> &Display {
        &self.display
    }

    fn tries_local(&self) -> bool {
        self.tries_local
    }

    fn set_cancel(&mut self, cancel: &Cancel) {
        self.cancel = cancel.clone();
    }

    fn apply(&mut self, n: usize, rule: Rule, extrapolation: Option<f32>, local: bool) {
        self.outcome = self.update_by(n, rule, extrapolation, local);
    }

    fn outcome(&mut self) -> Outcome {
        self.outcome
    }

    fn save(&mut self, n: usize) {
        let stored = self.stored[n].as_ref().map(|(_, factor)| factor.values.clone());
        self.saved = Some((self.factors[n].values.clone(), stored));
    }

    fn restore(&mut self, n: usize) {
        let Some((effective, stored)) = self.saved.take() else { return };
        self.factors[n].values = effective;
        if let (Some((_, factor)), Some(values)) = (&mut self.stored[n], stored) {
            factor.values = values;
        }
    }

    fn errors(&mut self) -> ErrorSum {
        let (plan, factors) = (&self.plan, &self.factors);
        let functions = ErrorFunctions::new(plan);
        let sums = bands::map(
            plan.target.channels * plan.rows,
            || Scratch::new(plan, 0),
            |scratch, index| {
                if self.cancel.is_cancelled() {
                    return ErrorSum::default();
                }
                let (channel, row) = (index / plan.rows, index % plan.rows);
                RowErrors { plan, factors, channel, row, functions: &functions, scratch }.sum()
            },
        );
        sums.iter().fold(ErrorSum::default(), |total, sum| total.merged(*sum))
    }

    fn swap_latest(&mut self) {
        let own = self.factors.iter_mut().zip(&mut self.stored);
        for ((effective, stored), latest) in own.zip(&mut self.latest) {
            match stored {
                None => std::mem::swap(&mut effective.values, latest),
                Some((response, stored)) => {
                    std::mem::swap(&mut stored.values, latest);
                    respond::respond(response, stored, &mut effective.values);
                }
            }
        }
    }

    fn restart(&mut self) {
        self.swap_latest();
        let own = self.factors.iter().zip(&self.stored);
        let own = own.map(|(effective, stored)| stored.as_ref().map_or(effective, |(_, stored)| stored));
        self.latest.iter_mut().zip(own).for_each(|(latest, factor)| latest.copy_from_slice(&factor.values));
    }

    fn check(&self) -> Result<(), FactorizeError> {
        Ok(())
    }

    fn download(&mut self) -> LayerStack {
        stack_of(&self.display, self.own())
    }

    /// Does the same as [`download`](Updater::download), but into the memory of `latest`, if it is
    /// not empty. Allocation of new memory would take longer than the copy.
    fn into_stack(mut self: Box<Self>) -> Result<LayerStack, FactorizeError> {
        if self.latest.is_empty() {
            return Ok(self.download());
        }
        let mut stack = LayerStack::filled(&self.display, 0.0);
        let mut latest = std::mem::take(&mut self.latest).into_iter();
        let mut own = self.own();
        for layer in &mut stack.layers {
            if let (Some(own), Some(latest)) = (own.next(), latest.next()) {
                *layer = lent(layer, own, latest);
            }
        }
        if let (Some(emission), Some(own), Some(latest)) = (&mut stack.emission, own.next(), latest.next()) {
            *emission = lent(emission, own, latest);
        }
        drop(own);
        Ok(stack)
    }

    fn into_factors(self: Box<Self>) -> Result<Vec<Factor>, FactorizeError> {
        let own = self.factors.into_iter().zip(self.stored);
        Ok(own.map(|(effective, stored)| stored.map_or(effective, |(_, stored)| stored)).collect())
    }
}

/// A tensor's values in the memory of a factor that is no longer needed.
struct Reused {
    values: Aligned,
    len: usize,
}

impl AsRef<[f32]> for Reused {
    fn as_ref(&self) -> &[f32] {
        &self.values[..self.len]
    }
}

/// Copies a factor into the memory of `values`. Returns a tensor with the shape of `tensor` that
/// keeps its values in this memory.
fn lent<const N: usize>(tensor: &Tensor<N>, own: &Factor, mut values: Aligned) -> Tensor<N> {
    let len = tensor.shape().iter().product();
    own.download(&mut values[..len]);
    let lent = Tensor::lent(tensor.axes(), tensor.shape(), Arc::new(Reused { values, len }));
    lent.unwrap_or_else(|_| tensor.clone())
}

/// One line of the factor under update.
struct Line<'a> {
    values: &'a mut [f32],
    extrapolation: Option<(f32, &'a mut [f32])>,
    sums: Option<&'a mut [f32]>,
    outcome: Outcome,
}

/// Splits a factor's values, its last iterate and its sums into lines.
fn lines_of<'a>(
    layout: &Layout,
    values: &'a mut [f32],
    extrapolation: Option<(f32, &'a mut Aligned)>,
    sums: Option<&'a mut [f32]>,
) -> Vec<Line<'a>> {
    let (by, latest) = extrapolation.unzip();
    let mut latest = latest.map(|latest| latest.chunks_exact_mut(layout.line_len()));
    let count = values.len() / layout.line_len();
    let mut sums = sums.map(|sums| {
        let len = sums.len() / count;
        sums.chunks_exact_mut(len)
    });
    let lines = values.chunks_exact_mut(layout.line_len()).map(|values| Line {
        values,
        extrapolation: by.zip(latest.as_mut().and_then(Iterator::next)),
        sums: sums.as_mut().and_then(Iterator::next),
        outcome: Outcome::default(),
    });
    lines.collect()
}

/// Parameters of an update that the steps of all lines share.
struct Steps<'a> {
    rule: Rule,
    range: [f32; 2],
    levels: Option<&'a Levels>,
    columns: std::ops::Range<usize>,
    stride: usize,
    /// [`LineStep::limits`] of all lines, `[line][x]`.
    limits: Option<Vec<f32>>,
    /// [`LineStep::fixed`], the same for all lines.
    fixed: Option<Vec<bool>>,
}

impl<'s> Steps<'s> {
    fn new(
        plan: &Plan,
        n: usize,
        rule: Rule,
        range: [f32; 2],
        levels: Option<&'s Levels>,
        limits: Option<Vec<f32>>,
    ) -> Self {
        let (layout, fixed) = (&plan.maps[n].layout, plan.fixed_columns(n));
        let columns = layout.pad..layout.pad + layout.cols();
        Self { rule, range, levels, columns, stride: layout.stride, limits, fixed }
    }

    fn functions(&self, plan: &Plan, frames: usize) -> StepFunctions {
        StepFunctions::new(plan.backend, self.rule, self.levels.is_some(), frames)
    }

    fn of<'a>(&'a self, at: usize, line: &'a mut Line) -> LineStep<'a> {
        LineStep {
            rule: self.rule,
            range: self.range,
            levels: self.levels,
            limits: self.limits.as_ref().map(|limits| &limits[at * self.stride..][..self.stride]),
            fixed: self.fixed.as_deref(),
            columns: self.columns.clone(),
            stride: self.stride,
            values: &mut *line.values,
            extrapolation: line.extrapolation.as_mut().map(|(by, latest)| (*by, &mut **latest)),
            sums: line.sums.as_deref_mut(),
        }
    }
}
