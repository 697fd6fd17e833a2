//! The list of solvers.

use crate::block_exact::{BlockExact, Extrapolated};
use lumistack_display::LayerStack;

use crate::device::Executor;
use crate::method::Method;
use crate::multiplicative::Multiplicative;
use crate::prepared::Prepared;
use crate::problem::{FactorizeError, Problem};
use crate::solver::{AUTO, Run, Solver};

/// All solvers. Each implements the internal trait [`Method`].
static METHODS: [&dyn Method; 3] = [&Multiplicative, &BlockExact, &Extrapolated];

/// Returns all solvers.
pub fn solvers() -> &'static [&'static dyn Solver] {
    &[&Multiplicative, &BlockExact, &Extrapolated]
}

/// Returns all names that select a solver; the first is [`AUTO`].
pub fn solver_names() -> impl Iterator<Item = &'static str> {
    std::iter::once(AUTO).chain(solvers().iter().map(|solver| solver.name()))
}

/// Returns the solver of a name; [`AUTO`] selects the best one.
///
/// # Errors
/// If no solver has this name; the error lists all names.
pub fn solver(name: &str) -> Result<&'static dyn Solver, FactorizeError> {
    method(name).map(|method| method as &dyn Solver)
}

/// Runs [`Solver::start`] of the named solver on an executor.
///
/// # Errors
/// The errors of [`solver`] and of [`Solver::start`]; also if the executor cannot solve the
/// problem.
pub fn start_on(
    executor: &dyn Executor,
    name: &str,
    problem: &Problem,
    start: LayerStack,
) -> Result<Box<dyn Run>, FactorizeError> {
    Ok(method(name)?.begin(Prepared::new(problem, start, executor)?)?)
}

/// Returns the solver with this name; [`AUTO`] selects the best solver.
pub(crate) fn method(name: &str) -> Result<&'static dyn Method, FactorizeError> {
    let name = if name == AUTO { Extrapolated.name() } else { name };
    METHODS.into_iter().find(|method| method.name() == name).ok_or_else(|| FactorizeError::UnknownSolver {
        expected: solver_names().collect::<Vec<_>>().join(", "),
        found: name.into(),
    })
}
