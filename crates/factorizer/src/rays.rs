//! Rays through one line read certain rows of every factor. This module stores these rows for the
//! inner loops, as a pointer per row and view.

use std::marker::PhantomData;
use std::ops::Range;

use lumistack_simd::{Lanes, prefetch};

use crate::expand::Rays;
use crate::factor::{Factor, PAD};
use crate::line::LineOf;
use crate::plan::Plan;
use crate::row::Row;
use crate::rows::Reading;
use crate::vector::mask;

/// Pointer to the value at x = 0 of a row; x is an index into the padded storage of the line under
/// update.
///
/// Rows may begin later than x = 0, so the pointer itself may lie outside of its row.
#[derive(Clone)]
pub(crate) struct Place<'a, T> {
    zero: *const T,
    /// The row, to check bounds.
    #[cfg(debug_assertions)]
    row: Range<*const T>,
    life: PhantomData<&'a [T]>,
}

impl<'a, T> Place<'a, T> {
    /// Returns a place in `row`, such that `row[x + offset]` is the value at x.
    #[inline(always)]
    fn new(row: &'a [T], offset: isize) -> Self {
        Self {
            zero: row.as_ptr().wrapping_offset(offset),
            #[cfg(debug_assertions)]
            row: row.as_ptr_range(),
            life: PhantomData,
        }
    }

    /// Returns a place in a row of `len` values. The values may be written while the place exists.
    fn within(row: *const T, len: usize, offset: isize) -> Self {
        let _ = len;
        Self {
            zero: row.wrapping_offset(offset),
            #[cfg(debug_assertions)]
            row: row..row.wrapping_add(len),
            life: PhantomData,
        }
    }

    /// Returns a pointer to the values from x on, as many as a vector `V` has.
    #[inline(always)]
    pub(crate) fn at<V: Lanes>(&self, x: usize) -> *const T {
        let at = self.zero.wrapping_add(x);
        #[cfg(debug_assertions)]
        assert!(self.row.start <= at && at.wrapping_add(V::COUNT) <= self.row.end, "x = {x} lies outside of its row");
        at
    }
}

/// One view's rays through the line that the solver updates: their valid range and their weights.
pub(crate) struct View<'a> {
    /// Range of x in which the view's rays are valid.
    valid: Range<usize>,
    /// √w of the rays; `None` if all weights are 1.
    weights: Option<Place<'a, f32>>,
}

impl View<'_> {
    /// Returns √w of the rays; `None` if all weights are 1.
    #[inline(always)]
    pub(crate) fn root_weights(&self) -> Option<&Place<'_, f32>> {
        self.weights.as_ref()
    }

    /// Returns √w of the rays of a block, 0 for invalid rays; `None` if all are invalid.
    ///
    /// # Safety
    /// The machine has `V`'s instruction set.
    #[inline(always)]
    pub(crate) unsafe fn weight<V: Lanes>(&self, x: usize) -> Option<V> {
        let (low, high) = (self.valid.start.max(x), self.valid.end.min(x + V::COUNT));
        // SAFETY: the machine has the instruction set of V; padding makes loads legal where a ray
        // is valid
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

/// Number of rows that each view prefetches. A prefetch of all rows together would stall the loads.
const PREFETCHED: usize = 3;

/// The rows that the rays of one view read.
pub(crate) struct RowsOfView<'a, const K: usize> {
    pub(crate) view: &'a View<'a>,
    pub(crate) target: &'a TargetRow<'a>,
    pub(crate) others: &'a [Place<'a, f32>; K],
    ahead: &'a [*const f32; PREFETCHED],
}

impl<const K: usize> RowsOfView<'_, K> {
    /// Prefetches the values at x of the rows that are assigned to this view.
    #[inline(always)]
    pub(crate) fn prefetch(&self, x: usize) {
        for row in self.ahead {
            prefetch(row.wrapping_add(x));
        }
    }
}

