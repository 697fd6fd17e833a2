//! Loops along one row, each a small function compiled per instruction set.
//!
//! They read a factor by its map, add to a line's sums, and do plain arithmetic. The compiler
//! vectorizes them; no result depends on the instruction set.

use std::marker::PhantomData;
use std::ops::{AddAssign, Mul, Range};

use lumistack_simd::{Backend, Function, Kernel, Lanes, float_from_half, nearest_half};

use crate::map::{Access, ColumnTaps};
use crate::row::{Cover, Row, RowMut};

/// The functions of one instruction set. They check their arguments themselves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowFunctions {
    read: Function<Read<false>>,
    multiply: Function<Read<true>>,
    scatter: Function<Scatter<f32>>,
    scatter_long: Function<Scatter<f64>>,
    weigh: Function<Weigh>,
    radiance: Function<Radiance>,
    average: Function<Average>,
    mix: Function<Mix>,
    add: Function<Add>,
    add_products: Function<AddProducts>,
}

// SAFETY of every block below: the kernels demand only the instruction set for which `new` chose
// them
#[expect(clippy::undocumented_unsafe_blocks, reason = "one reason for all, above")]
impl RowFunctions {
    pub(crate) fn new(backend: Backend) -> Self {
        Self {
            read: backend.function::<Read<false>>(),
            multiply: backend.function::<Read<true>>(),
            scatter: backend.function::<Scatter<f32>>(),
            scatter_long: backend.function::<Scatter<f64>>(),
            weigh: backend.function::<Weigh>(),
            radiance: backend.function::<Radiance>(),
            average: backend.function::<Average>(),
            mix: backend.function::<Mix>(),
            add: backend.function::<Add>(),
            add_products: backend.function::<AddProducts>(),
        }
    }

    /// Writes to `to` the values that rays read in a factor.
    pub(crate) fn read(&self, from: Reading, to: &mut [f32]) {
        unsafe { (self.read)((from, to)) }
    }

    /// Multiplies `to` by the values that rays read in a factor.
    pub(crate) fn multiply(&self, from: Reading, to: &mut [f32]) {
        unsafe { (self.multiply)((from, to)) }
    }

    /// For every ray, adds a·b to the two pixels that the ray reads, times the pixels' shares.
    ///
    /// Rays that miss the line add to the padding, which no step reads.
    pub(crate) fn scatter(&self, x: &ColumnTaps, run: &Range<usize>, a: &[f32], b: &[f32], sums: &mut [f32]) {
        unsafe { (self.scatter)((x, run, a, b, sums)) }
    }

    /// Does the same as [`scatter`](Self::scatter), with sums in f64.
    pub(crate) fn scatter_long(&self, x: &ColumnTaps, run: &Range<usize>, a: &[f32], b: &[f32], sums: &mut [f64]) {
        unsafe { (self.scatter_long)((x, run, a, b, sums)) }
    }

    /// Writes values · share · w. `root_weights` has √w, and w is 1 without it.
    pub(crate) fn weigh(&self, values: &[f32], share: f32, root_weights: Option<&[f32]>, to: &mut [f32]) {
        unsafe { (self.weigh)((values, share, root_weights, to)) }
    }

    /// Writes βL of the first columns of a row of the target, for as many columns as `to` has.
    pub(crate) fn radiance(&self, row: Row, brightness: f32, to: &mut [f32]) {
        unsafe { (self.radiance)((row, brightness, to)) }
    }

    /// Writes one row of coarser pixels. It is the weighted mean of `rows`, averaged over the
    /// columns that each coarse pixel covers.
    ///
    /// `mixed` is scratch storage, two values longer than the rows.
    pub(crate) fn average(&self, rows: &[(Row, f32)], cols: &[Cover], mixed: &mut [f32], to: RowMut) {
        unsafe { (self.average)((rows, cols, mixed, to)) }
    }

    /// Writes (1 − t)·rows[0] + t·rows[1].
    pub(crate) fn mix(&self, rows: [&[f32]; 2], t: f32, to: &mut [f32]) {
        unsafe { (self.mix)((rows, t, to)) }
    }

    /// Adds `values` to `sum`.
    pub(crate) fn add(&self, sum: &mut [f32], values: &[f32]) {
        unsafe { (self.add)((sum, values)) }
    }

    /// Adds a·b to `sum`.
    pub(crate) fn add_products(&self, sum: &mut [f32], a: &[f32], b: &[f32]) {
        unsafe { (self.add_products)((sum, a, b)) }
    }
}

/// Data to read one factor along rays, through a range of columns of one field row.
#[derive(Clone, Copy)]
pub(crate) struct Reading<'a> {
    pub(crate) x: &'a ColumnTaps,
    pub(crate) run: &'a Range<usize>,
    /// The row that the rays read.
    pub(crate) upper: &'a [f32],
    /// A second row for bilinear sampling, with its weight.
    pub(crate) lower: Option<(&'a [f32], f32)>,
}

fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + t * (b - a)
}

/// Reads a factor along rays, and writes the values or multiplies by them.
struct Read<const MULTIPLY: bool>;

