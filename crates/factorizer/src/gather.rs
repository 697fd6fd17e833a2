//! One line of one factor, the fast way: every ray reads one pixel of the factor, at its own column plus a constant of the view.
//!
//! That is the paper's case: oblique views, equal pitch, nearest sampling. The simple version, for line j of layer n:
//!
//! ```text
//! for every view (a_y, a_x), every field row r that meets line j, every column x of the line, with c = x − shift_n:
//!     a_m = Π_{k≠n} f_k[line of r][m][c + shift_k]      e = βL[a][r][c] − (1/M) Σ_m a_m f_n[j][m][x]
//!     r[m][x] += w e a_m                                G[m][k][x] += w a_m a_k
//! step f_n[j][..][x] by r and G
//! ```
//!
//! Departures:
//! 1. Columns go in blocks of one vector, and a block meets all views before the next begins: its values stay in the first-level cache, and
//!    no accumulator ever moves to memory.
//! 2. Where registers hold a_m and the sums of all frames (with AVX-512 and NEON up to 8 for the paper's rule, up to 4 for G, and 6), that is all. G of
//!    6 frames is too large for that: 3×3 tiles along its diagonal are summed at once, what lies between them afterwards from a_m in a small
//!    buffer. Otherwise all views' a_m and e are buffered (10 kB for 25 views and 6 frames) before the sums are made tile by tile, each in registers;
//!    so any number of frames takes the same code, and 12 frames spill as little as 6. Views are buffered and summed in groups that leave room in the
//!    first-level cache. Buffering alone took 1.3 times as long (multiplicative) and
//!    1.2 times (block-exact) on Zen 4.
//! 3. Many rows are read side by side (frames × layers × view rows, and all views of the target), more than hardware prefetchers follow: each view asks
//!    for a few rows' values of two vectors later (all 60 at the block's start took 4 % longer), and for its own target's, which are read once, only
//!    into the second-level cache: the first is full of factors. With everything in the first-level cache a view of a block would take 26 cycles on
//!    Zen 4; it takes 45 to 50. Tiles of fewer columns, AVX2's vectors with AVX-512's registers, and the sum over frames in two chains gained nothing.
//!    Measured apart, again on Zen 4: 54 cycles as it is, 48 where no load straddles cache lines, 38 where moreover all view rows read one line. So neither
//!    alone is worth much: aligned loads and a permutation took 63 cycles, groups of one to three view rows 58 to 75, lines in steps of a view's shift 60.
//! 4. The target is read in 16 bits where that is what it holds. √w multiplies a and e, so that no sum needs w.
//! 5. Blocks that the border of the valid rays crosses, and all where rays have weights, are masked; padding makes their loads legal.
//! 6. Where another factor is not at a constant shift (a lenslet grid, a layer of another pitch), its values along the rays are expanded into rows
//!    first; then it is at shift 0. Rows are kept from line to line as long as they read the same lenslets.
//! 7. A case (rule, frames, factors, masked or not) is a function of its own in [`registers`](crate::registers), chosen once per update and
//!    called once per block; all others share one in [`buffers`](crate::buffers). One function for everything, inlined, was 400 kB of code and took
//!    four times as long to compile.

use lumistack_simd::{Backend, Function};

use crate::buffers::{BlockOfLine, Buffers, ByBuffers, Sight};
use crate::factor::Factor;
use crate::line::{LineOf, LineStep, Outcome, StepFunctions};
use crate::plan::Plan;
use crate::rays::{LineRays, Spare, rays_through};
use crate::registers::{Gram, Pairs};
use crate::step::{Rule, Sums};
use crate::vector::{self, Vector};

/// How many blocks' errors are added in f32 before they go to an f64 sum.
const BLOCKS_PER_SUM: usize = 4;

/// The functions of an update, for one instruction set, rule, and number of frames and of factors.
pub(crate) struct GatherFunctions {
    lanes: usize,
    /// For blocks where the rays of every view count in full, and for all others.
    whole: Function<ByBuffers>,
    masked: Function<ByBuffers>,
    step: StepFunctions,
}

impl GatherFunctions {
    /// `others`: number of factors beside the one under update.
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
        // more do not fit into the registers of any instruction set
        let [whole, masked] = match rule.sums() {
            Sums::Gram => in_registers!(Gram((false), (true)) for 1, 2, 3, 4, 6),
            Sums::Ratio => in_registers!(Pairs((false, false), (true, false)) for 1, 2, 3, 4, 6, 8),
            // once per solve: one for all blocks
            Sums::Diagonal => in_registers!(Pairs((true, true), (true, true)) for 3, 4, 6),
        };
        Self { lanes: backend.lanes(), whole, masked, step }
    }
}

/// Buffers of one thread, reused from line to line.
pub(crate) struct Scratch {
    /// Other factors that are not at a constant shift.
    spare: Spare,
    buffers: Buffers,
    /// Storage for the list of a line's rays.
    rays: LineRays<'static>,
}

impl Scratch {
    pub(crate) fn new(plan: &Plan) -> Self {
        Self { buffers: Buffers::new(plan.frames), spare: Spare::default(), rays: LineRays::default() }
    }
}

/// One line and what becomes of it.
pub(crate) struct GatherLine<'a, 'b> {
    pub(crate) plan: &'a Plan,
    /// The line's own factor is not read.
    pub(crate) factors: &'a [Factor],
    pub(crate) at: LineOf,
    pub(crate) functions: &'a GatherFunctions,
    pub(crate) step: LineStep<'b>,
    pub(crate) scratch: &'a mut Scratch,
}

impl GatherLine<'_, '_> {
    /// Sums and steps, block by block.
    pub(crate) fn update(self) -> Outcome {
        let Self { plan, factors, at, functions, mut step, scratch } = self;
        let Scratch { spare, buffers, rays } = scratch;
        let layout = &plan.maps[at.factor].layout;
        let (frames, stride, lanes) = (layout.frames, layout.stride, functions.lanes);
        let latest = step.beyond.as_ref().map(|(_, latest)| latest.as_ptr());
        let own = [Some(step.values.as_ptr()), latest].into_iter().flatten();
        let own = own.flat_map(|line| (0..frames).map(move |frame| line.wrapping_add(frame * stride)));
        let list = rays_through(std::mem::take(rays), plan, factors, at, own, spare);
        let (outer, inner) = (list.outer(), list.inner());
        let first = layout.pad + (outer.start.max(layout.pad) - layout.pad) / lanes * lanes;
        let end = outer.end.min(layout.pad + layout.cols());
        let sight = Sight { brightness: plan.target.brightness, sums: step.rule.sums() };
        let mut outcome = Outcome::default();
        let (mut squares, mut gain) = (Vector::default(), Vector::default());
        let mut x = first;
        while x < end {
            let is_whole = inner.start <= x && x + lanes <= inner.end;
            let sums = if is_whole { functions.whole } else { functions.masked };
            let values = &*step.values;
            // SAFETY: x + lanes lies within padded rows for every block that overlaps a view's valid range
            unsafe { sums(BlockOfLine { rays: &list, x, sight, values, stride, buffers: &mut *buffers }) };
            vector::add(&mut squares, &buffers.squares);
            step.finish_block(&functions.step, &mut buffers.block, x);
            vector::add(&mut gain, &buffers.block.gain);
            x += lanes;
            // a few blocks may share an f32 sum, a line may not
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
