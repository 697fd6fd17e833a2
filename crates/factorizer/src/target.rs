//! The target and the weights in the order in which the inner loops read them: `[channel][view][row][x]`, rows padded on both sides.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use lumistack_core::pages::prefer_large_pages;
use lumistack_display::{FieldGeometry, Weights};

use crate::bands;
use crate::factor::PAD;
use crate::problem::Problem;

/// Target L, brightness β and weights w.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    stride: usize,
    rows: usize,
    views: usize,
    /// Colour channels.
    pub(crate) channels: usize,
    /// L, not yet scaled by β.
    values: Radiance,
    /// β.
    pub(crate) brightness: f32,
    /// √w.
    weights: RayWeights,
    /// The largest weight; kept weights are divided by it, since only ratios matter to a step.
    pub(crate) weight_scale: f64,
}

/// L in 16 bits where that is all it holds: the inner loops wait for memory.
#[derive(Clone, Debug)]
enum Radiance {
    Half(Vec<u16>),
    Float(Vec<f32>),
    Lent(Lent),
}

/// Half floats `[view_y][view_x][row][col]` that lie elsewhere, for example in a mapped file.
pub type LentTarget = Arc<dyn AsRef<[u16]> + Send + Sync>;

/// Rows without padding: a row's neighbours are read in its place, except at the ends.
#[derive(Clone)]
struct Lent {
    values: LentTarget,
    first: Vec<u16>,
    last: Vec<u16>,
}

impl std::fmt::Debug for Lent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Lent({} values)", (*self.values).as_ref().len())
    }
}

/// One padded row of L.
#[derive(Clone, Copy)]
pub(crate) enum Row<'a> {
    Half(&'a [u16]),
    Float(&'a [f32]),
}

#[derive(Clone, Debug)]
enum RayWeights {
    Uniform,
    /// `[view][x]`, constant rows.
    PerView(Vec<f32>),
    /// `[view][row][x]`.
    PerRay(Vec<f32>),
}

impl Target {
    pub(crate) fn new(problem: &Problem) -> Self {
        let geometry = problem.target.geometry();
        let (rows, cols) = (geometry.rows, geometry.cols);
        let [view_rows, view_cols] = geometry.grid.views();
        let views = view_rows * view_cols;
        let stride = PAD + cols + PAD;
        let radiance = problem.target.radiance().data();
        let halves = rows_of(radiance, cols, stride, halves_from_floats);
        let values = match halves {
            Some(halves) => Radiance::Half(halves),
            None => {
                let copied = |from: &[f32], to: &mut [f32]| {
                    to.copy_from_slice(from);
                    true
                };
                Radiance::Float(rows_of(radiance, cols, stride, copied).unwrap_or_default())
            }
        };
        let (weights, weight_scale) = ray_weights(problem.weights, [views, rows, cols], stride);
        let brightness = problem.display.brightness as f32;
        Self { stride, rows, views, channels: 3, values, brightness, weights, weight_scale }
    }

    /// One channel of half floats that are not copied; all weights are 1.
    ///
    /// # Panics
    /// If the values are not those of the geometry, or rows are narrower than [`PAD`].
    pub(crate) fn lent(geometry: &FieldGeometry, brightness: f64, lent: LentTarget) -> Self {
        let [view_rows, view_cols] = geometry.grid.views();
        let (views, cols) = (view_rows * view_cols, geometry.cols);
        let values = (*lent).as_ref();
        assert!(cols >= PAD && values.len() == views * geometry.rows * cols, "lent target of {} values", values.len());
        let padded = |row: &[u16]| [&[0; PAD][..], row, &[0; PAD][..]].concat();
        let (first, last) = (padded(&values[..cols]), padded(&values[values.len() - cols..]));
        Self {
            stride: PAD + cols + PAD,
            rows: geometry.rows,
            views,
            channels: 1,
            values: Radiance::Lent(Lent { values: lent, first, last }),
            brightness: brightness as f32,
            weights: RayWeights::Uniform,
            weight_scale: 1.0,
        }
    }

    /// One padded row of L; column c stands at [`PAD`] + c.
    #[inline(always)]
    pub(crate) fn row(&self, channel: usize, view: usize, row: usize) -> Row<'_> {
        let index = (channel * self.views + view) * self.rows + row;
        let at = index * self.stride;
        match &self.values {
            Radiance::Half(values) => Row::Half(&values[at..at + self.stride]),
            Radiance::Float(values) => Row::Float(&values[at..at + self.stride]),
            Radiance::Lent(lent) if index == 0 => Row::Half(&lent.first),
            Radiance::Lent(lent) if index + 1 == self.views * self.rows => Row::Half(&lent.last),
            Radiance::Lent(lent) => {
                let at = index * (self.stride - 2 * PAD) - PAD;
                Row::Half(&(*lent.values).as_ref()[at..at + self.stride])
            }
        }
    }

    /// One padded row of √w, weights relative to the largest, or `None` where all are 1.
    #[inline(always)]
    pub(crate) fn weights(&self, view: usize, row: usize) -> Option<&[f32]> {
        match &self.weights {
            RayWeights::Uniform => None,
            RayWeights::PerView(values) => Some(&values[view * self.stride..(view + 1) * self.stride]),
            RayWeights::PerRay(values) => {
                let at = (view * self.rows + row) * self.stride;
                Some(&values[at..at + self.stride])
            }
        }
    }

    /// Number of rays with w > 0 in a part of a row.
    pub(crate) fn count(&self, view: usize, row: usize, cols: &Range<usize>) -> u64 {
        match self.weights(view, row) {
            None => cols.len() as u64,
            Some(weights) => weights[PAD + cols.start..PAD + cols.end].iter().filter(|w| **w > 0.0).count() as u64,
        }
    }
}

