//! The rules of a step: each computes the new values of one vector of pixels from their sums.
//!
//! For pixel j of one factor, all sums are over the rays r through the pixel:
//!
//! ```text
//! a_m(r) = ∂L̃/∂(f_m/M)   where layers attenuate, the product P_m of the other factors
//! e(r)   = βL − L̃        before the step
//!
//! residual   r_m  = Σ w e a_m          Gram     G_mk = Σ w a_m a_k
//! wanted     n_m  = Σ w βL a_m         emitted  d_m  = Σ w L̃ a_m
//! ```
//!
//! Let u = f/M, and let δ be the change of u. If L̃ is linear in u, the terms of the objective that
//! depend on the pixel are the quadratic −2 rᵀδ + δᵀGδ + constant. All sums are in units of u, so
//! no inner loop multiplies by 1/M.

use lumistack_display::quantize;
use lumistack_simd::{Backend, Kernel, Lanes, MAX_LANES};

use crate::aligned::Aligned;
use crate::vector::{Vector, load as get, store as put};

/// The computation of a pixel's M new values from its sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// f ← clamp(f·n/d): the paper's rule (eq. 16), with n = Σ w βL a_m and d = Σ w L̃ a_m.
    ///
    /// n is summed directly. It is not computed as Σ w (βL − L̃) a_m + d. Values may shrink by
    /// orders of magnitude in one step and must keep their relative precision, which that sum would
    /// lose.
    Multiplicative,
    /// Sweeps of exact coordinate steps on the quadratic within the box.
    Block {
        /// Number of sweeps over the M frames.
        sweeps: u32,
    },
    /// Changes nothing. The gain is the squared change of the emission that exact coordinate steps
    /// within the box would cause.
    KktResidual,
    /// The same gain as [`Self::KktResidual`]. Also sets unlit values to the darkest value; see
    /// [`crate::Run::darken_unlit`].
    Darken,
}

impl Rule {
    pub(crate) fn sums(self) -> Sums {
        match self {
            Self::Multiplicative => Sums::Ratio,
            Self::Block { .. } => Sums::Gram,
            Self::KktResidual | Self::Darken => Sums::Diagonal,
        }
    }

    /// Returns the number of sweeps of coordinate steps; 0 for rules without sweeps.
    pub(crate) fn sweeps(self) -> u32 {
        if let Self::Block { sweeps } = self { sweeps } else { 0 }
    }
}

/// The sums that a rule needs, per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sums {
    /// For each frame m, n = Σ w βL a_m and d = Σ w L̃ a_m.
    Ratio,
    /// For each frame m, the residual sum r_m = Σ w e a_m, and the diagonal entry Σ w a_m² of the
    /// Gram matrix.
    Diagonal,
    /// For each frame m, the residual sum r_m = Σ w e a_m; then the upper triangle of the Gram
    /// matrix G_mk = Σ w a_m a_k.
    Gram,
}

impl Sums {
    /// Returns the number of sums per pixel. The sums n or r of every frame come first. Then follow
    /// d, the diagonal, or the triangle of the Gram matrix.
    pub(crate) fn count(self, frames: usize) -> usize {
        if self == Self::Gram { frames + frames * (frames + 1) / 2 } else { 2 * frames }
    }
}

/// The levels of a factor whose panel has few bits.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Levels {
    /// The levels, in rising order.
    pub(crate) values: Vec<f32>,
    /// Constraint of each frame.
    pub(crate) frames: Vec<Freedom>,
}

/// Constraint on the values of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Freedom {
    /// Any value in the box.
    Free,
    /// Only the levels of the factor.
    Levels,
}

/// Lower limit of the diagonal entries of a Gram matrix: a smaller entry is raised to this value.
/// Such an entry belongs to a pixel that almost no light reaches. The pixel's values are arbitrary
/// until [`Rule::Darken`] darkens them.
const LEAST_CURVATURE: f32 = 1e-30;

