//! Writes PDF files, with lengths in millimetres. Pictures are written row by row, so that memory
//! never holds a whole picture.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use lumistack_plugin::PluginError;
use pdf_writer::{Chunk, Content, Finish, Name, Pdf, Rect, Ref, Str, TextStr};

use crate::sheet::INCH_MM;

/// PDF units per millimetre.
const POINTS: f64 = 72.0 / INCH_MM;
const FONT: Name<'_> = Name(b"F");
/// Largest number of pixels of one picture in the file, so that PDF readers can count its bytes in
/// 31 bits. A larger picture is split into pieces, one below another.
const MOST_SAMPLES: usize = if cfg!(test) { 1 << 11 } else { 1 << 28 };
/// Largest position of the table of objects in the file. A PDF has ten digits for a position.
const LONGEST: u64 = 9_999_999_999;

/// A PDF document. It has no dates, so that the same content gives the same bytes.
pub struct Document<W> {
    out: W,
    /// Bytes written so far.
    written: u64,
    /// Position of each object in the file. Element n − 1 belongs to object n.
    places: Vec<u64>,
    pages: Vec<Ref>,
}

const CATALOG: Ref = Ref::new(1);
const PAGE_TREE: Ref = Ref::new(2);
const HELVETICA: Ref = Ref::new(3);
const INFO: Ref = Ref::new(4);

impl<W: Write> Document<W> {
    /// Begins a document.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(out: W, title: &str) -> io::Result<Self> {
        let mut document = Self { out, written: 0, places: vec![0; 4], pages: Vec::new() };
        // Let `Pdf` write the header and the title. It does not write the trailer; `finish` does.
        let mut pdf = Pdf::new();
        document.put(pdf.as_bytes())?;
        pdf.document_info(INFO).title(TextStr(title)).producer(TextStr("Lumistack"));
        let info = pdf.as_bytes()[document.written as usize..].to_vec();
        document.object(INFO, &info)?;
        document.chunk(HELVETICA, |chunk| {
            chunk.type1_font(HELVETICA).base_font(Name(b"Helvetica")).encoding_predefined(Name(b"WinAnsiEncoding"));
        })?;
        document.object(CATALOG, b"1 0 obj\n<<\n  /Type /Catalog\n  /Pages 2 0 R\n>>\nendobj\n\n")?;
        Ok(document)
    }

    /// Adds a page of `size_mm` = [width, height].
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn add(&mut self, size_mm: [f64; 2], page: Page) -> io::Result<()> {
        let [id, contents] = [self.reserve(), self.reserve()];
        self.pages.push(id);
        self.chunk(id, |chunk| {
            let mut entry = chunk.page(id);
            entry.media_box(Rect::new(0.0, 0.0, points(size_mm[0]), points(size_mm[1])));
            entry.parent(PAGE_TREE).contents(contents);
            let mut resources = entry.resources();
            resources.fonts().pair(FONT, HELVETICA);
            if !page.images.is_empty() {
                let mut images = resources.x_objects();
                page.images.iter().enumerate().for_each(|(n, image)| {
                    images.pair(Name(image_name(n).as_bytes()), *image);
                });
            }
            resources.finish();
        })?;
        let content = page.content.finish();
        self.chunk(contents, |chunk| {
            chunk.stream(contents, &content);
        })
    }

    /// Adds a picture of `size` = [columns, rows] pixels. Each call of `row` appends the next row
    /// `[col][rgb]`.
    ///
    /// Returns the pieces of the picture from the top, each with its number of rows and its
    /// reference.
    ///
    /// # Errors
    /// Those of `row`, or if the picture cannot be written.
    pub fn image(
        &mut self,
        size: [usize; 2],
        mut row: impl FnMut(&mut Vec<u8>) -> Result<(), PluginError>,
    ) -> Result<Vec<(usize, Ref)>, PluginError> {
        let most = (MOST_SAMPLES / size[0]).max(1);
        let mut pieces = Vec::new();
        for first in (0..size[1]).step_by(most) {
            let rows = most.min(size[1] - first);
            let [id, length] = [self.reserve(), self.reserve()];
            // The length of a compressed stream is known only at its end. So the length is a
            // separate object, which follows the stream.
            let begin = format!(
                "{} 0 obj\n<<\n  /Length {} 0 R\n  /Type /XObject\n  /Subtype /Image\n  /Filter /FlateDecode\n  /Width {}\n  /Height {rows}\n  \
                 /ColorSpace /DeviceRGB\n  /BitsPerComponent 8\n  /Interpolate false\n>>\nstream\n",
                id.get(),
                length.get(),
                size[0]
            );
            self.object(id, begin.as_bytes()).map_err(failed)?;
            let before = self.written;
            let mut encoder = ZlibEncoder::new(&mut *self, Compression::default());
            let mut codes = Vec::with_capacity(3 * size[0]);
            for _ in 0..rows {
                codes.clear();
                row(&mut codes)?;
                encoder.write_all(&codes).map_err(failed)?;
            }
            encoder.finish().map_err(failed)?;
            let bytes = self.written - before;
            self.put(b"\nendstream\nendobj\n\n").map_err(failed)?;
            let text = format!("{} 0 obj\n{bytes}\nendobj\n\n", length.get());
            self.object(length, text.as_bytes()).map_err(failed)?;
            pieces.push((rows, id));
        }
        Ok(pieces)
    }

    /// Writes the page tree, the table of objects and the trailer.
    ///
    /// # Errors
    /// If the document cannot be written, or if the position of the table of objects has more than
    /// ten digits.
    pub fn finish(mut self) -> io::Result<W> {
        let pages = std::mem::take(&mut self.pages);
        self.chunk(PAGE_TREE, |chunk| {
            let count = pages.len() as i32;
            chunk.pages(PAGE_TREE).kids(pages).count(count);
        })?;
        let (table, count) = (self.written, self.places.len() + 1);
        if table > LONGEST {
            return Err(io::Error::other(format!(
                "expected a PDF whose table of objects begins at byte {LONGEST} at the latest, found a table that begins at byte {table}; print at a lower resolution"
            )));
        }
        let mut text = format!("xref\n0 {count}\n0000000000 65535 f\r\n");
        self.places.iter().for_each(|place| text += &format!("{place:010} 00000 n\r\n"));
        text += &format!(
            "trailer\n<<\n  /Size {count}\n  /Root {} 0 R\n  /Info {} 0 R\n>>\nstartxref\n{table}\n%%EOF",
            CATALOG.get(),
            INFO.get()
        );
        self.put(text.as_bytes())?;
        Ok(self.out)
    }

    /// Reserves a number for an object that is written later.
    fn reserve(&mut self) -> Ref {
        self.places.push(0);
        Ref::new(self.places.len() as i32)
    }

    fn chunk(&mut self, id: Ref, fill: impl FnOnce(&mut Chunk)) -> io::Result<()> {
        let mut chunk = Chunk::new();
        fill(&mut chunk);
        self.object(id, chunk.as_bytes())
    }

    /// Writes an object or the beginning of an object, and records its position.
    fn object(&mut self, id: Ref, bytes: &[u8]) -> io::Result<()> {
        self.places[id.get() as usize - 1] = self.written;
        self.put(bytes)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.written += bytes.len() as u64;
        Ok(())
    }
}

