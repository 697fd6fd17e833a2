//! Values that next to no light reaches, since other layers block it: the objective leaves them open.
//!
//! Where another layer is black in frame m on all rays through a pixel, a_m = 0 there, and f_m may take any value at the same emission. A run ends with
//! the darkest one ([`crate::Run::settle`]). Layers that are black behind each other no longer move each other, since every a_m is then 0; a
//! warm start therefore [lifts](lifted) black a little, from where an exact step finds any value.

use lumistack_display::LayerStack;

use crate::bands;
use crate::plan::Plan;

/// Root mean square of a_m over a pixel's rays, relative to the brightness β, up to which the pixel counts as unlit in frame m. The whole range of
/// its value then changes what a viewer sees by a third of the smallest step of an 8-bit sRGB picture at most.
const UNLIT: f64 = 1e-4;

/// The least value in a warm start. Steps have no scale, so that any number that squares well above 0 in single precision frees a black pixel.
const LIFTED: f32 = 1e-4;

/// Per pixel of factor `n` the Σ w a_m² up to which it counts as unlit: `[line][x]` as the factor's lines are stored, (UNLIT β)² Σ w over the rays
/// through it. Negative where there are none.
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
            limits.iter_mut().for_each(|limit| *limit = if *limit > 0.0 { *limit * share } else { -1.0 });
        },
    );
    limits
}

/// Σ w a_m² relative to Σ w over a pixel's rays.
pub(crate) fn share(plan: &Plan) -> f32 {
    ((UNLIT * f64::from(plan.target.brightness)).powi(2)) as f32
}

/// Patterns to start from: no value is so dark that layers behind each other hold each other there.
pub(crate) fn lifted(stack: &LayerStack) -> LayerStack {
    let mut stack = stack.clone();
    let tensors = stack.layers.iter_mut().map(|layer| layer.data_mut());
    for values in tensors.chain(stack.emission.iter_mut().map(|emission| emission.data_mut())) {
        values.iter_mut().for_each(|value| *value = value.max(LIFTED));
    }
    stack
}
