//! Draws the content of the pages.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Display, Layer};

use crate::TransparenciesParams;
use crate::curve::Film;
use crate::pdf::Page;
use crate::sheet::Sheet;

/// Codes of the test chart's steps. They are denser near black and near white.
pub(crate) const CHART_CODES: [u8; 24] =
    [0, 4, 8, 12, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160, 176, 192, 208, 224, 240, 248, 255];
/// Size of the letters in mm.
const TYPE_MM: f64 = 3.2;
const LINE_MM: f64 = 4.6;
const MARGIN_MM: f64 = 12.0;

/// Returns the thickness of the spacers between neighbouring films, in mm.
///
/// In air a spacer is as thick as the distance between the layers, minus half the thickness of a
/// film on either side. For a material with a refractive index, this thickness is multiplied by the
/// index.
///
/// # Errors
/// If films are thicker than a gap.
pub(crate) fn spacers_mm(layers: &[Layer], film_mm: f64, index: f64) -> Result<Vec<f64>, PluginError> {
    layers
        .windows(2)
        .map(|pair| {
            let gap = pair[1].d_mm - pair[0].d_mm;
            // A gap of 0.3 − 0.2 mm is less than 0.1 mm by rounding.
            if gap < film_mm - 1e-9 {
                return Err(PluginError::Refused(format!(
                    "parameter `film_mm`: expected at most {gap}, the distance between two layers in mm, found {film_mm}"
                )));
            }
            Ok((gap - film_mm).max(0.0) * index)
        })
        .collect()
}

/// Makes a film's page without its mask: the title, the cut lines and the registration marks.
pub(crate) fn film(sheet: &Sheet, display: &Display, n: usize, mirror: bool) -> Page {
    let mut page = Page::default();
    let [left, bottom] = sheet.film_corner();
    let [right, top] = [left + sheet.film_mm[0], bottom + sheet.film_mm[1]];
    for (x, outward_x) in [(left, -1.0), (right, 1.0)] {
        for (y, outward_y) in [(bottom, -1.0), (top, 1.0)] {
            page.line(&[[x + 2.0 * outward_x, y], [x + 7.0 * outward_x, y]]);
            page.line(&[[x, y + 2.0 * outward_y], [x, y + 7.0 * outward_y]]);
        }
    }
    for mark in sheet.marks() {
        page.mark(mark);
    }
    let place = match n {
        0 => ", rear",
        n if n + 1 == display.layers.len() => ", front",
        _ => "",
    };
    let side = if mirror { "printed side away from the viewer" } else { "printed side to the viewer" };
    let d_mm = display.layers[n].d_mm;
    page.text([left + 9.0, bottom - 6.0], 2.6, &format!("layer {n}{place}, z = {d_mm} mm, {side}"));
    // A short line marks the film's upper edge, so that the edge is known after the film is cut.
    page.line(&[[left + 0.5 * sheet.film_mm[0] + 5.0, top - 1.0], [left + 0.5 * sheet.film_mm[0] + 10.0, top - 1.0]]);
    page
}

/// Makes the assembly sheet with the order of films and spacers, and a ruler.
pub(crate) fn assembly(
    sheet: &Sheet,
    display: &Display,
    params: &TransparenciesParams,
    film: &Film,
    spacers_mm: &[f64],
) -> Page {
    let mut page = Page::default();
    let mut lines = vec![
        display.name.clone(),
        String::new(),
        "Print all pages at 100 %, without scaling and without colour management.".into(),
        format!("Cut every film at the corner lines, {:.2} x {:.2} mm.", sheet.film_mm[0], sheet.film_mm[1]),
        "Lay the films on one another until all marks coincide, with the short line at the top.".into(),
        if params.mirror {
            "Films are mirrored: their printed sides face away from the viewer.".into()
        } else {
            "The printed sides face the viewer.".into()
        },
        String::new(),
        "From the back to the viewer:".into(),
    ];
    // List films and spacers in the order of assembly.
    for (n, layer) in display.layers.iter().enumerate() {
        lines.push(format!(
            "film {n}: z = {} mm, {} x {} pixels of {} mm",
            layer.d_mm, layer.resolution[0], layer.resolution[1], layer.pitch_mm
        ));
        if let Some(spacer) = spacers_mm.get(n) {
            let index = params.spacer_index;
            let what = if index == 1.0 { "air".to_string() } else { format!("a plate of index {index}") };
            lines.push(format!("    spacer of {spacer:.3} mm, {what}"));
        }
    }
    let darkest = film.dark.map(|dark| format!("{dark:.3}")).join(", ");
    lines.push(String::new());
    lines.push(format!("Thickness of a film: {} mm.", params.film_mm));
    lines.push(format!("Transmittance of the darkest print, relative to clear film: {darkest} (red, green, blue)."));
    if let Some(clear) = film.clear {
        let clear = clear.map(|clear| format!("{clear:.3}")).join(", ");
        lines.push(format!("Clear film transmits {clear} of the light; every layer is darker by that factor."));
    }
    let [width, height] = sheet.page_mm;
    let longest = lines.iter().map(|line| line.chars().count()).max().unwrap_or(1) as f64;
    // Reduce the letters until the text fits on the page. Letters of Helvetica are about half as
    // wide as high.
    let fit = ((width - 2.0 * MARGIN_MM) / (0.5 * TYPE_MM * longest))
        .min((height - 2.0 * MARGIN_MM - 12.0) / (LINE_MM * lines.len() as f64))
        .clamp(0.05, 1.0);
    for (i, line) in lines.iter().enumerate() {
        let y = height - MARGIN_MM - LINE_MM * fit * (i as f64 + 1.0);
        page.text([MARGIN_MM, y], TYPE_MM * fit, line);
    }
    ruler(&mut page, width);
    page
}