/// The rays through one line. The lists with entries per view (`views`, `targets`, `others`, `own`,
/// `fractions`) use the same order of views.
#[derive(Default)]
pub(crate) struct LineRays<'a> {
    pub(crate) views: Vec<View<'a>>,
    pub(crate) targets: Vec<TargetRow<'a>>,
    /// For each view, the lines of the other factors that the view's rays read. Every line has all
    /// its frames. There are `others_per_view` lines per view.
    pub(crate) others: Vec<Place<'a, f32>>,
    pub(crate) others_per_view: usize,
    /// For each other factor, the distance from one frame to the next frame, in values.
    pub(crate) strides: Vec<usize>,
    /// For each view, the line of the factor under update, with all frames, at the columns that the
    /// view's rays read. Empty if all views read the same columns of that line.
    pub(crate) own: Vec<Place<'a, f32>>,
    pub(crate) own_stride: usize,
    /// A ray that hits a factor between two columns interpolates two pixels. For each view, this
    /// lists the second pixel's weight in every other factor, then in the factor under update.
    /// Only [`rays_between`] fills this list.
    pub(crate) fractions: Vec<f32>,
    /// Rows to prefetch, as pointers to x = 0: the line's own rows, and the other factors' rows.
    /// Views of a view row read the same rows at neighbouring columns, so only the pointer of the
    /// view that is farthest ahead is listed.
    ahead: Vec<*const f32>,
}

impl<'a> LineRays<'a> {
    /// Adds a view: the valid range of x, the weights and the target of its row of rays. Column c
    /// of the row is at x = c + [`PAD`] − `offset`.
    fn push_view(&mut self, plan: &'a Plan, rays: &Rays<'_>, offset: isize) {
        let (view, x_of_0) = (plan.view(rays.view[0], rays.view[1]), PAD as isize - offset);
        let x = |column: usize| (column as isize + x_of_0) as usize;
        self.views.push(View {
            valid: x(rays.run.start)..x(rays.run.end),
            weights: plan.target.weights(view, rays.row).map(|weights| Place::new(weights, offset)),
        });
        self.targets.push(match plan.target.row(rays.channel, view, rays.row) {
            Row::Half(row) => TargetRow::Half(Place::new(row, offset)),
            Row::Float(row) => TargetRow::Float(Place::new(row, offset)),
        });
    }

    /// Returns the range of x in which the rays of every view are valid and have weight 1.
    pub(crate) fn inner(&self) -> Range<usize> {
        if self.views.iter().any(|view| view.weights.is_some()) {
            return 0..0;
        }
        let start = self.views.iter().map(|view| view.valid.start).max().unwrap_or(0);
        start..self.views.iter().map(|view| view.valid.end).min().unwrap_or(0)
    }

    /// Returns the range of x in which the rays of any view are valid.
    pub(crate) fn outer(&self) -> Range<usize> {
        let start = self.views.iter().map(|view| view.valid.start).min().unwrap_or(0);
        start..self.views.iter().map(|view| view.valid.end).max().unwrap_or(0)
    }

    /// Returns, for each view of a range, the rows that its rays read. K is the number of factors
    /// besides the factor under update.
    #[inline(always)]
    pub(crate) fn by_view<const K: usize>(&self, views: Range<usize>) -> impl Iterator<Item = RowsOfView<'_, K>> {
        let others = &self.others.as_chunks::<K>().0[views.clone()];
        let ahead = &self.ahead.as_chunks::<PREFETCHED>().0[views.clone()];
        let views = self.views[views.clone()].iter().zip(&self.targets[views]).zip(others).zip(ahead);
        views.map(|(((view, target), others), ahead)| RowsOfView { view, target, others, ahead })
    }

    /// Returns the lines of the other factors that one view reads.
    pub(crate) fn others_of(&self, view: usize) -> &[Place<'_, f32>] {
        &self.others[view * self.others_per_view..(view + 1) * self.others_per_view]
    }

    /// Prefetches the values at x of all listed rows. If `by_views` is true, leaves out the rows
    /// that are assigned to views.
    #[inline(always)]
    pub(crate) fn prefetch_rest(&self, x: usize, by_views: bool) {
        for row in &self.ahead[if by_views { (PREFETCHED * self.views.len()).min(self.ahead.len()) } else { 0 }..] {
            prefetch(row.wrapping_add(x));
        }
    }

    /// Prefetches the values at x of a range of the listed rows.
    #[inline(always)]
    pub(crate) fn prefetch(&self, rows: Range<usize>, x: usize) {
        for row in &self.ahead[rows] {
            prefetch(row.wrapping_add(x));
        }
    }

    /// Empties the list, and keeps its storage for the next list.
    pub(crate) fn emptied(self) -> LineRays<'static> {
        LineRays {
            views: emptied(self.views),
            targets: emptied(self.targets),
            others: emptied(self.others),
            strides: emptied(self.strides),
            own: emptied(self.own),
            fractions: emptied(self.fractions),
            ahead: emptied(self.ahead),
            ..LineRays::default()
        }
    }
}

