//! The target and the weights in the order of the inner loops, in rows that are padded at both
//! ends.
//!
//! The copy of a target in memory is `[channel][view][row][x]`. The copy of a target in a file is
//! `[channel][row][view][x]`, since the rays through a line of a layer are in a band of rows. So
//! updates read the file from one end to the other, and only a band is in memory. If a copy in
//! memory had the order of files, updates would take 1.3 times as long for 13 × 13 views. A lent
//! target is not copied: it has one channel, `[view][row][x]`.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use lumistack_core::Tensor;
use lumistack_core::pages::{Array, Plain, prefer_large_pages};
use lumistack_display::{FieldGeometry, Weights};
use lumistack_simd::{Backend, Kernel, Lanes};

use crate::bands;
use crate::factor::PAD;
use crate::problem::{FactorizeError, Problem};
use crate::row::{Cover, Row, RowMut};
use crate::rows::RowFunctions;

/// Target L, brightness β and weights w.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    stride: usize,
    rows: usize,
    views: usize,
    order: Order,
    /// Number of colour channels.
    pub(crate) channels: usize,
    /// L, not yet scaled by β.
    values: Radiance,
    /// β.
    pub(crate) brightness: f32,
    /// √w.
    weights: RayWeights,
    /// The largest weight. `weights` are relative to it, since only their ratios matter to a step.
    pub(crate) weight_scale: f64,
}

/// Order of the rows of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    /// Rows in the order `[view][row]`.
    Views,
    /// Rows in the order `[row][view]`.
    Rows,
}

impl Order {
    /// Returns the order of a target that is a copy of `radiance`.
    fn of(radiance: &Tensor<5>) -> Self {
        if radiance.storage().is_some() { Self::Rows } else { Self::Views }
    }

    /// Returns the position of a row in a channel of `views` views, each of `rows` rows.
    #[inline(always)]
    fn index(self, [views, rows]: [usize; 2], view: usize, row: usize) -> usize {
        match self {
            Self::Views => view * rows + row,
            Self::Rows => row * views + view,
        }
    }
}

/// L, in 16 bits if half floats hold it exactly, since the inner loops wait for memory.
#[derive(Clone, Debug)]
enum Radiance {
    Half(Arc<Array<u16>>),
    Float(Arc<Array<f32>>),
    Lent(Lent),
}

/// Half floats `[view_y][view_x][row][col]` in the caller's memory, for example a mapped file.
pub type LentTarget = Arc<dyn AsRef<[u16]> + Send + Sync>;

/// Rows without padding. Reads past a row's ends get values of the rows before and after it, which
/// are then ignored. No row is before the first row or after the last row, so padded copies of
/// these two rows are read.
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

#[derive(Clone, Debug)]
enum RayWeights {
    Uniform,
    /// `[view][x]`, constant along a row.
    PerView(Vec<f32>),
    /// A weight for each ray, `[view][row][x]`.
    PerRay(Vec<f32>),
}

impl Target {
    /// Copies the problem's target and weights. If the target is in a file, the copy is also in a
    /// file.
    ///
    /// # Errors
    /// If the file for the copy cannot be written.
    pub(crate) fn new(problem: &Problem) -> Result<Self, FactorizeError> {
        let geometry = problem.target.geometry();
        let (rows, cols) = (geometry.rows, geometry.cols);
        let [view_rows, view_cols] = geometry.grid.views();
        let views = view_rows * view_cols;
        let stride = PAD + cols + PAD;
        let radiance = problem.target.radiance();
        // store half floats if they hold all values exactly, otherwise f32
        let halve = Backend::best().function::<Halve>();
        // SAFETY: the kernel has no requirements
        let halves = rows_of(radiance, stride, |from, to| unsafe { halve((from, to)) })?;
        let values = match halves {
            Some(halves) => Radiance::Half(Arc::new(halves)),
            None => Radiance::Float(Arc::new(rows_of(radiance, stride, apart)?.unwrap_or(Array::Held(Vec::new())))),
        };
        let (weights, weight_scale) = ray_weights(problem.weights, [views, rows, cols], stride);
        let brightness = problem.display.brightness as f32;
        let order = Order::of(radiance);
        Ok(Self { stride, rows, views, order, channels: 3, values, brightness, weights, weight_scale })
    }

