//! Which rows the rays through one line read, listed as inner loops want them: a pointer per row and view.

use std::marker::PhantomData;
use std::ops::Range;

use lumistack_simd::{Lanes, prefetch};

use crate::expand::{Rays, expand_factor};
use crate::factor::{Factor, PAD};
use crate::line::LineOf;
use crate::plan::Plan;
use crate::target::Row;
use crate::vector::mask;

/// Where the value of a row at x = 0 would stand; x counts in the padded storage of the line under update.
#[derive(Clone)]
pub(crate) struct Place<'a, T> {
    zero: *const T,
    /// To check bounds with.
    #[cfg(debug_assertions)]
    row: Range<*const T>,
    life: PhantomData<&'a [T]>,
}

impl<'a, T> Place<'a, T> {
    /// The value of x stands at `row[x + offset]`.
    #[inline(always)]
    fn new(row: &'a [T], offset: isize) -> Self {
        Self {
            zero: row.as_ptr().wrapping_offset(offset),
            #[cfg(debug_assertions)]
            row: row.as_ptr_range(),
            life: PhantomData,
        }
    }

    /// The values of x and of the next, as many as a vector has.
    #[inline(always)]
    pub(crate) fn at<V: Lanes>(&self, x: usize) -> *const T {
        let at = self.zero.wrapping_add(x);
        #[cfg(debug_assertions)]
        assert!(self.row.start <= at && at.wrapping_add(V::COUNT) <= self.row.end, "x = {x} lies outside of its row");
        at
    }
}

/// One view's rays through the line.
pub(crate) struct View<'a> {
    /// x of the rays that count.
    valid: Range<usize>,
    /// √w.
    weights: Option<Place<'a, f32>>,
}

impl View<'_> {
    /// √w of the rays of a block, 0 where they do not count; `None` where none does.
    ///
    /// # Safety
    /// The machine has V.
    #[inline(always)]
    pub(crate) unsafe fn weight<V: Lanes>(&self, x: usize) -> Option<V> {
        let (low, high) = (self.valid.start.max(x), self.valid.end.min(x + V::COUNT));
        // SAFETY: the machine has V; padding makes loads legal where a ray counts
        (low < high).then(|| unsafe {
            let inside = mask::<V>(low - x, high - x);
            self.weights.as_ref().map_or(inside, |weights| inside.mul(V::load(weights.at::<V>(x))))
        })
    }
}

/// One view's row of L.
pub(crate) enum TargetRow<'a> {
    Half(Place<'a, u16>),
    Float(Place<'a, f32>),
}

/// How many rows each view asks for. All rows at once would wait for each other.
const ASKED: usize = 3;

/// What is read along one view's rays.
pub(crate) struct RowsOfView<'a, const K: usize> {
    pub(crate) view: &'a View<'a>,
    pub(crate) target: &'a TargetRow<'a>,
    pub(crate) others: &'a [Place<'a, f32>; K],
    ahead: &'a [*const f32; ASKED],
}

impl<const K: usize> RowsOfView<'_, K> {
    /// Asks for what will be read at x of some rows.
    #[inline(always)]
    pub(crate) fn ask(&self, x: usize) {
        for row in self.ahead {
            prefetch(row.wrapping_add(x));
        }
    }
}

/// The rays through one line; per view, everything in the same order.
#[derive(Default)]
pub(crate) struct LineRays<'a> {
    pub(crate) views: Vec<View<'a>>,
    pub(crate) targets: Vec<TargetRow<'a>>,
    /// The other factors' lines, all frames; `others_per_view` for each view.
    pub(crate) others: Vec<Place<'a, f32>>,
    pub(crate) others_per_view: usize,
    /// Per other factor: from one frame to the next.
    pub(crate) strides: Vec<usize>,
    /// Rows to be asked for ahead of their use, at x = 0: those of other factors where the foremost view reads them, and the line's own.
    ahead: Vec<*const f32>,
}

