//! What a step does with the sums of a pixel: the rules, for one vector of pixels at a time.
//!
//! For pixel j of one factor, over the rays r through it, with a_m(r) = ∂L̃/∂(f_m/M) (the other factors' product P_m where layers attenuate) and
//! e = βL − L̃ before the step:
//!
//! ```text
//! residual   r_m  = Σ w e a_m          Gram     G_mk = Σ w a_m a_k
//! wanted     n_m  = Σ w βL a_m         emitted  d_m  = Σ w L̃ a_m
//! ```
//!
//! In u = f/M the pixel's part of the objective is the quadratic −2 rᵀδ + δᵀGδ + constant, δ the change of u.
//!
//! Sums are kept in units of u, so that no inner loop multiplies by 1/M.

use lumistack_display::quantize;
use lumistack_simd::{Backend, Kernel, Lanes, MAX_LANES};

use crate::aligned::Aligned;
use crate::vector::{Vector, load as get, store as put};

/// How a pixel's M values follow from its sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// f ← clamp(f·n/d): the paper's rule (eq. 16). n = r + d is summed apart: values may shrink by orders of magnitude in one step, and keep
    /// their relative precision.
    Multiplicative,
    /// `sweeps` rounds of exact coordinate steps on the quadratic within the box.
    Block {
        /// Rounds over the M frames.
        sweeps: u32,
    },
    /// Nothing moves: the gain is Σ δᵀδ G_mm over the coordinate steps δ that could be made, the squared change of the emission.
    Probe,
    /// The same gain; values that next to no light reaches become the darkest, see [`crate::Run::settle`].
    Settle,
}

impl Rule {
    /// The sums that the rule needs.
    pub(crate) fn sums(self) -> Sums {
        match self {
            Self::Multiplicative => Sums::Ratio,
            Self::Block { .. } => Sums::Gram,
            Self::Probe | Self::Settle => Sums::Diagonal,
        }
    }

    /// Rounds of coordinate steps.
    pub(crate) fn sweeps(self) -> u32 {
        if let Self::Block { sweeps } = self { sweeps } else { 0 }
    }
}

/// The sums of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sums {
    /// n and d.
    Ratio,
    /// r and G_mm.
    Diagonal,
    /// r and G.
    Gram,
}

impl Sums {
    /// How many there are per pixel: the first M, then the others, of G its upper triangle.
    pub(crate) fn count(self, frames: usize) -> usize {
        if self == Self::Gram { frames + frames * (frames + 1) / 2 } else { 2 * frames }
    }
}

/// Which values a factor may take where they are few.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Levels {
    /// The levels, rising.
    pub(crate) values: Vec<f32>,
    /// Per frame.
    pub(crate) frames: Vec<Freedom>,
}

/// How a frame's values may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Freedom {
    /// Anywhere in the box.
    Free,
    /// From level to level.
    Levels,
}

/// The smallest diagonal of a Gram matrix; what is less is a pixel that next to no light reaches, and any value of it is as good until
/// [`Rule::Settle`] makes it dark.
const LEAST_CURVATURE: f32 = 1e-30;

/// Sums and values of one vector of pixels, `[frame][lane]`.
pub(crate) struct Block {
    pub(crate) frames: usize,
    /// r, or n.
    pub(crate) residual: Aligned,
    /// d, or G_mm, or M/G_mm while solving in memory.
    pub(crate) emitted: Aligned,
    /// G, `[frame][frame][lane]`; the upper triangle is given.
    pub(crate) gram: Aligned,
    /// f.
    pub(crate) values: Aligned,
    /// r before the step.
    before: Aligned,
    /// Change of u.
    change: Aligned,
    /// By how much the last step lowers the objective, per lane, in weights relative to the largest; 0 by the multiplicative rule, which does not know.
    pub(crate) gain: Vector,
}

impl Block {
    pub(crate) fn new(frames: usize) -> Self {
        let vectors = |count: usize| Aligned::filled(0.0, count * MAX_LANES);
        Self {
            frames,
            residual: vectors(frames),
            emitted: vectors(frames),
            gram: vectors(frames * frames),
            values: vectors(frames),
            before: vectors(frames),
            change: vectors(frames),
            gain: Vector::default(),
        }
    }

