//! Layout of a page, in millimetres from its lower left corner.
//!
//! All films are cut to the same rectangle. It is the smallest rectangle that contains all layers
//! at their positions in the display, plus a border with registration marks. The centre of the
//! rectangle is the centre of the page.
//!
//! Marks and cut lines have the same positions on every film, so films are aligned when their marks
//! coincide. Cut lines are outside the film's corners.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::Layer;

/// Least distance from a film's edge to the page's edge, in mm. Cut lines and the title are printed
/// between these edges.
pub const OUTSIDE_MM: f64 = 12.0;
/// Millimetres per inch.
pub const INCH_MM: f64 = 25.4;

/// Sizes of pages and films.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    /// [width, height] of a page.
    pub page_mm: [f64; 2],
    /// [width, height] of a film.
    pub film_mm: [f64; 2],
    /// The film's centre in display space.
    pub centre_mm: [f64; 2],
    /// Width of the border around the layers.
    pub border_mm: f64,
}

impl Sheet {
    /// Computes the sizes for `layers`. `paper_mm` is the paper's [shorter, longer] side; `None`
    /// gives pages of the smallest possible size.
    ///
    /// # Errors
    /// If the films do not fit on the paper.
    pub fn new(layers: &[Layer], border_mm: f64, paper_mm: Option<[f64; 2]>) -> Result<Self, PluginError> {
        let edge = |axis: usize, sign: f64| {
            let edges = layers
                .iter()
                .map(|layer| sign * layer.offset_mm[axis] + 0.5 * layer.resolution[axis] as f64 * layer.pitch_mm);
            sign * edges.fold(f64::NEG_INFINITY, f64::max)
        };
        let film_mm = [0, 1].map(|axis| edge(axis, 1.0) - edge(axis, -1.0) + 2.0 * border_mm);
        let centre_mm = [0, 1].map(|axis| 0.5 * (edge(axis, 1.0) + edge(axis, -1.0)));
        let needed = film_mm.map(|side| side + 2.0 * OUTSIDE_MM);
        let fits = |page: [f64; 2]| needed[0] <= page[0] && needed[1] <= page[1];
        let page_mm = match paper_mm {
            None => needed,
            Some([short, long]) if fits([short, long]) => [short, long],
            Some([short, long]) if fits([long, short]) => [long, short],
            Some([short, long]) => {
                return Err(PluginError::Refused(format!(
                    "parameter `paper`: expected pages of at least {:.1} × {:.1} mm for films of {:.1} × {:.1} mm, found {short} × {long} mm; set paper = \"tight\" for pages that fit, or make the display smaller",
                    needed[0], needed[1], film_mm[0], film_mm[1]
                )));
            }
        };
        Ok(Self { page_mm, film_mm, centre_mm, border_mm })
    }

    /// Maps a point of display space to the page. With `mirror`, left and right are exchanged.
    pub fn on_page(&self, [x, y]: [f64; 2], mirror: bool) -> [f64; 2] {
        let sign = if mirror { -1.0 } else { 1.0 };
        [0.5 * self.page_mm[0] + sign * (x - self.centre_mm[0]), 0.5 * self.page_mm[1] + y - self.centre_mm[1]]
    }

    /// Returns [left, bottom, width, height] of a layer's mask on the page.
    pub fn place(&self, layer: &Layer, mirror: bool) -> [f64; 4] {
        let size = [0, 1].map(|axis| layer.resolution[axis] as f64 * layer.pitch_mm);
        let [x, y] = self.on_page(layer.offset_mm, mirror);
        [x - 0.5 * size[0], y - 0.5 * size[1], size[0], size[1]]
    }

    /// Returns [left, bottom] of the film on the page.
    pub fn film_corner(&self) -> [f64; 2] {
        [0, 1].map(|axis| 0.5 * (self.page_mm[axis] - self.film_mm[axis]))
    }

    /// Returns the centres of the registration marks. They are in the film's border, at the corners
    /// and at the middles of the sides.
    pub fn marks(&self) -> Vec<[f64; 2]> {
        let [left, bottom] = self.film_corner();
        let [width, height] = self.film_mm;
        let inset = 0.5 * self.border_mm;
        let (xs, ys) = (
            [left + inset, left + 0.5 * width, left + width - inset],
            [bottom + inset, bottom + 0.5 * height, bottom + height - inset],
        );
        let all = (0..3).flat_map(|i| (0..3).map(move |j| [i, j]));
        all.filter(|place| *place != [1, 1]).map(|[i, j]| [xs[i], ys[j]]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layers() -> Vec<Layer> {
        vec![Layer::new(-5.0, [80, 50], 1.0), Layer { offset_mm: [10.0, 0.0], ..Layer::new(5.0, [40, 60], 1.5) }]
    }

    #[test]
    fn films_hold_all_layers_where_they_stand() {
        // The layers extend over x from −40 to 40 and y from −45 to 45, and the border adds 10 on
        // each side.
        let sheet = Sheet::new(&layers(), 10.0, Some([210.0, 297.0])).unwrap();
        assert_eq!((sheet.film_mm, sheet.centre_mm, sheet.page_mm), ([100.0, 110.0], [0.0, 0.0], [210.0, 297.0]));
        assert_eq!(sheet.place(&layers()[0], false), [65.0, 123.5, 80.0, 50.0]);
        assert_eq!(sheet.place(&layers()[1], false), [85.0, 103.5, 60.0, 90.0]);
        assert_eq!(sheet.place(&layers()[1], true), [65.0, 103.5, 60.0, 90.0], "mirrored about the page's centre");
        assert_eq!(sheet.marks().len(), 8);
        assert_eq!(sheet.film_corner(), [55.0, 93.5]);
    }

    #[test]
    fn paper_is_turned_or_refused() {
        let wide = [Layer::new(0.0, [200, 100], 1.0)];
        assert_eq!(Sheet::new(&wide, 10.0, Some([210.0, 297.0])).unwrap().page_mm, [297.0, 210.0]);
        assert_eq!(Sheet::new(&wide, 10.0, None).unwrap().page_mm, [244.0, 144.0]);
        let large = [Layer::new(0.0, [400, 300], 1.0)];
        let error = Sheet::new(&large, 10.0, Some([210.0, 297.0])).unwrap_err().to_string();
        assert!(error.contains("expected pages of at least 444.0 × 344.0 mm for films of 420.0 × 320.0 mm"), "{error}");
    }
}
