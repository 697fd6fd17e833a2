//! The tables of a problem as one list of words, which shaders read.

use lumistack_display::Tap;
use lumistack_factorizer::device::Plan;

/// Entry of a table for a ray that misses the factor.
const MISSED: u32 = u32::MAX;

/// All tables, and the offset of each.
pub(crate) struct Tables {
    pub(crate) words: Vec<u32>,
    /// Offset in `words` of the table `[view row][field row]`: 1 if the rays are valid, otherwise
    /// 0.
    pub(crate) counted_rows: u32,
    /// Offset in `words` of the table `[view column][field column]`: 1 if the rays are valid,
    /// otherwise 0.
    pub(crate) counted_cols: u32,
    pub(crate) factors: Vec<FactorTables>,
}

/// Offsets and ranges of one factor's tables.
pub(crate) struct FactorTables {
    /// Offset, in taps, of the table `[view row][field row]`: the lines that rays read.
    pub(crate) y: u32,
    /// Offset, in taps, of the table `[view column][field column]`: the columns that rays read.
    pub(crate) x: u32,
    /// Offset in `words` of the table `[view row][line]`. An entry is the offset of a list, which
    /// names the field rows that read the line. The list ends at the next entry's offset.
    pub(crate) own_lines: u32,
    /// Offset in `words` of the table `[view column][column]`. An entry is the offset of a list,
    /// which names the field columns that read the column. The list ends at the next entry's
    /// offset.
    pub(crate) own_columns: u32,
    /// For each line, the first and the last field row whose rays read it in any view; `None` if
    /// there are none.
    pub(crate) rows_of_line: Vec<Option<[usize; 2]>>,
    /// For each field row, the first and the last line that its rays read in any view; `None` if
    /// there are none.
    pub(crate) lines_of_row: Vec<Option<[usize; 2]>>,
}

impl Tables {
    pub(crate) fn new(plan: &Plan) -> Self {
        let ([views_y, views_x], [rows, cols]) = (plan.views(), plan.field());
        // add a flag for every row and column of rays: 1 if the rays are valid, otherwise 0
        let mut words = Vec::new();
        let counted_rows = 0;
        for view_y in 0..views_y {
            words.extend((0..rows).map(|row| u32::from(plan.counts_row(view_y, row))));
        }
        let counted_cols = words.len() as u32;
        for view_x in 0..views_x {
            let at = words.len();
            words.resize(at + cols, 0);
            for range in plan.counted_columns(view_x) {
                words[at + range.start..at + range.end].fill(1);
            }
        }
        // for every factor, add its taps, and the lists of rays that read each line and column
        let mut tables = Self { words, counted_rows, counted_cols, factors: Vec::new() };
        for n in 0..plan.factor_count() {
            let factor = tables.add(plan, n);
            tables.factors.push(factor);
        }
        tables
    }

    fn add(&mut self, plan: &Plan, n: usize) -> FactorTables {
        let ([views_y, views_x], [rows, cols]) = (plan.views(), plan.field());
        let [lines, own_cols] = plan.size(n);
        let mixed = !plan.is_nearest(n);
        let (mut rows_of_line, mut lines_of_row) = (vec![None; lines], vec![None; rows]);
        let y = self.taps(views_y, rows, mixed, |view, row| plan.line(n, view, row));
        let x = self.taps(views_x, cols, mixed, |view, col| plan.column(n, view, col));
        let own_lines = self.readers(views_y, lines, |view| {
            let counted = (0..rows).filter(|&row| plan.counts_row(view, row));
            counted.filter_map(|row| Some((row, plan.line(n, view, row)?))).collect()
        });
        let own_columns = self.readers(views_x, own_cols, |view| {
            let counted = plan.counted_columns(view).iter().flat_map(Clone::clone);
            counted.filter_map(|col| Some((col, plan.column(n, view, col)?))).collect()
        });
        for (view, row) in (0..views_y).flat_map(|view| (0..rows).map(move |row| (view, row))) {
            let Some(tap) = plan.line(n, view, row) else { continue };
            for line in [tap.first, tap.second] {
                widen(&mut lines_of_row[row], line as usize);
                widen(&mut rows_of_line[line as usize], row);
            }
        }
        FactorTables { y, x, own_lines, own_columns, rows_of_line, lines_of_row }
    }

    /// Appends the taps of all views and positions: one word per tap, or three if two neighbours
    /// are mixed.
    fn taps(&mut self, views: usize, count: usize, mixed: bool, tap: impl Fn(usize, usize) -> Option<Tap>) -> u32 {
        // shaders index tables by taps, so the offset must be a multiple of a tap's width
        let width = if mixed { 3 } else { 1 };
        self.words.resize(self.words.len().next_multiple_of(width), 0);
        let at = self.words.len() / width;
        for (view, i) in (0..views).flat_map(|view| (0..count).map(move |i| (view, i))) {
            let tap = tap(view, i);
            self.words.push(tap.map_or(MISSED, |tap| tap.first));
            if mixed {
                self.words.push(tap.map_or(MISSED, |tap| tap.second));
                self.words.push(tap.map_or(0, |tap| tap.t.to_bits()));
            }
        }
        at as u32
    }

    /// Appends a table of offsets, then one list for each view row (or view column) and each line
    /// (or column) of a factor. The list contains the field rows (or field columns) that read this
    /// line (or column), with their interpolation weights.
    fn readers(&mut self, views: usize, places: usize, taps: impl Fn(usize) -> Vec<(usize, Tap)>) -> u32 {
        let at = self.words.len();
        self.words.resize(at + views * (places + 1), 0);
        for view in 0..views {
            let mut readers = vec![Vec::new(); places];
            for (ray, tap) in taps(view) {
                for (place, share) in [(tap.first, 1.0 - tap.t), (tap.second, tap.t)] {
                    if share > 0.0 {
                        readers[place as usize].push((ray as u32, share));
                    }
                }
            }
            for (place, rays) in readers.iter().enumerate() {
                self.words[at + view * (places + 1) + place] = self.words.len() as u32;
                self.words.extend(rays.iter().flat_map(|&(ray, share)| [ray, share.to_bits()]));
            }
            self.words[at + view * (places + 1) + places] = self.words.len() as u32;
        }
        at as u32
    }
}

fn widen(range: &mut Option<[usize; 2]>, to: usize) {
    let [first, last] = range.unwrap_or([to, to]);
    *range = Some([first.min(to), last.max(to)]);
}