/// Returns an empty vector that keeps the storage of `from`, whose elements may have a shorter
/// lifetime.
fn emptied<A, B>(mut from: Vec<A>) -> Vec<B> {
    from.clear();
    // collecting in place keeps the allocation; allocation per line took 5 % of an update
    from.into_iter().filter_map(|_| None).collect()
}

/// Returns the length of one expanded row, in values.
pub(crate) fn expanded_stride(plan: &Plan) -> usize {
    (PAD + plan.cols + PAD).next_multiple_of(PAD)
}

/// Memory of one thread for values that rays read but that no factor holds: mixtures of two lines,
/// and values expanded along rays.
#[derive(Default)]
pub(crate) struct Spare {
    /// Mixtures of two neighbouring lines of a factor, for all frames, one after another.
    mixed: Vec<f32>,
    /// Values along rays, for all frames, one row after another.
    expanded: Vec<f32>,
    /// The content of each expanded row: factor, channel, view column, first column, line.
    held: Vec<Option<[usize; 5]>>,
    /// The rows of rays for which the values are computed.
    pub(crate) rows: Vec<RowOfRays>,
}

/// The rays of one view row through one field row.
#[derive(Clone, Copy)]
pub(crate) struct RowOfRays {
    pub(crate) view_y: usize,
    pub(crate) row: usize,
}

impl Spare {
    /// For every listed row of rays, and every factor that these rays read between two lines, mixes
    /// the two lines. `mixes` selects the factors.
    pub(crate) fn mix_lines(&mut self, plan: &Plan, factors: &[Factor], channel: usize, mixes: impl Fn(usize) -> bool) {
        let mut end = 0;
        for &RowOfRays { view_y, row } in &self.rows {
            for (k, (map, factor)) in plan.maps.iter().zip(factors).enumerate() {
                let tap = map.y[view_y][row];
                if tap.t != 0.0 && mixes(k) {
                    let start = end;
                    end += map.layout.line_len();
                    if self.mixed.len() < end {
                        self.mixed.resize(end, 0.0);
                    }
                    let lines = [tap.first, tap.second].map(|line| factor.line(channel, line as usize));
                    plan.row.mix(lines, tap.t, &mut self.mixed[start..end]);
                }
            }
        }
    }
}

/// The rest of a [`Spare`]: memory that is still free, and mixed lines that are still unread, in
/// the order in which they were made.
struct Left<'a> {
    mixed: &'a [f32],
    expanded: &'a mut [f32],
    held: std::slice::IterMut<'a, Option<[usize; 5]>>,
}

impl<'a> Left<'a> {
    /// Prepares the memory for the listed rows of rays, each expanded `times` times.
    fn of(spare: &'a mut Spare, plan: &Plan, times: usize) -> (Self, &'a [RowOfRays]) {
        let Spare { mixed, expanded, held, rows } = spare;
        let count = rows.len() * times;
        if held.len() < count {
            expanded.resize(count * plan.frames * expanded_stride(plan), 0.0);
            held.resize(count, None);
        }
        (Self { mixed, expanded, held: held.iter_mut() }, rows)
    }