impl<const MULTIPLY: bool> Kernel for Read<MULTIPLY> {
    type Args<'a> = (Reading<'a>, &'a mut [f32]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((Reading { x, run, upper, lower }, to): Self::Args<'_>) {
        let put = |to: &mut f32, value: f32| if MULTIPLY { *to *= value } else { *to = value };
        // each piece of a run has one kind of access, so its loop has no branches
        for (cols, access) in x.pieces_within(run) {
            let to = &mut to[cols.start - run.start..cols.end - run.start];
            let len = to.len();
            let value = |i: usize| lower.map_or(upper[i], |(lower, t)| mix(upper[i], lower[i], t));
            match access {
                Access::Shift { by, t } => {
                    let start = (cols.start as isize + by) as usize;
                    let pixels = start..start + len + usize::from(t != 0.0);
                    let upper = &upper[pixels.clone()];
                    let lower = lower.map(|(lower, row_t)| (&lower[pixels], row_t));
                    match (t == 0.0, lower) {
                        (true, None) => to.iter_mut().zip(upper).for_each(|(to, &a)| put(to, a)),
                        (true, Some((lower, row_t))) => {
                            let pairs = upper.iter().zip(lower);
                            to.iter_mut().zip(pairs).for_each(|(to, (&a, &b))| put(to, mix(a, b, row_t)));
                        }
                        (false, None) => {
                            let pairs = upper[..len].iter().zip(&upper[1..]);
                            to.iter_mut().zip(pairs).for_each(|(to, (&a, &b))| put(to, mix(a, b, t)));
                        }
                        (false, Some((lower, row_t))) => {
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
}

/// [`RowFunctions::scatter`] with sums of type T.
struct Scatter<T>(PhantomData<T>);

impl<T: Copy + From<f32> + AddAssign + Mul<Output = T> + 'static> Kernel for Scatter<T> {
    type Args<'a> = (&'a ColumnTaps, &'a Range<usize>, &'a [f32], &'a [f32], &'a mut [T]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((x, run, a, b, sums): Self::Args<'_>) {
        for (cols, access) in x.pieces_within(run) {
            let part = cols.start - run.start..cols.end - run.start;
            let values = a[part.clone()].iter().zip(&b[part]).map(|(&a, &b)| T::from(a) * T::from(b));
            match access {
                Access::Shift { by, t } => {
                    let start = (cols.start as isize + by) as usize;
                    let share = T::from(1.0 - t);
                    if t == 0.0 {
                        sums[start..].iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
                    } else {
                        sums[start..].iter_mut().zip(values.clone()).for_each(|(sum, value)| *sum += share * value);
                        let share = T::from(t);
                        sums[start + 1..].iter_mut().zip(values).for_each(|(sum, value)| *sum += share * value);
                    }
                }
                Access::Indexed => {
                    for (&i, value) in x.first[cols].iter().zip(values) {
                        sums[i as usize] += value;
                    }
                }
                Access::Mixed => {
                    for (col, value) in cols.zip(values) {
                        sums[x.first[col] as usize] += T::from(1.0 - x.t[col]) * value;
                        sums[x.second[col] as usize] += T::from(x.t[col]) * value;
                    }
                }
            }
        }
    }
}

struct Weigh;

impl Kernel for Weigh {
    type Args<'a> = (&'a [f32], f32, Option<&'a [f32]>, &'a mut [f32]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((values, share, root_weights, to): Self::Args<'_>) {
        match root_weights {
            None => to.iter_mut().zip(values).for_each(|(to, &value)| *to = share * value),
            Some(roots) => {
                let weighed = values.iter().zip(roots).map(|(&value, &root)| share * root * root * value);
                to.iter_mut().zip(weighed).for_each(|(to, value)| *to = value);
            }
        }
    }
}

struct Radiance;

impl Kernel for Radiance {
    type Args<'a> = (Row<'a>, f32, &'a mut [f32]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((row, brightness, to): Self::Args<'_>) {
        match row {
            Row::Half(row) => to.iter_mut().zip(row).for_each(|(to, &half)| *to = brightness * float_from_half(half)),
            Row::Float(row) => to.iter_mut().zip(row).for_each(|(to, &value)| *to = brightness * value),
        }
    }
}

struct Average;

impl Kernel for Average {
    type Args<'a> = (&'a [(Row<'a>, f32)], &'a [Cover], &'a mut [f32], RowMut<'a>);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((rows, cols, mixed, to): Self::Args<'_>) {
        mixed.fill(0.0);
        for &(row, share) in rows {
            match row {
                Row::Half(row) => {
                    mixed.iter_mut().zip(row).for_each(|(to, &half)| *to += share * float_from_half(half))
                }
                Row::Float(row) => mixed.iter_mut().zip(row).for_each(|(to, &value)| *to += share * value),
            }
        }
        let means = cols.iter().map(|&(first, [a, b, c])| {
            let pixels = &mixed[first..first + 3];
            a * pixels[0] + b * pixels[1] + c * pixels[2]
        });
        match to {
            RowMut::Half(to) => to.iter_mut().zip(means).for_each(|(to, mean)| *to = nearest_half(mean)),
            RowMut::Float(to) => to.iter_mut().zip(means).for_each(|(to, mean)| *to = mean),
        }
    }
}

struct Mix;

impl Kernel for Mix {
    type Args<'a> = ([&'a [f32]; 2], f32, &'a mut [f32]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(([first, second], t, to): Self::Args<'_>) {
        to.iter_mut().zip(first.iter().zip(second)).for_each(|(to, (&a, &b))| *to = mix(a, b, t));
    }
}

struct Add;

impl Kernel for Add {
    type Args<'a> = (&'a mut [f32], &'a [f32]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((sum, values): Self::Args<'_>) {
        sum.iter_mut().zip(values).for_each(|(sum, &value)| *sum += value);
    }
}

struct AddProducts;

impl Kernel for AddProducts {
    type Args<'a> = (&'a mut [f32], &'a [f32], &'a [f32]);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((sum, a, b): Self::Args<'_>) {
        sum.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (&a, &b))| *sum += a * b);
    }
}
