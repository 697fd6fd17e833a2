//! Where a run begins. Frames that start equal stay equal, and an exact 0 can never grow again under a multiplicative rule.

use lumistack_core::seed::{Stream, derive};
use lumistack_display::{Display, LayerStack};

/// Smallest value of a pattern: solvers whose rule multiplies never go below it.
pub const FLOOR: f32 = 1e-4;

/// How starting patterns are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StartKind {
    /// Every value of every frame independently uniform in [`FLOOR`]..1. The paper does not state its start; narrower ranges gain a few
    /// tenths of a dB in the first updates and change the ranking of no method.
    #[default]
    Random,
}

impl StartKind {
    /// All kinds with their names.
    pub const ALL: [(&'static str, Self); 1] = [("random", Self::Random)];

    /// The kind of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, kind)| *kind)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
        }
    }
}

/// Patterns of [`StartKind::Random`].
pub fn random_start(display: &Display, seed: u64) -> LayerStack {
    let mut stack = LayerStack::filled(display, 0.0);
    let parts = stack.layers.iter_mut().map(|layer| layer.data_mut());
    for (part, values) in parts.chain(stack.emission.iter_mut().map(|emission| emission.data_mut())).enumerate() {
        let mut stream = Stream::new(derive(seed, &[part as u64]));
        values.iter_mut().for_each(|value| *value = FLOOR + (1.0 - FLOOR) * stream.next_f32());
    }
    stack
}
