//! Adapts a display to another resolution, or to another light field.

use crate::{
    Backlight, Display, DisplayError, FieldGeometry, LensletBacklight, OutsideBins, Projection, ProjectionKind, Views,
};

/// Relative difference up to which angles and lengths are taken as equal. So rounding changes
/// nothing if a display is adapted to its own light field.
const SAME: f64 = 1e-9;
/// Largest number of angular bins per axis of a backlight that follows a light field. A backlight
/// with at most two bins per view may have more.
const MOST_BINS: usize = 64;

impl Display {
    /// Returns this display at another resolution. The field becomes `resolution` = [columns, rows]
    /// pixels over the same width. The numbers of mask pixels and of lenslets change in proportion
    /// to the number of field pixels. The lenslets cover at least the same fraction of the field as
    /// before. Point spreads keep their width in millimetres, so that a coarse preview blurs as the
    /// display does. Physical panels stay the same, and colour filters stay stripes of one mask
    /// column.
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
            let [old_cols, old_rows] = backlight.lenslets.map(|count| count as f64);
            let cols = scaled(backlight.lenslets[0], 0);
            let pitch_mm = backlight.pitch_mm * old_cols / cols as f64;
            // Lenslets have one pitch for both axes. The number of rows is rounded up, so that the
            // lenslets cover at least the old fraction of the height. Rays outside the lenslets
            // would be lost.
            let height_factor = pitch_factor * resolution[1] as f64 / old[1] as f64;
            let rows = old_rows * backlight.pitch_mm * height_factor / pitch_mm;
            backlight.lenslets = [cols, ((rows - SAME * rows).ceil() as usize).max(1)];
            backlight.pitch_mm = pitch_mm;
        }
        display
    }

    /// Returns this display adapted to a light field that already exists. Masks scale with the
    /// resolution and the size of the light field. The new field of view makes the display's views
    /// as far apart as the views of the light field. Lenslets scale with the masks. The distances
    /// of layers and lenslets stay the same, and so do the frames.
    ///
    /// The backlight's bins follow the views per axis: the number of bins per view stays the same.
    /// So a backlight that was made for the display's views has one bin for each view of the light
    /// field. The backlight has more bins if rays of perspective or one-sided views leave these
    /// bins.
    ///
    /// # Errors
    /// If the rays of the light field need more than 64 bins along an axis, and more than two per
    /// view. Also if this display's view grid is invalid.
    pub fn adapted_to(&self, geometry: &FieldGeometry) -> Result<Self, DisplayError> {
        if self.geometry()? == *geometry {
            return Ok(self.clone());
        }
        let mut display = self.with_resolution([geometry.cols, geometry.rows]);
        let pitch_factor = geometry.pitch_mm / display.field.pitch_mm;
        display.field.pitch_mm = geometry.pitch_mm;
        for layer in &mut display.layers {
            layer.pitch_mm *= pitch_factor;
        }
        let [view_rows, view_cols] = geometry.grid.views();
        let widths = geometry.grid.bin_width();
        display.field.views = Views::Fixed([view_cols, view_rows]);
        display.field.fov_deg = [0, 1].map(|axis| {
            let fov_deg = full_angle_deg(0.5 * widths[axis] * [view_cols, view_rows][axis] as f64);
            kept(self.field.fov_deg[axis], fov_deg)
        });
        (display.field.projection, display.field.distance_mm) = match geometry.grid.projection {
            Projection::Oblique => (ProjectionKind::Oblique, None),
            Projection::Perspective { distance_mm } => (ProjectionKind::Perspective, Some(distance_mm)),
        };
        if let (Backlight::Lenslets(adapted), Backlight::Lenslets(own)) = (&mut display.backlight, &self.backlight) {
            adapted.pitch_mm = kept(own.pitch_mm, adapted.pitch_mm * pitch_factor);
            for axis in [0, 1] {
                (adapted.views[axis], adapted.fov_deg[axis]) = self.adapted_bins(own, axis, geometry)?;
            }
        }
        Ok(display)
    }

    /// Returns the number of bins along an axis, and the full angle of all bins in degrees. These
    /// are the bins of a backlight that follows the views of a light field.
    fn adapted_bins(
        &self,
        own: &LensletBacklight,
        axis: usize,
        geometry: &FieldGeometry,
    ) -> Result<(usize, f64), DisplayError> {
        let half = |fov_deg: f64| (0.5 * fov_deg.to_radians()).tan();
        let own_bins = own.views[axis] as f64;
        // If the display file states no number of views, assume one view per bin.
        let own_views = match self.field.views {
            Views::Fixed(views) => views[axis] as f64,
            Views::Auto | Views::Step(_) => own_bins,
        };
        let (own_reach, bins_reach) = (half(self.field.fov_deg[axis]), half(own.fov_deg[axis]));
        // Keep the display's number of bins per view. Also keep the ratio between the largest slope
        // of the bins and the largest slope of the field of view.
        let (fineness, spread) = if own_reach > 0.0 {
            (own_reach / own_views * own_bins / bins_reach, bins_reach / own_reach)
        } else {
            (1.0, 1.0)
        };
        let slopes = if axis == 0 { &geometry.grid.slope_x } else { &geometry.grid.slope_y };
        let outermost = slopes.iter().fold(0.0f64, |most, slope| most.max(slope.abs()));
        // The rays of a perspective view have other slopes at the field's edges than at its centre.
        // If the backlight is dark outside its bins, the bins must also cover this difference. Bins
        // that repeat cover all slopes anyway.
        let fan = match (geometry.grid.projection, own.outside_bins) {
            (Projection::Perspective { distance_mm }, OutsideBins::Dark) => {
                0.5 * geometry.size_mm()[axis] / distance_mm
            }
            _ => 0.0,
        };
        let width = geometry.grid.bin_width()[axis];
        if width == 0.0 {
            // A single view gets the number of bins that the display has per view. These bins keep
            // the display's angle, unless rays of the view leave it.
            let bins = (own_bins / own_views).round().max(1.0) as usize;
            let reach = outermost + fan;
            let fov_deg = if reach < bins_reach { own.fov_deg[axis] } else { full_angle_deg(reach * 1.001) };
            return Ok((bins, fov_deg));
        }
        let bin = width / fineness;
        let centred = 0.5 * width * slopes.len() as f64;
        let repeats = own.outside_bins == OutsideBins::Repeat;
        let reach = if repeats { spread * centred } else { (outermost + 0.5 * width + fan).max(spread * centred) };
        let needed = 2.0 * reach / bin;
        let mut bins = (needed - 1e-6).ceil().max(1.0);
        if (fineness - 1.0).abs() < 1e-6 {
            // Bin centres are at whole multiples of the bin's width for an odd number of bins, and
            // at half-integer multiples for an even one. Choose the number that puts views at bin
            // centres.
            let from_whole = slopes[0] / bin - (slopes[0] / bin).round();
            let odd = from_whole.abs() <= 0.25;
            if (bins % 2.0 == 1.0) != odd {
                bins += 1.0;
            }
        }
        if bins > MOST_BINS.max(2 * slopes.len()) as f64 {
            let name = ["horizontal", "vertical"][axis];
            return Err(DisplayError::Value {
                key: "backlight.views".into(),
                expected: format!(
                    "a light field whose {name} slopes need at most {MOST_BINS} angular bins, or two bins per view (use parallel views or \
                     outside_bins = \"repeat\"), or a display with a uniform backlight"
                ),
                found: format!(
                    "{} views whose slopes are {width:.4} apart, and rays of slopes up to {:.3}, which need {bins} bins",
                    slopes.len(),
                    outermost + fan
                ),
            });
        }
        let fov_deg = full_angle_deg(0.5 * bins * bin);
        Ok((bins as usize, kept(own.fov_deg[axis], fov_deg)))
    }

    /// Returns a sentence that states how the backlight of `adapted` differs from the backlight of
    /// this display. `None` if both are equal, or if one of them is uniform.
    pub fn backlight_change(&self, adapted: &Self) -> Option<String> {
        let (Backlight::Lenslets(own), Backlight::Lenslets(now)) = (&self.backlight, &adapted.backlight) else {
            return None;
        };
        let bins = |b: &LensletBacklight| {
            let ([x, y], [across, down]) = (b.views, b.fov_deg);
            format!("{x} × {y} bins over {across:.1}° × {down:.1}°")
        };
        let lenslets = |b: &LensletBacklight| {
            let [cols, rows] = b.lenslets;
            format!("{cols} × {rows} lenslets of {:.2} mm", b.pitch_mm)
        };
        let changes: Vec<String> = [(bins(own), bins(now)), (lenslets(own), lenslets(now))]
            .into_iter()
            .filter(|(own, now)| own != now)
            .map(|(own, now)| format!("{now} instead of {own}"))
            .collect();
        (!changes.is_empty())
            .then(|| format!("the directional backlight is adapted to the light field: {}", changes.join(", and ")))
    }
}

