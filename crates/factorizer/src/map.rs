//! Where rays meet one factor: per view column the columns that they read, per view row the lines.

use std::ops::Range;

use lumistack_display::Tap;

use crate::aligned::LINE;
use crate::factor::{Layout, PAD};

/// Weights of neighbouring pixels that differ by less than this are the same weight; a mask value changes by no more.
const SAME_WEIGHT: f32 = 1e-6;
/// Shorter pieces of equal shift are not worth a loop of their own.
const SHORTEST_PIECE: usize = 8;
/// Number of rays, by their shares, up to which a pixel's sums stay in f32. A mean over more is alike in all frames, so the Gram matrix is nearly
/// singular and shows their rounding: sums over 64 rays in f32 moved values by 4e-5. In f64 bilinear updates take 30 % longer.
const SHORT_SUM: f32 = 40.0;

/// Where rays meet one factor.
#[derive(Clone, Debug)]
pub(crate) struct FactorMap {
    pub(crate) layout: Layout,
    /// Per view column.
    pub(crate) x: Vec<ColumnTaps>,
    /// Per view row: one entry per field row.
    pub(crate) y: Vec<Vec<LineTap>>,
    /// Per view row.
    rays: Vec<RaysOfLine>,
    /// Per view row, the field rows by the first of the two lines that they read, with the weight of the second.
    after: Vec<RaysOfLine>,
    /// Whether few enough rays meet every pixel for their sum to be exact enough in f32.
    pub(crate) short_sums: bool,
    /// Whether every ray reads exactly one pixel, at a column that is the field column plus a constant of the view.
    pub(crate) shifted: bool,
    /// Whether each view column's rays read it at a constant shift, whatever the rows.
    pub(crate) columns_shifted: bool,
    /// Whether every ray reads one pixel alone.
    pub(crate) nearest: bool,
    /// Whether every ray that counts meets the factor.
    pub(crate) complete: bool,
}

/// Columns of one view column's rays, as indices into a padded line.
#[derive(Clone, Debug)]
pub(crate) struct ColumnTaps {
    pub(crate) first: Vec<u32>,
    pub(crate) second: Vec<u32>,
    /// Weight of `second`.
    pub(crate) t: Vec<f32>,
    /// The same in pieces that inner loops can take at once; together all field columns.
    pub(crate) pieces: Vec<Piece>,
    /// Index minus field column, where that is the same for every ray that counts and every `t` is 0.
    pub(crate) shift: Option<isize>,
}

/// Consecutive field columns that read a factor alike.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Piece {
    pub(crate) cols: Range<usize>,
    pub(crate) access: Access,
}

/// How consecutive columns read a factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Access {
    /// At their own column plus `by`, mixed with the next by the weight `t`.
    Shift { by: isize, t: f32 },
    /// One pixel each, by table.
    Indexed,
    /// Two pixels each, by table.
    Mixed,
}

/// Lines of one field row's rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LineTap {
    pub(crate) first: u32,
    pub(crate) second: u32,
    /// Weight of `second`.
    pub(crate) t: f32,
}

/// The field rows whose rays meet each line, for one view row: 0, 1 or 2 of them at equal pitch.
#[derive(Clone, Debug)]
struct RaysOfLine {
    /// Range of `entries` per line.
    starts: Vec<u32>,
    /// Field row and weight of the line in its rays.
    entries: Vec<(u32, f32)>,
}

impl FactorMap {
    /// Field rows whose rays count and meet `line`, with the line's weight.
    #[inline(always)]
    pub(crate) fn rays_of_line(&self, view_y: usize, line: usize) -> &[(u32, f32)] {
        self.rays[view_y].of_line(line)
    }

    /// Field rows whose rays count and read `line` or lie between it and the next, with the next line's weight.
    #[inline(always)]
    pub(crate) fn rays_after_line(&self, view_y: usize, line: usize) -> &[(u32, f32)] {
        self.after[view_y].of_line(line)
    }

