//! Updates one line of a factor at a constant shift. Every ray reads one pixel of the factor. The
//! pixel's column is the ray's column plus a constant of the view.
//!
//! This is the paper's case: oblique views, equal pitch, nearest sampling. The simple version, for
//! line j of layer n:
//!
//! ```text
//! for every view (a_y, a_x), every field row i that reads line j, every column x of the line:
//!     c = x − shift_n
//!     a_m = Π_{k≠n} f_k[line of i][m][c + shift_k]
//!     e = βL[a][i][c] − (1/M) Σ_m a_m f_n[j][m][x]
//!     r[m][x] += w e a_m
//!     G[m][k][x] += w a_m a_k
//! step f_n[j][..][x] by r and G
//! ```
//!
//! The code departs from the simple version in the following ways:
//!
//! 1. **Blocks.** Columns are processed in blocks of one vector, and a block sums all views before
//!    the next block begins. The values of a block stay in the first-level cache, and accumulators
//!    stay in registers.
//! 2. **Registers.** If registers hold a_m and the sums of all frames,
//!    [`registers`](crate::registers) has the loop. AVX-512 and NEON hold up to 8 frames for the
//!    paper's rule, and up to 4 for G. For G of 6 frames, 3×3 tiles along its diagonal are summed
//!    together. The rest of G follows from a_m in a small buffer.
//! 3. **Buffers.** Otherwise the a_m and e of a group of views are buffered, 11 kB for 25 views and
//!    6 frames. Then the sums are made tile by tile, each in registers. So any number of frames
//!    runs the same code, and 12 frames spill as little as 6. A group is small enough to leave room
//!    in the first-level cache.
//! 4. **Prefetch.** An update reads many rows side by side: frames × layers × view rows of the
//!    factors, and one row of the target per view. Hardware prefetchers do not follow so many rows.
//!    So each view prefetches a few rows of factors two vectors ahead. It prefetches its row of the
//!    target into the second-level cache only.
//! 5. **Target.** The target is read in 16 bits if half floats hold it exactly. √w multiplies a_m
//!    and e, so that no sum needs w.
//! 6. **Masks.** A block is masked if it crosses the border of the valid rays or if rays have
//!    weights. Padding makes the loads of a masked block legal.
//! 7. **Expanded factors.** A factor that is not at a constant shift is first expanded along the
//!    rays, which puts it at shift 0. Examples are a lenslet grid and a layer of another pitch.
//!    Expanded rows are reused for the next lines as long as the rays read the same lenslets.
//! 8. **Functions.** Each case of rule, frames, factors and masking is a separate function, which
//!    is chosen once per update and called once per block.
//!
//! Measurements on Zen 4, and changes that gained nothing:
//!
//! * Buffers alone took 1.3 times as long as registers for the multiplicative rule, and 1.2 times
//!   as long for the block-exact rule.
//! * An update with a prefetch of all 60 rows at the start of a block took 4 % longer.
//! * The sums of one view in a block take 45 to 54 cycles. If no load straddles cache lines, they
//!   take 48 instead of 54. If in addition all view rows read one line, they take 38. With
//!   everything in the first-level cache they would take 26.
//! * Three other versions took longer per view and block. Aligned loads with a permutation took 63
//!   cycles. Sums over one to three view rows together took 58 to 75 cycles. Lines in the order of
//!   a view's shift took 60 cycles.
//! * These changes had no effect: tiles of fewer columns, vectors of AVX2 with the registers of
//!   AVX-512, and two independent chains of additions for the sum over frames.
//! * A single function for all cases, inlined, was 400 kB of code and took four times as long to
//!   compile.

use lumistack_simd::{Backend, Function};

use crate::buffers::{BlockOfLine, Buffers, ByBuffers, SumParams};
use crate::factor::Factor;
use crate::line::{LineOf, LineStep, Outcome, StepFunctions};
use crate::plan::Plan;
use crate::rays::{LineRays, Spare, rays_through};
use crate::registers::{Gram, Pairs};
use crate::step::{Rule, Sums};
use crate::vector::{self, Vector};

/// Number of blocks whose errors are added in f32 before they go into an f64 sum.
const BLOCKS_PER_SUM: usize = 4;

/// The functions of an update, for one instruction set, rule, number of frames and number of
/// factors.
pub(crate) struct GatherFunctions {
    lanes: usize,
    /// For blocks in which all rays of every view are valid and have weight 1.
    whole: Function<ByBuffers>,
    /// For blocks in which some rays are invalid or have another weight.
    masked: Function<ByBuffers>,
    step: StepFunctions,
}

