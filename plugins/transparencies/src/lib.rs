//! Output plugin `transparencies`: writes a PDF of static layers, to be printed on film at true
//! size.
//!
//! | page | content |
//! |---|---|
//! | 1 | assembly sheet: order and sides of films, spacers, and a ruler to check the scale |
//! | 2 | test chart: steps of codes to measure the printer's curve; see [`curve`] |
//! | 3, ... | one film per layer, from the rear; see [`sheet`]. Without a test chart, the films start at page 2 |
//!
//! A film's page has the mask, registration marks in the border, and cut lines outside the border.
//!
//! `transparencies.json` lists the position of each mask on its page. Colours are device RGB, so
//! the pages must be printed without colour management. They must also be printed without scaling.

pub mod curve;
mod pages;
mod params;
pub mod pdf;
pub mod sheet;

use std::io::{BufWriter, Write};
use std::sync::{Mutex, PoisonError};

use lumistack_plugin::display::{Backlight, Formation, Layer};
use lumistack_plugin::serde::Serialize;
use lumistack_plugin::{
    Display, Host, Input, OutputPlugin, Param, PluginError, Port, Schema, StackInput, Time, export_plugin, serde_json,
};

use curve::Film;
use params::Paper;
pub use params::TransparenciesParams;
use pdf::{Document, Page};
use sheet::{INCH_MM, Sheet};

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// The plugin, open for one display.
#[derive(Debug)]
pub struct Transparencies {
    host: Host,
    params: TransparenciesParams,
    display: Display,
    film: Film,
    sheet: Sheet,
    written: Mutex<Vec<Entry>>,
}

impl Paper {
    /// Returns the [shorter, longer] side of the paper in mm; `None` if pages have the smallest
    /// possible size.
    fn size_mm(self) -> Option<[f64; 2]> {
        match self {
            Self::A4 => Some([210.0, 297.0]),
            Self::A3 => Some([297.0, 420.0]),
            Self::Letter => Some([8.5 * INCH_MM, 11.0 * INCH_MM]),
            Self::Tight => None,
        }
    }
}

/// Content of `transparencies.json`.
#[derive(Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Manifest<'a> {
    schema: &'static str,
    version: u32,
    page_mm: [f64; 2],
    film_mm: [f64; 2],
    mirrored: bool,
    /// Least transmittance of the film relative to clear film, per channel. The `black_level` of
    /// the display's layers should be the largest of these three values.
    darkest: [f64; 3],
    spacers_mm: &'a [f64],
    /// Codes of the test chart's steps.
    chart_codes: &'a [u8],
    files: Vec<Entry>,
}

/// The position of one film's mask in the PDF.
#[derive(Clone, Debug, Serialize)]
#[serde(crate = "lumistack_plugin::serde")]
struct Entry {
    file: String,
    /// Page number, from 1.
    page: usize,
    layer: usize,
    d_mm: f64,
    /// Left, bottom, width and height of the mask on the page, in mm.
    place_mm: [f64; 4],
    /// Columns and rows of the picture in the file.
    resolution: [usize; 2],
    /// Number of mask values below the film's least transmittance.
    too_dark: usize,
    time: u64,
}

impl OutputPlugin for Transparencies {
    const DOC: &'static str = "Writes a PDF to print static layers on film at true size, with an assembly sheet and a test chart. \
        It accepts displays of attenuating layers with one frame. Masks are continuous tones: the printer makes the halftone dots, \
        and the chart measures them together with the inks.";
    const PORTS: &'static [Port] = &[Port::LayerStack];
    type Params = TransparenciesParams;

