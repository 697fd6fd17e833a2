//! Tables of the pixels that rays read in one factor: columns for each view column, and lines for
//! each view row.

use std::ops::Range;

use lumistack_display::Tap;

use crate::aligned::LINE;
use crate::factor::{Layout, PAD};

/// A weight below this number is treated as 0 in a mixture of two neighbouring pixels. The mixture
/// changes by no more than this number, since values are in 0..1.
const SAME_WEIGHT: f32 = 1e-6;
/// Smallest number of columns of a [`Piece`] that inner loops read by its constant shift. Shorter
/// pieces are read through the tables of pixel indices.
const SHORTEST_PIECE: usize = 8;
/// Largest number of rays of a pixel for which its sums stay in f32. A ray counts by the weight of
/// the pixel in the value that the ray reads.
///
/// With more rays, all entries of a pixel's Gram matrix become nearly equal. The matrix is then
/// nearly singular, and the rounding of its sums shows. Sums over 64 rays in f32 moved values by
/// 4e-5. With sums in f64, bilinear updates take 30 % longer.
const SHORT_SUM: f32 = 40.0;

/// The pixels that rays read in one factor, and the rays of each line.
#[derive(Clone, Debug)]
pub(crate) struct FactorMap {
    pub(crate) layout: Layout,
    /// Per view column, the columns that rays read.
    pub(crate) x: Vec<ColumnTaps>,
    /// Per view row, the lines that each field row's rays read.
    pub(crate) y: Vec<Vec<LineTap>>,
    /// Per view row and line, the field rows whose rays read the line, each with the line's weight.
    rays: Vec<RaysOfLine>,
    /// Per view row and line, the field rows whose rays read between this line and the next line.
    /// Each entry also has the share of the rays' sums that the next line gets.
    after: Vec<RaysOfLine>,
    /// True if so few rays read each pixel that sums in f32 are precise.
    pub(crate) short_sums: bool,
    /// True if every ray reads one pixel, at the field column plus a constant of the view.
    pub(crate) shifted: bool,
    /// True if the rays of each view column read columns at a constant shift. They may still read a
    /// mixture of two lines.
    pub(crate) columns_shifted: bool,
    /// True if all valid rays of each view column read at one constant shift from their field
    /// columns, and these columns are consecutive. The shift may be fractional.
    pub(crate) between: bool,
    /// True if `between` is true and a shift is fractional.
    pub(crate) mixes_columns: bool,
    /// True if every ray that hits the factor reads a single pixel.
    pub(crate) nearest: bool,
    /// True if every valid ray hits the factor.
    pub(crate) complete: bool,
}

/// The columns that the rays of one view column read, as indices into a padded line.
#[derive(Clone, Debug)]
pub(crate) struct ColumnTaps {
    pub(crate) first: Vec<u32>,
    pub(crate) second: Vec<u32>,
    /// Weight of `second`, 0..1.
    pub(crate) t: Vec<f32>,
    /// The taps as pieces for the inner loops; together the pieces cover all field columns.
    pub(crate) pieces: Vec<Piece>,
    /// The index of the pixel that a ray reads in the padded line, minus the ray's field column.
    /// `None` in the cases that [`constant_shift`] lists.
    pub(crate) shift: Option<isize>,
    /// The index of the first pixel minus the field column, and the weight of the second pixel.
    /// `None` if these two values differ between valid rays. A ray at the border reads the border
    /// pixel alone.
    pub(crate) between: Option<(isize, f32)>,
}

/// Consecutive field columns whose rays read a factor in the same way.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Piece {
    pub(crate) cols: Range<usize>,
    pub(crate) access: Access,
}

/// The way in which consecutive field columns read a factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Access {
    /// Each ray reads its own column plus `by`, mixed with the next pixel by the weight `t`.
    Shift { by: isize, t: f32 },
    /// Each ray reads one pixel, whose index is in the table.
    Indexed,
    /// Each ray reads two pixels, whose indices are in the table.
    Mixed,
}

/// The lines that one field row's rays read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LineTap {
    pub(crate) first: u32,
    pub(crate) second: u32,
    /// Weight of `second`, 0..1.
    pub(crate) t: f32,
}

/// The field rows whose rays read each line, for one view row. If layer and field have the same
/// pitch, at most two field rows read a line.
#[derive(Clone, Debug)]
struct RaysOfLine {
    /// Line j has `entries[starts[j]..starts[j + 1]]`.
    starts: Vec<u32>,
    /// Field row, and the weight of line j in the values that this row's rays read. In
    /// [`FactorMap::after`], it is the weight of line j + 1.
    entries: Vec<(u32, f32)>,
}

