//! The geometry of a panel, which maps output pixels to millimetres on the layer. The source file
//! of `lumistack_display::Panel` has the equations. The output shows the upright picture after it
//! has been mirrored and then rotated.

use lumistack_plugin::display::{Backlight, Display, Flip, Homography, Panel};

use crate::Shows;

/// Maps the pixels of one output to positions on its panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// [columns, rows] of the output.
    pub output: [usize; 2],
    /// Pixel pitch of the panel, millimetres.
    pub pitch_mm: f64,
    panel: Panel,
    homography: Homography,
}

impl Place {
    /// Returns the geometry of an output of [columns, rows] pixels that drives the panel `shows`.
    pub fn new(display: &Display, shows: Shows, output: [usize; 2]) -> Self {
        let (panel, pitch_mm) = match (shows, &display.backlight) {
            (Shows::Layer(n), _) => {
                let layer = &display.layers[n];
                (layer.panel.clone(), layer.panel_pitch_mm.unwrap_or(layer.pitch_mm))
            }
            (Shows::Backlight, Backlight::Lenslets(backlight)) => {
                let rear = &display.layers[0];
                let pitch_mm = backlight.panel_pitch_mm.or(rear.panel_pitch_mm).unwrap_or(rear.pitch_mm);
                (backlight.panel.clone(), pitch_mm)
            }
            (Shows::Backlight, Backlight::Uniform) => (None, 1.0),
        };
        let panel = panel.unwrap_or_default();
        let homography = panel.homography.map_or(Homography::IDENTITY, Homography);
        Self { output, pitch_mm, panel, homography }
    }

    /// Returns [columns, rows] of the panel's upright picture.
    pub fn upright_size(&self) -> [usize; 2] {
        let [cols, rows] = self.output;
        if self.panel.rotate_deg.is_multiple_of(180) { [cols, rows] } else { [rows, cols] }
    }

    /// Returns `[left, top, columns, rows]` of the region of the upright picture that is used.
    /// `None` if all of it is used.
    pub(crate) fn crop(&self) -> Option<[usize; 4]> {
        self.panel.crop
    }

    /// Maps a position (column, row) on the output to its position (column, row) in the upright
    /// picture. Whole numbers are pixel centres.
    pub fn upright(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [cols, rows] = self.upright_size().map(|count| count as f64 - 1.0);
        let [u, v] = match self.panel.rotate_deg {
            90 => [y, rows - x],
            180 => [cols - x, rows - y],
            270 => [cols - y, x],
            _ => [x, y],
        };
        match self.panel.flip {
            Flip::None => [u, v],
            Flip::Horizontal => [cols - u, v],
            Flip::Vertical => [u, rows - v],
        }
    }

    /// Maps a position (column, row) on the output to its nominal position on the layer, before the
    /// homography. The result is in millimetres from the layer's centre, x right and y up. `None`
    /// outside the crop.
    pub fn nominal_mm(&self, output: [f64; 2]) -> Option<[f64; 2]> {
        let [u, v] = self.upright(output);
        let [left, top, cols, rows] = self.panel.crop.map_or_else(
            || {
                let [cols, rows] = self.upright_size();
                [0.0, 0.0, cols as f64, rows as f64]
            },
            |crop| crop.map(|count| count as f64),
        );
        // the region's edge is half a pixel outside its outermost pixel centres
        if u < left - 0.5 || v < top - 0.5 || u >= left + cols - 0.5 || v >= top + rows - 0.5 {
            return None;
        }
        let [right, down] = self.panel.nudge_px;
        let x = u - right - left - (cols - 1.0) / 2.0;
        let y = v - down - top - (rows - 1.0) / 2.0;
        Some([x * self.pitch_mm, -y * self.pitch_mm])
    }

