//! The paper's multiplicative rule (eqs. 16 and 17), per ray.
//!
//! With P_m(r) = b_m(r) Π_{k≠n} f_m^(k) and L̃(r) = (1/M) Σ_m b_m(r) Π_k f_m^(k), for every pixel j of layer n:
//!
//! ```text
//! f_m[j] ← clamp( f_m[j] · Σ_{r through j} w βL P_m / Σ_{r through j} w L̃ P_m )
//! ```
//!
//! Layers in sequence, rear to front, then the directional backlight by the same rule. Each step minimizes a separable quadratic majorizer over the
//! box, whose lower end is at least [`FLOOR`], so the objective never rises, for real weights w ≥ 0 and for bilinear sampling too, where each
//! sum carries the sample's weight. A pixel without a weighted ray, or whose denominator is 0 (below f32's normal range), is left alone.

use lumistack_core::{Cancel, Cancelled};
use lumistack_display::{Formation, LayerStack};

use crate::engine::Engine;
use crate::step::Rule;
use crate::{FLOOR, FactorizeError, Objective, Problem, Run, Solver};

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
    pub(crate) engine: Engine,
}

impl MultiplicativeRun {
    pub(crate) fn new(problem: &Problem, start: LayerStack) -> Result<Self, FactorizeError> {
        if problem.display.formation == Formation::Polarization {
            return Err(FactorizeError::Unsuitable {
                solver: "multiplicative",
                why: "layers that rotate polarization make no nonnegative product",
            });
        }
        Ok(Self { engine: Engine::new(problem, start, FLOOR)? })
    }

    /// Updates factor `n` from the present state of all.
    pub(crate) fn update_factor(&mut self, n: usize) {
        self.engine.update(n, Rule::Multiplicative, None);
    }
}

impl Run for MultiplicativeRun {
    fn step(&mut self, cancel: &Cancel) -> Result<(), Cancelled> {
        for n in 0..self.engine.factor_count() {
            cancel.check()?;
            self.update_factor(n);
        }
        Ok(())
    }

    fn objective(&mut self) -> Objective {
        self.engine.objective()
    }

    fn unsettled(&mut self) -> f64 {
        self.engine.unsettled()
    }

    fn settle(&mut self) -> f64 {
        self.engine.settle()
    }

    fn rays(&self) -> u64 {
        self.engine.rays()
    }

    fn download(&mut self) -> LayerStack {
        self.engine.download()
    }
}