    #[inline(always)]
    unsafe fn multiply<V: Lanes>(&mut self, [low, high]: [f32; 2]) -> V {
        // SAFETY: see `kernel`
        unsafe {
            for m in 0..self.frames {
                let at = m * V::COUNT;
                let (f, n, d) = (get::<V>(&self.values, at), get::<V>(&self.residual, at), get::<V>(&self.emitted, at));
                let moved = f.mul(n.div(d)).max(V::splat(low)).min(V::splat(high));
                // where d is 0 (below f32's normal range) the value is left alone
                put(moved.where_else(V::splat(f32::MIN_POSITIVE).below(d), f), &mut self.values, at);
            }
            V::splat(0.0)
        }
    }

    /// Every coordinate step waits for the one before: through registers that takes 5 instructions' latencies, through memory three times as long. Two vectors
    /// side by side do not fit into registers and gained nothing; to keep each frame's best value up to date instead of r gained 6 % of an update, but lost
    /// digits where G is nearly singular.
    #[inline(always)]
    unsafe fn descend_in_registers<V: Lanes, const M: usize>(&mut self, sweeps: u32, [low, high]: [f32; 2]) -> V {
        let n = V::COUNT;
        // SAFETY: see `kernel`
        unsafe {
            let (low, high, mean) = (V::splat(low), V::splat(high), V::splat(1.0 / M as f32));
            // G/M in the upper triangle, M/G_mm apart
            for m in 0..M {
                for k in m + 1..M {
                    let g = get::<V>(&self.gram, (m * M + k) * n).mul(mean);
                    put(g, &mut self.gram, (m * M + k) * n);
                }
                let curvature = get::<V>(&self.gram, (m * M + m) * n).max(V::splat(LEAST_CURVATURE));
                put(V::splat(M as f32).div(curvature), &mut self.emitted, m * n);
            }
            let start: [V; M] = std::array::from_fn(|m| get::<V>(&self.values, m * n));
            let before: [V; M] = std::array::from_fn(|m| get::<V>(&self.residual, m * n));
            let (mut values, mut residual) = (start, before);
            for _ in 0..sweeps {
                for m in 0..M {
                    let best = residual[m].mul_add(get::<V>(&self.emitted, m * n), values[m]);
                    let moved = best.max(low).min(high);
                    let delta = moved.sub(values[m]);
                    values[m] = moved;
                    for k in 0..M {
                        let g = get::<V>(&self.gram, (m.min(k) * M + m.max(k)) * n);
                        let g = if k == m { g.mul(mean) } else { g };
                        residual[k] = g.neg_mul_add(delta, residual[k]);
                    }
                }
            }
            // −2 rᵀδ + δᵀGδ = −(r + r')ᵀδ with r' = r − Gδ
            let mut gain = V::splat(0.0);
            for m in 0..M {
                gain = before[m].add(residual[m]).mul_add(values[m].sub(start[m]).mul(mean), gain);
                put(values[m], &mut self.values, m * n);
            }
            gain
        }
    }

