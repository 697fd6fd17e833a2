//! A factor's values along the rays of one field row, and what the display emits along them.
//!
//! Tables become loops over columns: pieces of equal shift as slices, everything else one index at a time.

use std::f32::consts::{FRAC_PI_2, PI};
use std::ops::Range;

use lumistack_display::Formation;

use crate::factor::Factor;
use crate::plan::{Access, ColumnTaps, LineTap, Plan};
use crate::sums::Scratch;

/// Rays of one view through a part of one field row.
pub(crate) struct Rays<'a> {
    pub(crate) channel: usize,
    pub(crate) view: [usize; 2],
    pub(crate) row: usize,
    pub(crate) run: &'a Range<usize>,
}

/// a_m = ∂L̃/∂(f_m/M) for the values f of factor `own`, and L̃, along the rays.
///
/// Where layers attenuate, a_m = Π_{k ≠ own} f_k. Where they emit, a_m = 1. Where they rotate polarization, L̃ = (1/M) Σ b sin²((π/2) s_m) with
/// the sum s_m of all layers: a_m = b (π/2) sin(π s_m) for a layer and sin²((π/2) s_m) for the backlight; there, the curvature along a
/// layer's values is bounded by (π/2)² M (1 + 2 max|e|), from ‖sin‖² ≤ M and |cos| ≤ 1.
#[inline(always)]
pub(crate) fn coefficients(plan: &Plan, factors: &[Factor], own: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    match plan.formation {
        Formation::Attenuating => {
            expand_product(plan, factors, own, rays, scratch);
            emit_product(plan, factors, own, rays, scratch);
        }
        Formation::Additive => {
            let len = rays.run.len();
            let Scratch { product, values, emitted, .. } = scratch;
            let (values, emitted) = (&mut values[..len], &mut emitted[..len]);
            emitted.fill(0.0);
            for k in 0..factors.len() {
                for frame in 0..plan.frames {
                    expand_factor(plan, factors, k, frame, rays, values);
                    emitted.iter_mut().zip(&*values).for_each(|(sum, &value)| *sum += value);
                }
            }
            let mean = 1.0 / plan.frames as f32;
            emitted.iter_mut().for_each(|sum| *sum *= mean);
            if own.is_some() {
                product.fill(1.0);
            }
        }
        Formation::Polarization => rotate(plan, factors, own, rays, scratch),
    }
}

/// [`coefficients`] of polarization-rotating layers.
#[inline(always)]
fn rotate(plan: &Plan, factors: &[Factor], own: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let len = rays.run.len();
    let Scratch { product, phase, values, emitted, curvature, .. } = scratch;
    let (values, emitted) = (&mut values[..len], &mut emitted[..len]);
    emitted.fill(0.0);
    let (layers, backlight) = (0..plan.layers, (plan.layers < factors.len()).then_some(plan.layers));
    for frame in 0..plan.frames {
        let phase = &mut phase[frame * plan.cols..][..len];
        phase.fill(0.0);
        for k in layers.clone() {
            expand_factor(plan, factors, k, frame, rays, values);
            phase.iter_mut().zip(&*values).for_each(|(sum, &value)| *sum += value);
        }
        values.fill(1.0);
        if let Some(k) = backlight {
            expand_factor(plan, factors, k, frame, rays, values);
        }
        let product = &mut product[frame * plan.cols..][..len];
        for (((a, sum), &s), &b) in product.iter_mut().zip(&mut *emitted).zip(&*phase).zip(&*values) {
            let (sin, cos) = (FRAC_PI_2 * s).sin_cos();
            *sum += b * sin * sin;
            *a = if own == backlight { sin * sin } else { b * PI * sin * cos };
        }
    }
    let mean = 1.0 / plan.frames as f32;
    emitted.iter_mut().for_each(|sum| *sum *= mean);
    if own.is_some() && own != backlight {
        let curvature = &mut curvature[..len];
        plan.target.wanted(rays, plan, curvature);
        let most = FRAC_PI_2 * FRAC_PI_2 * plan.frames as f32;
        // L̃ stays in 0..1
        curvature.iter_mut().for_each(|value| *value = most * (1.0 + 2.0 * value.abs().max((1.0 - *value).abs())));
    }
}

/// P_m = Π_{k ≠ skip} of the factors' values along the rays.
#[inline(always)]
fn expand_product(plan: &Plan, factors: &[Factor], skip: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let len = rays.run.len();
    let mut first = true;
    for k in (0..factors.len()).filter(|&k| Some(k) != skip) {
        for frame in 0..plan.frames {
            let product = &mut scratch.product[frame * plan.cols..][..len];
            if first {
                expand(plan, factors, k, frame, rays, product, |product, value| *product = value);
            } else {
                expand(plan, factors, k, frame, rays, product, |product, value| *product *= value);
            }
        }
        first = false;
    }
    if first {
        scratch.product.fill(1.0);
    }
}

