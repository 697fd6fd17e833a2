//! The step of one line of a factor by its sums.

use lumistack_simd::{Backend, Function, Kernel, Lanes};

use crate::step::{Block, Levels, Rule, Step, StepFunction, Sums, step_function};
use crate::vector::{self, Vector, load};

/// Position of a line: its factor, its colour channel, and its index in that channel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineOf {
    pub(crate) factor: usize,
    pub(crate) channel: usize,
    pub(crate) line: usize,
}

/// Error and gain of an update. A ray's error is e = βL − L̃, its target minus its light. The
/// weights w of rays are relative to the largest weight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Σ w e² over the rays through the updated lines, before the step. If a ray reads several
    /// lines, each line gets its share of w e². Rays that miss the factor may be left out. So this
    /// sum covers all rays only if [`Plan::sees_all_rays`](crate::device::Plan::sees_all_rays)
    /// returns true.
    pub error: f64,
    /// Lower bound of the decrease of Σ w e² by the step; 0 if the rule does not compute it.
    /// [`Rule::KktResidual`] and [`Rule::Darken`] return their result here.
    pub gain: f64,
}

impl Outcome {
    pub(crate) fn merged(self, other: Self) -> Self {
        Self { error: self.error + other.error, gain: self.gain + other.gain }
    }
}

/// A line's values and the limits of its step. In `[x]`, x is an index into a padded row; the rows
/// of successive frames are `stride` apart.
pub(crate) struct LineStep<'a> {
    pub(crate) rule: Rule,
    /// Box [low, high] of the values.
    pub(crate) range: [f32; 2],
    pub(crate) levels: Option<&'a Levels>,
    /// For [`Rule::Darken`] and each x, the largest Σ w a_m² of an unlit pixel; `step.rs` defines
    /// a_m.
    pub(crate) limits: Option<&'a [f32]>,
    /// In a tile, true for each x whose pixel keeps its values.
    pub(crate) fixed: Option<&'a [bool]>,
    /// Columns that rays can hit.
    pub(crate) columns: std::ops::Range<usize>,
    pub(crate) stride: usize,
    /// The values of all frames, which the step replaces.
    pub(crate) values: &'a mut [f32],
    /// The extrapolation's factor β_k, and this line's values in the last iterate.
    pub(crate) extrapolation: Option<(f32, &'a mut [f32])>,
    /// Destination of the sums, `[quantity][x]` in the order of [`Sums`]. If it is given, the line
    /// stores its sums and does not step, since a later step needs the sums of other lines too.
    pub(crate) sums: Option<&'a mut [f32]>,
}

/// The functions that are called after the sums, for one instruction set, rule and number of
/// frames.
pub(crate) struct StepFunctions {
    lanes: usize,
    step: StepFunction,
    fetch: Function<Fetch>,
    store_sums: Function<StoreSums>,
    put: Function<Put>,
}

impl StepFunctions {
    pub(crate) fn new(backend: Backend, rule: Rule, levels: bool, frames: usize) -> Self {
        Self {
            lanes: backend.lanes(),
            step: step_function(backend, rule, levels, frames),
            fetch: backend.function::<Fetch>(),
            store_sums: backend.function::<StoreSums>(),
            put: backend.function::<Put>(),
        }
    }
}

impl LineStep<'_> {
    /// Steps all pixels by their sums, `[quantity][x]` in the order of [`Sums`]; returns the gain.
    pub(crate) fn by_sums(&mut self, functions: &StepFunctions, sums: &[f32], block: &mut Block) -> f64 {
        let mut gain = 0.0;
        let lanes = functions.lanes;
        for x in self.columns.clone().step_by(lanes) {
            // SAFETY: the kernel has no requirements
            unsafe { (functions.fetch)((self, &sums[x..], self.stride, block, x)) };
            self.finish_block(functions, block, x);
            gain += vector::sum_of(&block.gain[..lanes]);
        }
        gain
    }

    /// Steps the vector of pixels at x by the sums and values in `block`, and writes the gain to
    /// the block. If `sums` is given, only stores the sums there, and does not step. The vector
    /// must be within the padded rows.
    pub(crate) fn finish_block(&mut self, functions: &StepFunctions, block: &mut Block, x: usize) {
        let lanes = functions.lanes;
        // Lanes past the last column are padding, to which rays that miss the layer add their sums.
        // So only the first `room` lanes get new values.
        let room = (self.columns.end - x).min(lanes);
        if let Some(sums) = &mut self.sums {
            block.gain = Vector::default();
            // SAFETY: the kernel has no requirements
            unsafe { (functions.store_sums)((block, &mut sums[x..], self.stride, self.rule.sums())) };
            return;
        }
        // step by the rule, then darken unlit values and restore fixed values, pixel by pixel
        let step = Step { block: &mut *block, sweeps: self.rule.sweeps(), range: self.range, levels: self.levels };
        // SAFETY: the function is for the block's number of frames
        unsafe { (functions.step)(step) };
        if let Some(limits) = self.limits {
            block.darken(lanes, &limits[x..x + room], self.range[0]);
        }
        if let Some(fixed) = self.fixed.map(|fixed| &fixed[x..x + room]).filter(|fixed| fixed.contains(&true)) {
            block.restore_fixed(lanes, fixed, &self.values[x..], self.stride);
        }
        block.gain[room..].fill(0.0);
        if self.rule != Rule::KktResidual {
            let extrapolation = self.extrapolation.as_mut().map(|(by, latest)| (*by, &mut latest[x..]));
            let to = Stepped { values: &mut self.values[x..], extrapolation, stride: self.stride, range: self.range };
            // SAFETY: the kernel has no requirements
            unsafe { (functions.put)((block, to, room)) };
        }
    }
}

