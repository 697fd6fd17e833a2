//! State of a run on this machine's processor, and the update of one factor.

use std::sync::Arc;

use lumistack_core::pages::prefer_large_pages;
use lumistack_core::{Cancel, Tensor};
use lumistack_display::{Backlight, Display, LayerStack, Response};

use crate::aligned::Aligned;
use crate::errors::{ErrorFunctions, ErrorSum, RowErrors};
use crate::factor::{Factor, Layout};
use crate::gather::{self, GatherFunctions, GatherLine};
use crate::line::{LineOf, LineStep, Outcome, StepFunctions};
use crate::plan::Plan;
use crate::respond::{self, Pulled, StepLine};
use crate::scratch::Scratch;
use crate::spread::{self, SpreadBand, SpreadFunctions};
use crate::step::{Block, Levels, Rule};
use crate::sums::SumLine;
use crate::{Objective, bands, coarse, unlit};

/// Which part of the objective an update must leave for the rest to be known from its gain, whose terms are f32.
const LEAST_LEFT: f64 = 0.01;

/// Patterns under way.
pub(crate) struct Engine {
    plan: Arc<Plan>,
    display: Display,
    /// What rays read: layers rear to front, then the backlight.
    factors: Vec<Factor>,
    /// Per factor, what is stored where that is not what rays read.
    stored: Vec<Option<(Response, Factor)>>,
    /// Per factor, the levels of its values and which frames keep to them.
    pub(crate) levels: Vec<Option<Levels>>,
    /// Where the last steps ended, while the patterns go beyond them; else empty.
    latest: Vec<Aligned>,
    /// Spare storage for factors that cannot be updated in place.
    spare: Aligned,
    /// The boxes of the factors' values.
    ranges: Vec<[f32; 2]>,
    fast: bool,
    /// Asked before every line; where it is set, what is left stays as it is.
    pub(crate) cancel: Cancel,
    /// Where L̃ is not linear in a factor: whether updates try the curvature at the present point before the bound that holds everywhere.
    pub(crate) bold: bool,
    rays: u64,
}

/// Where patterns come from.
#[derive(Clone)]
pub(crate) enum Patterns<'a> {
    Stack(LayerStack),
    /// A solution at half the resolution.
    Coarse(&'a Engine),
}

impl Engine {
    /// Values of the start, and of all patterns later, stay within the hardware's box and at `floor` or above.
    pub(crate) fn begin(plan: Arc<Plan>, display: &Display, floor: f32, patterns: &Patterns) -> Self {
        let mut ranges = ranges_of(display);
        ranges.iter_mut().for_each(|[low, high]| *low = low.max(floor).min(*high));
        let layouts = plan.maps.iter().map(|map| &map.layout).zip(&ranges);
        let factors: Vec<_> = match patterns {
            Patterns::Stack(stack) => {
                let tensors = stack.layers.iter().map(|t| t.data()).chain(stack.emission.iter().map(|t| t.data()));
                layouts.zip(tensors).map(|((layout, range), values)| Factor::upload(layout, values, *range)).collect()
            }
            Patterns::Coarse(engine) => {
                layouts.zip(engine.own()).map(|((layout, range), own)| coarse::refine(own, layout, *range)).collect()
            }
        };
        Self::with_factors(plan, display, ranges, factors)
    }

