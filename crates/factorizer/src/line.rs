//! What becomes of one line of a factor once its sums are known.

use crate::factor::PAD;
use crate::lanes::Lanes;
use crate::step::{Block, Levels, Rule};

/// Which line is updated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineOf {
    pub(crate) factor: usize,
    pub(crate) channel: usize,
    pub(crate) line: usize,
}

/// What an update saw and gained, weights relative to the largest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Outcome {
    /// Σ w e² over the rays through the line, before the step; rays that several pixels share count by their share.
    pub(crate) error: f64,
    /// By how much the step lowers Σ w e², at least; 0 where the rule does not know. What [`Rule::Probe`] and [`Rule::Settle`] return.
    pub(crate) gain: f64,
}

impl Outcome {
    pub(crate) fn merged(self, other: Self) -> Self {
        Self { error: self.error + other.error, gain: self.gain + other.gain }
    }
}

/// A line's values and how they move; x counts in padded storage, frames are `stride` apart.
pub(crate) struct LineStep<'a> {
    pub(crate) rule: Rule,
    /// The box of the values.
    pub(crate) range: [f32; 2],
    pub(crate) levels: Option<&'a Levels>,
    /// For [`Rule::Settle`]: the Σ w a_m² up to which a pixel of the line counts as unlit, `[x]`.
    pub(crate) limits: Option<&'a [f32]>,
    /// Columns that rays can meet.
    pub(crate) columns: std::ops::Range<usize>,
    pub(crate) stride: usize,
    /// The line, all frames: what rays read.
    pub(crate) values: &'a mut [f32],
    /// How far to go beyond the step, and the line where the last steps ended.
    pub(crate) beyond: Option<(f32, &'a mut [f32])>,
    /// Where the sums go instead, `[r and the upper triangle of G, or n and d][x]`, when the step needs those of other lines too.
    pub(crate) sums: Option<&'a mut [f32]>,
}

/// How many sums a rule needs per pixel: r and the upper triangle of G, or n and d.
pub(crate) fn quantities_of(rule: Rule, frames: usize) -> usize {
    if rule.needs_gram() { frames + frames * (frames + 1) / 2 } else { 2 * frames }
}

impl LineStep<'_> {
    /// Fills a block with the values at x and with sums: `fetch` writes one quantity after another.
    #[inline(always)]
    pub(crate) fn fetch_block<V: Lanes>(&self, block: &mut Block, x: usize, mut fetch: impl FnMut(usize, &mut [f32])) {
        let frames = block.frames;
        for m in 0..frames {
            let from = &self.values[m * self.stride + x..][..V::COUNT];
            block.values[m * V::COUNT..][..V::COUNT].copy_from_slice(from);
        }
        (0..frames).for_each(|m| fetch(m, &mut block.residual[m * V::COUNT..][..V::COUNT]));
        if self.rule.needs_gram() {
            let mut quantity = frames;
            for m in 0..frames {
                for k in m..frames {
                    fetch(quantity, &mut block.gram[(m * frames + k) * V::COUNT..][..V::COUNT]);
                    quantity += 1;
                }
            }
        } else {
            (0..frames).for_each(|m| fetch(frames + m, &mut block.emitted[m * V::COUNT..][..V::COUNT]));
        }
    }

    /// Steps one vector of pixels, whose sums and values are in `block`; returns what [`Block::step`] returns.
    ///
    /// # Safety
    /// The machine has `V`'s instruction set, and x + COUNT lies within the padded rows.
    #[inline(always)]
    pub(crate) unsafe fn finish_block<V: Lanes>(&mut self, block: &mut Block, x: usize) -> V {
        let (frames, stride) = (block.frames, self.stride);
        // SAFETY: see above
        unsafe {
            if let Some(sums) = &mut self.sums {
                let mut quantity = 0;
                let mut hand_over = |from: &[f32], at: usize| {
                    V::load(from[at..at + V::COUNT].as_ptr())
                        .store(sums[quantity * stride + x..][..V::COUNT].as_mut_ptr());
                    quantity += 1;
                };
                (0..frames).for_each(|m| hand_over(&block.residual, m * V::COUNT));
                if self.rule.needs_gram() {
                    for m in 0..frames {
                        (m..frames).for_each(|k| hand_over(&block.gram, (m * frames + k) * V::COUNT));
                    }
                } else {
                    (0..frames).for_each(|m| hand_over(&block.emitted, m * V::COUNT));
                }
                return V::splat(0.0);
            }
            let mut gain = block.step::<V>(self.rule, self.range, self.levels);
            if let Some(limits) = self.limits {
                block.darken(&limits[x..x + V::COUNT], self.range[0]);
            }
            let room = (self.columns.end - x).min(V::COUNT);
            if room < V::COUNT {
                // rays that miss the layer add to its padding
                let mut lanes = [0.0f32; PAD];
                put(gain, &mut lanes, room);
                gain = V::load(lanes.as_ptr());
            }
            if self.rule == Rule::Probe {
                return gain;
            }
            for m in 0..frames {
                let moved = V::load(block.values[m * V::COUNT..][..V::COUNT].as_ptr());
                let at = m * stride + x;
                let Some((beyond, latest)) = &mut self.beyond else {
                    put(moved, &mut self.values[at..], room);
                    continue;
                };
                let before = V::load(latest[at..at + V::COUNT].as_ptr());
                let further = moved.sub(before).mul_add(V::splat(*beyond), moved);
                let further = further.max(V::splat(self.range[0])).min(V::splat(self.range[1]));
                put(moved, &mut latest[at..], room);
                put(further, &mut self.values[at..], room);
            }
            gain
        }
    }
}

/// Stores the first `room` lanes: what follows the last column is padding that rays read.
#[inline(always)]
unsafe fn put<V: Lanes>(vector: V, to: &mut [f32], room: usize) {
    // SAFETY: the machine has V; lengths are checked
    unsafe {
        if room == V::COUNT {
            vector.store(to[..V::COUNT].as_mut_ptr());
        } else {
            let mut lanes = [0.0f32; PAD];
            vector.store(lanes.as_mut_ptr());
            to[..room].copy_from_slice(&lanes[..room]);
        }
    }
}
