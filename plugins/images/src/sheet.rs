//! Writes a contact sheet: reduced pictures of all masks and of the selected views, each with a
//! caption.
//!
//! Each frame is a row of cells, with the rear layer on the left and the front layer on the right.
//! The views are below. The sheet is written row by row, so memory does not grow with the number of
//! frames.

use std::io::{BufWriter, Write};

use lumistack_plugin::display::Transfer;
use lumistack_plugin::encoding::codes8;
use lumistack_plugin::{Display, Host, PluginError, StackInput};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use crate::animation::reduced;
use crate::encode::png_error;
use crate::views::ViewSource;

/// Smallest and largest width of a cell, pixels. A picture that is smaller than its cell is not
/// enlarged.
const CELL: [usize; 2] = [224, 384];
/// Width of the space between cells and around the sheet, pixels.
const GAP: usize = 12;
/// Height of a line of text, pixels.
const LINE: usize = 20;
/// 8-bit code of the background.
const PAPER: u8 = 24;
/// 8-bit code of the text.
const INK: u8 = 232;

/// A picture with a caption. Its values are computed only when its row of the sheet is written.
pub(crate) struct Cell<'a> {
    pub(crate) caption: String,
    /// [rows, cols] of the picture before the reduction.
    pub(crate) size: [usize; 2],
    /// Computes the linear values `[row][col][rgb]`.
    pub(crate) rgb: Box<dyn Fn() -> Result<Vec<f32>, PluginError> + 'a>,
}

impl Cell<'_> {
    /// Returns [rows, cols] of the picture on the sheet.
    fn shown(&self) -> [usize; 2] {
        let [rows, cols] = self.size;
        if cols <= CELL[1] {
            return [rows, cols];
        }
        [((rows * CELL[1]) as f64 / cols as f64).round().max(1.0) as usize, CELL[1]]
    }
}

/// Returns the cells of one frame: the mask of every layer.
pub(crate) fn patterns<'a>(display: &'a Display, stack: &'a StackInput<'_>, frame: usize) -> Vec<Cell<'a>> {
    let count = stack.layer_count();
    let cell = |layer: usize| {
        let place = match layer {
            _ if count == 1 => "",
            0 => ", rear",
            _ if layer + 1 == count => ", front",
            _ => "",
        };
        let d_mm = display.layers.get(layer).map_or(String::new(), |layer| format!(" at {:.2} mm", layer.d_mm));
        Cell {
            caption: format!("Frame {frame} of {}, layer {layer}{place}{d_mm}", stack.frames()),
            size: stack.layer_size(layer).unwrap_or([1, 1]),
            rgb: Box::new(move || Ok(stack.layer(layer, frame)?.to_vec())),
        }
    };
    (0..count).map(cell).collect()
}

/// Returns the cell of one view.
pub(crate) fn view<'a>(source: &'a ViewSource<'_>, view: [usize; 2]) -> Cell<'a> {
    let geometry = source.geometry();
    let degrees = |slope: f64, [low, high]: [&str; 2]| match slope.atan().to_degrees() {
        angle if angle.abs() < 0.005 => String::new(),
        angle => format!(", {:.1} deg {}", angle.abs(), if angle < 0.0 { low } else { high }),
    };
    let x = degrees(geometry.grid.slope_x[view[1]], ["left", "right"]);
    let y = degrees(geometry.grid.slope_y[view[0]], ["below", "above"]);
    let place = if x.is_empty() && y.is_empty() { ", straight on" } else { "" };
    Cell {
        caption: format!("View row {}, column {}{place}{x}{y}", view[0], view[1]),
        size: [geometry.rows, geometry.cols],
        rgb: Box::new(move || source.view(view)),
    }
}