    /// Maps a position (column, row) on the output to its real position on the layer, after the
    /// homography, in millimetres from the layer's centre. `None` outside the crop.
    pub fn mm(&self, output: [f64; 2]) -> Option<[f64; 2]> {
        self.nominal_mm(output).map(|nominal| self.homography.apply(nominal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(panel: Panel, output: [usize; 2]) -> Place {
        let mut display = Display::uniform([6, 4], 1.0, [1, 1], [10.0, 10.0], &[0.0], 1);
        display.layers[0].panel = Some(panel);
        Place::new(&display, Shows::Layer(0), output)
    }

    /// Compares positions with an oracle, which mirrors and rotates an array of pixels as an image
    /// editor does.
    #[test]
    fn orientation_equals_mirroring_and_rotating_a_picture() {
        for (rotate_deg, flip) in [0, 90, 180, 270]
            .into_iter()
            .flat_map(|turn| [Flip::None, Flip::Horizontal, Flip::Vertical].into_iter().map(move |flip| (turn, flip)))
        {
            let (cols, rows) = (5usize, 3usize);
            let mut picture: Vec<Vec<(usize, usize)>> =
                (0..rows).map(|v| (0..cols).map(|u| (u, v)).collect()).collect();
            match flip {
                Flip::None => {}
                Flip::Horizontal => picture.iter_mut().for_each(|row| row.reverse()),
                Flip::Vertical => picture.reverse(),
            }
            for _ in 0..rotate_deg / 90 {
                // Turn the picture clockwise by a quarter: the left column, read upwards, becomes
                // the top row.
                let turned =
                    (0..picture[0].len()).map(|c| picture.iter().rev().map(|row| row[c]).collect()).collect::<Vec<_>>();
                picture = turned;
            }
            let place = place(Panel { rotate_deg, flip, ..Panel::default() }, [picture[0].len(), picture.len()]);
            assert_eq!(place.upright_size(), [cols, rows]);
            for (y, row) in picture.iter().enumerate() {
                for (x, &(u, v)) in row.iter().enumerate() {
                    assert_eq!(place.upright([x as f64, y as f64]), [u as f64, v as f64], "{rotate_deg} {flip:?}");
                }
            }
        }
    }

    #[test]
    fn crop_nudge_and_homography_move_the_place() {
        let plain = place(Panel::default(), [6, 4]);
        assert_eq!(plain.mm([0.0, 0.0]), Some([-2.5, 1.5]));
        assert_eq!(plain.mm([5.0, 3.0]), Some([2.5, -1.5]));
        // The nudge moves the picture right and down. So a pixel shows content from further left
        // and further up.
        let nudged = place(Panel { nudge_px: [1.0, 0.5], ..Panel::default() }, [6, 4]);
        assert_eq!(nudged.mm([0.0, 0.0]), Some([-3.5, 2.0]));
        let cropped = place(Panel { crop: Some([10, 20, 6, 4]), ..Panel::default() }, [40, 40]);
        assert_eq!(cropped.mm([10.0, 20.0]), Some([-2.5, 1.5]));
        assert_eq!((cropped.mm([9.0, 20.0]), cropped.mm([10.0, 24.0])), (None, None));
        let shear = [[1.0, 0.1, 0.3], [0.0, 1.0, 0.0], [0.0, 0.01, 1.0]];
        let moved = place(Panel { homography: Some(shear), ..Panel::default() }, [6, 4]).mm([0.0, 0.0]).unwrap();
        let expected = [(-2.5 + 0.15 + 0.3) / 1.015, 1.5 / 1.015];
        assert!((moved[0] - expected[0]).abs() < 1e-12 && (moved[1] - expected[1]).abs() < 1e-12);
    }

    #[test]
    fn a_homography_and_its_inverse_leave_points_alone() {
        let map = Homography([[1.1, 0.02, 3.0], [-0.05, 0.9, -2.0], [1e-4, -2e-4, 1.0]]);
        for point in [[0.0, 0.0], [100.0, -50.0], [-237.0, 148.0]] {
            let back = map.inverse().apply(map.apply(point));
            let both = map.inverse().after(&map).apply(point);
            for found in [back, both] {
                assert!((found[0] - point[0]).abs() < 1e-9 && (found[1] - point[1]).abs() < 1e-9, "{found:?}");
            }
        }
    }
}