    /// Makes a target of one channel of half floats that stay in the caller's memory; all weights
    /// are 1.
    ///
    /// `brightness` is β.
    ///
    /// # Panics
    /// If the number of values does not fit the geometry, or rows are narrower than [`PAD`].
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
            order: Order::Views,
            channels: 1,
            values: Radiance::Lent(Lent { values: lent, first, last }),
            brightness: brightness as f32,
            weights: RayWeights::Uniform,
            weight_scale: 1.0,
        }
    }

    /// Returns the target at a coarser resolution: means over fine pixels, for the given views.
    ///
    /// `pixels` = [rows, columns] has, for each coarse row and each coarse column, the shares of
    /// three fine rows or columns. Means of half floats are stored as half floats too, since only a
    /// start depends on the means.
    pub(crate) fn averaged(&self, functions: &RowFunctions, views: &[usize], pixels: &[Vec<Cover>; 2]) -> Self {
        let [rows, cols] = [&pixels[0], &pixels[1]];
        let (stride, fine_cols) = (PAD + cols.len() + PAD, self.stride - 2 * PAD);
        // compute one coarse row: average three fine rows, then average groups of three columns of
        // the result
        let mix = |mixed: &mut Vec<f32>, index: usize, to: RowMut| {
            let (picture, (first, shares)) = (index / rows.len(), rows[index % rows.len()]);
            let (channel, view) = (picture / views.len(), views[picture % views.len()]);
            let fine = shares.iter().enumerate().filter(|(_, share)| **share > 0.0);
            let fine = fine.map(|(k, &share)| (self.row(channel, view, first + k).part(0..fine_cols), share));
            functions.average(&fine.collect::<Vec<_>>(), cols, mixed, to);
        };
        // the last coarse column reads up to two values past the row
        let scratch = || vec![0.0f32; fine_cols + 2];
        let len = self.channels * views.len() * rows.len() * stride;
        let inner = PAD..PAD + cols.len();
        let values = if let Radiance::Float(_) = self.values {
            let mut values = vec![0.0f32; len];
            prefer_large_pages(&values);
            bands::for_each_chunk(&mut values, stride, scratch, |mixed, index, row| {
                mix(mixed, index, RowMut::Float(&mut row[inner.clone()]));
            });
            Radiance::Float(Arc::new(Array::Held(values)))
        } else {
            let mut values = vec![0u16; len];
            prefer_large_pages(&values);
            bands::for_each_chunk(&mut values, stride, scratch, |mixed, index, row| {
                mix(mixed, index, RowMut::Half(&mut row[inner.clone()]));
            });
            Radiance::Half(Arc::new(Array::Held(values)))
        };
        // average the weights w themselves, not their roots
        let weights = match &self.weights {
            RayWeights::Uniform => RayWeights::Uniform,
            RayWeights::PerView(fine) => {
                let roots = views.iter().map(|view| fine[view * self.stride + PAD]);
                RayWeights::PerView(roots.flat_map(|root| std::iter::repeat_n(root, stride)).collect())
            }
            RayWeights::PerRay(_) => {
                let mut roots = vec![0.0f32; views.len() * rows.len() * stride];
                bands::for_each_chunk(&mut roots, stride, scratch, |mixed, index, row| {
                    let (view, (first, shares)) = (views[index / rows.len()], rows[index % rows.len()]);
                    mixed.fill(0.0);
                    for (k, &share) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
                        let fine = self.weights(view, first + k).unwrap_or_default();
                        mixed.iter_mut().zip(&fine[PAD..]).for_each(|(sum, root)| *sum += share * root * root);
                    }
                    for (root, &(first, shares)) in row[inner.clone()].iter_mut().zip(cols) {
                        let mean: f32 = shares.iter().zip(&mixed[first..]).map(|(share, w)| share * w).sum();
                        *root = mean.sqrt();
                    }
                });
                RayWeights::PerRay(roots)
            }
        };
        Self { stride, rows: rows.len(), views: views.len(), order: Order::Views, values, weights, ..*self }
    }

    /// Returns true for [`Weights::Uniform`]: all rays have weight 1.
    pub(crate) fn is_uniform(&self) -> bool {
        matches!(self.weights, RayWeights::Uniform)
    }

    /// Returns true if L may hold infinite values or NaN. The stored half floats are all finite.
    pub(crate) fn may_be_infinite(&self) -> bool {
        matches!(self.values, Radiance::Float(_))
    }

    /// Returns one padded row of L; column c is at [`PAD`] + c.
    #[inline(always)]
    pub(crate) fn row(&self, channel: usize, view: usize, row: usize) -> Row<'_> {
        let index = self.order.index([self.views, self.rows], view, row);
        let at = (channel * self.views * self.rows + index) * self.stride;
        match &self.values {
            Radiance::Half(values) => Row::Half(values.part(at..at + self.stride)),
            Radiance::Float(values) => Row::Float(values.part(at..at + self.stride)),
            Radiance::Lent(lent) => match index {
                0 => Row::Half(&lent.first),
                index if index + 1 == self.views * self.rows => Row::Half(&lent.last),
                index => {
                    let at = index * (self.stride - 2 * PAD) - PAD;
                    Row::Half(&(*lent.values).as_ref()[at..at + self.stride])
                }
            },
        }
    }

    /// Returns one padded row of √w, with w relative to the largest weight; `None` for
    /// [`Weights::Uniform`].
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

    /// Returns the number of rays with w > 0 in a range of columns.
    pub(crate) fn count(&self, view: usize, row: usize, cols: &Range<usize>) -> u64 {
        match self.weights(view, row) {
            None => cols.len() as u64,
            Some(weights) => weights[PAD + cols.start..PAD + cols.end].iter().filter(|w| **w > 0.0).count() as u64,
        }
    }
}