/// L̃ = (1/M) Σ_m P_m f_m with the values of factor `own`, or (1/M) Σ_m P_m where the product holds every factor.
#[inline(always)]
fn emit_product(plan: &Plan, factors: &[Factor], own: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let len = rays.run.len();
    let emitted = &mut scratch.emitted[..len];
    emitted.fill(0.0);
    for frame in 0..plan.frames {
        let product = &scratch.product[frame * plan.cols..][..len];
        if let Some(own) = own {
            let values = &mut scratch.values[..len];
            expand_factor(plan, factors, own, frame, rays, values);
            for ((sum, &p), &f) in emitted.iter_mut().zip(product).zip(&*values) {
                *sum += p * f;
            }
        } else {
            emitted.iter_mut().zip(product).for_each(|(sum, &p)| *sum += p);
        }
    }
    let scale = 1.0 / plan.frames as f32;
    emitted.iter_mut().for_each(|sum| *sum *= scale);
}

/// One factor's values along the rays.
#[inline(always)]
pub(crate) fn expand_factor(plan: &Plan, factors: &[Factor], k: usize, frame: usize, rays: &Rays, to: &mut [f32]) {
    expand(plan, factors, k, frame, rays, to, |to, value| *to = value);
}

/// One factor's values along the rays, handed to `put` one by one.
#[inline(always)]
fn expand(
    plan: &Plan,
    factors: &[Factor],
    k: usize,
    frame: usize,
    rays: &Rays,
    to: &mut [f32],
    put: impl Fn(&mut f32, f32),
) {
    let map = &plan.maps[k];
    let x: &ColumnTaps = &map.x[rays.view[1]];
    let LineTap { first, second, t } = map.y[rays.view[0]][rays.row];
    let upper = factors[k].row(rays.channel, first as usize, frame);
    if t == 0.0 {
        expand_pieces(x, rays.run, to, put, |i| upper[i], |range| (&upper[range], None), t);
    } else {
        let lower = factors[k].row(rays.channel, second as usize, frame);
        let value = |i: usize| upper[i] + t * (lower[i] - upper[i]);
        expand_pieces(x, rays.run, to, put, value, |range| (&upper[range.clone()], Some(&lower[range])), t);
    }
}

/// Along columns, piece by piece: `value` gives the row's value at an index; `rows` gives the same as slices of one row, or of two that are mixed
/// by `row_t`.
#[inline(always)]
fn expand_pieces<'a>(
    x: &ColumnTaps,
    run: &Range<usize>,
    to: &mut [f32],
    put: impl Fn(&mut f32, f32),
    value: impl Fn(usize) -> f32,
    rows: impl Fn(Range<usize>) -> (&'a [f32], Option<&'a [f32]>),
    row_t: f32,
) {
    let mix = |a: f32, b: f32, t: f32| a + t * (b - a);
    for (cols, access) in pieces_within(x, run) {
        let to = &mut to[cols.start - run.start..cols.end - run.start];
        let len = to.len();
        match access {
            Access::Shift { by, t } => {
                let start = (cols.start as isize + by) as usize;
                match (t == 0.0, rows(start..start + len + usize::from(t != 0.0))) {
                    (true, (upper, None)) => to.iter_mut().zip(upper).for_each(|(to, &a)| put(to, a)),
                    (true, (upper, Some(lower))) => {
                        to.iter_mut().zip(upper.iter().zip(lower)).for_each(|(to, (&a, &b))| put(to, mix(a, b, row_t)));
                    }
                    (false, (upper, None)) => {
                        let pairs = upper[..len].iter().zip(&upper[1..]);
                        to.iter_mut().zip(pairs).for_each(|(to, (&a, &b))| put(to, mix(a, b, t)));
                    }
                    (false, (upper, Some(lower))) => {
                        let left = upper[..len].iter().zip(&lower[..len]);
                        let right = upper[1..].iter().zip(&lower[1..]);
                        for (to, ((&a, &b), (&c, &d))) in to.iter_mut().zip(left.zip(right)) {
                            put(to, mix(mix(a, b, row_t), mix(c, d, row_t), t));
                        }
                    }
                }
            }
            Access::Indexed => {
                to.iter_mut().zip(&x.first[cols]).for_each(|(to, &i)| put(to, value(i as usize)));
            }
            Access::Mixed => {
                let taps = x.first[cols.clone()].iter().zip(&x.second[cols.clone()]).zip(&x.t[cols]);
                for (to, ((&first, &second), &t)) in to.iter_mut().zip(taps) {
                    put(to, mix(value(first as usize), value(second as usize), t));
                }
            }
        }
    }
}

/// The pieces of a run.
#[inline(always)]
pub(crate) fn pieces_within<'a>(
    x: &'a ColumnTaps,
    run: &'a Range<usize>,
) -> impl Iterator<Item = (Range<usize>, Access)> + 'a {
    x.pieces
        .iter()
        .map(|piece| (piece.cols.start.max(run.start)..piece.cols.end.min(run.end), piece.access))
        .filter(|(cols, _)| !cols.is_empty())
}
