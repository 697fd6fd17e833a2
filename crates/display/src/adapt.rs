//! The same display at another resolution, or for another light field.

use crate::{Backlight, Display, FieldGeometry, Projection, ProjectionKind};

impl Display {
    /// The same display at another resolution: the field becomes `resolution` = [columns, rows] pixels over the same width, and the masks are
    /// scaled by the same factors, and so is the number of lenslets over the same area, while point spreads keep their width in millimetres: a coarse
    /// preview keeps the display's character. Physical panels stay, and colour filters stay stripes of one mask column.
    #[must_use]
    pub fn with_resolution(&self, resolution: [usize; 2]) -> Self {
        let mut display = self.clone();
        let old = self.field.resolution;
        let pitch_factor = old[0] as f64 / resolution[0] as f64;
        let scaled = |count: usize, axis: usize| {
            ((count as f64 * resolution[axis] as f64 / old[axis] as f64).round() as usize).max(1)
        };
        display.field.resolution = resolution;
        display.field.pitch_mm *= pitch_factor;
        for layer in &mut display.layers {
            layer.resolution = [scaled(layer.resolution[0], 0), scaled(layer.resolution[1], 1)];
            layer.pitch_mm *= pitch_factor;
            layer.blur_px /= pitch_factor;
        }
        if let Backlight::Lenslets(backlight) = &mut display.backlight {
            let cols = scaled(backlight.lenslets[0], 0);
            backlight.pitch_mm *= backlight.lenslets[0] as f64 / cols as f64;
            backlight.lenslets = [cols, scaled(backlight.lenslets[1], 1)];
        }
        display
    }

    /// The same display for a light field that already exists: masks take its resolution and size, the view grid its angles (as the full
    /// angle whose bins are as wide as the field's). Distances and frames stay.
    #[must_use]
    pub fn adapted_to(&self, geometry: &FieldGeometry) -> Self {
        let mut display = self.with_resolution([geometry.cols, geometry.rows]);
        let pitch_factor = geometry.pitch_mm / display.field.pitch_mm;
        display.field.pitch_mm = geometry.pitch_mm;
        for layer in &mut display.layers {
            layer.pitch_mm *= pitch_factor;
        }
        let [view_rows, view_cols] = geometry.grid.views();
        let bins = geometry.grid.bin_width();
        display.field.views = [view_cols, view_rows];
        display.field.fov_deg =
            [0, 1].map(|axis| 2.0 * (0.5 * bins[axis] * display.field.views[axis] as f64).atan().to_degrees());
        (display.field.projection, display.field.distance_mm) = match geometry.grid.projection {
            Projection::Oblique => (ProjectionKind::Oblique, None),
            Projection::Perspective { distance_mm } => (ProjectionKind::Perspective, Some(distance_mm)),
        };
        display
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ViewGrid;
    use crate::config::tests::small_display;

    #[test]
    fn an_adapted_display_has_the_light_fields_geometry() {
        let wide = small_display();
        let grid = ViewGrid::uniform(Projection::Oblique, [5, 1], [30.0, 10.0]).unwrap();
        let geometry = FieldGeometry { rows: 7, cols: 9, pitch_mm: 2.0, grid };
        let display = wide.adapted_to(&geometry);
        display.check().unwrap();
        assert_eq!((display.layers[0].resolution, display.layers[2].pitch_mm), ([9, 7], 2.0));
        let adapted = display.geometry().unwrap();
        for (a, b) in adapted.grid.slope_x.iter().zip(&geometry.grid.slope_x) {
            assert!((a - b).abs() < 1e-12);
        }
        assert_eq!(adapted.grid.views(), [1, 5]);
    }

    #[test]
    fn another_resolution_keeps_the_width() {
        let mut display = small_display();
        display.layers[1].blur_px = 0.75;
        let display = display.with_resolution([32, 19]);
        assert_eq!(display.layers[1].resolution, [32, 19]);
        assert_eq!(display.field.pitch_mm * 32.0, 16.0);
        assert_eq!(display.layers[1].blur_px * display.layers[1].pitch_mm, 0.75);
        display.check().unwrap();
    }
}