/// Sorts `[view_y][view_x][row][col][rgb]` into padded rows, in the order of [`Order::of`].
///
/// `convert` fills one row per channel. It returns false if T cannot hold a value; then the result
/// is `None`.
fn rows_of<T: Plain>(
    radiance: &Tensor<5>,
    stride: usize,
    convert: impl Fn(&[f32], [&mut [T]; 3]) -> bool + Sync + Send,
) -> Result<Option<Array<T>>, FactorizeError> {
    let [view_rows, view_cols, rows, cols, _] = radiance.shape();
    let views = view_rows * view_cols;
    let lines = views * rows;
    let mut array = Array::zeros(3 * lines * stride, radiance.storage())
        .map_err(|error| FactorizeError::Storage { why: error.to_string() })?;
    let (values, window) = array.all_mut();
    let (red, rest) = values.split_at_mut(lines * stride);
    let (green, blue) = rest.split_at_mut(lines * stride);
    let channels = red.chunks_exact_mut(stride).zip(green.chunks_exact_mut(stride)).zip(blue.chunks_exact_mut(stride));
    let mut places: Vec<_> = channels.map(|((red, green), blue)| [red, green, blue]).collect();
    // visit the rows in the order of the values in `radiance`, since it may be in a file too
    let order = Order::of(radiance);
    let place = |line| std::mem::take(&mut places[order.index([views, rows], line / rows, line % rows)]);
    let mut places: Vec<_> = (0..lines).map(place).collect();
    let complete = AtomicBool::new(true);
    bands::for_each_chunk(
        &mut places,
        1,
        || (),
        |(), line, places| {
            if !complete.load(Ordering::Relaxed) {
                return;
            }
            window.into_iter().for_each(|window| window.announce(3 * stride * size_of::<T>()));
            let places = places[0].each_mut().map(|row| &mut row[PAD..PAD + cols]);
            if !convert(radiance.part(line * cols * 3..(line + 1) * cols * 3), places) {
                complete.store(false, Ordering::Relaxed);
            }
        },
    );
    Ok(complete.into_inner().then_some(array))
}

/// Splits pixels into one row per channel.
fn apart(pixels: &[f32], [red, green, blue]: [&mut [f32]; 3]) -> bool {
    let rows = red.iter_mut().zip(green).zip(blue);
    for (((red, green), blue), pixel) in rows.zip(pixels.as_chunks::<3>().0) {
        [*red, *green, *blue] = *pixel;
    }
    true
}

/// Splits pixels into one row of half floats per channel; false if half floats cannot hold a value
/// exactly.
struct Halve;