impl LineRays<'_> {
    /// x where the rays of every view count in full.
    pub(crate) fn inner(&self) -> Range<usize> {
        if self.views.iter().any(|view| view.weights.is_some()) {
            return 0..0;
        }
        let start = self.views.iter().map(|view| view.valid.start).max().unwrap_or(0);
        start..self.views.iter().map(|view| view.valid.end).min().unwrap_or(0)
    }

    /// x where the rays of any view count.
    pub(crate) fn outer(&self) -> Range<usize> {
        let start = self.views.iter().map(|view| view.valid.start).min().unwrap_or(0);
        start..self.views.iter().map(|view| view.valid.end).max().unwrap_or(0)
    }

    /// Every view's rows, K other factors.
    #[inline(always)]
    pub(crate) fn by_view<const K: usize>(&self) -> impl Iterator<Item = RowsOfView<'_, K>> {
        let others = self.others.as_chunks::<K>().0.iter();
        let ahead = self.ahead.as_chunks::<ASKED>().0.iter();
        let views = self.views.iter().zip(&self.targets).zip(others).zip(ahead);
        views.map(|(((view, target), others), ahead)| RowsOfView { view, target, others, ahead })
    }

    /// The other factors of one view.
    pub(crate) fn others_of(&self, view: usize) -> &[Place<'_, f32>] {
        &self.others[view * self.others_per_view..(view + 1) * self.others_per_view]
    }

    /// Asks for what will be read at x of the rows that no view asks for.
    #[inline(always)]
    pub(crate) fn ask_for_rest(&self, x: usize, by_views: bool) {
        for row in &self.ahead[if by_views { (ASKED * self.views.len()).min(self.ahead.len()) } else { 0 }..] {
            prefetch(row.wrapping_add(x));
        }
    }

    /// No rays, with the storage of these.
    pub(crate) fn emptied(self) -> LineRays<'static> {
        LineRays {
            views: emptied(self.views),
            targets: emptied(self.targets),
            others: emptied(self.others),
            strides: emptied(self.strides),
            ahead: emptied(self.ahead),
            ..LineRays::default()
        }
    }
}

/// An empty vector in the storage of another, whose elements may have borrowed for shorter.
fn emptied<A, B>(mut from: Vec<A>) -> Vec<B> {
    from.clear();
    // collecting in place keeps the allocation: growing these for each line anew took 5 % of an update
    from.into_iter().filter_map(|_| None).collect()
}

/// Values of one expanded row.
pub(crate) fn expanded_stride(plan: &Plan) -> usize {
    (PAD + plan.cols + PAD).next_multiple_of(PAD)
}

/// Lists the rays of a line in the storage of `rays`, and expands what is not at a constant shift. `own` are the line's rows, to be asked for ahead.
pub(crate) fn rays_through<'a>(
    mut rays: LineRays<'a>,
    plan: &'a Plan,
    factors: &'a [Factor],
    at: LineOf,
    own: impl Iterator<Item = *const f32>,
    expanded: &'a mut [f32],
) -> LineRays<'a> {
    let map = &plan.maps[at.factor];
    rays.others_per_view = factors.len() - 1;
    let mut rest = expanded;
    let stride = expanded_stride(plan);
    let others = || (0..factors.len()).filter(|&k| k != at.factor);
    rays.strides.extend(others().map(|k| if plan.maps[k].shifted { plan.maps[k].layout.stride } else { stride }));
    rays.ahead.extend(own);
    for view_y in 0..plan.views[0] {
        for &(row, _) in map.rays_of_line(view_y, at.line) {
            let row = row as usize;
            let before = rays.others.len();
            for view_x in 0..plan.views[1] {
                let ([run], Some(own)) = (plan.runs[view_x].as_slice(), map.x[view_x].shift) else { continue };
                let view = plan.view(view_y, view_x);
                let offset = PAD as isize - own;
                rays.views.push(View {
                    valid: (run.start as isize + own) as usize..(run.end as isize + own) as usize,
                    weights: plan.target.weights(view, row).map(|weights| Place::new(weights, offset)),
                });
                rays.targets.push(match plan.target.row(at.channel, view, row) {
                    Row::Half(row) => TargetRow::Half(Place::new(row, offset)),
                    Row::Float(row) => TargetRow::Float(Place::new(row, offset)),
                });
                for k in others() {
                    let other = &plan.maps[k];
                    if let (true, Some(shift)) = (other.shifted, other.x[view_x].shift) {
                        let line = other.y[view_y][row].first as usize;
                        rays.others.push(Place::new(factors[k].line(at.channel, line), shift - own));
                    } else {
                        let (values, tail) = std::mem::take(&mut rest).split_at_mut(plan.frames * stride);
                        rest = tail;
                        let part = Rays { channel: at.channel, view: [view_y, view_x], row, run };
                        for (frame, values) in values.chunks_exact_mut(stride).enumerate() {
                            expand_factor(plan, factors, k, frame, &part, &mut values[PAD + run.start..PAD + run.end]);
                        }
                        rays.others.push(Place::new(values, offset));
                    }
                }
            }
            // all views of a view row read the same lines, side by side
            for (k, &stride) in rays.strides.iter().enumerate() {
                let of_factor = rays.others[before..].iter().skip(k).step_by(rays.others_per_view);
                if let Some(lead) = of_factor.map(|other| other.zero).max() {
                    rays.ahead.extend((0..plan.frames).map(|frame| lead.wrapping_add(frame * stride)));
                }
            }
        }
    }
    // every view asks for the same number
    let last = rays.ahead.last().copied().unwrap_or(std::ptr::null());
    rays.ahead.resize(rays.ahead.len().max(ASKED * rays.views.len()), last);
    rays
}
