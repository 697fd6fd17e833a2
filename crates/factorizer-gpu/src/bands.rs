//! Divides the lines of a factor (its rows of pixels) into bands, so that the data of a dispatch
//! fit into the device's bindings.
//!
//! A buffer holds a whole channel. A dispatch writes the lines of one band, and binds only parts of
//! the buffers, called windows. The windows of the target and the weights hold the field rows whose
//! rays read the lines of the band. The windows of the factors hold all lines that these rays read.
//! A band whose windows exceed the device's limits is halved.

use std::ops::Range;

use crate::tables::Tables;

/// The parts of buffers that one dispatch binds (windows). Except for `lines`, the ranges are in
/// 4-byte words of a channel's buffers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Band {
    /// Lines of a factor that the dispatch computes. If the shader computes errors, these are rows
    /// of the light field instead.
    pub(crate) lines: Range<usize>,
    pub(crate) own: Range<u64>,
    pub(crate) target: Range<u64>,
    pub(crate) weights: Range<u64>,
    pub(crate) factors: Vec<Range<u64>>,
}

/// Number of 4-byte words per line of each buffer, and the device's limits.
pub(crate) struct BandSizes<'a> {
    pub(crate) tables: &'a Tables,
    /// Words per line of each factor.
    pub(crate) line_words: Vec<u64>,
    /// Words per field row, over all views.
    pub(crate) target_words: u64,
    pub(crate) weight_words: u64,
    /// Largest binding, in bytes.
    pub(crate) limit: u64,
    /// Alignment of a binding's offset, in bytes.
    pub(crate) align: u64,
    /// Largest number of workgroups along an axis.
    pub(crate) groups: usize,
}

impl BandSizes<'_> {
    /// Divides all lines of a factor into bands; `None` if a single line exceeds the limits.
    pub(crate) fn of_factor(&self, n: usize, lines: usize) -> Option<Vec<Band>> {
        self.divide(Some(n), 0..lines)
    }

    /// Divides all field rows into bands; `None` if a single row exceeds the limits.
    pub(crate) fn of_rows(&self, rows: usize) -> Option<Vec<Band>> {
        self.divide(None, 0..rows)
    }

    fn divide(&self, own: Option<usize>, lines: Range<usize>) -> Option<Vec<Band>> {
        if lines.len() <= self.groups
            && let Some(band) = self.band(own, lines.clone())
        {
            return Some(vec![band]);
        }
        if lines.len() < 2 {
            return None;
        }
        let half = lines.start + lines.len() / 2;
        let mut bands = self.divide(own, lines.start..half)?;
        bands.extend(self.divide(own, half..lines.end)?);
        Some(bands)
    }

    fn band(&self, own: Option<usize>, lines: Range<usize>) -> Option<Band> {
        let rows = match own {
            Some(n) => span(&self.tables.factors[n].rows_of_line[lines.clone()]),
            None => lines.clone(),
        };
        let factors = self.tables.factors.iter().enumerate().map(|(k, tables)| {
            let mut read = span(&tables.lines_of_row[rows.clone()]);
            if Some(k) == own {
                read =
                    if read.is_empty() { lines.clone() } else { read.start.min(lines.start)..read.end.max(lines.end) };
            }
            // a binding must not be empty, even if no ray hits the factor
            if read.is_empty() {
                read = 0..1;
            }
            self.window(read, self.line_words[k])
        });
        Some(Band {
            own: match own {
                Some(n) => self.window(lines.clone(), self.line_words[n])?,
                None => 0..1,
            },
            factors: factors.collect::<Option<_>>()?,
            target: self.window(rows.start..rows.end.max(rows.start + 1), self.target_words)?,
            weights: self.window(rows.start..rows.end.max(rows.start + 1), self.weight_words)?,
            lines,
        })
    }

    /// Returns the words that hold `lines`, where a line has `words` words. The start is moved down
    /// to an aligned word. `None` if the range is larger than a binding may be.
    fn window(&self, lines: Range<usize>, words: u64) -> Option<Range<u64>> {
        let align = self.align.div_ceil(4);
        let start = lines.start as u64 * words / align * align;
        let end = lines.end as u64 * words;
        (4 * (end - start) <= self.limit).then_some(start..end.max(start + 1))
    }
}

/// Returns the smallest range that contains all given ranges.
fn span(ranges: &[Option<[usize; 2]>]) -> Range<usize> {
    let all = ranges.iter().flatten();
    let first = all.clone().map(|range| range[0]).min();
    let last = all.map(|range| range[1]).max();
    first.zip(last).map_or(0..0, |(first, last)| first..last + 1)
}
