//! Pages of a PDF in millimetres.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use lumistack_plugin::PluginError;
use pdf_writer::{Buf, Content, Filter, Finish, Name, Pdf, Rect, Ref, Str, TextStr};

use crate::sheet::INCH_MM;

/// PDF units per millimetre.
const POINTS: f64 = 72.0 / INCH_MM;
const FONT: Name<'_> = Name(b"F");
const IMAGE: Name<'_> = Name(b"I");

/// A document; without dates, so that the same content gives the same bytes.
pub struct Document {
    pdf: Pdf,
    next: i32,
    pages: Vec<Ref>,
}

const CATALOG: Ref = Ref::new(1);
const PAGE_TREE: Ref = Ref::new(2);
const HELVETICA: Ref = Ref::new(3);

impl Document {
    /// An empty document.
    pub fn new(title: &str) -> Self {
        let mut pdf = Pdf::new();
        pdf.document_info(Ref::new(4)).title(TextStr(title)).producer(TextStr("Lumistack"));
        pdf.catalog(CATALOG).pages(PAGE_TREE);
        pdf.type1_font(HELVETICA).base_font(Name(b"Helvetica")).encoding_predefined(Name(b"WinAnsiEncoding"));
        Self { pdf, next: 5, pages: Vec::new() }
    }

    /// Adds a page of [width, height] millimetres.
    pub fn add(&mut self, size_mm: [f64; 2], page: Page) {
        let [id, contents, image] = [0, 1, 2].map(|i| Ref::new(self.next + i));
        self.next += 3;
        self.pages.push(id);
        let mut entry = self.pdf.page(id);
        entry
            .media_box(Rect::new(0.0, 0.0, points(size_mm[0]), points(size_mm[1])))
            .parent(PAGE_TREE)
            .contents(contents);
        let mut resources = entry.resources();
        resources.fonts().pair(FONT, HELVETICA);
        if page.image.is_some() {
            resources.x_objects().pair(IMAGE, image);
        }
        resources.finish();
        entry.finish();
        if let Some(Image { size, deflated, .. }) = &page.image {
            let mut object = self.pdf.image_xobject(image, deflated);
            object.filter(Filter::FlateDecode);
            object.width(size[0] as i32).height(size[1] as i32);
            object.color_space().device_rgb();
            object.bits_per_component(8).interpolate(false);
        }
        let content: Buf = page.content.finish();
        self.pdf.stream(contents, &content);
    }

    /// The file's bytes.
    pub fn finish(mut self) -> Vec<u8> {
        let count = self.pages.len() as i32;
        self.pdf.pages(PAGE_TREE).kids(self.pages).count(count);
        self.pdf.finish()
    }
}

struct Image {
    /// [columns, rows].
    size: [usize; 2],
    deflated: Vec<u8>,
}

/// What stands on a page.
pub struct Page {
    content: Content,
    image: Option<Image>,
}

impl Default for Page {
    /// An empty page; lines are black and as thin as a printer draws well.
    fn default() -> Self {
        let mut content = Content::new();
        content.set_line_width(points(0.1));
        Self { content, image: None }
    }
}

impl Page {
    /// One picture of `size` = [columns, rows] samples `[row][col][rgb]` in [left, bottom, width, height]; pixels keep their edges.
    ///
    /// # Errors
    /// If it cannot be compressed.
    pub fn image(
        &mut self,
        [x, y, width, height]: [f64; 4],
        size: [usize; 2],
        codes: &[u8],
    ) -> Result<(), PluginError> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        let deflated = encoder.write_all(codes).and_then(|()| encoder.finish());
        let deflated = deflated.map_err(|error| PluginError::failed("PDF image", error))?;
        self.content.save_state();
        self.content.transform([points(width), 0.0, 0.0, points(height), points(x), points(y)]);
        self.content.x_object(IMAGE).restore_state();
        self.image = Some(Image { size, deflated });
        Ok(())
    }

    /// A line through places.
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

    /// A filled rectangle [left, bottom, width, height] of an 8-bit grey or colour.
    pub fn fill(&mut self, [x, y, width, height]: [f64; 4], rgb: [u8; 3]) {
        let [r, g, b] = rgb.map(|code| f32::from(code) / 255.0);
        self.content.set_fill_rgb(r, g, b);
        self.content.rect(points(x), points(y), points(width), points(height)).fill_nonzero();
        self.content.set_fill_gray(0.0);
    }

    /// The outline of a rectangle.
    pub fn frame(&mut self, [x, y, width, height]: [f64; 4]) {
        self.content.rect(points(x), points(y), points(width), points(height)).stroke();
    }

    /// Text from a place to the right, `height` = size of the type in millimetres. Letters that the type lacks become `?`.
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

    /// A cross in a ring of 3 millimetres, for aligning films.
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
