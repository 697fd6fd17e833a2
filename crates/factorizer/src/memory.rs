//! How much memory a solve takes, said before it begins.

use lumistack_display::{Backlight, Display, FieldGeometry, Sampling};

use crate::factor::PAD;
use crate::step::Sums;

/// Bytes of a table per factor, and per column of a view column or row of a view row: where rays meet it, as floats and as tables for the kernels.
const TABLE_BYTES: u64 = 96;
/// Bytes of all that is small.
const SMALL: u64 = 1 << 20;

/// The most bytes that [`factorize`](crate::factorize()) holds at a time, from above: the target in half floats, at this and at coarser levels, the patterns
/// under way and those that are handed over, tables, and buffers of so many threads. The target itself, which may lie in a mapped file, and the weights are
/// not counted; one with values that are no half floats is kept in full floats, twice as large.
pub fn held_bytes(display: &Display, geometry: &FieldGeometry, threads: usize) -> u64 {
    let [view_rows, view_cols] = geometry.grid.views().map(|count| count as u64);
    let (rows, cols, threads) = (geometry.rows as u64, geometry.cols as u64, threads as u64);
    let (frames, pad) = (display.frames as u64, PAD as u64);
    let target = 2 * 3 * view_rows * view_cols * rows * (cols + 2 * pad);
    let factors = factors(display, geometry);
    let padded = |[factor_cols, factor_rows]: [u64; 2], reach: u64| {
        4 * 3 * frames * (factor_rows + 1) * (factor_cols + 2 * reach + 6 * pad)
    };
    let patterns: u64 = factors.iter().map(|&(size, reach)| padded(size, reach)).sum();
    // layers that rays do not meet as they are stored hold the sums of all pixels, twice
    let summed = |(n, &(size, reach)): (usize, &([u64; 2], u64))| match display.layers.get(n) {
        Some(layer) if layer.response().is_some() => {
            2 * padded(size, reach) * Sums::Gram.count(display.frames) as u64 / frames
        }
        _ => 0,
    };
    let sums: u64 = factors.iter().enumerate().map(summed).sum();
    let tables = TABLE_BYTES * factors.len() as u64 * (view_cols * cols + view_rows * rows);
    // values of factors that rays do not read in their place: of the field rows that meet a line or lie next to it
    let longest = factors.iter().map(|([factor_cols, _], reach)| factor_cols + 2 * reach).max().unwrap_or(0).max(cols);
    let lines = 3 * view_rows * frames * (longest + 6 * pad) * 4;
    let expanded = match (&display.backlight, display.sampling) {
        (Backlight::Uniform, Sampling::Nearest) if same_pitch(display, geometry) => 0,
        (Backlight::Uniform, _) => lines * 2 * factors.len() as u64,
        (Backlight::Lenslets(_), _) => lines * (2 * factors.len() as u64 + view_cols * (factors.len() as u64 - 1)),
    };
    // each level takes a quarter of the one below it; patterns: rays' and those before extrapolation, one spare, and tensors at the begin and the end
    4 * (target + 4 * patterns + sums + tables) / 3 + 2 * patterns + threads * expanded + SMALL
}

/// Columns and rows of layers and backlight, and how many columns beyond their edges rays may meet them.
fn factors(display: &Display, geometry: &FieldGeometry) -> Vec<([u64; 2], u64)> {
    let steepest = geometry.grid.slope_x.iter().fold(0.0f64, |most, slope| most.max(slope.abs()));
    let width = geometry.cols as f64 * geometry.pitch_mm;
    let reach = |d_mm: f64, pitch_mm: f64, cols: usize| {
        let wider = 0.5 * (width - cols as f64 * pitch_mm).max(0.0);
        ((d_mm.abs() * steepest + wider) / pitch_mm).ceil() as u64 + 1
    };
    let layers = display.layers.iter().map(|layer| {
        let [cols, rows] = layer.resolution;
        ([cols as u64, rows as u64], reach(layer.d_mm, layer.pitch_mm, cols))
    });
    let mut factors: Vec<_> = layers.collect();
    if let Backlight::Lenslets(lenslets) = &display.backlight {
        let [cols, rows] = [0, 1].map(|axis| lenslets.lenslets[axis] * lenslets.views[axis]);
        factors.push(([cols as u64, rows as u64], reach(lenslets.d_mm, lenslets.pitch_mm, cols)));
    }
    factors
}

/// Whether every layer's pixels are as large as those of the field.
fn same_pitch(display: &Display, geometry: &FieldGeometry) -> bool {
    display.layers.iter().all(|layer| (layer.pitch_mm / geometry.pitch_mm - 1.0).abs() < 1e-9)
}