    #[inline(always)]
    unsafe fn descend_in_memory<V: Lanes>(&mut self, sweeps: u32, [low, high]: [f32; 2]) -> V {
        let n = V::COUNT;
        let frames = self.frames;
        // SAFETY: see `kernel`
        unsafe {
            let (low, high, mean) = (V::splat(low), V::splat(high), V::splat(1.0 / frames as f32));
            for m in 0..frames {
                for k in 0..m {
                    let mirrored = get::<V>(&self.gram, (k * frames + m) * n);
                    put(mirrored, &mut self.gram, (m * frames + k) * n);
                }
                let curvature = get::<V>(&self.gram, (m * frames + m) * n).max(V::splat(LEAST_CURVATURE));
                put(V::splat(frames as f32).div(curvature), &mut self.emitted, m * n);
                put(get::<V>(&self.residual, m * n), &mut self.before, m * n);
                put(V::splat(0.0), &mut self.change, m * n);
            }
            for _ in 0..sweeps {
                for m in 0..frames {
                    let f = get::<V>(&self.values, m * n);
                    let best = get::<V>(&self.residual, m * n).mul_add(get::<V>(&self.emitted, m * n), f);
                    let moved = best.max(low).min(high);
                    let delta = moved.sub(f).mul(mean);
                    put(moved, &mut self.values, m * n);
                    put(get::<V>(&self.change, m * n).add(delta), &mut self.change, m * n);
                    for k in 0..frames {
                        let r = get::<V>(&self.residual, k * n);
                        put(
                            get::<V>(&self.gram, (m * frames + k) * n).neg_mul_add(delta, r),
                            &mut self.residual,
                            k * n,
                        );
                    }
                }
            }
            let mut gain = V::splat(0.0);
            for m in 0..frames {
                let both = get::<V>(&self.before, m * n).add(get::<V>(&self.residual, m * n));
                gain = both.mul_add(get::<V>(&self.change, m * n), gain);
            }
            gain
        }
    }

    /// Coordinate steps where some frames move between levels: the level nearest to the minimum of a coordinate's parabola is the best one.
    #[inline(always)]
    unsafe fn descend_levels<V: Lanes>(&mut self, sweeps: u32, [low, high]: [f32; 2], levels: &Levels) -> V {
        let (n, frames) = (V::COUNT, self.frames);
        let mut gains = Vector::default();
        for (lane, gain) in gains.iter_mut().enumerate().take(n) {
            let gram = |m: usize, k: usize| self.gram[(m.min(k) * frames + m.max(k)) * n + lane];
            for _ in 0..sweeps {
                for (m, &freedom) in levels.frames.iter().enumerate() {
                    let f = self.values[m * n + lane];
                    let curvature = gram(m, m);
                    let best = f + self.residual[m * n + lane] * frames as f32 / curvature.max(LEAST_CURVATURE);
                    let moved = match freedom {
                        Freedom::Free => best.max(low).min(high),
                        Freedom::Levels => quantize(best.max(low).min(high), &levels.values),
                    };
                    let delta = (moved - f) / frames as f32;
                    *gain += delta * (2.0 * self.residual[m * n + lane] - curvature * delta);
                    self.values[m * n + lane] = moved;
                    for k in 0..frames {
                        self.residual[k * n + lane] -= gram(m, k) * delta;
                    }
                }
            }
        }
        // SAFETY: see `kernel`
        unsafe { V::load(gains.as_ptr()) }
    }

    /// Sets to `low` each value whose frame passes so little light through the other factors that Σ w a_m² is at most that lane's limit. A negative limit leaves
    /// all values of a lane alone.
    ///
    /// Once per solve, so no vectors: inlined into the kernels, it cost every update a fifth.
    #[cold]
    #[inline(never)]
    pub(crate) fn darken(&mut self, lanes: usize, limits: &[f32], low: f32) {
        for m in 0..self.frames {
            let light = &self.emitted[m * lanes..][..lanes];
            let values = &mut self.values[m * lanes..][..lanes];
            for ((value, light), limit) in values.iter_mut().zip(light).zip(limits) {
                if light <= limit {
                    *value = low;
                }
            }
        }
    }

    /// Takes the step back in the lanes of fixed pixels, whose values before it are `met`, frames `stride` apart.
    ///
    /// Only for borders of tiles, so no vectors either.
    #[cold]
    #[inline(never)]
    pub(crate) fn keep(&mut self, lanes: usize, fixed: &[bool], met: &[f32], stride: usize) {
        for (lane, _) in fixed.iter().enumerate().filter(|(_, fixed)| **fixed) {
            for m in 0..self.frames {
                self.values[m * lanes + lane] = met[m * stride + lane];
            }
            self.gain[lane] = 0.0;
        }
    }

