//! Tests of whole displays against naive oracles in double precision.

mod forward;
mod oracle;
mod response;

use lumistack_core::seed::{Stream, derive};

use crate::{Display, LayerStack};

/// Fills values with uniformly distributed random numbers.
fn fill(values: &mut [f32], seed: u64) {
    let mut random = Stream::new(derive(seed, &[]));
    values.fill_with(|| random.next_f32());
}

fn random_stack(display: &Display, seed: u64) -> LayerStack {
    let mut stack = LayerStack::filled(display, 0.0);
    for (n, layer) in stack.layers.iter_mut().enumerate() {
        fill(layer.data_mut(), derive(seed, &[n as u64]));
    }
    if let Some(emission) = &mut stack.emission {
        fill(emission.data_mut(), derive(seed, &[u64::MAX]));
    }
    stack
}