/// The compressor of pictures writes to the document through this trait.
impl<W: Write> Write for Document<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.put(bytes).map(|()| bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Converts an error of writing. An error that the host reported is returned unchanged.
pub(crate) fn failed(error: io::Error) -> PluginError {
    PluginError::from_io("PDF", error)
}

fn image_name(number: usize) -> String {
    format!("I{number}")
}

/// The content of a page.
pub struct Page {
    content: Content,
    images: Vec<Ref>,
}

impl Default for Page {
    /// Makes an empty page. Its lines will be black and 0.1 mm wide, since printers draw thinner
    /// lines badly.
    fn default() -> Self {
        let mut content = Content::new();
        content.set_line_width(points(0.1));
        Self { content, images: Vec::new() }
    }
}

impl Page {
    /// Places a picture of `rows` rows in the rectangle [left, bottom, width, height] in mm.
    /// `pieces` is the result of [`Document::image`].
    pub fn image(&mut self, [x, y, width, height]: [f64; 4], rows: usize, pieces: &[(usize, Ref)]) {
        let mut below = rows;
        for &(count, image) in pieces {
            below -= count;
            let [bottom, tall] = [below, count].map(|rows_of| height * rows_of as f64 / rows as f64);
            self.content.save_state();
            self.content.transform([points(width), 0.0, 0.0, points(tall), points(x), points(y + bottom)]);
            self.content.x_object(Name(image_name(self.images.len()).as_bytes())).restore_state();
            self.images.push(image);
        }
    }

    /// Draws a line through points, whose coordinates are in mm.
    pub fn line(&mut self, places: &[[f64; 2]]) {
        for (i, [x, y]) in places.iter().enumerate() {
            if i == 0 {
                self.content.move_to(points(*x), points(*y));
            } else {
                self.content.line_to(points(*x), points(*y));
            }
        }
        self.content.stroke();
    }

    /// Fills a rectangle [left, bottom, width, height], in mm, with an 8-bit colour.
    pub fn fill(&mut self, [x, y, width, height]: [f64; 4], rgb: [u8; 3]) {
        let [r, g, b] = rgb.map(|code| f32::from(code) / 255.0);
        self.content.set_fill_rgb(r, g, b);
        self.content.rect(points(x), points(y), points(width), points(height)).fill_nonzero();
        self.content.set_fill_gray(0.0);
    }

    /// Draws the outline of a rectangle [left, bottom, width, height] in mm.
    pub fn frame(&mut self, [x, y, width, height]: [f64; 4]) {
        self.content.rect(points(x), points(y), points(width), points(height)).stroke();
    }

    /// Writes text that starts at a point; `height` is the size of the letters in mm. Minus signs
    /// and en dashes become `-`, and all other characters outside Latin-1 become `?`.
    pub fn text(&mut self, [x, y]: [f64; 2], height: f64, text: &str) {
        let latin: Vec<u8> = text
            .chars()
            .map(|c| match c {
                '−' | '–' => b'-',
                c => u8::try_from(u32::from(c)).unwrap_or(b'?'),
            })
            .collect();
        self.content.begin_text().set_font(FONT, points(height));
        self.content.next_line(points(x), points(y)).show(Str(&latin)).end_text();
    }

    /// Draws a registration mark: a cross in a ring.
    pub fn mark(&mut self, [x, y]: [f64; 2]) {
        self.line(&[[x - 2.5, y], [x + 2.5, y]]);
        self.line(&[[x, y - 2.5], [x, y + 2.5]]);
        let ring: Vec<[f64; 2]> = (0..=32)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 32.0).sin_cos();
                [x + 1.5 * cos, y + 1.5 * sin]
            })
            .collect();
        self.line(&ring);
    }
}