impl FactorMap {
    /// Returns the valid field rows whose rays read `line`. Each entry also has the weight of
    /// `line` in the values that the row's rays read.
    #[inline(always)]
    pub(crate) fn rays_of_line(&self, view_y: usize, line: usize) -> &[(u32, f32)] {
        self.rays[view_y].of_line(line)
    }

    /// Returns the valid field rows whose rays read between `line` and the next line. Each entry
    /// also has the share of the rays' sums that the next line gets.
    #[inline(always)]
    pub(crate) fn rays_after_line(&self, view_y: usize, line: usize) -> &[(u32, f32)] {
        self.after[view_y].of_line(line)
    }

    /// Builds the tables; `runs` and `valid_rows` select the valid rays.
    pub(crate) fn new(raw: RawMap, frames: usize, runs: &[Vec<Range<usize>>], valid_rows: &[Vec<bool>]) -> Self {
        let (lines, cols) = (raw.bins[0] * raw.size[0], raw.bins[1] * raw.size[1]);
        let shifts: Vec<_> = raw.x.iter().zip(runs).map(|(taps, runs)| constant_shift(taps, runs, cols)).collect();
        // padding is needed, since at a constant shift rays that miss the layer read past its edges
        let (mut before, mut after) = (0, 0);
        for (shift, runs) in shifts.iter().zip(runs) {
            if let (Some(shift), [first, ..]) = (*shift, runs.as_slice()) {
                let end = runs[runs.len() - 1].end;
                before = before.max(-(first.start as isize + shift));
                after = after.max(end as isize + shift - cols as isize);
            }
        }
        // the factor's own columns start on a cache line
        let pad = (PAD + before as usize).next_multiple_of(PAD);
        // The stride is an odd number of cache lines. If the rows of all frames lie a multiple of 4
        // KiB apart, they share the same sets of the first-level cache. An update then takes 1.7
        // times as long. If they lie a multiple of 1 KiB apart, it takes a fifth longer.
        let stride = ((pad + cols + after as usize + PAD).div_ceil(LINE) | 1) * LINE;
        let layout = Layout { bins: raw.bins, size: raw.size, frames, pad, stride, outside: raw.outside };
        // list the pixels that rays read; the line after the last line stands for a miss
        let column = |((taps, shift), runs): ((_, &Option<isize>), &Vec<Range<usize>>)| {
            let between = shift.map(|shift| (shift, 0.0)).or_else(|| constant_between(taps, runs, cols));
            ColumnTaps::new(taps, *shift, between, pad)
        };
        let x: Vec<_> = raw.x.iter().map(Vec::as_slice).zip(&shifts).zip(runs).map(column).collect();
        let y: Vec<Vec<LineTap>> = raw
            .y
            .iter()
            .map(|taps| {
                let line = |tap: &Option<Tap>| match tap {
                    Some(tap) => LineTap { first: tap.first, second: tap.second, t: tap.t },
                    None => LineTap { first: lines as u32, second: lines as u32, t: 0.0 },
                };
                taps.iter().map(line).collect()
            })
            .collect();
        // list the rays of each line: valid field rows that hit the factor
        let read_by_view = |(taps, valid): (&Vec<LineTap>, &Vec<bool>)| -> Vec<(u32, LineTap)> {
            let rows = taps.iter().zip(valid).enumerate();
            rows.filter(|(_, (tap, valid))| **valid && tap.first as usize != lines)
                .map(|(row, (tap, _))| (row as u32, *tap))
                .collect()
        };
        let reads: Vec<_> = y.iter().zip(valid_rows).map(read_by_view).collect();
        let rays: Vec<_> = reads
            .iter()
            .map(|rows| {
                let both = |&(row, tap): &(u32, LineTap)| [(tap.first, (row, 1.0 - tap.t)), (tap.second, (row, tap.t))];
                RaysOfLine::new(lines, rows.iter().flat_map(both).filter(|(_, (_, share))| *share > 0.0))
            })
            .collect();
        let after: Vec<_> = reads
            .iter()
            .map(|rows| RaysOfLine::new(lines, rows.iter().map(|&(row, tap)| (tap.first, (row, tap.t)))))
            .collect();
        // the largest number of rays of a pixel decides whether f32 sums are precise enough
        let shares_of_line =
            |line: usize| rays.iter().flat_map(|rays| rays.of_line(line)).map(|(_, share)| share).sum();
        let mut shares_of_col = vec![0.0f32; cols];
        for tap in raw.x.iter().flatten().flatten() {
            shares_of_col[tap.first as usize] += 1.0 - tap.t;
            shares_of_col[tap.second as usize] += tap.t;
        }
        let most_shares: f32 = (0..lines).map(shares_of_line).fold(0.0, f32::max);
        let short_sums = most_shares * shares_of_col.into_iter().fold(0.0, f32::max) <= SHORT_SUM;
        // find the properties by which an update chooses its kernel
        let one_shift = |x: &ColumnTaps, runs: &[Range<usize>]| runs.is_empty() || x.shift.is_some() && runs.len() == 1;
        let shifted =
            x.iter().zip(runs).all(|(x, runs)| one_shift(x, runs)) && y.iter().flatten().all(|tap| tap.t == 0.0);
        let complete =
            raw.x.iter().zip(runs).all(|(taps, runs)| runs.iter().flat_map(Clone::clone).all(|i| taps[i].is_some()))
                && raw
                    .y
                    .iter()
                    .zip(valid_rows)
                    .all(|(taps, valid)| taps.iter().zip(valid).all(|(tap, valid)| tap.is_some() || !valid));
        let columns_shifted = x.iter().zip(runs).all(|(x, runs)| runs.is_empty() || x.shift.is_some());
        let between = x.iter().zip(runs).all(|(x, runs)| runs.is_empty() || x.between.is_some() && runs.len() == 1);
        let mixes_columns = between && x.iter().any(|x| x.between.is_some_and(|(_, t)| t != 0.0));
        let mut taps = raw.x.iter().chain(&raw.y).flatten().flatten();
        let nearest = taps.all(|tap| tap.t == 0.0);
        Self {
            layout,
            x,
            y,
            rays,
            after,
            short_sums,
            shifted,
            columns_shifted,
            between,
            mixes_columns,
            nearest,
            complete,
        }
    }
}