/// Copies one vector of a line's pixels, beginning at pixel x, into a block: their values and their
/// sums. In the slice of sums, each quantity has a row. The slice begins at pixel x of the first
/// row, and the rows are `stride` apart.
pub(crate) struct Fetch;

impl Kernel for Fetch {
    type Args<'a> = (&'a LineStep<'a>, &'a [f32], usize, &'a mut Block, usize);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((line, sums, stride, block, x): Self::Args<'_>) {
        let frames = block.frames;
        let copy = |from: &[f32], to: &mut [f32], at: usize| {
            let (from, to) = (&from[..V::COUNT], &mut to[at * V::COUNT..][..V::COUNT]);
            // SAFETY: the machine has the instruction set of V; both slices have COUNT values
            unsafe { V::load(from.as_ptr()).store(to.as_mut_ptr()) };
        };
        for m in 0..frames {
            copy(&line.values[m * line.stride + x..], &mut block.values, m);
        }
        let mut rows = sums.chunks(stride);
        let mut next = || rows.next().unwrap_or_default();
        for m in 0..frames {
            copy(next(), &mut block.residual, m);
        }
        for m in 0..frames {
            match line.rule.sums() {
                Sums::Gram => (m..frames).for_each(|k| copy(next(), &mut block.gram, m * frames + k)),
                Sums::Ratio | Sums::Diagonal => copy(next(), &mut block.emitted, m),
            }
        }
    }
}

/// Copies the sums of a block to rows whose first value belongs to the block's first pixel.
pub(crate) struct StoreSums;

impl Kernel for StoreSums {
    type Args<'a> = (&'a Block, &'a mut [f32], usize, Sums);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((block, to, stride, sums): Self::Args<'_>) {
        let frames = block.frames;
        let mut rows = to.chunks_mut(stride);
        let mut store_sums = |from: &[f32], at: usize| {
            let (from, to) = (&from[at * V::COUNT..][..V::COUNT], &mut rows.next().unwrap_or_default()[..V::COUNT]);
            // SAFETY: the machine has the instruction set of V; both slices have COUNT values
            unsafe { V::load(from.as_ptr()).store(to.as_mut_ptr()) };
        };
        (0..frames).for_each(|m| store_sums(&block.residual, m));
        for m in 0..frames {
            match sums {
                Sums::Gram => (m..frames).for_each(|k| store_sums(&block.gram, m * frames + k)),
                Sums::Ratio | Sums::Diagonal => store_sums(&block.emitted, m),
            }
        }
    }
}

/// Destination of a block's values: the values of a line from the block's first pixel on, and the
/// box to which the values are clamped.
struct Stepped<'a> {
    values: &'a mut [f32],
    extrapolation: Option<(f32, &'a mut [f32])>,
    stride: usize,
    range: [f32; 2],
}

/// Writes the first `room` values of a block to the line. With an extrapolation, the last iterate
/// gets these values, and the line gets extrapolated values.
struct Put;

impl Kernel for Put {
    type Args<'a> = (&'a Block, Stepped<'a>, usize);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((block, to, room): Self::Args<'_>) {
        let Stepped { values, mut extrapolation, stride, range } = to;
        for m in 0..block.frames {
            let at = m * stride;
            // SAFETY: the machine has the instruction set of V; slices check lengths
            unsafe {
                let moved = load::<V>(&block.values, m * V::COUNT);
                let Some((by, latest)) = &mut extrapolation else {
                    put(moved, &mut values[at..], room);
                    continue;
                };
                let before = V::load(latest[at..at + V::COUNT].as_ptr());
                let extrapolated = moved.sub(before).mul_add(V::splat(*by), moved);
                let extrapolated = extrapolated.max(V::splat(range[0])).min(V::splat(range[1]));
                put(moved, &mut latest[at..], room);
                put(extrapolated, &mut values[at..], room);
            }
        }
    }
}

/// Stores the first `room` lanes. The values after the last column are padding, which must not
/// change, since rays that miss the factor read it.
#[inline(always)]
unsafe fn put<V: Lanes>(vector: V, to: &mut [f32], room: usize) {
    // SAFETY: the machine has the instruction set of V; lengths are checked
    unsafe {
        if room == V::COUNT {
            vector.store(to[..V::COUNT].as_mut_ptr());
        } else {
            let mut lanes = Vector::default();
            vector.store(lanes.as_mut_ptr());
            to[..room].copy_from_slice(&lanes[..room]);
        }
    }
}
