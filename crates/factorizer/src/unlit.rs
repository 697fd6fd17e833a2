//! Unlit values: other layers block almost all their light, so the objective does not determine
//! them.
//!
//! The derivative a_m of L̃ by f_m/M is the light that the other layers transmit in frame m. If
//! another layer is black in frame m on all rays through a pixel, then a_m = 0. Every value of f_m
//! then gives the same emission. At the end of a run, [`crate::Run::darken_unlit`] chooses the
//! darkest value.
//!
//! If two layers are black on the same rays, each layer makes a_m of the other layer 0. So no
//! update can change either layer there. A warm start therefore [lifts](lifted) black slightly.
//! From the lifted value an exact step reaches any value.

use lumistack_display::LayerStack;

use crate::bands;
use crate::plan::Plan;

/// Largest root mean square of the light a_m that the other layers pass to an unlit pixel, relative
/// to the brightness β.
///
/// The full range of an unlit value changes the picture along its rays, in the root mean square, by
/// at most a third of the smallest step in 8-bit sRGB.
const UNLIT: f64 = 1e-4;

/// Smallest value of a warm start. An exact step moves a value to the minimum of the objective even
/// if very little light reaches the pixel. So any number whose square is a normal f32 suffices.
const LIFTED: f32 = 1e-4;

/// Returns a limit for each pixel of factor `n`. The pixel is unlit if Σ w a_m² over its rays is at
/// most the limit, which is (UNLIT β)² Σ w over the same rays.
///
/// The order is `[line][x]`, as the factor's lines are stored. A pixel without rays has a negative
/// limit, so it is never unlit.
pub(crate) fn limits(plan: &Plan, n: usize) -> Vec<f32> {
    let map = &plan.maps[n];
    let stride = map.layout.stride;
    let share = share(plan);
    let mut limits = vec![0.0f32; map.layout.lines() * stride];
    bands::for_each_chunk(
        &mut limits,
        stride,
        || vec![0.0; plan.cols],
        |weighted, line, limits| {
            // sum the weights w over the rays through each pixel of the line
            for view_y in 0..plan.views[0] {
                for &(row, line_weight) in map.rays_of_line(view_y, line) {
                    for view_x in 0..plan.views[1] {
                        for run in &plan.runs[view_x] {
                            let weights = plan.target.weights(plan.view(view_y, view_x), row as usize);
                            let weighted = &mut weighted[..run.len()];
                            match weights {
                                None => weighted.fill(line_weight),
                                Some(roots) => {
                                    let roots = &roots[crate::factor::PAD + run.start..];
                                    weighted.iter_mut().zip(roots).for_each(|(w, root)| *w = line_weight * root * root);
                                }
                            }
                            plan.row.scatter(&map.x[view_x], run, weighted, &plan.ones[..run.len()], limits);
                        }
                    }
                }
            }
            // scale the sum to the limit, and exempt pixels without rays
            limits.iter_mut().for_each(|limit| *limit = if *limit > 0.0 { *limit * share } else { -1.0 });
        },
    );
    limits
}

/// Returns the largest Σ w a_m² of an unlit pixel, divided by Σ w over the pixel's rays.
pub(crate) fn share(plan: &Plan) -> f32 {
    ((UNLIT * f64::from(plan.target.brightness)).powi(2)) as f32
}

/// Raises values below [`LIFTED`] to [`LIFTED`], so that updates can change layers that are black
/// on the same rays.
pub(crate) fn lifted(stack: &LayerStack) -> LayerStack {
    let mut stack = stack.clone();
    let tensors = stack.layers.iter_mut().map(|layer| layer.data_mut());
    for values in tensors.chain(stack.emission.iter_mut().map(|emission| emission.data_mut())) {
        values.iter_mut().for_each(|value| *value = value.max(LIFTED));
    }
    stack
}