impl ColumnTaps {
    /// Splits a run of columns into pieces, each with one kind of access.
    #[inline(always)]
    pub(crate) fn pieces_within<'a>(
        &'a self,
        run: &'a Range<usize>,
    ) -> impl Iterator<Item = (Range<usize>, Access)> + Clone + 'a {
        self.pieces
            .iter()
            .map(|piece| (piece.cols.start.max(run.start)..piece.cols.end.min(run.end), piece.access))
            .filter(|(cols, _)| !cols.is_empty())
    }

    fn new(taps: &[Option<Tap>], shift: Option<isize>, between: Option<(isize, f32)>, pad: usize) -> Self {
        // a miss gets index 0, which is in the padding
        let index = |i: Option<u32>| i.map_or(0, |i| i + pad as u32);
        Self {
            first: taps.iter().map(|tap| index(tap.map(|tap| tap.first))).collect(),
            second: taps.iter().map(|tap| index(tap.map(|tap| tap.second))).collect(),
            t: taps.iter().map(|tap| tap.map_or(0.0, |tap| tap.t)).collect(),
            pieces: pieces(taps, pad as isize),
            shift: shift.map(|shift| shift + pad as isize),
            between: between.map(|(by, t)| (by + pad as isize, t)),
        }
    }
}

/// If the weight of one of a tap's two pixels is only rounding, returns a tap that reads the other
/// pixel alone. Otherwise rays that hit pixels exactly would read single pixels in some columns
/// and pairs in others.
pub(crate) fn snapped(tap: Tap) -> Tap {
    match tap.t {
        t if t < SAME_WEIGHT => Tap { t: 0.0, ..tap },
        t if t > 1.0 - SAME_WEIGHT => Tap { first: tap.second, second: tap.second, t: 0.0 },
        _ => tap,
    }
}

