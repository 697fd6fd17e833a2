//! Updates the lines of a factor that is not at a constant shift. (At a constant shift, a ray's
//! column in the factor is its column in the view plus a constant.) There are three such cases.
//! Rays may read the factor between pixels, at shifts that vary. Several field pixels may share one
//! pixel of the factor. The factor's pitch may differ from the field's pitch.
//!
//! A ray reads the factor between lines j and j + 1, and between columns i and i + 1. So the sums
//! of [`gather`](crate::gather) are added to four pixels, with the shares (1 − t_y, t_y) and
//! (1 − t_x, t_x). If these additions were done ray by ray, an update would take nine times as long
//! as at a constant shift. But all views of a view column have the same t_x and read the same
//! columns. So the sums of these views are added up first, and distributed to the columns once:
//!
//! ```text
//! for every line j, for every view column:
//!     for the field rows whose rays read lines j and j + 1, in blocks of columns, in registers:
//!         low  += (1 − t_y) · (w e a_m, w a_m a_k)
//!         high += t_y · (w e a_m, w a_m a_k)
//!     once:  line j += low,  line j + 1 += high,  divided between columns i and i + 1 by t_x
//! ```
//!
//! Lines come in bands, one after another. Each line passes its sums `high` on to the next line.
//! Factors are read in two steps as well. First, two lines of the factor are mixed, once for all
//! view columns. Then the columns of that mixture are read. A version that updated lines in parts
//! of 128 columns, whose rows stay in the first-level cache, took 1.25 times as long.
//!
//! Under bilinear sampling a ray reads a mean Σ_t s_t f_t of the pixels t with the shares s_t. If
//! these pixels change by δ_t, Jensen's inequality gives (e − a·Σ_t s_t δ_t)² ≤ Σ_t s_t (e −
//! a·δ_t)². So the sums by shares describe a quadratic that is separable over pixels. It bounds the
//! objective from above and equals it at δ = 0, so a step to its minimum never raises the
//! objective.

use std::ops::{AddAssign, Mul, Range};

use lumistack_simd::{Backend, Function, Kernel, Lanes};

use crate::buffers::{Buffers, GROUP, Group, SumParams, buffered, sum_views};
use crate::factor::{Factor, PAD};
use crate::line::{LineOf, LineStep, Outcome, StepFunctions};
use crate::map::{Access, ColumnTaps};
use crate::plan::Plan;
use crate::rays::{LineRays, RowOfRays, Spare, expanded_stride, rays_of_column};
use crate::step::{Rule, Sums};
use crate::vector;

/// Number of lines per band. The rays between the last line of a band and the first line of the
/// next band are summed by both bands.
pub(crate) const BAND: usize = 16;

/// Number of rows of rays that are summed in f32 before these sums are added to f64 sums. Pixels
/// with very many rays need f64, since f32 loses digits.
const SHORT_ROWS: usize = 7;

/// The functions of an update, for one instruction set and rule.
pub(crate) struct ScatterFunctions {
    lanes: usize,
    block: Function<Apart>,
    scatter: Function<ScatterQuantities<f32>>,
    scatter_long: Function<ScatterQuantities<f64>>,
    step: StepFunctions,
}

impl ScatterFunctions {
    pub(crate) fn new(backend: Backend, step: StepFunctions) -> Self {
        Self {
            lanes: backend.lanes(),
            block: backend.function::<Apart>(),
            scatter: backend.function::<ScatterQuantities<f32>>(),
            scatter_long: backend.function::<ScatterQuantities<f64>>(),
            step,
        }
    }
}

/// Sums of the pixels of one line, `[quantity][x]`.
struct LineSums {
    /// The sums in f32. In the end, the sums in f64 are rounded to f32 and stored here.
    short: Vec<f32>,
    /// The sums in f64, if pixels may get many rays; otherwise empty.
    long: Vec<f64>,
    error: f64,
}

impl LineSums {
    fn clear(&mut self) {
        self.short.fill(0.0);
        self.long.fill(0.0);
        self.error = 0.0;
    }
}

/// Buffers of one thread, reused from band to band.
pub(crate) struct Scratch {
    buffers: Buffers,
    rays: LineRays<'static>,
    spare: Spare,
    /// For one view column, the sums of each field column, `[quantity][x]`: first the sums for this
    /// line, then the sums for the next line.
    columns: [Vec<f32>; 2],
    /// The sums of this line and of the next line.
    lines: [LineSums; 2],
    /// For each listed row of rays, its shares in this line and in the next line.
    shares: Vec<[f32; 2]>,
}

impl Scratch {
    pub(crate) fn new(plan: &Plan, n: usize, rule: Rule) -> Self {
        let map = &plan.maps[n];
        let quantities = rule.sums().count(plan.frames);
        let len = quantities * map.layout.stride;
        let line =
            || LineSums { short: vec![0.0; len], long: vec![0.0; if map.short_sums { 0 } else { len }], error: 0.0 };
        let columns = || vec![0.0; quantities * expanded_stride(plan)];
        Self {
            buffers: Buffers::new(plan.frames),
            rays: LineRays::default(),
            spare: Spare::default(),
            columns: [columns(), columns()],
            lines: [line(), line()],
            shares: Vec::new(),
        }
    }
}