/// `[view][row][col][rgb]` into padded rows `[channel][view][row][x]`; `None` where `convert` says of a row that not all values have a counterpart.
fn rows_of<T: Copy + Default + Send>(
    radiance: &[f32],
    cols: usize,
    stride: usize,
    convert: impl Fn(&[f32], &mut [T]) -> bool + Sync + Send,
) -> Option<Vec<T>> {
    let lines = radiance.len() / (3 * cols);
    let mut values = vec![T::default(); 3 * lines * stride];
    prefer_large_pages(&values);
    let (red, rest) = values.split_at_mut(lines * stride);
    let (green, blue) = rest.split_at_mut(lines * stride);
    let channels = red.chunks_exact_mut(stride).zip(green.chunks_exact_mut(stride)).zip(blue.chunks_exact_mut(stride));
    let mut rows: Vec<_> = channels.map(|((red, green), blue)| [red, green, blue]).collect();
    let complete = AtomicBool::new(true);
    bands::for_each_chunk(
        &mut rows,
        1,
        || vec![T::default(); 3 * cols],
        |converted, line, rows| {
            if !complete.load(Ordering::Relaxed) {
                return;
            }
            if !convert(&radiance[line * cols * 3..][..cols * 3], converted) {
                complete.store(false, Ordering::Relaxed);
            }
            let [red, green, blue] = &mut rows[0];
            let rows = red[PAD..].iter_mut().zip(&mut green[PAD..]).zip(&mut blue[PAD..]);
            for (((red, green), blue), pixel) in rows.zip(converted.chunks_exact(3)) {
                (*red, *green, *blue) = (pixel[0], pixel[1], pixel[2]);
            }
        },
    );
    complete.into_inner().then_some(values)
}