/// Sums and values of one vector of pixels, `[frame][lane]`.
pub(crate) struct Block {
    pub(crate) frames: usize,
    /// The sums r_m = Σ w e a_m; for the paper's rule the sums n_m = Σ w βL a_m.
    pub(crate) residual: Aligned,
    /// For the paper's rule, the sums d_m = Σ w L̃ a_m. For the KKT residual, the diagonal G_mm of
    /// the Gram matrix. During coordinate descent, M/G_mm.
    pub(crate) emitted: Aligned,
    /// The Gram matrix, `[frame][frame][lane]`. The input is its upper triangle.
    pub(crate) gram: Aligned,
    /// f, the values of the pixels.
    pub(crate) values: Aligned,
    /// The residual sums before the step.
    before: Aligned,
    /// The change of the values by the step, divided by the number of frames.
    change: Aligned,
    /// Decrease of the objective by the last step, per lane. The rays' weights are divided by the
    /// largest weight. The multiplicative rule does not compute the decrease and leaves 0.
    /// [`Rule::KktResidual`] and [`Rule::Darken`] store their result here.
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
                // if the sum d is below f32's normal range, it is treated as 0, and the value stays
                put(moved.where_else(V::splat(f32::MIN_POSITIVE).below(d), f), &mut self.values, at);
            }
            V::splat(0.0)
        }
    }

    /// Runs coordinate descent with the values and the residual sums in registers.
    ///
    /// Every coordinate step waits for the previous step. Through registers, a step takes the
    /// latency of 5 instructions; through memory, three times as long. Two vectors side by side do
    /// not fit into registers and gained nothing. A variant kept each frame's best value instead of
    /// its residual sum. It saved 6 % of an update, but lost digits if the Gram matrix is nearly
    /// singular.
    #[inline(always)]
    unsafe fn descend_in_registers<V: Lanes, const M: usize>(&mut self, sweeps: u32, [low, high]: [f32; 2]) -> V {
        let n = V::COUNT;
        // SAFETY: see `kernel`
        unsafe {
            let (low, high, mean) = (V::splat(low), V::splat(high), V::splat(1.0 / M as f32));
            // store the Gram matrix divided by M, and M/G_mm, so that the sweeps have no divisions
            for m in 0..M {
                for k in m + 1..M {
                    let g = get::<V>(&self.gram, (m * M + k) * n).mul(mean);
                    put(g, &mut self.gram, (m * M + k) * n);
                }
                let curvature = get::<V>(&self.gram, (m * M + m) * n).max(V::splat(LEAST_CURVATURE));
                put(V::splat(M as f32).div(curvature), &mut self.emitted, m * n);
            }
            // Make sweeps of coordinate steps. Each step sets the value of one frame to the minimum
            // of the quadratic, clamped to the box. It then updates the residual sums.
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
            // With δ the change of f/M and r' = r − Gδ, the gain is 2 rᵀδ − δᵀGδ = (r + r')ᵀδ.
            let mut gain = V::splat(0.0);
            for m in 0..M {
                gain = before[m].add(residual[m]).mul_add(values[m].sub(start[m]).mul(mean), gain);
                put(values[m], &mut self.values, m * n);
            }
            gain
        }
    }

    /// Does the same as [`Self::descend_in_registers`], for any number of frames.
    #[inline(always)]
    unsafe fn descend_in_memory<V: Lanes>(&mut self, sweeps: u32, [low, high]: [f32; 2]) -> V {
        let n = V::COUNT;
        let frames = self.frames;
        // SAFETY: see `kernel`
        unsafe {
            let (low, high, mean) = (V::splat(low), V::splat(high), V::splat(1.0 / frames as f32));
            // mirror the Gram matrix, so that the sweeps read its rows in order
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
            // run the sweeps of `descend_in_registers`, with the residual sums in memory
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
            // compute the gain by the formula in `descend_in_registers`
            let mut gain = V::splat(0.0);
            for m in 0..frames {
                let both = get::<V>(&self.before, m * n).add(get::<V>(&self.residual, m * n));
                gain = both.mul_add(get::<V>(&self.change, m * n), gain);
            }
            gain
        }
    }

    /// Makes coordinate steps for values that are confined to levels. Along a coordinate the
    /// objective is a parabola, so the best level is the one nearest to the parabola's minimum.
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

    /// Sets unlit values to `low`. A value is unlit if Σ w a_m² is at most the limit of its lane.
    ///
    /// A negative limit exempts a lane. Only the end of a solve needs this function, so it has no
    /// vector code. Inlined into the kernels, it made every update a fifth slower.
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

    /// In the lanes of fixed pixels, restores the values from before the step. `old` has these
    /// values, one row per frame, `stride` apart.
    ///
    /// Only borders of tiles need this function, so it has no vector code.
    #[cold]
    #[inline(never)]
    pub(crate) fn restore_fixed(&mut self, lanes: usize, fixed: &[bool], old: &[f32], stride: usize) {
        for (lane, _) in fixed.iter().enumerate().filter(|(_, fixed)| **fixed) {
            for m in 0..self.frames {
                self.values[m * lanes + lane] = old[m * stride + lane];
            }
            self.gain[lane] = 0.0;
        }
    }

    #[inline(always)]
    unsafe fn kkt_residual<V: Lanes>(&mut self, [low, high]: [f32; 2]) -> V {
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

/// One vector of pixels and the limits of its step.
pub(crate) struct Step<'a> {
    pub(crate) block: &'a mut Block,
    /// Number of sweeps over the frames.
    pub(crate) sweeps: u32,
    pub(crate) range: [f32; 2],
    pub(crate) levels: Option<&'a Levels>,
}

/// Steps the values of a block by its sums and writes the gain to the block. The block must have
/// the number of frames for which the function was made.
pub(crate) type StepFunction = for<'a> unsafe fn(Step<'a>);

/// Returns the function for an instruction set, a rule and a number of frames. `levels` is true if
/// some frames are confined to levels.
pub(crate) fn step_function(backend: Backend, rule: Rule, levels: bool, frames: usize) -> StepFunction {
    match (rule, levels, frames) {
        (Rule::Multiplicative, ..) => backend.function::<Multiply>(),
        (Rule::KktResidual | Rule::Darken, ..) => backend.function::<KktResidual>(),
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

/// Defines a kernel that calls one method of [`Block`].
macro_rules! kernel {
    ($name:ident $(<const $frames:ident>)?, |$step:ident| $method:ident::<V $(, $arg:ident)?>($($value:expr),*)) => {
        struct $name $(<const $frames: usize>)?;

        impl $(<const $frames: usize>)? Kernel for $name $(<$frames>)? {
            type Args<'a> = Step<'a>;
            type Output = ();

            #[inline(always)]
            unsafe fn run<V: Lanes>($step: Step<'_>) {
                // SAFETY: guaranteed by the caller; every buffer holds `frames` (or frames²)
                // vectors of at most MAX_LANES values
                unsafe {
                    let gain = $step.block.$method::<V $(, $arg)?>($($value),*);
                    put(gain, &mut $step.block.gain, 0);
                }
            }
        }
    };
}

kernel!(Multiply, |step| multiply::<V>(step.range));
kernel!(KktResidual, |step| kkt_residual::<V>(step.range));
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
