//! The paper's multiplicative rule (eqs. 16 and 17), per ray.
//!
//! With P_m(r) = b_m(r) Π_{k≠n} f_m^(k) and L̃(r) = (1/M) Σ_m b_m(r) Π_k f_m^(k), for every pixel j of layer n:
//!
//! ```text
//! f_m[j] ← clamp( f_m[j] · Σ_{r through j} w βL P_m / Σ_{r through j} w L̃ P_m )
//! ```
//!
//! Layers in sequence, rear to front, then the directional backlight by the same rule. Each step minimizes a separable quadratic majorizer over the
//! box [[`FLOOR`], 1], so the objective never rises, for real weights w ≥ 0 and for bilinear sampling too, where each sum carries the sample's
//! weight. A pixel without a weighted ray, or whose denominator is 0 (below f32's normal range), is left alone.

use lumistack_core::{Cancel, Cancelled};
use lumistack_display::LayerStack;

use crate::factor::Factor;
use crate::lanes::InstructionSet;
use crate::plan::Plan;
use crate::rows::{ErrorSum, LineOf, RowOf};
use crate::{FLOOR, FactorizeError, Objective, Problem, Run, Solver, bands, rows, shifted};

/// The paper's rule; the reference for every other solver.
#[derive(Clone, Copy, Debug, Default)]
pub struct Multiplicative;

impl Solver for Multiplicative {
    fn name(&self) -> &'static str {
        "multiplicative"
    }

    fn doc(&self) -> &'static str {
        "The paper's multiplicative update (eq. 16), one layer after another. Never worsens; slow to converge."
    }

    fn start<'a>(&self, problem: &Problem<'a>, start: LayerStack) -> Result<Box<dyn Run + 'a>, FactorizeError> {
        Ok(Box::new(MultiplicativeRun::new(problem, start)?))
    }
}

/// State of a run.
pub(crate) struct MultiplicativeRun {
    plan: Plan,
    /// Layers rear to front, then the backlight.
    factors: Vec<Factor>,
    /// Spare storage for factors that cannot be updated in place.
    spare: Vec<f32>,
    /// What was handed in; gives the downloaded stack its shapes.
    shapes: LayerStack,
    set: InstructionSet,
    shifted: bool,
    rays: u64,
}

impl MultiplicativeRun {
    pub(crate) fn new(problem: &Problem, start: LayerStack) -> Result<Self, FactorizeError> {
        problem.check()?;
        start.check(problem.display)?;
        let plan = Plan::new(problem);
        let tensors = start.layers.iter().map(|layer| layer.data()).chain(start.emission.iter().map(|e| e.data()));
        let factors: Vec<_> =
            plan.maps.iter().zip(tensors).map(|(map, tensor)| Factor::upload(&map.layout, tensor, FLOOR)).collect();
        let shapes = LayerStack { brightness: problem.display.brightness, ..start };
        let (shifted, rays) = (shifted::is_possible(&plan), plan.rays());
        Ok(Self { plan, factors, spare: Vec::new(), shapes, set: InstructionSet::detect(), shifted, rays })
    }

    /// Chooses the instruction set and whether the fast kernel may be used.
    #[cfg(test)]
    pub(crate) fn with_kernel(mut self, set: InstructionSet, shifted: bool) -> Self {
        self.set = set;
        self.shifted &= shifted;
        self
    }

    /// Whether the fast kernel is used.
    #[cfg(test)]
    pub(crate) fn is_shifted(&self) -> bool {
        self.shifted
    }

    /// Number of factors: layers and backlight.
    pub(crate) fn factor_count(&self) -> usize {
        self.factors.len()
    }

    /// Updates factor `n` from the present state of all.
    pub(crate) fn update_factor(&mut self, n: usize) {
        let layout = self.plan.maps[n].layout.clone();
        let (stored_lines, line_len) = (layout.stored_lines(), layout.line_len());
        let (plan, set) = (&self.plan, self.set);
        if self.shifted {
            // only rays through a line read that line: update in place
            let mut values = std::mem::take(&mut self.factors[n].values);
            let factors = &self.factors;
            bands::for_each_chunk(
                &mut values,
                line_len,
                || shifted::Scratch::new(plan, n),
                |scratch, index, line| {
                    let at = LineOf { factor: n, channel: index / stored_lines, line: index % stored_lines };
                    if at.line < layout.lines() {
                        shifted::update_line(set, plan, factors, at, FLOOR, line, scratch);
                    }
                },
            );
            self.factors[n].values = values;
            return;
        }
        let mut next = std::mem::take(&mut self.spare);
        next.clear();
        next.extend_from_slice(&self.factors[n].values);
        let factors = &self.factors;
        bands::for_each_chunk(
            &mut next,
            line_len,
            || rows::Scratch::new(plan, n),
            |scratch, index, line| {
                let at = LineOf { factor: n, channel: index / stored_lines, line: index % stored_lines };
                if at.line < layout.lines() {
                    rows::update_line(set, plan, factors, at, FLOOR, line, scratch);
                }
            },
        );
        self.spare = std::mem::replace(&mut self.factors[n].values, next);
    }
}

impl Run for MultiplicativeRun {
    fn step(&mut self, cancel: &Cancel) -> Result<(), Cancelled> {
        for n in 0..self.factor_count() {
            cancel.check()?;
            self.update_factor(n);
        }
        Ok(())
    }

    fn objective(&mut self) -> Objective {
        let (plan, factors, set, fast) = (&self.plan, &self.factors, self.set, self.shifted);
        let sums = bands::map(
            3 * plan.rows,
            || rows::Scratch::new(plan, 0),
            |scratch, index| {
                let at = RowOf { channel: index / plan.rows, row: index % plan.rows, fast };
                rows::row_error(set, plan, factors, at, scratch)
            },
        );
        let total = sums.iter().fold(ErrorSum::default(), |total, sum| ErrorSum {
            weighted: total.weighted + sum.weighted,
            plain: total.plain + sum.plain,
        });
        let mean = total.plain / (3 * self.rays) as f64;
        Objective {
            value: plan.target.weight_scale * total.weighted,
            psnr_view: -10.0 * mean.log10() + 20.0 * self.shapes.brightness.log10(),
        }
    }

    fn rays(&self) -> u64 {
        self.rays
    }

    fn download(&self) -> LayerStack {
        let mut stack = self.shapes.clone();
        let tensors = stack
            .layers
            .iter_mut()
            .map(|layer| layer.data_mut())
            .chain(stack.emission.iter_mut().map(|e| e.data_mut()));
        self.factors.iter().zip(tensors).for_each(|(factor, tensor)| factor.download(tensor));
        stack
    }
}