    /// Returns the line of factor `k` that a row of rays reads, in all frames.
    ///
    /// The caller must call this for all factors in their order, since mixed lines are taken in the
    /// order in which they were made. If factor `k` is being updated in place, it has no values
    /// here, and the result is empty.
    fn line(&mut self, plan: &Plan, factors: &'a [Factor], k: usize, channel: usize, rays: RowOfRays) -> &'a [f32] {
        let (map, factor) = (&plan.maps[k], &factors[k]);
        let tap = map.y[rays.view_y][rays.row];
        if tap.t == 0.0 {
            return if factor.values.is_empty() { &[] } else { factor.line(channel, tap.first as usize) };
        }
        let (line, rest) = self.mixed.split_at(map.layout.line_len());
        self.mixed = rest;
        line
    }

    /// Returns the place of the values that the rays of a view read from a line of factor `k`. If
    /// `is_there` is true, the values are in the line itself. Otherwise they are in a row that is
    /// expanded along the rays.
    ///
    /// `offset` is added to x, see [`Place`].
    fn place(
        &mut self,
        plan: &Plan,
        line: &'a [f32],
        k: usize,
        rays: &Rays,
        is_there: bool,
        offset: isize,
    ) -> Place<'a, f32> {
        let map = &plan.maps[k];
        let x = &map.x[rays.view[1]];
        if let (true, Some((shift, _))) = (is_there, x.between) {
            return Place::new(line, shift - PAD as isize + offset);
        }
        let stride = expanded_stride(plan);
        let (values, rest) = std::mem::take(&mut self.expanded).split_at_mut(plan.frames * stride);
        self.expanded = rest;
        // several successive field rows read the same lenslets, so an expanded row may exist
        // already
        let tap = map.y[rays.view[0]][rays.row];
        let holds = (tap.t == 0.0).then_some([k, rays.channel, rays.view[1], rays.run.start, tap.first as usize]);
        if let Some(held) = self.held.next()
            && (holds.is_none() || *held != holds)
        {
            for (frame, values) in values.chunks_exact_mut(stride).enumerate() {
                let upper = &line[frame * map.layout.stride..][..map.layout.stride];
                let to = &mut values[PAD + rays.run.start..PAD + rays.run.end];
                plan.row.read(Reading { x, run: rays.run, upper, lower: None }, to);
            }
            *held = holds;
        }
        Place::new(values, offset)
    }
}

/// Returns the distance from one frame to the next frame in the row that rays of a view column read
/// from factor `k`. If the view column needs an expanded row, this is the distance in that row.
/// Otherwise it is the factor's own distance.
fn stride_of(plan: &Plan, k: usize, view_x: usize) -> usize {
    if plan.maps[k].x[view_x].shift.is_some() { plan.maps[k].layout.stride } else { expanded_stride(plan) }
}

/// Lists the rays of one view column by field columns: column c is at x = [`PAD`] + c.
///
/// `spare.rows` has the rows of rays; [`Spare::mix_lines`] must have mixed the lines that they
/// read.
pub(crate) fn rays_of_column<'a>(
    mut rays: LineRays<'a>,
    plan: &'a Plan,
    factors: &'a [Factor],
    at: LineOf,
    (view_x, run): (usize, &'a Range<usize>),
    spare: &'a mut Spare,
) -> LineRays<'a> {
    rays.others_per_view = factors.len() - 1;
    rays.strides.extend((0..factors.len()).filter(|&k| k != at.factor).map(|k| stride_of(plan, k, view_x)));
    rays.own_stride = stride_of(plan, at.factor, view_x);
    let is_there = |k: usize| plan.maps[k].x[view_x].shift.is_some();
    let (mut left, rows) = Left::of(spare, plan, (0..factors.len()).filter(|&k| !is_there(k)).count());
    for (index, &row_of) in rows.iter().enumerate() {
        let RowOfRays { view_y, row } = row_of;
        let part = Rays { channel: at.channel, view: [view_y, view_x], row, run };
        rays.push_view(plan, &part, 0);
        // neighbouring field rows often read the same lines; then they share the expanded values
        for k in 0..factors.len() {
            let line = left.line(plan, factors, k, at.channel, row_of);
            let list = if k == at.factor { &mut rays.own } else { &mut rays.others };
            let before =
                (index > 0).then(|| list[list.len() - if k == at.factor { 1 } else { rays.others_per_view }].clone());
            let tap = |row: RowOfRays| plan.maps[k].y[row.view_y][row.row];
            let place = match before {
                Some(place) if tap(rows[index - 1]) == tap(row_of) => place,
                _ => left.place(plan, line, k, &part, is_there(k), 0),
            };
            list.push(place);
        }
    }
    rays
}