impl GatherFunctions {
    /// Chooses the functions. `others` is the number of factors besides the factor under update.
    pub(crate) fn new(backend: Backend, rule: Rule, frames: usize, others: usize, step: StepFunctions) -> Self {
        macro_rules! in_registers {
            ($kernel:ident($whole:tt, $masked:tt) for $($frames:literal),*) => {
                match (frames, others) {
                    $(($frames, 1) => in_registers!(@ $kernel $whole $masked $frames, 1),
                    ($frames, 2) => in_registers!(@ $kernel $whole $masked $frames, 2),
                    ($frames, 3) => in_registers!(@ $kernel $whole $masked $frames, 3),)*
                    _ => [backend.function::<ByBuffers>(); 2],
                }
            };
            (@ $kernel:ident ($($whole:literal),*) ($($masked:literal),*) $frames:literal, $others:literal) => {
                [backend.function::<$kernel<$frames, $others, $($whole),*>>(), backend.function::<$kernel<$frames, $others, $($masked),*>>()]
            };
        }
        // the listed numbers of frames have functions that sum in registers; other numbers use
        // buffers
        let [whole, masked] = match rule.sums() {
            Sums::Gram => in_registers!(Gram((false), (true)) for 1, 2, 3, 4, 6),
            Sums::Ratio => in_registers!(Pairs((false, false), (true, false)) for 1, 2, 3, 4, 6, 8),
            // one function serves all blocks, since a rule with these sums runs once per solve
            Sums::Diagonal => in_registers!(Pairs((true, true), (true, true)) for 3, 4, 6),
        };
        Self { lanes: backend.lanes(), whole, masked, step }
    }
}

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// Values of factors without a constant shift, expanded along the rays.
    spare: Spare,
    buffers: Buffers,
    /// Storage of a line's list of rays.
    rays: LineRays<'static>,
}

impl Scratch {
    pub(crate) fn new(plan: &Plan) -> Self {
        Self { buffers: Buffers::new(plan.frames), spare: Spare::default(), rays: LineRays::default() }
    }
}

/// One line of a factor, and the step that updates it.
pub(crate) struct GatherLine<'a, 'b> {
    pub(crate) plan: &'a Plan,
    /// All factors. The factor of the line is not read here; `step` has its values.
    pub(crate) factors: &'a [Factor],
    pub(crate) at: LineOf,
    pub(crate) functions: &'a GatherFunctions,
    pub(crate) step: LineStep<'b>,
    pub(crate) scratch: &'a mut Scratch,
}

impl GatherLine<'_, '_> {
    /// Sums and steps the line, block by block.
    pub(crate) fn update(self) -> Outcome {
        let Self { plan, factors, at, functions, mut step, scratch } = self;
        let Scratch { spare, buffers, rays } = scratch;
        let layout = &plan.maps[at.factor].layout;
        let (frames, stride, lanes) = (layout.frames, layout.stride, functions.lanes);
        // list the line's rays, with the line's own rows for prefetch
        let latest = step.extrapolation.as_ref().map(|(_, latest)| latest.as_ptr());
        let own = [Some(step.values.as_ptr()), latest].into_iter().flatten();
        let own = own.flat_map(|line| (0..frames).map(move |frame| line.wrapping_add(frame * stride)));
        let list = rays_through(std::mem::take(rays), plan, factors, at, own, spare);
        // blocks begin at multiples of a vector's length from the first column; the first block
        // holds the first column that any ray reads
        let (outer, inner) = (list.outer(), list.inner());
        let first = layout.pad + (outer.start.max(layout.pad) - layout.pad) / lanes * lanes;
        let end = outer.end.min(layout.pad + layout.cols());
        let params = SumParams { brightness: plan.target.brightness, sums: step.rule.sums() };
        let mut outcome = Outcome::default();
        let (mut squares, mut gain) = (Vector::default(), Vector::default());
        let mut x = first;
        while x < end {
            let is_whole = inner.start <= x && x + lanes <= inner.end;
            let sums = if is_whole { functions.whole } else { functions.masked };
            let values = &*step.values;
            // SAFETY: x + lanes lies within padded rows for every block that overlaps a view's
            // valid range
            unsafe { sums(BlockOfLine { rays: &list, x, params, values, stride, buffers: &mut *buffers }) };
            vector::add(&mut squares, &buffers.squares);
            step.finish_block(&functions.step, &mut buffers.block, x);
            vector::add(&mut gain, &buffers.block.gain);
            x += lanes;
            // Few blocks add to one f32 sum, since an f32 sum over a whole line would lose digits.
            if x >= end || (x - first) % (BLOCKS_PER_SUM * lanes) == 0 {
                outcome.error += vector::sum_of(&squares[..lanes]);
                outcome.gain += vector::sum_of(&gain[..lanes]);
                (squares, gain) = (Vector::default(), Vector::default());
            }
        }
        *rays = list.emptied();
        outcome
    }
}
