//! The paper's multiplicative rule (eqs. 16 and 17), per ray.
//!
//! For every pixel j of layer n, with the backlight's value b_m(r) on the ray r:
//!
//! ```text
//! P_m(r) = b_m(r) Π_{k≠n} f_m^(k)
//! L̃(r)   = (1/M) Σ_m b_m(r) Π_k f_m^(k)
//!
//! f_m[j] ← clamp( f_m[j] · Σ_{r through j} w βL P_m / Σ_{r through j} w L̃ P_m )
//! ```
//!
//! Layers are updated in sequence, rear to front, then the directional backlight by the same rule.
//! Each step minimizes, over the box, a separable quadratic that bounds the objective from above.
//! So the objective never rises. This holds for all weights w ≥ 0, and also under bilinear
//! sampling. There each term of the sums is multiplied by the weight of pixel j in the value that
//! the ray reads.
//!
//! The lower end of the box is at least [`FLOOR`], since a value of 0 would stay 0. A pixel keeps
//! its value if no weighted ray hits it or if its denominator is below f32's normal range.

use lumistack_core::Cancel;
use lumistack_display::{Display, Formation, LayerStack};

use crate::device::Updater;
use crate::engine::Processor;
use crate::method::{Iterated, Method};
use crate::prepared::Prepared;
use crate::step::Rule;
use crate::{FLOOR, FactorizeError, Objective, Problem, Run, Solver};

/// The paper's rule; the reference for the other solvers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Multiplicative;

impl Solver for Multiplicative {
    fn name(&self) -> &'static str {
        "multiplicative"
    }

    fn doc(&self) -> &'static str {
        "The paper's multiplicative update (eq. 16), one layer after another. The error never rises. Convergence is slow."
    }

    fn suits(&self, display: &Display) -> Result<(), FactorizeError> {
        if display.formation == Formation::Polarization {
            return Err(FactorizeError::Unsuitable {
                solver: "multiplicative",
                why: "expected layers that attenuate or emit light, found layers that rotate polarization",
            });
        }
        Ok(())
    }

    fn start<'a>(&self, problem: &Problem<'a>, start: LayerStack) -> Result<Box<dyn Run + 'a>, FactorizeError> {
        Ok(self.begin(Prepared::new(problem, start, &Processor)?)?)
    }
}

impl Method for Multiplicative {
    fn begin(&self, prepared: Prepared) -> Result<Box<dyn Iterated>, FactorizeError> {
        self.suits(prepared.display)?;
        Ok(Box::new(MultiplicativeRun { state: prepared.begin(FLOOR, false)? }))
    }
}

struct MultiplicativeRun {
    state: Box<dyn Updater>,
}

impl Run for MultiplicativeRun {
    fn step(&mut self, cancel: &Cancel) -> Result<(), FactorizeError> {
        self.state.set_cancel(cancel);
        for n in 0..self.state.plan().factor_count() {
            self.state.update(n, Rule::Multiplicative, None);
            cancel.check()?;
        }
        self.state.check()
    }

    fn objective(&mut self) -> Objective {
        self.state.objective()
    }

    fn known_objective(&self) -> Option<Objective> {
        // The multiplicative rule does not compute the decrease of the objective, so the objective
        // after an update is not known.
        None
    }

    fn kkt_residual(&mut self) -> f64 {
        self.state.kkt_residual()
    }

    fn darken_unlit(&mut self) -> f64 {
        self.state.darken_unlit()
    }

    fn rays(&self) -> u64 {
        self.state.plan().rays
    }

    fn check(&self) -> Result<(), FactorizeError> {
        self.state.check()
    }

    fn download(&mut self) -> LayerStack {
        self.state.download()
    }
}

impl Iterated for MultiplicativeRun {
    fn finish(self: Box<Self>) -> Box<dyn Updater> {
        self.state
    }
}