    fn with_factors(plan: Arc<Plan>, display: &Display, ranges: Vec<[f32; 2]>, mut factors: Vec<Factor>) -> Self {
        let responses = display.layers.iter().map(|layer| layer.response()).chain(std::iter::repeat(None));
        let stored = factors.iter_mut().zip(responses).map(|(met, response)| {
            let response = response?;
            let mut stored = met.clone();
            if response.is_tied() {
                respond::tie(&mut stored);
            }
            respond::respond(&response, &stored, &mut met.values);
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
            bold: false,
            rays: plan.rays(),
            plan,
            factors,
        }
    }

    /// For one channel: begins at `start(plan, range, line, values)`, which fills a line's rows frame by frame.
    pub(crate) fn by_lines(
        plan: Plan,
        display: &Display,
        start: impl Fn(&Plan, [f32; 2], LineOf, &mut [f32]) + Sync,
    ) -> Self {
        let ranges = ranges_of(display);
        let begun = |(n, range): (usize, &[f32; 2])| {
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
        let factors = ranges.iter().enumerate().map(begun).collect();
        Self::with_factors(Arc::new(plan), display, ranges, factors)
    }

    /// What is stored of every factor.
    fn own(&self) -> impl Iterator<Item = &Factor> {
        self.factors.iter().zip(&self.stored).map(|(met, stored)| stored.as_ref().map_or(met, |(_, stored)| stored))
    }

    /// One row of a pattern.
    pub(crate) fn row(&self, n: usize, channel: usize, line: usize, frame: usize) -> &[f32] {
        let layout = &self.factors[n].layout;
        &self.factors[n].row(channel, line, frame)[layout.pad..layout.pad + layout.cols()]
    }

    /// Chooses the instruction set and whether the fast kernel may be used.
    #[cfg(test)]
    pub(crate) fn use_kernel(&mut self, backend: lumistack_simd::Backend, fast: bool) {
        Arc::make_mut(&mut self.plan).use_backend(backend);
        self.fast = fast;
    }

    /// What sums of weighted errors are to be multiplied by.
    #[cfg(test)]
    pub(crate) fn weight_scale(&self) -> f64 {
        self.plan.target.weight_scale
    }

    /// Number of factors: layers and backlight.
    pub(crate) fn factor_count(&self) -> usize {
        self.factors.len()
    }

    /// Number of rays with w > 0 that meet the display.
    pub(crate) fn rays(&self) -> u64 {
        self.rays
    }

    /// Whether the fast kernel updates factor `n`.
    pub(crate) fn is_fast(&self, n: usize) -> bool {
        self.fast && self.plan.is_product() && self.plan.maps[n].shifted
    }

    /// Whether the outcome of updating factor `n` covers all rays.
    pub(crate) fn sees_all_rays(&self, n: usize) -> bool {
        self.plan.maps[n].complete && self.plan.free(n).is_none()
    }

    /// Updates factor `n` from the present state of all. With `beyond`, rays then read the point that lies so much further along the way from
    /// the step before.
    ///
    /// The local curvature is a guess that pays: where the objective rises all the same, the update is taken back and done by the bound.
    pub(crate) fn update(&mut self, n: usize, rule: Rule, beyond: Option<f32>) -> Outcome {
        if !self.bold || self.plan.is_bounded(n) || rule == Rule::Probe {
            return self.update_by(n, rule, beyond, false);
        }
        let weighted = |engine: &Self| engine.objective().value / engine.plan.target.weight_scale;
        let (met, stored) = (self.factors[n].values.clone(), self.stored[n].as_ref().map(|(_, f)| f.values.clone()));
        let before = weighted(self);
        let outcome = self.update_by(n, rule, None, true);
        let after = weighted(self);
        if after > before {
            self.factors[n].values = met;
            if let (Some((_, factor)), Some(values)) = (&mut self.stored[n], stored) {
                factor.values = values;
            }
            return self.update_by(n, rule, None, false);
        }
        Outcome { error: outcome.error, gain: before - after }
    }

    fn update_by(&mut self, n: usize, rule: Rule, beyond: Option<f32>, local: bool) -> Outcome {
        if beyond.is_some() && self.latest.is_empty() {
            self.latest = self.own().map(|factor| factor.values.clone()).collect();
        }
        if self.stored[n].is_some() {
            return self.update_stored(n, rule, beyond, local);
        }
        let in_place = self.is_fast(n);
        let mut values = std::mem::take(&mut self.factors[n].values);
        if !in_place {
            // rays through one line read others: those keep their old values until all are done
            let mut next = std::mem::take(&mut self.spare);
            if next.len() != values.len() {
                next = Aligned::filled(0.0, values.len());
            }
            next.copy_from_slice(&values);
            self.factors[n].values = std::mem::replace(&mut values, next);
        }
        let outcome = self.update_lines(n, rule, beyond, local, &mut values, None);
        let before = std::mem::replace(&mut self.factors[n].values, values);
        if !in_place {
            self.spare = before;
        }
        outcome
    }

    /// Updates a factor that stores other values than rays read.
    fn update_stored(&mut self, n: usize, rule: Rule, beyond: Option<f32>, local: bool) -> Outcome {
        let layout = self.plan.maps[n].layout.clone();
        let line_sums = rule.sums().count(layout.frames) * layout.stride;
        let mut sums = vec![0.0; self.plan.target.channels * layout.stored_lines() * line_sums];
        let mut met = self.factors[n].values.clone();
        let seen = self.update_lines(n, rule, None, local, &mut met, Some(&mut sums));
        let Some((response, stored)) = &mut self.stored[n] else { return seen };
        let pulled = Pulled::back(response, &layout, rule.sums(), &sums);
        let limits = (rule == Rule::Settle).then(|| unlit::limits(&self.plan, n));
        let steps = Steps::new(&self.plan, n, rule, self.ranges[n], self.levels[n].as_ref(), limits);
        let latest = beyond.map(|_| &mut self.latest[n]);
        let mut lines = lines_of(&layout, &mut stored.values, beyond.zip(latest), None);
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
                        StepLine { pulled: &pulled, channel, line: at, step, functions: &functions, block, sums };
                    line[0].outcome = line_of.update();
                }
            },
        );
        let gain: f64 = lines.iter().map(|line| line.outcome.gain).sum();
        // tied channels are one unknown, stepped three times alike
        let gain = if response.is_tied() { gain / 3.0 } else { gain };
        respond::respond(response, stored, &mut self.factors[n].values);
        Outcome { error: seen.error, gain }
    }

    fn update_lines(
        &mut self,
        n: usize,
        rule: Rule,
        beyond: Option<f32>,
        local: bool,
        values: &mut [f32],
        sums: Option<&mut [f32]>,
    ) -> Outcome {
        let (plan, factors, fast) = (&self.plan, &self.factors, self.is_fast(n));
        let layout = &plan.maps[n].layout;
        let latest = beyond.map(|_| &mut self.latest[n]);
        // another step takes the sums of all lines
        let all = sums.is_some();
        let mut lines = lines_of(layout, values, beyond.zip(latest), sums);
        let line_of = |index: usize| LineOf {
            factor: n,
            channel: index / layout.stored_lines(),
            line: index % layout.stored_lines(),
        };
        // sums that another step takes are not acted on here
        let limits =
            (rule == Rule::Settle && lines.iter().all(|line| line.sums.is_none())).then(|| unlit::limits(plan, n));
        let steps = Steps::new(plan, n, rule, self.ranges[n], self.levels[n].as_ref(), limits);
        let cancel = &self.cancel;
        let may_change = |at: &LineOf| at.line < layout.lines() && (all || plan.may_change(n, at.line));
        let is_line = |at: &LineOf| may_change(at) && !cancel.is_cancelled();
        let functions = steps.functions(plan, layout.frames);
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
        } else if plan.is_product() {
            let functions = SpreadFunctions::new(plan.backend, functions);
            bands::for_each_chunk(
                &mut lines,
                spread::BAND,
                || spread::Scratch::new(plan, n, rule),
                |scratch, index, lines| {
                    let mut band = SpreadBand { plan, factors, functions: &functions, scratch, before: None };
                    for (i, line) in lines.iter_mut().enumerate() {
                        let at = line_of(index * spread::BAND + i);
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

    /// Exchanges the patterns for where the last steps ended, or back.
    pub(crate) fn swap_latest(&mut self) {
        let own = self.factors.iter_mut().zip(&mut self.stored);
        for ((met, stored), latest) in own.zip(&mut self.latest) {
            match stored {
                None => std::mem::swap(&mut met.values, latest),
                Some((response, stored)) => {
                    std::mem::swap(&mut stored.values, latest);
                    respond::respond(response, stored, &mut met.values);
                }
            }
        }
    }

    /// The patterns where the last steps ended, seen by `look`.
    pub(crate) fn at_latest<T>(&mut self, look: impl FnOnce(&mut Self) -> T) -> T {
        self.swap_latest();
        let seen = look(self);
        self.swap_latest();
        seen
    }

    /// Drops what lies beyond where the last steps ended.
    pub(crate) fn return_to_latest(&mut self) {
        self.swap_latest();
        let own = self.factors.iter().zip(&self.stored);
        let own = own.map(|(met, stored)| stored.as_ref().map_or(met, |(_, stored)| stored));
        self.latest.iter_mut().zip(own).for_each(|(latest, factor)| latest.copy_from_slice(&factor.values));
    }

    /// The objective after an update of factor `n` with this outcome, where that is known: every ray that counts reads one pixel of the factor, whose
    /// steps are exact, and all count alike.
    pub(crate) fn seen(&self, n: usize, outcome: Outcome) -> Option<Objective> {
        let (plan, map) = (&self.plan, &self.plan.maps[n]);
        let exact = plan.is_product() && map.nearest && self.sees_all_rays(n) && self.stored[n].is_none();
        // where next to nothing is left, that is rounding
        let left = outcome.error - outcome.gain;
        let known = exact && plan.target.is_uniform() && left > LEAST_LEFT * outcome.error;
        known.then(|| self.objective_of(left, None))
    }

    /// Root mean square, over all values, of the change of the emission that an exact coordinate step within the box would still make: 0 at a
    /// first-order (KKT) point.
    pub(crate) fn unsettled(&mut self) -> f64 {
        self.over_all(Rule::Probe)
    }

    /// The same, and each value that next to no light reaches becomes the darkest. Only where layers attenuate: elsewhere no value is darkness.
    pub(crate) fn settle(&mut self) -> f64 {
        self.over_all(if self.plan.is_product() { Rule::Settle } else { Rule::Probe })
    }

    fn over_all(&mut self, rule: Rule) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for n in 0..self.factors.len() {
            sum += self.update(n, rule, None).gain;
            let layout = &self.plan.maps[n].layout;
            count += self.plan.target.channels * self.plan.changing(n) * layout.frames;
        }
        (sum / count as f64).sqrt()
    }

    /// The objective of what rays read.
    pub(crate) fn objective(&self) -> Objective {
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
        let total = sums.iter().fold(ErrorSum::default(), |total, sum| total.merged(*sum));
        self.objective_of(total.weighted, Some(total.plain))
    }

    /// From Σ w e², weights relative to the largest, and Σ e² where that is another sum.
    fn objective_of(&self, weighted: f64, plain: Option<f64>) -> Objective {
        let target = &self.plan.target;
        let mean = plain.unwrap_or(weighted) / (target.channels as u64 * self.rays) as f64;
        Objective {
            value: target.weight_scale * weighted,
            psnr_view: -10.0 * mean.log10() + 20.0 * self.display.brightness.log10(),
        }
    }

    /// [`download`](Self::download) into the memory of what [`swap_latest`](Self::swap_latest) exchanged, where there is any: new memory costs more than
    /// what is written there.
    pub(crate) fn into_stack(mut self) -> LayerStack {
        if self.latest.is_empty() {
            return self.download();
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
        stack
    }

    /// The patterns that are stored.
    pub(crate) fn download(&self) -> LayerStack {
        // zeros that nobody has touched are no memory yet
        let mut stack = LayerStack::filled(&self.display, 0.0);
        let layers = stack.layers.iter_mut().map(|layer| layer.data_mut());
        for (factor, tensor) in self.own().zip(layers.chain(stack.emission.iter_mut().map(|e| e.data_mut()))) {
            prefer_large_pages(tensor);
            factor.download(tensor);
        }
        stack
    }
}

/// Values of a tensor in the memory of a factor that is needed no more.
struct Reused {
    values: Aligned,
    len: usize,
}

impl AsRef<[f32]> for Reused {
    fn as_ref(&self) -> &[f32] {
        &self.values[..self.len]
    }
}

/// A tensor's shape with other values.
fn lent<const N: usize>(tensor: &Tensor<N>, own: &Factor, mut values: Aligned) -> Tensor<N> {
    let len = tensor.shape().iter().product();
    own.download(&mut values[..len]);
    let lent = Tensor::lent(tensor.axes(), tensor.shape(), Arc::new(Reused { values, len }));
    lent.unwrap_or_else(|_| tensor.clone())
}

/// The boxes of a display's values: layers, then the backlight.
fn ranges_of(display: &Display) -> Vec<[f32; 2]> {
    let mut ranges: Vec<[f32; 2]> = display.layers.iter().map(|layer| layer.range()).collect();
    if let Backlight::Lenslets(lenslets) = &display.backlight {
        ranges.push(lenslets.range());
    }
    ranges
}

/// One line of the factor under update.
struct Line<'a> {
    values: &'a mut [f32],
    beyond: Option<(f32, &'a mut [f32])>,
    sums: Option<&'a mut [f32]>,
    outcome: Outcome,
}

/// A factor's lines, with what goes along line by line.
fn lines_of<'a>(
    layout: &Layout,
    values: &'a mut [f32],
    beyond: Option<(f32, &'a mut Aligned)>,
    sums: Option<&'a mut [f32]>,
) -> Vec<Line<'a>> {
    let (far, latest) = beyond.unzip();
    let mut latest = latest.map(|latest| latest.chunks_exact_mut(layout.line_len()));
    let count = values.len() / layout.line_len();
    let mut sums = sums.map(|sums| {
        let len = sums.len() / count;
        sums.chunks_exact_mut(len)
    });
    let lines = values.chunks_exact_mut(layout.line_len()).map(|values| Line {
        values,
        beyond: far.zip(latest.as_mut().and_then(Iterator::next)),
        sums: sums.as_mut().and_then(Iterator::next),
        outcome: Outcome::default(),
    });
    lines.collect()
}

/// What the steps of all lines have in common.
struct Steps<'a> {
    rule: Rule,
    range: [f32; 2],
    levels: Option<&'a Levels>,
    columns: std::ops::Range<usize>,
    stride: usize,
    /// `[line][x]`, see [`LineStep::limits`].
    limits: Option<Vec<f32>>,
    /// `[x]`, see [`LineStep::fixed`].
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
            beyond: line.beyond.as_mut().map(|(far, latest)| (*far, &mut **latest)),
            sums: line.sums.as_deref_mut(),
        }
    }
}