fn points(mm: f64) -> f32 {
    (mm * POINTS) as f32
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::ZlibDecoder;

    use super::*;

    /// Returns the bytes of an object in a file, found by the table at the file's end.
    fn object(file: &[u8], id: Ref) -> &[u8] {
        let text = String::from_utf8_lossy(&file[file.len() - 200..]);
        let table: usize = text.rsplit("startxref\n").next().unwrap().lines().next().unwrap().parse().unwrap();
        let rows = file[table..].split(|byte| *byte == b'\n').skip(2);
        let row = rows.map(|row| String::from_utf8_lossy(&row[..row.len().min(10)])).nth(id.get() as usize).unwrap();
        let object = &file[row.parse::<usize>().unwrap()..];
        assert!(object.starts_with(format!("{} 0 obj", id.get()).as_bytes()));
        object
    }

    fn after<'a>(bytes: &'a [u8], word: &str) -> &'a [u8] {
        let at = bytes.windows(word.len()).position(|found| found == word.as_bytes()).unwrap();
        &bytes[at + word.len()..]
    }

    #[test]
    fn pieces_of_a_picture_make_it_up() {
        let size = [7, 1000];
        let rows: Vec<Vec<u8>> = (0..size[1]).map(|row| (0..21).map(|i| (row * 31 + i * 7) as u8).collect()).collect();
        let mut document = Document::new(Vec::new(), "pieces").unwrap();
        let mut next = rows.iter();
        let pieces = document.image(size, |codes| {
            codes.extend_from_slice(next.next().unwrap());
            Ok(())
        });
        let pieces = pieces.unwrap();
        assert!(next.next().is_none() && pieces.len() > 2);
        let mut page = Page::default();
        page.image([10.0, 20.0, 30.0, 40.0], size[1], &pieces);
        document.add([100.0, 100.0], page).unwrap();
        let file = document.finish().unwrap();
        let mut found = Vec::new();
        for (count, id) in &pieces {
            let stream = after(object(&file, *id), "stream\n");
            let before = found.len();
            ZlibDecoder::new(stream).read_to_end(&mut found).unwrap();
            assert_eq!(found.len() - before, 21 * count);
            let length = String::from_utf8_lossy(&after(object(&file, Ref::new(id.get() + 1)), "obj\n")[..20]);
            let length: usize = length.lines().next().unwrap().parse().unwrap();
            assert!(stream[length..].starts_with(b"\nendstream"), "the stated length of the stream is wrong");
        }
        assert!(found == rows.concat());
        // On the page, every piece must touch the piece above it.
        let content = String::from_utf8_lossy(&file);
        let places = content.lines().filter_map(|line| line.strip_suffix(" cm"));
        let places: Vec<Vec<f64>> =
            places.map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect()).collect();
        assert_eq!(places.len(), pieces.len());
        let mut top = 60.0 * f64::from(POINTS as f32);
        for place in &places {
            assert!((place[5] + place[3] - top).abs() < 1e-3, "{place:?} below {top}");
            top = place[5];
        }
        assert!((top - 20.0 * POINTS).abs() < 1e-3);
    }
}
