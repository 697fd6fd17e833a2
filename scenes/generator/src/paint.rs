//! Paints textures: samples a function of (u, v) with a box filter against aliasing. Also computes
//! noise that repeats without a visible border.
//!
//! While a texture is painted, its colours are sRGB-encoded in 0..1. The noise comes from integer
//! hashes, so that the pixels are the same on every machine.

use std::f64::consts::TAU;

/// A colour as RGBA, 0..1: sRGB-encoded, and not multiplied by its alpha.
pub(crate) type Rgba = [f64; 4];

/// An 8-bit RGBA picture, rows from the top.
#[derive(Debug, Clone)]
pub(crate) struct Picture {
    /// Number of columns.
    pub(crate) width: u32,
    /// Number of rows.
    pub(crate) height: u32,
    /// Row-major pixels.
    pub(crate) pixels: Vec<[u8; 4]>,
}

/// Paints the function `color(u, v)` (u to the right, v downwards, both 0..1). A pixel is the
/// average of `samples` x `samples` points.
pub(crate) fn paint(width: u32, height: u32, samples: u32, color: impl Fn(f64, f64) -> Rgba) -> Picture {
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    let step = 1.0 / f64::from(samples);
    for row in 0..height {
        for column in 0..width {
            let mut sum = [0.0; 4];
            for sample in 0..samples * samples {
                let (i, j) = (f64::from(sample % samples), f64::from(sample / samples));
                let u = (f64::from(column) + (i + 0.5) * step) / f64::from(width);
                let v = (f64::from(row) + (j + 0.5) * step) / f64::from(height);
                let value = color(u, v);
                // weight the colour by alpha, so that transparent samples add no colour
                for channel in 0..3 {
                    sum[channel] += value[channel] * value[3];
                }
                sum[3] += value[3];
            }
            let alpha = sum[3];
            let average = std::array::from_fn(|channel| match channel {
                3 => alpha * step * step,
                _ if alpha > 0.0 => sum[channel] / alpha,
                _ => 0.0,
            });
            pixels.push(average.map(quantized));
        }
    }
    Picture { width, height, pixels }
}

/// Paints a normal map in tangent space for a surface of the height `relief` · `height(u, v)`, in
/// widths of the texture. The texture repeats.
///
/// The normal is n ∝ (-∂h/∂x, -∂h/∂y, 1), with x to the right and y upwards in the image. It is
/// stored as (n + 1)/2 (glTF 2.0, 3.9.3).
pub(crate) fn paint_normals(size: u32, relief: f64, height: impl Fn(f64, f64) -> f64) -> Picture {
    let step = 1.0 / f64::from(size);
    paint(size, size, 1, |u, v| {
        let slope_right = relief * (height(u + step, v) - height(u - step, v)) / (2.0 * step);
        let slope_up = relief * (height(u, v - step) - height(u, v + step)) / (2.0 * step);
        let length = (slope_right * slope_right + slope_up * slope_up + 1.0).sqrt();
        let encode = |component: f64| 0.5 + 0.5 * component / length;
        [encode(-slope_right), encode(-slope_up), encode(1.0), 1.0]
    })
}

/// Returns an opaque colour, given 8-bit components.
pub(crate) fn rgb(red: u8, green: u8, blue: u8) -> Rgba {
    [f64::from(red) / 255.0, f64::from(green) / 255.0, f64::from(blue) / 255.0, 1.0]
}

/// Blends two colours linearly: `a` at t = 0, `b` at t = 1.
pub(crate) fn mix(a: Rgba, b: Rgba, t: f64) -> Rgba {
    std::array::from_fn(|channel| a[channel] + t.clamp(0.0, 1.0) * (b[channel] - a[channel]))
}

/// Multiplies red, green and blue of a colour by a factor.
pub(crate) fn shade(color: Rgba, factor: f64) -> Rgba {
    [color[0] * factor, color[1] * factor, color[2] * factor, color[3]]
}

/// Returns value noise in 0..1, with `cells_u` x `cells_v` cells in the unit square. The noise
/// repeats with the period 1 in u and v.
pub(crate) fn noise(u: f64, v: f64, cells_u: u32, cells_v: u32, seed: u32) -> f64 {
    let (x, y) = (u.rem_euclid(1.0) * f64::from(cells_u), v.rem_euclid(1.0) * f64::from(cells_v));
    let (column, row) = (x.floor() as u32, y.floor() as u32);
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (fx, fy) = (smooth(x - x.floor()), smooth(y - y.floor()));
    let at = |i: u32, j: u32| hash((column + i) % cells_u, (row + j) % cells_v, seed);
    let top = at(0, 0) + fx * (at(1, 0) - at(0, 0));
    let bottom = at(0, 1) + fx * (at(1, 1) - at(0, 1));
    top + fy * (bottom - top)
}

/// Returns a sum of several [`noise`] functions (octaves), scaled to 0..1. Each function has half
/// the amplitude and twice the number of cells of the previous function.
pub(crate) fn fractal_noise(u: f64, v: f64, cells: u32, octaves: u32, seed: u32) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for octave in 0..octaves {
        let amplitude = 0.5f64.powi(octave as i32);
        let cells = cells << octave;
        sum += amplitude * noise(u, v, cells, cells, seed + octave);
        total += amplitude;
    }
    sum / total
}

/// Returns a hash of three integers as a number in 0..1, by the finalizer of MurmurHash3 (Austin
/// Appleby).
pub(crate) fn hash(x: u32, y: u32, seed: u32) -> f64 {
    let mut state = x
        .wrapping_mul(0x9E37_79B1)
        .wrapping_add(y.wrapping_mul(0x85EB_CA77))
        .wrapping_add(seed.wrapping_mul(0xC2B2_AE3D));
    state ^= state >> 16;
    state = state.wrapping_mul(0x85EB_CA6B);
    state ^= state >> 13;
    state = state.wrapping_mul(0xC2B2_AE35);
    state ^= state >> 16;
    f64::from(state) / f64::from(u32::MAX)
}

/// Returns true if the distance of `x` from a multiple of `period` is less than `half_width`.
pub(crate) fn ruled(x: f64, period: f64, half_width: f64) -> bool {
    let offset = x.rem_euclid(period);
    offset.min(period - offset) < half_width
}

/// Returns cos(2π t), from which periodic reliefs are made.
pub(crate) fn wave(turns: f64) -> f64 {
    (TAU * turns).cos()
}

fn quantized(value: f64) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}