/// The half floats that are exactly `values`; whether all have one.
fn halves_from_floats(values: &[f32], halves: &mut [u16]) -> bool {
    // zeros and what is normal in both formats, without branches
    let mut simple = true;
    for (half, value) in halves.iter_mut().zip(values) {
        let (sign, bits) = ((value.to_bits() >> 16 & 0x8000) as u16, value.to_bits() & 0x7fff_ffff);
        let normal = (113 << 23..143 << 23).contains(&bits) & (bits & 0x1fff == 0);
        simple &= normal | (bits == 0);
        *half = sign | if bits == 0 { 0 } else { (bits.wrapping_sub(112 << 23) >> 13) as u16 };
    }
    simple
        || halves.iter_mut().zip(values).all(|(half, &value)| match half_from_float(value) {
            Some(exact) => {
                *half = exact;
                true
            }
            None => false,
        })
}

/// The half float that is exactly `value`, if there is one and it is finite.
#[inline(always)]
fn half_from_float(value: f32) -> Option<u16> {
    let bits = value.to_bits();
    let (sign, exponent, mantissa) = ((bits >> 16 & 0x8000) as u16, (bits >> 23 & 0xff) as i32, bits & 0x7f_ffff);
    // f32 has 13 mantissa bits more; below 2^-14 a half float loses one more per power of two
    let lost = 13 + (113 - exponent).max(0);
    match exponent {
        0 if mantissa == 0 => Some(sign),
        103..=142 => {
            let whole = mantissa | 0x80_0000;
            let kept = whole >> lost;
            let half = if exponent > 112 { ((exponent - 112) as u32) << 10 | kept & 0x3ff } else { kept };
            (kept << lost == whole).then_some(sign | half as u16)
        }
        _ => None,
    }
}

fn ray_weights(weights: &Weights, [views, rows, cols]: [usize; 3], stride: usize) -> (RayWeights, f64) {
    let data = match weights {
        Weights::Uniform => return (RayWeights::Uniform, 1.0),
        Weights::PerView(weights) => weights.data(),
        Weights::PerRay(weights) => weights.data(),
    };
    let largest = data.iter().copied().fold(0.0f32, f32::max);
    let scale = if largest > 0.0 { f64::from(largest) } else { 1.0 };
    // a tiny weight must not become 0: PSNR counts every ray with w > 0
    let relative = |w: f32| if w > 0.0 { ((f64::from(w) / scale).sqrt() as f32).max(f32::MIN_POSITIVE) } else { 0.0 };
    let ray_weights = match weights {
        Weights::PerRay(_) => {
            let mut values = vec![0.0; views * rows * stride];
            for (row, source) in values.chunks_exact_mut(stride).zip(data.chunks_exact(cols)) {
                row[PAD..PAD + cols].iter_mut().zip(source).for_each(|(value, &w)| *value = relative(w));
            }
            RayWeights::PerRay(values)
        }
        _ => {
            let mut values = vec![0.0; views * stride];
            for (row, &w) in values.chunks_exact_mut(stride).zip(data) {
                row[PAD..PAD + cols].fill(relative(w));
            }
            RayWeights::PerView(values)
        }
    };
    (ray_weights, scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_floats_are_found_exactly() {
        for bits in 0..=u16::MAX {
            // by the definition of the format
            let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
            let magnitude = match exponent {
                0 => mantissa / 1024.0 * 2f64.powi(-14),
                31 => continue,
                _ => (1.0 + mantissa / 1024.0) * 2f64.powi(exponent - 15),
            };
            let value = if bits & 0x8000 == 0 { magnitude } else { -magnitude } as f32;
            assert_eq!(half_from_float(value), Some(bits), "{value}");
            let mut half = [0];
            assert!(halves_from_floats(&[value], &mut half));
            assert_eq!(half, [bits], "{value}");
        }
        for value in [0.1, 1.0 + 1.0 / 2048.0, 65536.0, 2f32.powi(-25), f32::INFINITY, f32::NAN] {
            assert_eq!(half_from_float(value), None, "{value}");
            assert!(!halves_from_floats(&[1.0, value], &mut [0; 2]), "{value}");
        }
    }
}
