//! Node plugin `two_layer_nmf`: content-adaptive parallax barriers (Lanman et al. 2010). A weighted
//! nonnegative matrix factorization computes the masks of two layers in several frames.
//!
//! The light field of two layers is a matrix L. It has a row for each rear pixel and a column for
//! each front pixel. An entry of L is known if a ray hits its rear pixel and its front pixel. A
//! display with M frames emits the matrix F Gᵀ / M, of rank at most M. Column m of F is the rear
//! mask of frame m, and column m of G is the front mask. F and G start from random values. In each
//! iteration, the weighted multiplicative rule (Blondel et al. 2008) updates F, then G. W is 1 for
//! known entries and 0 for all others. Here ⊛ and the fraction work element by element:
//!
//! ```text
//! F ← F ⊛ [(W ⊛ βL) G] / [(W ⊛ (F Gᵀ / M)) G], G likewise, clamped to the layer's range
//! ```
//!
//! This is eq. (16) of the paper "Tensor Displays" for N = 2. The plugin always uses this rule, not
//! the solver that the job selects, so that the older method can be compared with newer ones.

use lumistack_factorizer::{FactorizeError, Multiplicative, Problem, Settings, Solver, StartKind};
use lumistack_plugin::core::{Cancel, Collector, Task};
use lumistack_plugin::display::{LayerStack, Weights};
use lumistack_plugin::serde::Deserialize;
use lumistack_plugin::{NodeInput, NodePlugin, Param, PluginError, Schema, expects, export_plugin};

/// The plugin `two_layer_nmf`.
pub struct TwoLayerNmf;

/// Parameters; see [`TwoLayerNmf::schema`](NodePlugin::schema) for their meaning.
#[derive(Clone, Debug, Deserialize)]
#[serde(crate = "lumistack_plugin::serde")]
pub struct NmfParams {
    iterations: u32,
    seed: u64,
}

impl NodePlugin for TwoLayerNmf {
    const DOC: &'static str = "Computes content-adaptive parallax barriers: the masks of two layers in several frames, by nonnegative matrix factorization with the multiplicative \
        rule. It starts from random patterns.";
    type Params = NmfParams;

    fn schema() -> Schema {
        Schema::new([
            Param::int("iterations", 50, 1..=10_000, "Iterations; each updates both layers.").unit("1"),
            Param::int("seed", 1, 0..=i64::from(i32::MAX), "Random seed of the start.").unit("1"),
        ])
    }

    fn make(params: NmfParams, input: &NodeInput<'_>) -> Result<LayerStack, PluginError> {
        let (host, display) = (input.host(), input.display());
        expects::layers(display, 2)?;
        expects::attenuating(display)?;
        expects::uniform_backlight(display)?;
        let target = input.field().to_light_field()?;
        let problem = Problem { display, target: &target, weights: &Weights::Uniform };
        let settings = Settings {
            solver: Multiplicative.name().into(),
            seed: params.seed,
            start: Some(StartKind::Random),
            coarse_levels: Some(0),
            ..Settings::default()
        };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let failed = |error: FactorizeError| PluginError::Failed(error.to_string());
        // Make the start, then run single iterations, so that the host can cancel between them.
        let start = Settings { iterations: 0, ..settings };
        let task = Task::quiet(&warnings, &cancel);
        let start = lumistack_factorizer::factorize(&problem, &start, None, task, &mut |_| {}).map_err(failed)?;
        let mut run = Multiplicative.start(&problem, start.stack).map_err(failed)?;
        let stage = host.stage("matrix factorization", u64::from(params.iterations), "iterations");
        for _ in 0..params.iterations {
            host.check_cancelled()?;
            run.step(&cancel).map_err(|_| PluginError::Cancelled)?;
            stage.advance(1, "");
        }
        Ok(run.download())
    }
}

export_plugin!("two_layer_nmf", TwoLayerNmf as node);