    #[inline(always)]
    unsafe fn unsettled<V: Lanes>(&mut self, [low, high]: [f32; 2]) -> V {
        let (n, frames) = (V::COUNT, self.frames);
        // SAFETY: see `kernel`
        unsafe {
            let mut sum = V::splat(0.0);
            for m in 0..frames {
                let f = get::<V>(&self.values, m * n);
                let curvature = get::<V>(&self.emitted, m * n).max(V::splat(LEAST_CURVATURE));
                let best = get::<V>(&self.residual, m * n).mul(V::splat(frames as f32)).div(curvature).add(f);
                let move_by = best.max(V::splat(low)).min(V::splat(high)).sub(f).mul(V::splat(1.0 / frames as f32));
                sum = move_by.mul(move_by).mul_add(curvature, sum);
            }
            sum
        }
    }
}

/// One vector of pixels, to be moved within `range` by the rule.
pub(crate) struct Step<'a> {
    pub(crate) block: &'a mut Block,
    /// Rounds over the frames.
    pub(crate) sweeps: u32,
    pub(crate) range: [f32; 2],
    pub(crate) levels: Option<&'a Levels>,
}

/// Moves the values of a block whose sums are known, and leaves the gain there. The block's number of frames must be the function's.
pub(crate) type StepFunction = for<'a> unsafe fn(Step<'a>);

/// The function for an instruction set and a case; `levels` says whether some frames keep to levels.
pub(crate) fn step_function(backend: Backend, rule: Rule, levels: bool, frames: usize) -> StepFunction {
    match (rule, levels, frames) {
        (Rule::Multiplicative, ..) => backend.function::<Multiply>(),
        (Rule::Probe | Rule::Settle, ..) => backend.function::<Unsettled>(),
        (Rule::Block { .. }, true, _) => backend.function::<DescendLevels>(),
        (Rule::Block { .. }, false, 1) => backend.function::<Descend<1>>(),
        (Rule::Block { .. }, false, 2) => backend.function::<Descend<2>>(),
        (Rule::Block { .. }, false, 3) => backend.function::<Descend<3>>(),
        (Rule::Block { .. }, false, 4) => backend.function::<Descend<4>>(),
        (Rule::Block { .. }, false, 5) => backend.function::<Descend<5>>(),
        (Rule::Block { .. }, false, 6) => backend.function::<Descend<6>>(),
        (Rule::Block { .. }, false, 7) => backend.function::<Descend<7>>(),
        (Rule::Block { .. }, false, 8) => backend.function::<Descend<8>>(),
        (Rule::Block { .. }, false, _) => backend.function::<DescendInMemory>(),
    }
}

/// A kernel of one method of [`Block`].
macro_rules! kernel {
    ($name:ident $(<const $frames:ident>)?, |$step:ident| $method:ident::<V $(, $arg:ident)?>($($value:expr),*)) => {
        struct $name $(<const $frames: usize>)?;

        impl $(<const $frames: usize>)? Kernel for $name $(<$frames>)? {
            type Args<'a> = Step<'a>;
            type Output = ();

            #[inline(always)]
            unsafe fn run<V: Lanes>($step: Step<'_>) {
                // SAFETY: passed on from the caller; every buffer holds `frames` (or frames²) vectors of at most MAX_LANES values
                unsafe {
                    let gain = $step.block.$method::<V $(, $arg)?>($($value),*);
                    put(gain, &mut $step.block.gain, 0);
                }
            }
        }
    };
}

kernel!(Multiply, |step| multiply::<V>(step.range));
kernel!(Unsettled, |step| unsettled::<V>(step.range));
kernel!(Descend<const M>, |step| descend_in_registers::<V, M>(step.sweeps, step.range));
kernel!(DescendInMemory, |step| descend_in_memory::<V>(step.sweeps, step.range));

struct DescendLevels;

impl Kernel for DescendLevels {
    type Args<'a> = Step<'a>;
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Lanes>(step: Step<'_>) {
        let Some(levels) = step.levels else { return };
        // SAFETY: as in `kernel`
        unsafe {
            let gain = step.block.descend_levels::<V>(step.sweeps, step.range, levels);
            put(gain, &mut step.block.gain, 0);
        }
    }
}