impl Kernel for Halve {
    type Args<'a> = (&'a [f32], [&'a mut [u16]; 3]);
    type Output = bool;

    #[inline(always)]
    unsafe fn run<V: Lanes>((pixels, [red, green, blue]): Self::Args<'_>) -> bool {
        let pixels = pixels.as_chunks::<3>().0;
        // convert zeros and values that are normal numbers in both formats, without branches; note
        // if there are other values
        let mut others = 0;
        let mut simple = |value: f32| {
            let (sign, bits) = ((value.to_bits() >> 16 & 0x8000) as u16, value.to_bits() & 0x7fff_ffff);
            let normal = (bits.wrapping_sub(113 << 23) < 30 << 23) & (bits & 0x1fff == 0);
            others |= u32::from(!(normal | (bits == 0)));
            sign | if bits == 0 { 0 } else { (bits.wrapping_sub(112 << 23) >> 13) as u16 }
        };
        let rows = red.iter_mut().zip(&mut *green).zip(&mut *blue);
        for (((red, green), blue), pixel) in rows.zip(pixels) {
            (*red, *green, *blue) = (simple(pixel[0]), simple(pixel[1]), simple(pixel[2]));
        }
        others == 0 || exact_halves(pixels, [red, green, blue])
    }
}

/// Does the same as [`Halve`] for any values, more slowly.
#[cold]
fn exact_halves(pixels: &[[f32; 3]], rows: [&mut [u16]; 3]) -> bool {
    rows.into_iter().enumerate().all(|(channel, row)| {
        row.iter_mut().zip(pixels).all(|(half, pixel)| match half_from_float(pixel[channel]) {
            Some(exact) => {
                *half = exact;
                true
            }
            None => false,
        })
    })
}

/// Returns the finite half float that equals `value`; `None` if there is none.
#[inline(always)]
fn half_from_float(value: f32) -> Option<u16> {
    let bits = value.to_bits();
    let (sign, exponent, mantissa) = ((bits >> 16 & 0x8000) as u16, (bits >> 23 & 0xff) as i32, bits & 0x7f_ffff);
    // f32 has 13 more mantissa bits; below 2^-14 a half float loses one bit more per power of two
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

/// Returns √w per view or per ray, where w is relative to the largest weight. The second result is
/// the largest weight.
fn ray_weights(weights: &Weights, [views, rows, cols]: [usize; 3], stride: usize) -> (RayWeights, f64) {
    let data = match weights {
        Weights::Uniform => return (RayWeights::Uniform, 1.0),
        Weights::PerView(weights) => weights.data(),
        Weights::PerRay(weights) => weights.data(),
    };
    let largest = data.iter().copied().fold(0.0f32, f32::max);
    let scale = if largest > 0.0 { f64::from(largest) } else { 1.0 };
    // a tiny weight must not become 0, since PSNR includes every ray with w > 0
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
        // SAFETY: the kernel has no requirements
        let halve =
            |pixel: [f32; 3], rows: [&mut [u16]; 3]| unsafe { Backend::best().function::<Halve>()((&pixel, rows)) };
        for bits in 0..=u16::MAX {
            // the value by the definition of the half-float format
            let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
            let magnitude = match exponent {
                0 => mantissa / 1024.0 * 2f64.powi(-14),
                31 => continue,
                _ => (1.0 + mantissa / 1024.0) * 2f64.powi(exponent - 15),
            };
            let value = if bits & 0x8000 == 0 { magnitude } else { -magnitude } as f32;
            assert_eq!(half_from_float(value), Some(bits), "{value}");
            let [mut red, mut green, mut blue] = [[0]; 3];
            assert!(halve([value, 1.0, value], [&mut red, &mut green, &mut blue]));
            assert_eq!([red, green, blue], [[bits], [0x3c00], [bits]], "{value}");
        }
        for value in [0.1, 1.0 + 1.0 / 2048.0, 65536.0, 2f32.powi(-25), f32::INFINITY, f32::NAN] {
            assert_eq!(half_from_float(value), None, "{value}");
            assert!(!halve([1.0, value, 1.0], [&mut [0], &mut [0], &mut [0]]), "{value}");
        }
    }
}