/// Consecutive lines of one factor, to be updated in order.
pub(crate) struct ScatterBand<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) factors: &'a [Factor],
    pub(crate) functions: &'a ScatterFunctions,
    pub(crate) scratch: &'a mut Scratch,
    /// The line that was updated last; `None` before the first update. The rays between that line
    /// and the next line have already added their sums for the next line.
    pub(crate) before: Option<LineOf>,
}

impl ScatterBand<'_> {
    /// Sums the rays that read the line `at`, and steps the line's pixels.
    pub(crate) fn update(&mut self, at: LineOf, mut step: LineStep) -> Outcome {
        let needed = step.rule.sums();
        let follows = self.before.is_some_and(|before| before.channel == at.channel && before.line + 1 == at.line);
        // If this band did not update the previous line, sum the rays between the two lines again.
        if !follows {
            self.scratch.lines.iter_mut().for_each(LineSums::clear);
            if at.line > 0 {
                self.add_rays(LineOf { line: at.line - 1, ..at }, needed, true);
            }
        }
        self.before = Some(at);
        // Begin with the sums that the rays between the previous line and this line have added.
        self.scratch.lines.swap(0, 1);
        self.scratch.lines[1].clear();
        self.add_rays(at, needed, false);
        let Scratch { lines: [line, _], buffers, .. } = &mut *self.scratch;
        if !self.plan.maps[at.factor].short_sums {
            line.short.iter_mut().zip(&line.long).for_each(|(to, sum)| *to = *sum as f32);
        }
        let gain = step.by_sums(&self.functions.step, &line.short, &mut buffers.block);
        Outcome { error: line.error, gain }
    }

    /// Adds the rays between a line and the next line to the sums of these two lines.
    ///
    /// If `high_alone` is true, the caller needs only the sums of the next line.
    fn add_rays(&mut self, at: LineOf, needed: Sums, high_alone: bool) {
        let (plan, factors, functions) = (self.plan, self.factors, self.functions);
        let Scratch { buffers, rays, spare, columns, lines, shares } = &mut *self.scratch;
        let map = &plan.maps[at.factor];
        // list the field rows whose rays read between the line and the next line
        spare.rows.clear();
        shares.clear();
        for view_y in 0..plan.views[0] {
            for &(row, t) in map.rays_after_line(view_y, at.line) {
                spare.rows.push(RowOfRays { view_y, row: row as usize });
                shares.push([1.0 - t, t]);
            }
        }
        // if no row of rays has a share in the next line, there are no sums for the next line
        let is_high = shares.iter().any(|[_, high]| *high > 0.0);
        if shares.is_empty() || high_alone && !is_high {
            return;
        }
        let lanes = functions.lanes;
        let (quantities, field_stride) = (needed.count(plan.frames), expanded_stride(plan));
        let together = if map.short_sums { GROUP } else { SHORT_ROWS };
        let params = SumParams { brightness: plan.target.brightness, sums: needed };
        spare.mix_lines(plan, factors, at.channel, |_| true);
        // For each view column, sum the rays of each field column. Then add these sums to the
        // pixels that the field column reads.
        for view_x in 0..plan.views[1] {
            for run in &plan.runs[view_x] {
                let list = rays_of_column(std::mem::take(rays), plan, factors, at, (view_x, run), spare);
                let all = list.views.len();
                for first in (0..all).step_by(together) {
                    let views = first..(first + together).min(all);
                    for x in (PAD + run.start..PAD + run.end).step_by(lanes) {
                        let to = columns.each_mut().map(|sums| &mut sums[x..]);
                        let (rays, views, buffers) = (&list, views.clone(), &mut *buffers);
                        let block = ColumnBlock { rays, views, shares, is_high, x, params, buffers, to, field_stride };
                        // SAFETY: x + lanes lies within padded rows
                        let squares = unsafe { (functions.block)(block) };
                        lines.iter_mut().zip(squares).for_each(|(line, squares)| line.error += squares);
                    }
                    // add the sums for this line, then the sums for the next line
                    for (columns, line) in columns.iter().zip(&mut *lines).take(if is_high { 2 } else { 1 }) {
                        let (x, columns) = (&map.x[view_x], (&columns[..], field_stride));
                        // SAFETY: the kernels have no requirements
                        unsafe {
                            if map.short_sums {
                                let to = (&mut line.short[..], map.layout.stride);
                                (functions.scatter)((x, run, columns, to, quantities));
                            } else {
                                let to = (&mut line.long[..], map.layout.stride);
                                (functions.scatter_long)((x, run, columns, to, quantities));
                            }
                        }
                    }
                }
                *rays = list.emptied();
            }
        }
    }
}

/// One block of field columns, with the rays of one view column.
struct ColumnBlock<'a> {
    rays: &'a LineRays<'a>,
    /// A range of the rows of rays, no longer than a group of buffered views.
    views: Range<usize>,
    /// For each row of rays, its shares in the line and in the next line.
    shares: &'a [[f32; 2]],
    /// True if any row of rays has a share in the next line.
    is_high: bool,
    x: usize,
    params: SumParams,
    buffers: &'a mut Buffers,
    /// Destination of the sums for the line and for the next line: rows whose first value belongs
    /// to the block.
    to: [&'a mut [f32]; 2],
    field_stride: usize,
}