/// Draws a ruler at the foot of a page: ten centimetres, or fewer whole centimetres if the page is
/// narrow.
fn ruler(page: &mut Page, width: f64) {
    let centimetres = ((width - 2.0 * MARGIN_MM) / 10.0).floor().clamp(0.0, 10.0);
    let length = 10.0 * centimetres;
    page.line(&[[MARGIN_MM, 6.0], [MARGIN_MM + length, 6.0]]);
    for i in 0..=length as u32 {
        let tick = if i % 10 == 0 { 4.0 } else { 2.0 };
        let x = MARGIN_MM + f64::from(i);
        page.line(&[[x, 6.0], [x, 6.0 + tick]]);
    }
    if centimetres >= 1.0 {
        page.text([MARGIN_MM + 1.0, 2.5], 2.6, &format!("{length:.0} mm"));
    }
}

/// Makes the test chart: steps of grey and of each colour alone, whose transmittance the user
/// measures.
pub(crate) fn chart(sheet: &Sheet) -> Page {
    let mut page = Page::default();
    let [width, height] = sheet.page_mm;
    let room = [width - 2.0 * MARGIN_MM, height - 2.0 * MARGIN_MM - 8.0];
    let (columns, rows) = (CHART_CODES.len() as f64 / 4.0, 16.0);
    let cell = [room[0] / columns, room[1] / rows];
    let sides: [(&str, [bool; 3]); 4] = [
        ("grey", [true; 3]),
        ("red", [true, false, false]),
        ("green", [false, true, false]),
        ("blue", [false, false, true]),
    ];
    let title = "Measure light through a step, divided by light through its colour's last step. Codes are below steps.";
    let size = (room[0] / (0.5 * title.chars().count() as f64)).min(TYPE_MM);
    page.text([MARGIN_MM, height - MARGIN_MM], size, title);
    for (s, (name, channels)) in sides.iter().enumerate() {
        for (i, &code) in CHART_CODES.iter().enumerate() {
            let (row, col) = (4 * s + i / 6, i % 6);
            let x = MARGIN_MM + col as f64 * cell[0];
            let y = height - MARGIN_MM - 4.0 - (row as f64 + 1.0) * cell[1];
            let label = (0.22 * cell[1]).min(TYPE_MM);
            // A step of one colour prints only its own channel. Code 255 leaves a channel clear.
            let rgb = channels.map(|own| if own { code } else { 255 });
            let patch = [x, y + 1.4 * label, 0.92 * cell[0], cell[1] - 1.6 * label];
            page.fill(patch, rgb);
            page.frame(patch);
            page.text([x, y + 0.3 * label], label, &format!("{name} {code}"));
        }
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plate_is_as_much_thicker_as_its_index_says() {
        let layers = [-4.0, 0.0, 6.0].map(|d_mm| Layer::new(d_mm, [2, 2], 1.0));
        assert_eq!(spacers_mm(&layers, 0.0, 1.0).unwrap(), [4.0, 6.0]);
        let acrylic = spacers_mm(&layers, 0.1, 1.49).unwrap();
        assert!((acrylic[0] - 3.9 * 1.49).abs() < 1e-12 && (acrylic[1] - 5.9 * 1.49).abs() < 1e-12);
        let error = spacers_mm(&layers, 5.0, 1.0).unwrap_err().to_string();
        assert!(
            error.starts_with("parameter `film_mm`: expected at most 4, the distance between two layers in mm"),
            "{error}"
        );
    }
}
