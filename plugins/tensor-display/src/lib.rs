//! Node plugin `tensor_display`: runs the factorizer as a plugin. Its parameters are the
//! factorizer's settings, with the same names and values. The host passes weights, a warm start and
//! the seed together with the light field.

use lumistack_factorizer::{AUTO, Factorization, FactorizeError, LevelsLoss, Problem, Settings, StartKind, solvers};
use lumistack_plugin::display::LayerStack;
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{NodeInput, NodePlugin, Param, PluginError, Schema, Solution, Step, export_plugin};

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin `tensor_display`.
pub struct TensorDisplay;

/// Parameters; see [`TensorDisplay::schema`](NodePlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct TensorParams {
    solver: String,
    iterations: u32,
    start: String,
    coarse_levels: i64,
    coarse_iterations: u32,
    levels: bool,
}

impl TensorParams {
    fn settings(&self, seed: u64) -> Settings {
        Settings {
            solver: self.solver.clone(),
            iterations: self.iterations,
            seed,
            // `auto` is no name of a start, so the result is `None`, which selects the default
            start: StartKind::from_name(&self.start),
            coarse_levels: u32::try_from(self.coarse_levels).ok(),
            coarse_iterations: self.coarse_iterations,
            report_every: Settings::curve_interval(self.iterations),
            levels: self.levels,
        }
    }
}

impl NodePlugin for TensorDisplay {
    const DOC: &'static str = "Computes the patterns of any display by weighted nonnegative tensor factorization of the light field (Wetzstein et al. 2012). \
        This is the default node of a job.";
    type Params = TensorParams;

    fn schema() -> Schema {
        let defaults = Settings::default();
        let most = i64::from(u32::MAX);
        let auto = |help| std::iter::once((AUTO, help));
        Schema::new([
            Param::choice(
                "solver",
                &defaults.solver,
                auto("The solver `extrapolated`.").chain(solvers().iter().map(|solver| (solver.name(), solver.doc()))),
                "Algorithm that finds the masks.",
            ),
            Param::int("iterations", defaults.iterations.into(), 0..=most, "Iterations; each updates every layer, and a directional backlight.").unit("1"),
            Param::choice(
                "start",
                AUTO,
                auto("The solver's default.").chain(StartKind::ALL.iter().map(|(name, kind)| (*name, kind.doc()))),
                "Start of a factorization without a warm start.",
            ),
            Param::int(
                "coarse_levels",
                -1,
                -1..=most,
                "Number of coarser resolutions that are solved first, each half of the next finer resolution. The display's size limits this number, and a warm start has none. -1 uses the solver's default.",
            )
            .unit("1"),
            Param::int("coarse_iterations", defaults.coarse_iterations.into(), 0..=most, "Iterations at each coarser resolution.")
                .unit("1"),
            Param::bool(
                "levels",
                defaults.levels,
                "Optimize the masks of panels with few bits once more, restricted to the panels' levels.",
            ),
        ])
    }

    fn make(params: TensorParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let (target, weights, start) = (input.field().to_light_field()?, input.weights()?, input.start()?);
        let problem = Problem { display: input.display(), target: &target, weights: &weights };
        let settings = params.settings(input.seed());
        let mut told = Ok(());
        let made = input.host().run(|task| {
            lumistack_factorizer::factorize(&problem, &settings, start.as_ref(), task, &mut |at| {
                let step = Step { iteration: at.iteration, objective: at.objective, psnr_view: at.psnr_view };
                if told.is_ok() {
                    told = input.step(step);
                }
            })
        });
        let made = made.map_err(|error| match error {
            FactorizeError::Cancelled(_) => PluginError::Cancelled,
            other => PluginError::Refused(other.to_string()),
        })?;
        told?;
        input.solution(&solution(&made, start.is_some()))?;
        Ok(made.stack)
    }
}

/// Returns the summary of a factorization, for the report to the host. `warm` is true if it began
/// with a warm start.
fn solution(made: &Factorization, warm: bool) -> Solution {
    let settings = &made.settings;
    let start = if warm { "warm" } else { settings.start.unwrap_or_default().name() };
    let of_levels = |loss: &LevelsLoss| [loss.continuous, loss.rounded, loss.reoptimized];
    Solution {
        solver: settings.solver.clone(),
        start: start.into(),
        coarse_levels: if warm { 0 } else { settings.coarse_levels.unwrap_or(0) },
        kkt_residual: made.kkt_residual,
        levels: made.levels.as_ref().map(of_levels),
    }
}

export_plugin!("tensor_display", TensorDisplay as node);