/// Sums a block's rays by their shares in the line and in the next line. Returns Σ w e² for each of
/// the two lines.
struct Apart;

impl Kernel for Apart {
    type Args<'a> = ColumnBlock<'a>;
    type Output = [f64; 2];

    #[inline(always)]
    unsafe fn run<V: Lanes>(at: ColumnBlock<'_>) -> [f64; 2] {
        let ColumnBlock { rays, views, shares, is_high, x, params, buffers, to, field_stride } = at;
        let frames = buffers.block.frames;
        // SAFETY: guaranteed by the caller
        unsafe {
            // buffer the rays, and their shares and errors for both lines
            let (mut squares, mut active) = ([V::splat(0.0); 2], [[0.0; GROUP]; 2]);
            let mut group = Group { frames, views: 0, add: false };
            for index in views {
                let Some(weight) = rays.views[index].weight::<V>(x) else { continue };
                let error = buffered::<V, true>(rays, index, x, weight, params, (group.views, &mut *buffers));
                for half in 0..2 {
                    active[half][group.views] = shares[index][half];
                    squares[half] = error.mul(V::splat(shares[index][half])).mul_add(error, squares[half]);
                }
                group.views += 1;
            }
            // sum the buffers for each of the two lines, and keep the sums of each field column
            for (half, to) in to.into_iter().enumerate().take(if is_high { 2 } else { 1 }) {
                sum_views::<V, true>(params.sums, buffers, &active[half], group);
                let mut rows = to.chunks_mut(field_stride);
                let mut keep = |from: &[f32], at: usize| {
                    let to = &mut rows.next().unwrap_or_default()[..V::COUNT];
                    vector::load::<V>(from, at * V::COUNT).store(to.as_mut_ptr());
                };
                let block = &buffers.block;
                (0..frames).for_each(|m| keep(&block.residual, m));
                for m in 0..frames {
                    match params.sums {
                        Sums::Gram => (m..frames).for_each(|k| keep(&block.gram, m * frames + k)),
                        Sums::Ratio | Sums::Diagonal => keep(&block.emitted, m),
                    }
                }
            }
            // vector::sum is called twice, since a closure in `squares.map` would not be inlined
            [vector::sum(squares[0]), vector::sum(squares[1])]
        }
    }
}

/// Adds the sums of field columns, `[quantity][column]`, to the sums of the pixels that the columns
/// read.
///
/// Rays that miss the line add to the padding, which no step reads.
struct ScatterQuantities<T>(std::marker::PhantomData<T>);

impl<T: Copy + Default + From<f32> + AddAssign + Mul<Output = T> + 'static> Kernel for ScatterQuantities<T> {
    type Args<'a> = (&'a ColumnTaps, &'a Range<usize>, (&'a [f32], usize), (&'a mut [T], usize), usize);
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>((x, run, (from, from_stride), (to, to_stride), quantities): Self::Args<'_>) {
        let rows = || from.chunks_exact(from_stride).take(quantities);
        for (cols, access) in x.pieces_within(run) {
            match access {
                Access::Shift { by, t } => {
                    let (start, share) = ((cols.start as isize + by) as usize, (T::from(1.0 - t), T::from(t)));
                    for (from, to) in rows().zip(to.chunks_exact_mut(to_stride)) {
                        let from = &from[PAD + cols.start..PAD + cols.end];
                        let to = &mut to[start..];
                        if t == 0.0 {
                            to.iter_mut().zip(from).for_each(|(sum, &value)| *sum += T::from(value));
                            continue;
                        }
                        // A pixel gets the second share of one column and the first share of the
                        // next column.
                        to[0] += share.0 * T::from(from[0]);
                        to[from.len()] += share.1 * T::from(from[from.len() - 1]);
                        for (sum, pair) in to[1..].iter_mut().zip(from.windows(2)) {
                            *sum += share.1 * T::from(pair[0]);
                            *sum += share.0 * T::from(pair[1]);
                        }
                    }
                }
                Access::Indexed => {
                    // columns that read the same pixel are summed first
                    let mut col = PAD + cols.start;
                    for same in x.first[cols].chunk_by(|a, b| a == b) {
                        let part = col..col + same.len();
                        col = part.end;
                        for (from, to) in rows().zip(to.chunks_exact_mut(to_stride)) {
                            let mut sum = T::default();
                            from[part.clone()].iter().for_each(|&value| sum += T::from(value));
                            to[same[0] as usize] += sum;
                        }
                    }
                }
                Access::Mixed => {
                    for (from, to) in rows().zip(to.chunks_exact_mut(to_stride)) {
                        for col in cols.clone() {
                            let value = T::from(from[PAD + col]);
                            to[x.first[col] as usize] += T::from(1.0 - x.t[col]) * value;
                            to[x.second[col] as usize] += T::from(x.t[col]) * value;
                        }
                    }
                }
            }
        }
    }
}