/// Writes the sheet; returns its [columns, rows]. Each entry of `bands` is a row of cells.
pub(crate) fn write(host: &Host, path: &str, legend: &str, bands: &[Vec<Cell<'_>>]) -> Result<[usize; 2], PluginError> {
    // Compute the sizes of cells, captions and rows of cells.
    let cells = || bands.iter().flatten();
    let cell = cells().map(|cell| cell.shown()[1]).max().unwrap_or(0).max(CELL[0]);
    let across = bands.iter().map(Vec::len).max().unwrap_or(1).max(2);
    let width = GAP + across * (cell + GAP);
    let head = lines(legend, width - 2 * GAP);
    let captions: Vec<Vec<Vec<String>>> =
        bands.iter().map(|band| band.iter().map(|c| lines(&c.caption, cell)).collect()).collect();
    let heights: Vec<[usize; 2]> = bands
        .iter()
        .zip(&captions)
        .map(|(band, captions)| {
            let text = captions.iter().map(Vec::len).max().unwrap_or(0) * LINE;
            [text, text + band.iter().map(|cell| cell.shown()[0]).max().unwrap_or(0) + GAP]
        })
        .collect();
    let top = GAP + head.len() * LINE + GAP;
    let height = top + heights.iter().map(|[_, all]| all).sum::<usize>();

    // Write the sheet one row of cells after another.
    let side = |n: usize| u32::try_from(n).map_err(|error| PluginError::failed("sheet", error));
    let mut file = host.create(path)?;
    let mut writer = BufWriter::new(&mut file);
    let mut encoder = png::Encoder::new(&mut writer, side(width)?, side(height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
    encoder.set_compression(png::Compression::Fast);
    let mut encoder = encoder.write_header().map_err(png_error)?;
    let mut rows = encoder.stream_writer().map_err(png_error)?;
    let stage = host.stage("sheet", cells().count() as u64, "pictures");
    let mut paper = Paper::new(width, top);
    paper.print(&head, [GAP, GAP]);
    rows.write_all(&paper.rgb).map_err(|error| PluginError::from_io(path, error))?;
    for ((band, captions), [text, all]) in bands.iter().zip(&captions).zip(heights) {
        let mut paper = Paper::new(width, all);
        for (i, (picture, caption)) in band.iter().zip(captions).enumerate() {
            host.check_cancelled()?;
            let x = GAP + i * (cell + GAP);
            paper.print(caption, [x, 0]);
            let [shown_rows, shown_cols] = picture.shown();
            let [rows, cols] = picture.size;
            let rgb = reduced((picture.rgb)()?, [cols, rows], [shown_cols as u32, shown_rows as u32]);
            paper.place(&codes8(&Transfer::Srgb, &rgb), [shown_rows, shown_cols], [x, text]);
            stage.advance(1, "");
        }
        rows.write_all(&paper.rgb).map_err(|error| PluginError::from_io(path, error))?;
    }
    rows.finish().map_err(png_error)?;
    encoder.finish().map_err(png_error)?;
    let flushed = writer.into_inner().map(drop).map_err(|error| error.into_error());
    flushed.map_err(|error| PluginError::from_io(path, error))?;
    file.commit()?;
    Ok([width, height])
}

/// The pixels of one row of cells, over the full width of the sheet.
struct Paper {
    width: usize,
    rgb: Vec<u8>,
}

impl Paper {
    fn new(width: usize, height: usize) -> Self {
        Self { width, rgb: vec![PAPER; 3 * width * height] }
    }

    fn place(&mut self, codes: &[u8], [rows, cols]: [usize; 2], [x, y]: [usize; 2]) {
        for row in 0..rows {
            let start = 3 * ((y + row) * self.width + x);
            self.rgb[start..start + 3 * cols].copy_from_slice(&codes[3 * row * cols..3 * (row + 1) * cols]);
        }
    }

    fn print(&mut self, lines: &[String], [x, y]: [usize; 2]) {
        for (n, line) in lines.iter().enumerate() {
            for (i, letter) in line.chars().enumerate() {
                let Some(raster) = raster(letter) else { continue };
                for (row, weights) in raster.rows().enumerate() {
                    for (col, weight) in weights.iter().enumerate() {
                        let pixel = (y + n * LINE + row) * self.width + x + i * advance() + col;
                        let code = PAPER + (u32::from(INK - PAPER) * u32::from(*weight) / 255) as u8;
                        self.rgb[3 * pixel..3 * pixel + 3].fill(code);
                    }
                }
            }
        }
    }
}

/// Returns the width of a letter, pixels. All letters are equally wide.
fn advance() -> usize {
    get_raster_width(FontWeight::Regular, RasterHeight::Size16)
}

fn raster(letter: char) -> Option<noto_sans_mono_bitmap::RasterizedChar> {
    let of = |letter| get_raster(letter, FontWeight::Regular, RasterHeight::Size16);
    of(letter).or_else(|| of('?'))
}

/// Breaks a text between words into lines of at most `width` pixels; a longer word is truncated.
fn lines(text: &str, width: usize) -> Vec<String> {
    let most = (width / advance()).max(1);
    let mut lines: Vec<String> = Vec::new();
    for paragraph in text.lines() {
        let mut line = String::new();
        for word in paragraph.split_whitespace() {
            let word: String = word.chars().take(most).collect();
            if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > most {
                lines.push(std::mem::take(&mut line));
            }
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(&word);
        }
        lines.push(line);
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_broken_between_words() {
        let narrow = lines("one two three\nunbreakable", 8 * advance());
        assert_eq!(narrow, ["one two", "three", "unbreaka"]);
        assert_eq!(lines("one two", 7 * advance()), ["one two"]);
    }

    #[test]
    fn letters_leave_their_place_alone() {
        let mut paper = Paper::new(3 * advance(), LINE);
        paper.print(&["a é".into()], [0, 0]);
        let ink = |letter: usize| {
            let cols = letter * advance()..(letter + 1) * advance();
            (0..LINE).any(|row| cols.clone().any(|col| paper.rgb[3 * (row * paper.width + col)] > 128))
        };
        assert_eq!(
            [ink(0), ink(1), ink(2)],
            [true, false, true],
            "a letter that the font lacks does not become a question mark"
        );
    }

    #[test]
    fn wide_pictures_are_reduced_and_small_ones_kept() {
        let cell = |size| Cell { caption: String::new(), size, rgb: Box::new(|| Ok(Vec::new())) };
        assert_eq!(cell([525, 840]).shown(), [240, 384]);
        assert_eq!(cell([10, 20]).shown(), [10, 20]);
        assert_eq!(cell([1, 4000]).shown(), [1, 384]);
    }
}
