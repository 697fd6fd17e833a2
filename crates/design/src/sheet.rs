//! A contact sheet: pictures of one size in rows and columns, with text. Text uses the font of the
//! plots. Pixels of the pictures stay unchanged; small pictures are enlarged by a whole number, so
//! that their captions fit.

use std::fmt::Write as _;

use lumistack_plot::{self as plot, FAMILY, PlotError};

/// A picture and its caption.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    /// Text under the picture; empty for none.
    pub caption: String,
    /// Codes `[row][col][rgb]`.
    pub rgb: Vec<u8>,
}

/// Pictures in rows and columns.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// [columns, rows] of pixels; all pictures have this size.
    pub size: [usize; 2],
    /// Lines of text above every column. The first line is larger.
    pub columns: Vec<Vec<String>>,
    /// For each row, the text next to it, and its pictures.
    pub rows: Vec<(String, Vec<Cell>)>,
}

/// Smallest width of a picture on the sheet, pixels.
const LEAST_WIDTH: usize = 200;
const SPACE: usize = 8;
const LINE: usize = 17;
/// Width of the text next to the rows, pixels.
const SIDE: usize = 30;

impl Sheet {
    /// Draws the sheet. Returns its [width, height] and its codes `[row][col][rgb]`.
    ///
    /// # Errors
    /// If the number of a picture's pixels is wrong, or the sheet is too large.
    pub fn drawn(&self) -> Result<([usize; 2], Vec<u8>), PlotError> {
        let [cols, rows] = self.size;
        if let Some(cell) = self.rows.iter().flat_map(|row| &row.1).find(|cell| cell.rgb.len() != 3 * cols * rows) {
            return Err(PlotError::new(format!(
                "expected 3 values for each pixel of a picture of {cols} × {rows} pixels, found {} values",
                cell.rgb.len()
            )));
        }
        // Lay out cells, enlarged by a whole number, with room for headings and captions.
        let larger = LEAST_WIDTH.div_ceil(cols.max(1)).max(1);
        let [wide, high] = [larger * cols, larger * rows];
        let heads = self.columns.iter().map(Vec::len).max().unwrap_or(0);
        let across = self.rows.iter().map(|row| row.1.len()).chain([self.columns.len()]).max().unwrap_or(0);
        let left = |col: usize| SIDE + col * (wide + SPACE);
        let top = |row: usize| SPACE + heads * LINE + row * (high + LINE + SPACE);
        let size = [left(across), top(self.rows.len())];
        // Draw all text as SVG, rasterize it, then copy the pictures over it.
        let mut svg = format!(
            "<svg width=\"{0}\" height=\"{1}\" viewBox=\"0 0 {0} {1}\" xmlns=\"http://www.w3.org/2000/svg\" font-family=\"{FAMILY}\">\n\
             <rect width=\"{0}\" height=\"{1}\" fill=\"white\"/>\n",
            size[0], size[1]
        );
        let mut write = |text: &str, x: usize, y: usize, style: &str| {
            let text = text.replace('&', "&amp;").replace('<', "&lt;");
            let _ = writeln!(svg, "<text x=\"{x}\" y=\"{y}\" {style}>{text}</text>");
        };
        for (col, lines) in self.columns.iter().enumerate() {
            for (line, text) in lines.iter().enumerate() {
                let style = if line == 0 { "font-size=\"14\"" } else { "font-size=\"12\" fill=\"#444\"" };
                write(text, left(col), SPACE + (line + 1) * LINE - 5, style);
            }
        }
        for (row, (name, cells)) in self.rows.iter().enumerate() {
            let middle = top(row) + high / 2;
            let turned = format!("font-size=\"13\" text-anchor=\"middle\" transform=\"rotate(-90 19 {middle})\"");
            write(name, 19, middle, &turned);
            for (col, cell) in cells.iter().enumerate() {
                write(&cell.caption, left(col), top(row) + high + LINE - 4, "font-size=\"12\" fill=\"#444\"");
            }
        }
        svg.push_str("</svg>\n");
        let mut rgb = plot::codes(&svg, size)?;
        for (row, (_, cells)) in self.rows.iter().enumerate() {
            for (col, cell) in cells.iter().enumerate() {
                for y in 0..high {
                    let from = &cell.rgb[3 * cols * (y / larger)..][..3 * cols];
                    let to = &mut rgb[3 * ((top(row) + y) * size[0] + left(col))..][..3 * wide];
                    to.chunks_exact_mut(3)
                        .enumerate()
                        .for_each(|(x, pixel)| pixel.copy_from_slice(&from[3 * (x / larger)..][..3]));
                }
            }
        }
        Ok((size, rgb))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_keep_their_pixels_and_words_are_drawn() {
        let cell = |value: u8| Cell { caption: "31.2 dB".into(), rgb: vec![value; 3 * 100 * 40] };
        let sheet = Sheet {
            size: [100, 40],
            columns: vec![vec!["target".into()], vec!["a & b".into(), "<2 layers".into()]],
            rows: vec![("left".into(), vec![cell(10), cell(20)]), ("right".into(), vec![cell(30)])],
        };
        let ([width, height], rgb) = sheet.drawn().unwrap();
        assert_eq!(rgb.len(), 3 * width * height);
        // Every picture is enlarged by two, so it covers 200 × 80 pixels.
        for value in [10u8, 20, 30] {
            assert_eq!(rgb.chunks_exact(3).filter(|p| **p == [value; 3]).count(), 200 * 80, "{value}");
        }
        let ink = |rows: std::ops::Range<usize>| {
            rgb[3 * width * rows.start..3 * width * rows.end].chunks_exact(3).filter(|p| p[0] < 128).count()
        };
        assert!(ink(0..SPACE + 2 * LINE) > 100, "words over the columns");
        let short = Sheet { rows: vec![(String::new(), vec![Cell::default()])], ..sheet };
        assert!(short.drawn().is_err());
    }
}