/// Splits the field columns into pieces of one kind of access.
fn pieces(taps: &[Option<Tap>], pad: isize) -> Vec<Piece> {
    let access = |col: usize| match taps[col] {
        Some(tap) => Access::Shift { by: tap.first as isize + pad - col as isize, t: tap.t },
        None => Access::Indexed,
    };
    let alike = |a: Access, b: Access| match (a, b) {
        (Access::Shift { by: a, t: ta }, Access::Shift { by: b, t: tb }) => a == b && (ta - tb).abs() < SAME_WEIGHT,
        (a, b) => a == b,
    };
    let mut even: Vec<Piece> = Vec::new();
    for col in 0..taps.len() {
        match even.last_mut() {
            // the piece keeps the `t` of its first column, so small differences do not add up
            Some(piece) if alike(piece.access, access(col)) => piece.cols.end = col + 1,
            _ => even.push(Piece { cols: col..col + 1, access: access(col) }),
        }
    }
    // short pieces are read through the tables, and neighbouring pieces of this kind become one
    let mut pieces: Vec<Piece> = Vec::new();
    for mut piece in even {
        if let Access::Shift { t, .. } = piece.access
            && piece.cols.len() < SHORTEST_PIECE
        {
            piece.access = if t == 0.0 { Access::Indexed } else { Access::Mixed };
        }
        match pieces.last_mut() {
            Some(last) if last.access == piece.access && piece.access == Access::Indexed => {
                last.cols.end = piece.cols.end
            }
            Some(last) if is_table(last.access) && is_table(piece.access) => {
                *last = Piece { cols: last.cols.start..piece.cols.end, access: Access::Mixed };
            }
            _ => pieces.push(piece),
        }
    }
    pieces
}

fn is_table(access: Access) -> bool {
    !matches!(access, Access::Shift { .. })
}

impl RaysOfLine {
    #[inline(always)]
    fn of_line(&self, line: usize) -> &[(u32, f32)] {
        &self.entries[self.starts[line] as usize..self.starts[line + 1] as usize]
    }

    /// Sorts entries, each given with its line, into one list per line.
    fn new(lines: usize, all: impl Iterator<Item = (u32, (u32, f32))>) -> Self {
        let mut of_line: Vec<Vec<(u32, f32)>> = vec![Vec::new(); lines];
        all.for_each(|(line, entry)| of_line[line as usize].push(entry));
        let mut starts = vec![0];
        let mut entries = Vec::new();
        for rows in of_line {
            entries.extend(rows);
            starts.push(entries.len() as u32);
        }
        Self { starts, entries }
    }
}

/// The pixels that rays read in a factor, before its padding is known; `None` for a miss.
pub(crate) struct RawMap {
    pub(crate) bins: [usize; 2],
    pub(crate) size: [usize; 2],
    pub(crate) outside: f32,
    pub(crate) x: Vec<Vec<Option<Tap>>>,
    pub(crate) y: Vec<Vec<Option<Tap>>>,
}

/// Returns the shift of the rays in `runs`, which are ranges of field columns. The shift is the
/// index of the pixel that a ray reads, minus the ray's field column.
///
/// Returns `None` if this shift differs between rays of the runs, if a ray reads two pixels, or if
/// no ray hits the factor. Also returns `None` if, at this shift, a ray that misses the factor
/// would read one of the factor's pixels.
fn constant_shift(taps: &[Option<Tap>], runs: &[Range<usize>], cols: usize) -> Option<isize> {
    let mut counted = runs.iter().flat_map(Clone::clone);
    let shift = counted.clone().find_map(|c| taps[c].map(|tap| tap.first as isize - c as isize))?;
    counted
        .all(|c| match taps[c] {
            Some(tap) => tap.t == 0.0 && tap.first as isize - c as isize == shift,
            None => !(0..cols as isize).contains(&(c as isize + shift)),
        })
        .then_some(shift)
}

/// Returns two values that all rays of the run share. The first is the index of a ray's first pixel
/// minus the ray's field column. The second is the weight of the second pixel. Rays that read only
/// the border pixel also fit.
///
/// Returns `None` if the values differ between rays, or if a ray misses the factor. Also returns
/// `None` if no ray reads two pixels, or if there is not exactly one run.
fn constant_between(taps: &[Option<Tap>], runs: &[Range<usize>], cols: usize) -> Option<(isize, f32)> {
    let [run] = runs else { return None };
    let distance = |c: usize| taps[c].map(|tap| (tap.first as isize - c as isize, tap.t));
    let (by, t) = run.clone().filter_map(distance).find(|&(_, t)| t != 0.0)?;
    let last = cols as isize - 1;
    let alike = |c: usize| {
        let Some(tap) = taps[c] else { return false };
        let (first, pixel) = (tap.first as isize, c as isize + by);
        let border = tap.t == 0.0 && (pixel == -1 && first == 0 || pixel == last && first == last);
        border || first == pixel && (tap.t - t).abs() < SAME_WEIGHT
    };
    run.clone().all(alike).then_some((by, t))
}
