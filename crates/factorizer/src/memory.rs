//! The memory that a factorization takes, estimated before it begins.

use lumistack_core::pages::Window;
use lumistack_display::{Backlight, Display, FieldGeometry, Sampling};

use crate::factor::PAD;
use crate::step::Sums;

/// Bytes of one factor's tables for one field column of a view column, or for one field row of a
/// view row.
///
/// The tables hold the pixels that rays read in the factor, once as [`Tap`](lumistack_display::Tap)
/// and once in the form for the kernels.
const TABLE_BYTES: u64 = 96;
/// Upper bound of the bytes of all small data.
const SMALL: u64 = 1 << 20;

/// Returns an upper bound of the bytes that [`factorize`](crate::factorize()) holds at any time, on
/// `threads` threads.
///
/// The bound includes:
/// * the target in half floats, at full resolution and at the coarser levels,
/// * the factors during the run, and the patterns before and after it,
/// * tables, and the buffers of each thread.
///
/// The bound does not include weights ([`weight_bytes`]), nor the caller's own target, which may be
/// in a mapped file. The bound assumes that half floats hold the target's values exactly. Otherwise
/// the target is kept in f32, and takes twice the memory.
pub fn held_bytes(display: &Display, geometry: &FieldGeometry, threads: usize) -> u64 {
    4 * target_bytes(geometry) / 3 + bytes_beside_target(display, geometry, threads)
}

/// Returns the bound of [`held_bytes`] for a target that the caller has in a file. The factorizer's
/// copy is then also in a file. About `window` bytes of the copy's file may be in memory.
pub fn paged_bytes(display: &Display, geometry: &FieldGeometry, threads: usize, window: u64) -> u64 {
    /// Bytes of a small page.
    const PAGE: u64 = 4096;
    /// Bytes of the references to one field row of one view, in three channels. They exist while
    /// rows are sorted.
    const PLACES: u64 = 96;
    let [view_rows, view_cols] = geometry.grid.views().map(|count| count as u64);
    let (views, rows, threads) = (view_rows * view_cols, geometry.rows as u64, threads as u64);
    let file = 2 * target_bytes(geometry);
    // a thread reads the rays of one line, or writes rows of one view
    let row = 4 * (geometry.cols as u64 + 2 * PAD as u64);
    let reading = views * row + view_rows * 2 * Window::NEIGHBOURS as u64;
    let writing = 3 * rows * (row + 2 * PAGE);
    let in_memory = (window + threads * reading.max(writing)).min(file);
    in_memory
        + PLACES * views * rows
        + target_bytes(geometry) / 3
        + bytes_beside_target(display, geometry, threads as usize)
}

/// Returns an upper bound of the bytes that the factorizer holds for weights of single rays, at
/// full resolution and at the coarser levels. The caller's own weights are not included.
pub fn weight_bytes(geometry: &FieldGeometry) -> u64 {
    // weights are single floats, and the target has three half floats per ray
    4 * (2 * target_bytes(geometry) / 3) / 3
}

/// Returns the bytes of the factorizer's own copy of the target: half floats in padded rows.
fn target_bytes(geometry: &FieldGeometry) -> u64 {
    let [view_rows, view_cols] = geometry.grid.views().map(|count| count as u64);
    2 * 3 * view_rows * view_cols * geometry.rows as u64 * (geometry.cols as u64 + 2 * PAD as u64)
}

fn bytes_beside_target(display: &Display, geometry: &FieldGeometry, threads: usize) -> u64 {
    let [view_rows, view_cols] = geometry.grid.views().map(|count| count as u64);
    let (rows, cols, threads) = (geometry.rows as u64, geometry.cols as u64, threads as u64);
    let (frames, pad) = (display.frames as u64, PAD as u64);
    let factors = factors(display, geometry);
    // factors are f32 in padded lines, with one line more than the layer has
    let padded = |[factor_cols, factor_rows]: [u64; 2], reach: u64| {
        4 * 3 * frames * (factor_rows + 1) * (factor_cols + 2 * reach + 6 * pad)
    };
    let patterns: u64 = factors.iter().map(|&(size, reach)| padded(size, reach)).sum();
    // a layer with a response keeps two sets of sums: one of the pixels that rays read, and one of
    // the stored pixels
    let summed = |(n, &(size, reach)): (usize, &([u64; 2], u64))| match display.layers.get(n) {
        Some(layer) if layer.response().is_some() => {
            2 * padded(size, reach) * Sums::Gram.count(display.frames) as u64 / frames
        }
        _ => 0,
    };
    let sums: u64 = factors.iter().enumerate().map(summed).sum();
    // bytes of the ray tables
    let tables = TABLE_BYTES * factors.len() as u64 * (view_cols * cols + view_rows * rows);
    // For each factor without a constant shift, every thread keeps values along rays. These values
    // take at most three rows per view row, for the field rows around a line.
    let longest = factors.iter().map(|([factor_cols, _], reach)| factor_cols + 2 * reach).max().unwrap_or(0).max(cols);
    let lines = 3 * view_rows * frames * (longest + 6 * pad) * 4;
    let expanded = match (&display.backlight, display.sampling) {
        (Backlight::Uniform, Sampling::Nearest) if same_pitch(display, geometry) => 0,
        (Backlight::Uniform, _) => lines * 2 * factors.len() as u64,
        (Backlight::Lenslets(_), _) => lines * (2 * factors.len() as u64 + view_cols * (factors.len() as u64 - 1)),
    };
    // A coarser level has a quarter of the pixels, so all levels take 4/3 of the finest. Four
    // copies of the factors are held: the values that rays read, the values before an
    // extrapolation, the stored values and a spare copy. The patterns are also held as tensors
    // before and after the run.
    4 * (4 * patterns + sums + tables) / 3 + 2 * patterns + threads * expanded + SMALL
}

/// Returns, for every layer and the backlight, the numbers of columns and rows, and the number of
/// columns past the edges that rays may read.
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

/// Returns true if every layer has the pixel pitch of the field.
fn same_pitch(display: &Display, geometry: &FieldGeometry) -> bool {
    display.layers.iter().all(|layer| (layer.pitch_mm / geometry.pitch_mm - 1.0).abs() < 1e-9)
}