    pub(crate) fn new(raw: RawMap, frames: usize, runs: &[Vec<Range<usize>>], valid_rows: &[Vec<bool>]) -> Self {
        let (lines, cols) = (raw.bins[0] * raw.size[0], raw.bins[1] * raw.size[1]);
        let shifts: Vec<_> = raw.x.iter().zip(runs).map(|(taps, runs)| constant_shift(taps, runs, cols)).collect();
        // a shifted line reads beyond the layer's edge where rays may miss it
        let (mut before, mut after) = (0, 0);
        for (shift, runs) in shifts.iter().zip(runs) {
            if let (Some(shift), [first, ..]) = (*shift, runs.as_slice()) {
                let end = runs[runs.len() - 1].end;
                before = before.max(-(first.start as isize + shift));
                after = after.max(end as isize + shift - cols as isize);
            }
        }
        // own columns start on a cache line
        let pad = (PAD + before as usize).next_multiple_of(PAD);
        // an odd number of cache lines: rows of all frames a multiple of 4 KiB apart share the same sets of the first-level cache (1.7 times as
        // long), a multiple of 1 KiB costs a fifth
        let stride = ((pad + cols + after as usize + PAD).div_ceil(LINE) | 1) * LINE;
        let layout = Layout { bins: raw.bins, size: raw.size, frames, pad, stride, outside: raw.outside };
        let x: Vec<_> = raw.x.iter().zip(&shifts).map(|(taps, shift)| ColumnTaps::new(taps, *shift, pad)).collect();
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
        // field rows that count and meet a line
        let met = |(taps, valid): (&Vec<LineTap>, &Vec<bool>)| -> Vec<(u32, LineTap)> {
            let rows = taps.iter().zip(valid).enumerate();
            rows.filter(|(_, (tap, valid))| **valid && tap.first as usize != lines)
                .map(|(row, (tap, _))| (row as u32, *tap))
                .collect()
        };
        let met: Vec<_> = y.iter().zip(valid_rows).map(met).collect();
        let rays: Vec<_> = met
            .iter()
            .map(|rows| {
                let both = |&(row, tap): &(u32, LineTap)| [(tap.first, (row, 1.0 - tap.t)), (tap.second, (row, tap.t))];
                RaysOfLine::new(lines, rows.iter().flat_map(both).filter(|(_, (_, share))| *share > 0.0))
            })
            .collect();
        let after: Vec<_> = met
            .iter()
            .map(|rows| RaysOfLine::new(lines, rows.iter().map(|&(row, tap)| (tap.first, (row, tap.t)))))
            .collect();
        let shares_of_line =
            |line: usize| rays.iter().flat_map(|rays| rays.of_line(line)).map(|(_, share)| share).sum();
        let mut shares_of_col = vec![0.0f32; cols];
        for tap in raw.x.iter().flatten().flatten() {
            shares_of_col[tap.first as usize] += 1.0 - tap.t;
            shares_of_col[tap.second as usize] += tap.t;
        }
        let most_shares: f32 = (0..lines).map(shares_of_line).fold(0.0, f32::max);
        let short_sums = most_shares * shares_of_col.into_iter().fold(0.0, f32::max) <= SHORT_SUM;
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
        let mut taps = raw.x.iter().chain(&raw.y).flatten().flatten();
        let nearest = taps.all(|tap| tap.t == 0.0);
        Self { layout, x, y, rays, after, short_sums, shifted, columns_shifted, nearest, complete }
    }
}

impl ColumnTaps {
    /// The pieces of a run.
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

    fn new(taps: &[Option<Tap>], shift: Option<isize>, pad: usize) -> Self {
        // a miss reads the padding
        let index = |i: Option<u32>| i.map_or(0, |i| i + pad as u32);
        Self {
            first: taps.iter().map(|tap| index(tap.map(|tap| tap.first))).collect(),
            second: taps.iter().map(|tap| index(tap.map(|tap| tap.second))).collect(),
            t: taps.iter().map(|tap| tap.map_or(0.0, |tap| tap.t)).collect(),
            pieces: pieces(taps, pad as isize),
            shift: shift.map(|shift| shift + pad as isize),
        }
    }
}

/// Splits the columns where the way they read the factor changes.
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
            // t is that of the piece's first column, so differences do not add up
            Some(piece) if alike(piece.access, access(col)) => piece.cols.end = col + 1,
            _ => even.push(Piece { cols: col..col + 1, access: access(col) }),
        }
    }
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

    /// From a line and an entry of it each.
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

/// A factor's taps before padding is known; `None` where a ray misses it.
pub(crate) struct RawMap {
    pub(crate) bins: [usize; 2],
    pub(crate) size: [usize; 2],
    pub(crate) outside: f32,
    pub(crate) x: Vec<Vec<Option<Tap>>>,
    pub(crate) y: Vec<Vec<Option<Tap>>>,
}

/// Pixel index minus field column, where that is one number for all rays of the runs that hit, and the others would fall outside under it.
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