    fn schema() -> Schema {
        Schema::new([
            Param::choice(
                "paper",
                "a4",
                [
                    ("a4", "210 × 297 mm."),
                    ("a3", "297 × 420 mm."),
                    ("letter", "8.5 × 11 inches."),
                    ("tight", "As small as films, cut lines and titles allow."),
                ],
                "Size of the pages, in portrait or landscape as the films need.",
            ),
            Param::int(
                "dpi",
                0,
                0..=4800,
                "Resolution of the pictures in the file; every pixel has the value of the nearest mask pixel. 0 keeps the masks' resolution, and the printer then enlarges the pictures. The file requests that the printer does not smooth them.",
            )
            .unit("dots/inch"),
            Param::text(
                "curve",
                "",
                "Transmittance of the printed film per code, measured on the test chart: pairs of a code (rising from 0 to 255) and a transmittance (rising, 0 to 1). For example \"0 0.02, 128 0.3, 255 0.88\". Three lists, separated by semicolons, are for red, green and blue. Without a curve, codes are sRGB.",
            ),
            Param::float(
                "min_transmittance",
                0.0,
                0.0..=0.9,
                "Transmittance of the darkest print relative to clear film, if there is no curve.",
            )
            .unit("1"),
            Param::bool("mirror", false, "Mirror films left to right, for films whose printed side faces away from the viewer."),
            Param::float("border_mm", 12.0, 8.0..=100.0, "Width of the border around the masks, which contains the registration marks.").unit("mm"),
            Param::float("film_mm", 0.1, 0.0..=10.0, "Thickness of a film, which is subtracted from the thickness of the spacers.").unit("mm"),
            Param::float(
                "spacer_index",
                1.0,
                1.0..=2.5,
                "Refractive index of the spacers: 1 for air, 1.49 for acrylic. A plate of thickness t has the effect of an air gap of width t / index.",
            )
            .unit("1"),
            Param::bool("chart", true, "Add the test chart."),
        ])
    }

    fn open(host: Host, params: TransparenciesParams, display: Display) -> Result<Self, PluginError> {
        if display.frames != 1 {
            return Err(PluginError::Refused(format!(
                "expected a display with frames = 1, since printed layers are static, found frames = {}",
                display.frames
            )));
        }
        if display.formation != Formation::Attenuating {
            return Err(PluginError::Refused(format!(
                "expected formation = \"attenuating\", since film attenuates light, found formation = \"{}\"",
                format!("{:?}", display.formation).to_lowercase()
            )));
        }
        if display.backlight != Backlight::Uniform {
            host.warn("only the layers are printed, not the display's directional backlight");
        }
        let film = Film::new(&params.curve, params.min_transmittance)?;
        let sheet = Sheet::new(&display.layers, params.border_mm, params.paper.size_mm())?;
        pages::spacers_mm(&display.layers, params.film_mm, params.spacer_index)?;
        for (n, layer) in display.layers.iter().enumerate() {
            picture_size(params.dpi, n, layer)?;
        }
        Ok(Self { host, params, display, film, sheet, written: Mutex::default() })
    }

    fn submit(&self, time: Time, data: &Input<'_>) -> Result<(), PluginError> {
        let Input::LayerStack(stack) = data else { return Err(PluginError::unexpected(data)) };
        let entries = self.write(time, stack)?;
        self.written.lock().unwrap_or_else(PoisonError::into_inner).extend(entries);
        Ok(())
    }

    fn finish(self) -> Result<(), PluginError> {
        self.host.check_cancelled()?;
        let mut files = self.written.into_inner().unwrap_or_else(PoisonError::into_inner);
        files.sort_by_key(|file| (file.time, file.page));
        let spacers = pages::spacers_mm(&self.display.layers, self.params.film_mm, self.params.spacer_index)?;
        let manifest = Manifest {
            schema: "lumistack/transparencies",
            version: 1,
            page_mm: self.sheet.page_mm,
            film_mm: self.sheet.film_mm,
            mirrored: self.params.mirror,
            darkest: self.film.dark,
            spacers_mm: &spacers,
            chart_codes: if self.params.chart { &pages::CHART_CODES } else { &[] },
            files,
        };
        let text = serde_json::to_string_pretty(&manifest).expect("JSON can express a manifest");
        self.host.write("transparencies.json", format!("{text}\n").as_bytes())
    }
}