/// Returns the angle between the slopes −`half` and `half`, in degrees.
fn full_angle_deg(half: f64) -> f64 {
    2.0 * half.atan().to_degrees()
}

/// Returns `own` if `new` differs from it only by rounding, otherwise `new`.
fn kept(own: f64, new: f64) -> f64 {
    if (new - own).abs() <= SAME * own.abs() { own } else { new }
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
        let display = wide.adapted_to(&geometry).unwrap();
        display.check().unwrap();
        assert_eq!((display.layers[0].resolution, display.layers[2].pitch_mm), ([9, 7], 2.0));
        let adapted = display.geometry().unwrap();
        for (a, b) in adapted.grid.slope_x.iter().zip(&geometry.grid.slope_x) {
            assert!((a - b).abs() < 1e-12);
        }
        assert_eq!(adapted.grid.views(), [1, 5]);
    }

    /// Returns a display of one layer in front of lenslets, made for 3 × 3 views over 20°.
    fn directional() -> Display {
        let mut display = Display::uniform([160, 100], 2.961, [3, 3], [20.0, 20.0], &[0.0], 8);
        let bins = LensletBacklight::new(-8.5, [47, 29], 10.08, [3, 3], [20.0, 20.0]);
        display.backlight = Backlight::Lenslets(bins);
        display.check().unwrap();
        display
    }

    fn lenslets(display: &Display) -> &LensletBacklight {
        let Backlight::Lenslets(lenslets) = &display.backlight else { panic!("a uniform backlight") };
        lenslets
    }

    /// Returns the bins that the rays of each view column (axis 0) or view row (axis 1) read.
    /// Panics if a ray is outside the bins.
    fn bins_of_views(display: &Display, geometry: &FieldGeometry, axis: usize) -> Vec<std::collections::BTreeSet<u32>> {
        let map = crate::RayMap::new(display, geometry);
        let backlight = map.backlight.as_ref().unwrap();
        let views = geometry.grid.views()[1 - axis];
        let taps = |view| if axis == 0 { backlight.x(view) } else { backlight.y(view) };
        let bin = |tap: &crate::BacklightTap| match tap {
            crate::BacklightTap::Lit { bin, .. } => Some(*bin),
            crate::BacklightTap::Missed => None,
            other => panic!("{other:?}: outside the bins"),
        };
        (0..views).map(|view| taps(view).iter().filter_map(bin).collect()).collect()
    }

    #[test]
    fn a_directional_backlight_follows_a_foreign_light_field() {
        for (views, fov) in [([5, 5], [20.0, 20.0]), ([7, 4], [48.0, 10.0]), ([2, 3], [10.0, 30.0])] {
            let grid = ViewGrid::uniform(Projection::Oblique, views, fov).unwrap();
            let geometry = FieldGeometry { rows: 50, cols: 84, pitch_mm: 1.7, grid };
            let display = directional().adapted_to(&geometry).unwrap();
            display.check().unwrap();
            let backlight = lenslets(&display);
            assert_eq!(backlight.views, views);
            for axis in [0, 1] {
                assert!((backlight.fov_deg[axis] - fov[axis]).abs() < 1e-9, "{:?}", backlight.fov_deg);
                // the rays of view i read bin i and no other bin
                let bins = bins_of_views(&display, &geometry, axis);
                for (view, bins) in (0u32..).zip(&bins) {
                    assert_eq!(bins.iter().copied().collect::<Vec<_>>(), [view], "{views:?}, axis {axis}");
                }
            }
            // the lenslets are as wide as the light field, and almost as high
            let [cols, rows] = backlight.lenslets.map(|count| count as f64 * backlight.pitch_mm);
            let [width, height] = geometry.size_mm();
            assert!((cols - width).abs() < 1e-6 * width && rows > 0.98 * height, "{cols} × {rows} mm");
            assert!(directional().backlight_change(&display).unwrap().contains("instead of 47 × 29 lenslets"));
        }
    }

    #[test]
    fn a_display_keeps_its_backlight_for_its_own_light_field() {
        let own = directional();
        let adapted = own.adapted_to(&own.geometry().unwrap()).unwrap();
        assert_eq!(adapted, own);
        assert_eq!(own.backlight_change(&adapted), None);
    }

    #[test]
    fn perspective_and_one_sided_views_get_bins_for_all_their_rays() {
        let projection = Projection::Perspective { distance_mm: 800.0 };
        let grid = ViewGrid::uniform(projection, [5, 5], [20.0, 20.0]).unwrap();
        let fanned = FieldGeometry { rows: 50, cols: 80, pitch_mm: 2.961, grid };
        let mut one_sided = fanned.clone();
        one_sided.grid = ViewGrid::uniform(Projection::Oblique, [5, 5], [20.0, 20.0]).unwrap();
        one_sided.grid.slope_x.iter_mut().for_each(|slope| *slope += 0.1);
        for geometry in [fanned.clone(), one_sided] {
            let display = directional().adapted_to(&geometry).unwrap();
            display.check().unwrap();
            assert!(lenslets(&display).views[0] > 5);
            for axis in [0, 1] {
                bins_of_views(&display, &geometry, axis);
            }
        }
        // If bins repeat, as behind a real lens array, perspective views need no additional bins.
        let mut repeated = directional();
        if let Backlight::Lenslets(backlight) = &mut repeated.backlight {
            backlight.outside_bins = OutsideBins::Repeat;
        }
        assert_eq!(lenslets(&repeated.adapted_to(&fanned).unwrap()).views, [5, 5]);
    }

    #[test]
    fn one_view_along_an_axis_takes_one_bin_over_all_its_rays() {
        let grid = ViewGrid { projection: Projection::Oblique, slope_x: vec![-0.1, 0.0, 0.1], slope_y: vec![0.4] };
        let geometry = FieldGeometry { rows: 50, cols: 80, pitch_mm: 2.961, grid };
        let display = directional().adapted_to(&geometry).unwrap();
        display.check().unwrap();
        assert_eq!(lenslets(&display).views, [3, 1]);
        bins_of_views(&display, &geometry, 1);
    }

    #[test]
    fn views_that_no_backlight_can_tell_apart_are_refused_with_the_reason() {
        let projection = Projection::Perspective { distance_mm: 500.0 };
        let grid = ViewGrid::uniform(projection, [17, 17], [2.0, 2.0]).unwrap();
        let geometry = FieldGeometry { rows: 300, cols: 480, pitch_mm: 1.0, grid };
        let error = directional().adapted_to(&geometry).unwrap_err().to_string();
        assert!(
            error.contains("17 views whose slopes are 0.0021 apart") && error.contains("uniform backlight"),
            "{error}"
        );
        assert!(small_display().adapted_to(&geometry).is_ok());
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