/// Lists the rays of a line, and expands factors that are not at a constant shift.
///
/// `rays` gives its memory to the result. `own` are the rows of the line under update, which are
/// prefetched too.
pub(crate) fn rays_through<'a>(
    mut rays: LineRays<'a>,
    plan: &'a Plan,
    factors: &'a [Factor],
    at: LineOf,
    own: impl Iterator<Item = *const f32>,
    spare: &'a mut Spare,
) -> LineRays<'a> {
    let map = &plan.maps[at.factor];
    rays.others_per_view = factors.len() - 1;
    let others = || (0..factors.len()).filter(|&k| k != at.factor);
    // A factor has one stride for all views. So it is expanded for all views or for none.
    let is_there = |k: usize| plan.maps[k].columns_shifted;
    let layout = |k: usize| &plan.maps[k].layout;
    rays.strides.extend(others().map(|k| if is_there(k) { layout(k).stride } else { expanded_stride(plan) }));
    let elsewhere = others().filter(|&k| !is_there(k)).count();
    rays.ahead.extend(own);
    // list the field rows whose rays read the line; where these rays read between two lines of
    // another factor, mix these two lines
    spare.rows.clear();
    for view_y in 0..plan.views[0] {
        let of_line = map.rays_of_line(view_y, at.line).iter();
        spare.rows.extend(of_line.map(|&(row, _)| RowOfRays { view_y, row: row as usize }));
    }
    spare.mix_lines(plan, factors, at.channel, |_| true);
    let (mut left, rows) = Left::of(spare, plan, plan.views[1] * elsewhere);
    let mut lines = Vec::new();
    for &row_of in rows {
        let RowOfRays { view_y, row } = row_of;
        let before = rays.others.len();
        lines.clear();
        lines.extend((0..factors.len()).map(|k| left.line(plan, factors, k, at.channel, row_of)));
        // for each view, list its valid range, its weights and its target, then the rows of the
        // other factors
        for view_x in 0..plan.views[1] {
            let ([run], Some(own)) = (plan.runs[view_x].as_slice(), map.x[view_x].shift) else { continue };
            let offset = PAD as isize - own;
            let part = Rays { channel: at.channel, view: [view_y, view_x], row, run };
            rays.push_view(plan, &part, offset);
            for k in others() {
                rays.others.push(left.place(plan, lines[k], k, &part, is_there(k), offset));
            }
        }
        // All views of a view row read the same lines at neighbouring columns. So a prefetch at the
        // largest of their addresses serves them all.
        for (k, &stride) in rays.strides.iter().enumerate() {
            let of_factor = rays.others[before..].iter().skip(k).step_by(rays.others_per_view);
            if let Some(lead) = of_factor.map(|other| other.zero).max() {
                rays.ahead.extend((0..plan.frames).map(|frame| lead.wrapping_add(frame * stride)));
            }
        }
    }
    // repeat the last row, so that every view prefetches the same number of rows
    let last = rays.ahead.last().copied().unwrap_or(std::ptr::null());
    rays.ahead.resize(rays.ahead.len().max(PREFETCHED * rays.views.len()), last);
    rays
}

/// Windows: for each factor, a line that one row of rays reads, mixed from two lines of the factor.
/// Only the columns of one part of the line are computed.
#[derive(Default)]
pub(crate) struct Windows {
    values: Vec<f32>,
    /// For each factor, the index in `values` at which its mixed line begins. The last entry is the
    /// length of `values`.
    starts: Vec<usize>,
}

impl Windows {
    /// Allocates memory for one line of every factor.
    pub(crate) fn new(plan: &Plan) -> Self {
        let mut starts = vec![0];
        starts.extend(plan.maps.iter().scan(0, |end, map| {
            *end += map.layout.line_len();
            Some(*end)
        }));
        Self { values: vec![0.0; starts[plan.maps.len()]], starts }
    }

    /// Returns true if a row of rays reads factor `k` in the windows, not in the factor itself.
    pub(crate) fn holds(plan: &Plan, k: usize, rays: RowOfRays) -> bool {
        let map = &plan.maps[k];
        map.between && (map.mixes_columns || map.y[rays.view_y][rays.row].t != 0.0)
    }

    /// Mixes the two lines of factor `k` that a row of rays reads, within `columns` of the padded
    /// lines, and repeats the border pixels once.
    ///
    /// # Safety
    /// `window` points to memory for a line of factor `k`, to which no reference exists.
    pub(crate) unsafe fn mix(
        window: *mut f32,
        plan: &Plan,
        (k, factor): (usize, &Factor),
        channel: usize,
        rays: RowOfRays,
        columns: Range<usize>,
    ) {
        let (map, layout) = (&plan.maps[k], &plan.maps[k].layout);
        let tap = map.y[rays.view_y][rays.row];
        let lines = [tap.first, tap.second].map(|line| factor.line(channel, line as usize));
        // SAFETY: guaranteed by the caller; a line of the factor begins at `window`
        let to = unsafe { std::slice::from_raw_parts_mut(window, layout.line_len()) };
        let rows = lines[0].chunks_exact(layout.stride).zip(lines[1].chunks_exact(layout.stride));
        for (to, (upper, lower)) in to.chunks_exact_mut(layout.stride).zip(rows) {
            plan.row.mix([&upper[columns.clone()], &lower[columns.clone()]], tap.t, &mut to[columns.clone()]);
            if map.mixes_columns {
                let (pad, cols) = (layout.pad, layout.cols());
                (to[pad - 1], to[pad + cols]) = (to[pad], to[pad + cols - 1]);
            }
        }
    }