impl Transparencies {
    fn write(&self, time: Time, stack: &StackInput<'_>) -> Result<Vec<Entry>, PluginError> {
        let file = if time.index == 0 {
            "transparencies.pdf".into()
        } else {
            format!("t{:04}/transparencies.pdf", time.index)
        };
        // Write the assembly sheet and the test chart, which come before the films.
        let layers = &self.display.layers;
        let stage = self.host.stage("films", layers.len() as u64, "pages");
        let out = BufWriter::with_capacity(1 << 16, self.host.create(&file)?);
        let mut document = Document::new(out, &self.display.name).map_err(pdf::failed)?;
        let spacers = pages::spacers_mm(layers, self.params.film_mm, self.params.spacer_index)?;
        let assembly = pages::assembly(&self.sheet, &self.display, &self.params, &self.film, &spacers);
        document.add(self.sheet.page_mm, assembly).map_err(pdf::failed)?;
        if self.params.chart {
            document.add(self.sheet.page_mm, pages::chart(&self.sheet)).map_err(pdf::failed)?;
        }
        // Write one page per layer, and its entry in the manifest.
        let first = if self.params.chart { 3 } else { 2 };
        let mut entries = Vec::new();
        for (n, layer) in layers.iter().enumerate() {
            self.host.check_cancelled()?;
            let (page, resolution, too_dark) = self.film_page(&mut document, stack, n, layer)?;
            document.add(self.sheet.page_mm, page).map_err(pdf::failed)?;
            entries.push(Entry {
                file: file.clone(),
                page: first + n,
                layer: n,
                d_mm: layer.d_mm,
                place_mm: self.sheet.place(layer, self.params.mirror),
                resolution,
                too_dark,
                time: time.index,
            });
            stage.advance(1, "");
        }
        // Warn of mask values that the film cannot show, since the user can avoid them.
        let too_dark: usize = entries.iter().map(|entry| entry.too_dark).sum();
        if too_dark > 0 {
            let darkest = self.film.dark.iter().copied().fold(0.0, f64::max);
            self.host.warn(&format!(
                "some mask values are below the film's least transmittance, {darkest:.3} of clear film (number of these values: {too_dark}). Patterns that are solved with black_level = {darkest:.3} in all layers of the display have no such values"
            ));
        }
        let out = document.finish().map_err(pdf::failed)?;
        out.into_inner().map_err(|error| pdf::failed(error.into_error()))?.commit()?;
        Ok(entries)
    }

    /// Makes the page of a layer's film. Returns the page, the picture's [columns, rows], and the
    /// number of values below the film's least transmittance.
    fn film_page(
        &self,
        document: &mut Document<impl Write>,
        stack: &StackInput<'_>,
        n: usize,
        layer: &Layer,
    ) -> Result<(Page, [usize; 2], usize), PluginError> {
        let plane = stack.layer(n, 0)?;
        let (rows, cols, size) = (plane.rows(), plane.cols(), picture_size(self.params.dpi, n, layer)?);
        // Read and encode the mask row by row, since a film's picture may be larger than memory.
        // If the picture has more rows than the mask, rows are repeated; if it has fewer, rows are
        // skipped.
        let mut masks = plane.iter_rows().enumerate();
        let (mut at, mut codes, mut too_dark, mut row) = (None, Vec::new(), 0, 0);
        let pieces = document.image(size, |printed| {
            self.host.check_cancelled()?;
            let wanted = (2 * row + 1) * rows / (2 * size[1]);
            while at.is_none_or(|at| at < wanted) {
                let Some((number, mask)) = masks.next() else { break };
                let (of_row, dark) = self.film.codes(layer, &mask);
                (at, codes, too_dark) = (Some(number), of_row, too_dark + dark);
            }
            row += 1;
            for col in 0..size[0] {
                let col = if self.params.mirror { size[0] - 1 - col } else { col };
                printed.extend_from_slice(&codes[3 * ((2 * col + 1) * cols / (2 * size[0]))..][..3]);
            }
            Ok(())
        })?;
        too_dark += masks.map(|(_, mask)| self.film.codes(layer, &mask).1).sum::<usize>();
        let mut page = pages::film(&self.sheet, &self.display, n, self.params.mirror);
        page.image(self.sheet.place(layer, self.params.mirror), size[1], &pieces);
        Ok((page, size, too_dark))
    }
}

/// Returns [columns, rows] of a layer's picture in the file, at the resolution `dpi`. If `dpi` is
/// 0, the picture has the mask's columns and rows.
///
/// # Errors
/// If a side exceeds [`SIDE_LIMIT`].
fn picture_size(dpi: u32, n: usize, layer: &Layer) -> Result<[usize; 2], PluginError> {
    let printed = |count: usize| ((count as f64 * layer.pitch_mm / INCH_MM * f64::from(dpi)).round() as usize).max(1);
    let size = if dpi == 0 { layer.resolution } else { layer.resolution.map(printed) };
    if size.iter().any(|side| *side > SIDE_LIMIT) {
        let (cause, [cols, rows]) = (if dpi == 0 { "display" } else { "parameter `dpi`" }, size);
        return Err(PluginError::Refused(format!(
            "{cause}: expected pictures of at most {SIDE_LIMIT} pixels a side, found {cols} × {rows} for layer {n}"
        )));
    }
    Ok(size)
}

/// Largest number of pixels per side of a picture.
const SIDE_LIMIT: usize = 1 << 17;

export_plugin!("transparencies", Transparencies);
