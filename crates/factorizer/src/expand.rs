//! A factor's values along the rays of one field row, and the display's emission along them.

use std::f32::consts::{FRAC_PI_2, PI};
use std::ops::Range;

use lumistack_display::Formation;

use crate::factor::{Factor, PAD};
use crate::map::LineTap;
use crate::plan::Plan;
use crate::row::Row;
use crate::rows::Reading;
use crate::scratch::Scratch;

/// Rays of one view through a range of columns of one field row.
pub(crate) struct Rays<'a> {
    pub(crate) channel: usize,
    pub(crate) view: [usize; 2],
    pub(crate) row: usize,
    pub(crate) run: &'a Range<usize>,
}

/// Computes a_m = ∂L̃/∂(f_m/M) for the values f of factor `own`, and L̃, along the rays.
///
/// * Attenuating layers: a_m = Π_{k≠own} f_k.
/// * Emitting layers: a_m = 1.
/// * Polarization-rotating layers: L̃ = (1/M) Σ_m b sin²((π/2) s_m). s_m is the sum of all layers'
///   values in frame m, and b the backlight. So a_m = b (π/2) sin(π s_m) for a layer, and a_m =
///   sin²((π/2) s_m) for the backlight.
///
/// Let u = f/M for the values f of a rotating layer, and e = βL − L̃. As in `step.rs`, the
/// curvature of e² along u is half its second derivative. The curvature is at most
/// (π/2)² M (1 + 2 max|e|). The reason: Σ_m sin²(π s_m) ≤ M, |cos(π s_m)| ≤ 1 and b ≤ 1.
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
                    plan.row.add(emitted, values);
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

/// Computes [`coefficients`] of polarization-rotating layers, and the bound of their curvature.
fn rotate(plan: &Plan, factors: &[Factor], own: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let len = rays.run.len();
    let Scratch { product, phase, values, emitted, curvature, .. } = scratch;
    let (values, emitted) = (&mut values[..len], &mut emitted[..len]);
    emitted.fill(0.0);
    let (layers, backlight) = (0..plan.layers, (plan.layers < factors.len()).then_some(plan.layers));
    // For each frame, compute the sum of rotations s_m and the backlight b, then the derivative a_m
    // and the frame's contribution to L̃.
    for frame in 0..plan.frames {
        let phase = &mut phase[frame * plan.cols..][..len];
        phase.fill(0.0);
        for k in layers.clone() {
            expand_factor(plan, factors, k, frame, rays, values);
            plan.row.add(phase, values);
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
        // bound the curvature: |βL − L̃| is largest at L̃ = 0 or L̃ = 1
        wanted(plan, rays, curvature);
        let most = FRAC_PI_2 * FRAC_PI_2 * plan.frames as f32;
        curvature.iter_mut().for_each(|value| *value = most * (1.0 + 2.0 * value.abs().max((1.0 - *value).abs())));
    }
}

/// Computes the products P_m of all factors' values except factor `skip`, frame by frame, along the
/// rays.
fn expand_product(plan: &Plan, factors: &[Factor], skip: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let len = rays.run.len();
    let mut first = true;
    for k in (0..factors.len()).filter(|&k| Some(k) != skip) {
        for frame in 0..plan.frames {
            let product = &mut scratch.product[frame * plan.cols..][..len];
            let from = reading(plan, factors, k, frame, rays);
            if first { plan.row.read(from, product) } else { plan.row.multiply(from, product) }
        }
        first = false;
    }
    if first {
        scratch.product.fill(1.0);
    }
}

/// Computes the emission L̃ = (1/M) Σ_m P_m f_m along the rays, with the values f of factor `own`.
/// Without `own` the products P_m already include every factor.
fn emit_product(plan: &Plan, factors: &[Factor], own: Option<usize>, rays: &Rays, scratch: &mut Scratch) {
    let len = rays.run.len();
    let emitted = &mut scratch.emitted[..len];
    emitted.fill(0.0);
    for frame in 0..plan.frames {
        let product = &scratch.product[frame * plan.cols..][..len];
        if let Some(own) = own {
            let values = &mut scratch.values[..len];
            expand_factor(plan, factors, own, frame, rays, values);
            plan.row.add_products(emitted, product, values);
        } else {
            plan.row.add(emitted, product);
        }
    }
    let scale = 1.0 / plan.frames as f32;
    emitted.iter_mut().for_each(|sum| *sum *= scale);
}

/// Reads one factor's values along the rays.
pub(crate) fn expand_factor(plan: &Plan, factors: &[Factor], k: usize, frame: usize, rays: &Rays, to: &mut [f32]) {
    plan.row.read(reading(plan, factors, k, frame, rays), to);
}

/// Returns the rows and columns of a factor that the rays read.
fn reading<'a>(plan: &'a Plan, factors: &'a [Factor], k: usize, frame: usize, rays: &Rays<'a>) -> Reading<'a> {
    let map = &plan.maps[k];
    let LineTap { first, second, t } = map.y[rays.view[0]][rays.row];
    let row = |line: u32| factors[k].row(rays.channel, line as usize, frame);
    let lower = (t != 0.0).then(|| (row(second), t));
    Reading { x: &map.x[rays.view[1]], run: rays.run, upper: row(first), lower }
}

/// Computes βL along the rays.
pub(crate) fn wanted(plan: &Plan, rays: &Rays, to: &mut [f32]) {
    let part = PAD + rays.run.start..PAD + rays.run.end;
    let row = match plan.target.row(rays.channel, plan.view(rays.view[0], rays.view[1]), rays.row) {
        Row::Half(row) => Row::Half(&row[part]),
        Row::Float(row) => Row::Float(&row[part]),
    };
    plan.row.radiance(row, plan.target.brightness, to);
}

/// Computes e = βL − L̃ along the rays.
pub(crate) fn errors(plan: &Plan, rays: &Rays, emitted: &[f32], to: &mut [f32]) {
    wanted(plan, rays, to);
    to.iter_mut().zip(emitted).for_each(|(to, &emitted)| *to -= emitted);
}