    /// Returns a map from the index of a factor to the address of its mixed line.
    pub(crate) fn lines(&mut self) -> impl Fn(usize) -> *mut f32 + use<'_> {
        let first = self.values.as_mut_ptr();
        move |k| first.wrapping_add(self.starts[k])
    }
}

/// Lists the rays between a line and the next line, for every row of rays in `spare.rows`. The
/// factor under update must be [`between`](crate::map::FactorMap::between). Views without valid
/// rays are left out, as in [`rays_through`].
///
/// `windows(k)` points to the line of factor `k` in [`Windows`]. One list has the rows to prefetch
/// for all rows of rays. For each row of rays, `ahead` gets the index at which its part of this
/// list ends. Lines in [`Windows`] are not in the list.
pub(crate) fn rays_between<'a>(
    mut rays: LineRays<'a>,
    plan: &'a Plan,
    factors: &'a [Factor],
    at: LineOf,
    (spare, windows): (&'a mut Spare, impl Fn(usize) -> *mut f32),
    ahead: &mut Vec<usize>,
) -> LineRays<'a> {
    let others = || (0..factors.len()).filter(|&k| k != at.factor);
    let is_there = |k: usize| plan.maps[k].between;
    let stride = |k: usize| if is_there(k) { plan.maps[k].layout.stride } else { expanded_stride(plan) };
    rays.others_per_view = factors.len() - 1;
    rays.strides.extend(others().map(stride));
    rays.own_stride = stride(at.factor);
    // mix the lines of factors that need expanded rows; `Windows` holds all other mixtures
    spare.mix_lines(plan, factors, at.channel, |k| !is_there(k));
    let elsewhere = others().filter(|&k| !is_there(k)).count();
    let (mut left, rows) = Left::of(spare, plan, plan.views[1] * elsewhere);
    let mut lines = Vec::new();
    ahead.clear();
    for &row_of in rows {
        let RowOfRays { view_y, row } = row_of;
        let before = [rays.others.len(), rays.own.len()];
        lines.clear();
        for k in 0..factors.len() {
            lines.push(match Windows::holds(plan, k, row_of) {
                false => left.line(plan, factors, k, at.channel, row_of),
                true => &[],
            });
        }
        // list each view: its range, weights and target, then the rows of all factors
        for view_x in 0..plan.views[1] {
            let own = plan.maps[at.factor].x[view_x].between;
            let ([run], Some((own, _))) = (plan.runs[view_x].as_slice(), own) else { continue };
            let offset = PAD as isize - own;
            let part = Rays { channel: at.channel, view: [view_y, view_x], row, run };
            rays.push_view(plan, &part, offset);
            for k in others().chain([at.factor]) {
                let list = if k == at.factor { &mut rays.own } else { &mut rays.others };
                let between = plan.maps[k].x[view_x].between.filter(|_| is_there(k));
                list.push(match between {
                    Some((shift, _)) if Windows::holds(plan, k, row_of) => {
                        Place::within(windows(k), plan.maps[k].layout.line_len(), shift - own)
                    }
                    _ => left.place(plan, lines[k], k, &part, is_there(k), offset),
                });
                rays.fractions.push(between.map_or(0.0, |(_, t)| t));
            }
        }
        // List rows to prefetch as `rays_through` does, but separately for every row of rays.
        for (index, k) in others().chain([at.factor]).enumerate() {
            let (places, of) = match k == at.factor {
                true => (&rays.own[before[1]..], 1),
                false => (&rays.others[before[0] + index..], rays.others_per_view),
            };
            let lead = places.iter().step_by(of).map(|place| place.zero).max();
            if let Some(lead) = lead.filter(|_| !Windows::holds(plan, k, row_of)) {
                rays.ahead.extend((0..plan.frames).map(|frame| lead.wrapping_add(frame * stride(k))));
            }
        }
        ahead.push(rays.ahead.len());
    }
    rays
}
