//! Computes the picture of the panel behind a lens array from the emission that the array must
//! show. Source: sections 3.3 and 5.1.2 of the paper.
//!
//! The panel is in the lenses' focal plane. Light of a point at offset u from a lens's axis leaves
//! that lens as a parallel beam of slope
//!
//! ```text
//! s = −u / f
//! ```
//!
//! at every point of the lens. At height h above the axis, a ray arrives with slope (h − u)/f, and
//! the lens adds −h/f. Along each axis, A bins divide the full angle α. In the display model, the
//! light that a lens emits at slope s is the value of bin floor(A/2 · (1 + s / tan(α/2))). In this
//! formula, vertical slopes are positive downwards.
//!
//! A lens is not a whole number of pixels wide (2.54 mm are 8.98 pixels of 0.2827 mm). Therefore
//! the lens and the offset u are computed for every pixel. Coordinates are millimetres in display
//! space, x right, y up, seen from the front.

use lumistack_display::LensletBacklight;

/// A panel behind a lens array. All lengths are lengths of the built device, after calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct LensletPanel {
    /// [columns, rows] of the panel.
    pub resolution: [usize; 2],
    /// Pixel pitch of the panel, millimetres. The panel's centre is on the display's axis.
    pub pitch_mm: f64,
    /// [columns, rows] of lenses.
    pub lenslets: [usize; 2],
    /// Distance between the axes of neighbouring lenses, millimetres.
    pub lens_pitch_mm: f64,
    /// Optical distance in air between panel and lenses, which is the focal length, millimetres.
    pub focal_mm: f64,
    /// Rotation of the array against the panel, counterclockwise seen from the front, degrees.
    pub rotation_deg: f64,
    /// [x, y] of the array's centre, millimetres.
    pub offset_mm: [f64; 2],
    /// [horizontal, vertical] angular bins of the emission.
    pub bins: [usize; 2],
    /// [horizontal, vertical] full angle that all bins of an axis together cover, degrees.
    pub fov_deg: [f64; 2],
}

/// The lens and bin of a point of the panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spot {
    /// [row, column] of the lens, from the top left.
    pub lenslet: [usize; 2],
    /// [row, column] of the angular bin; bin (0, 0) has the topmost and leftmost slopes.
    pub bin: [usize; 2],
}

impl LensletPanel {
    /// Makes the panel behind the lenslet array of a display file. If the file has no measured
    /// focal length, the focal length is p / (2 tan(α/2)). Here p is the backlight's `pitch_mm`,
    /// and α is the bins' horizontal angle. Then the horizontal bins fill a width p of the panel.
    pub fn new(backlight: &LensletBacklight, resolution: [usize; 2], pitch_mm: f64) -> Self {
        let lens = backlight.lens.clone().unwrap_or_default();
        let fitting_mm = backlight.pitch_mm / (2.0 * (0.5 * backlight.fov_deg[0].to_radians()).tan());
        Self {
            resolution,
            pitch_mm,
            lenslets: backlight.lenslets,
            lens_pitch_mm: lens.pitch_mm.unwrap_or(backlight.pitch_mm),
            focal_mm: lens.focal_mm.unwrap_or(fitting_mm),
            rotation_deg: lens.rotation_deg,
            offset_mm: [0, 1].map(|axis| backlight.offset_mm[axis] + lens.offset_mm[axis]),
            bins: backlight.views,
            fov_deg: backlight.fov_deg,
        }
    }

    /// Returns the lens and the bin of the panel's point (x, y), millimetres. Returns `None` if the
    /// point is outside the array, or the slope of its light is outside the bins.
    pub fn spot(&self, [x_mm, y_mm]: [f64; 2]) -> Option<Spot> {
        let (sin, cos) = self.rotation_deg.to_radians().sin_cos();
        let [dx, dy] = [x_mm - self.offset_mm[0], y_mm - self.offset_mm[1]];
        // Compute the coordinates along the array's axes. The coordinate y points down, since rows
        // are numbered from the top.
        let own = [cos * dx + sin * dy, sin * dx - cos * dy];
        let mut lens = [0usize; 2];
        let mut u = [0.0; 2];
        for axis in 0..2 {
            let count = self.lenslets[axis] as f64;
            let position = own[axis] / self.lens_pitch_mm + count / 2.0;
            let index = position.floor();
            if !(index >= 0.0 && index < count) {
                return None;
            }
            lens[axis] = index as usize;
            u[axis] = (position - index - 0.5) * self.lens_pitch_mm;
        }
        // Rotate the offset u back to the display's directions x and y, with y down.
        let u = [cos * u[0] + sin * u[1], cos * u[1] - sin * u[0]];
        let mut bin = [0usize; 2];
        for axis in 0..2 {
            let slope = -u[axis] / self.focal_mm;
            let half_width = (0.5 * self.fov_deg[axis].to_radians()).tan();
            let count = self.bins[axis] as f64;
            let index = (count / 2.0 * (1.0 + slope / half_width)).floor();
            if !(index >= 0.0 && index < count) {
                return None;
            }
            bin[axis] = index as usize;
        }
        Some(Spot { lenslet: [lens[1], lens[0]], bin: [bin[1], bin[0]] })
    }

    /// Returns the panel's picture `[row][col][rgb]` for an emission
    /// `planes[bin_y · bins_x + bin_x][lenslet_row][lenslet_col][rgb]`. A pixel is the mean of
    /// `samples` × `samples` points, which antialiases borders of bins and lenses. With one sample,
    /// the point is the pixel's centre.
    ///
    /// # Panics
    /// If `samples` is 0, or `planes` does not have the shape of the emission.
    pub fn picture(&self, planes: &[Vec<f32>], samples: usize) -> Vec<f32> {
        let [cols, rows] = self.resolution;
        let lens_cols = self.lenslets[0];
        assert!(
            samples > 0 && planes.len() == self.bins[0] * self.bins[1],
            "expected at least one sample, and one plane per bin"
        );
        let mut picture = vec![0.0; 3 * rows * cols];
        let weight = 1.0 / (samples * samples) as f32;
        let point = |i: usize, count: usize, sample: usize| {
            (i as f64 - (count as f64 - 1.0) / 2.0 + (sample as f64 + 0.5) / samples as f64 - 0.5) * self.pitch_mm
        };
        for (row, line) in picture.chunks_exact_mut(3 * cols).enumerate() {
            for (col, rgb) in line.chunks_exact_mut(3).enumerate() {
                for (sy, sx) in (0..samples).flat_map(|sy| (0..samples).map(move |sx| (sy, sx))) {
                    let place = [point(col, cols, sx), -point(row, rows, sy)];
                    let Some(Spot { lenslet, bin }) = self.spot(place) else { continue };
                    let plane = &planes[bin[0] * self.bins[0] + bin[1]];
                    let emitted = &plane[3 * (lenslet[0] * lens_cols + lenslet[1])..][..3];
                    rgb.iter_mut().zip(emitted).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::seed::Stream;
    use lumistack_display::{Backlight, BacklightTap, Display, FieldGeometry, Projection, RayMap, ViewGrid};

    use super::*;

    /// Returns a display with the paper's lens array: 10 lenses per inch, 48°, 5 × 5 bins.
    fn display() -> Display {
        let mut display = Display::uniform([84, 52], 0.5655, [5, 5], [48.0, 48.0], &[0.0], 1);
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-8.5, [18, 11], 2.54, [5, 5], [48.0, 48.0]));
        display
    }

    fn backlight(display: &Display) -> &LensletBacklight {
        let Backlight::Lenslets(backlight) = &display.backlight else { panic!("directional") };
        backlight
    }

    fn panel(display: &Display) -> LensletPanel {
        LensletPanel::new(backlight(display), [168, 105], 0.2827)
    }

    /// Returns random emission, so that every lens and bin has another colour.
    fn planes(panel: &LensletPanel) -> Vec<Vec<f32>> {
        let mut random = Stream::new(3);
        let count = 3 * panel.lenslets[0] * panel.lenslets[1];
        (0..panel.bins[0] * panel.bins[1]).map(|_| (0..count).map(|_| random.next_f32()).collect()).collect()
    }

    #[test]
    fn the_paper_s_figures() {
        let panel = panel(&display());
        assert!((panel.lens_pitch_mm / panel.pitch_mm - 8.98).abs() < 0.005);
        assert!((panel.focal_mm - 2.85).abs() < 0.005);
    }

    /// Compares the picture with an oracle by ray optics. The oracle traces random rays, which
    /// leave the lens array, back through a thin lens to the panel. For most rays, the pixel that
    /// the ray hits must have the ray's value in the display model.
    #[test]
    fn traced_rays_agree_with_the_display_model() {
        let display = display();
        for (rotation_deg, offset_mm, pitch_factor, focal_factor) in
            [(0.0, [0.0, 0.0], 1.0, 1.0), (0.7, [0.0, 0.0], 1.0, 1.0), (-1.3, [0.31, -0.77], 1.002, 0.97)]
        {
            let nominal = panel(&display);
            let built = LensletPanel {
                // The pixels are small, since pixels on the borders of bins may differ from the
                // exact trace.
                resolution: [168 * 4, 105 * 4],
                pitch_mm: 0.2827 / 4.0,
                rotation_deg,
                offset_mm,
                lens_pitch_mm: pitch_factor * nominal.lens_pitch_mm,
                focal_mm: focal_factor * nominal.focal_mm,
                ..nominal
            };
            let planes = planes(&built);
            let picture = built.picture(&planes, 1);
            let angle = rotation_deg.to_radians();
            let turned = |x: f64, y: f64| {
                [offset_mm[0] + x * angle.cos() - y * angle.sin(), offset_mm[1] + x * angle.sin() + y * angle.cos()]
            };
            let mut random = Stream::new(9);
            let (mut same, mut all) = (0, 0);
            while all < 20_000 {
                let lens = [(random.next_u64() % 18) as usize, (random.next_u64() % 11) as usize];
                let axis = |i: usize, count: usize| (i as f64 - (count as f64 - 1.0) / 2.0) * built.lens_pitch_mm;
                let centre = turned(axis(lens[0], 18), -axis(lens[1], 11));
                let height = [0, 1].map(|_| (f64::from(random.next_f32()) - 0.5) * built.lens_pitch_mm);
                let slope = [0, 1].map(|_| (2.0 * f64::from(random.next_f32()) - 1.0) * 24f64.to_radians().tan());
                // A thin lens changes slopes: slope before = slope after + height / f. Follow the
                // ray from the lens to the panel.
                let on_panel = [0, 1].map(|i| {
                    let before = slope[i] + height[i] / built.focal_mm;
                    centre[i] + height[i] - before * built.focal_mm
                });
                let col = (on_panel[0] / built.pitch_mm + (built.resolution[0] as f64 - 1.0) / 2.0).round();
                let row = ((built.resolution[1] as f64 - 1.0) / 2.0 - on_panel[1] / built.pitch_mm).round();
                if !(col >= 0.0 && row >= 0.0 && col < built.resolution[0] as f64 && row < built.resolution[1] as f64) {
                    continue;
                }
                // Skip a ray that hits the panel behind a neighbouring lens, since the pixel there
                // belongs to that lens.
                let u = [0, 1].map(|i| on_panel[i] - centre[i]);
                let own = [u[0] * angle.cos() + u[1] * angle.sin(), u[1] * angle.cos() - u[0] * angle.sin()];
                if own.iter().any(|u| u.abs() > 0.5 * built.lens_pitch_mm) {
                    continue;
                }
                let bin = |slope: f64| (5.0 * (slope / 24f64.to_radians().tan() + 1.0) / 2.0) as usize;
                let expected = &planes[5 * bin(-slope[1]) + bin(slope[0])][3 * (18 * lens[1] + lens[0])..][..3];
                let found = &picture[3 * (row as usize * built.resolution[0] + col as usize)..][..3];
                same += usize::from(expected == found);
                all += 1;
            }
            let share = same as f64 / all as f64;
            println!("{rotation_deg}°, {offset_mm:?}: {share:.4} of the rays");
            // A bin is about 7 pixels of this panel wide on both axes. A ray near a bin's border
            // may hit a pixel whose centre is in the next bin. This pixel has the value of the
            // next bin.
            assert!(share > 0.85, "{share}");
        }
    }

    /// Take a ray from a pixel's centre through the centre of its lens. The display model's tables
    /// must give this ray the same lenslet and angular bin as `panel.spot`.
    #[test]
    fn the_display_s_tables_agree_at_every_pixel() {
        let display = display();
        let (panel, backlight) = (panel(&display), backlight(&display));
        let [cols, rows] = panel.resolution;
        let mut lit = 0;
        for (row, col) in (0..rows).step_by(7).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let x = (col as f64 - (cols as f64 - 1.0) / 2.0) * panel.pitch_mm;
            let y = ((rows as f64 - 1.0) / 2.0 - row as f64) * panel.pitch_mm;
            let Some(spot) = panel.spot([x, y]) else { continue };
            let centre = [
                (spot.lenslet[1] as f64 - 8.5) * panel.lens_pitch_mm,
                (5.0 - spot.lenslet[0] as f64) * panel.lens_pitch_mm,
            ];
            let slope = [(centre[0] - x) / panel.focal_mm, (centre[1] - y) / panel.focal_mm];
            // shift the array so that the ray through the lens's centre hits the only pixel of a
            // light field on the display plane
            let here = [0, 1].map(|i| centre[i] - backlight.d_mm * slope[i]);
            let single = Display {
                backlight: Backlight::Lenslets(LensletBacklight {
                    offset_mm: [-here[0], -here[1]],
                    ..backlight.clone()
                }),
                ..display.clone()
            };
            let field =
                FieldGeometry { rows: 1, cols: 1, pitch_mm: 1.0, grid: ViewGrid::single(Projection::Oblique, slope) };
            let map = RayMap::new(&single, &field).backlight.unwrap();
            let lit_by = |lenslet: usize, bin: usize| BacklightTap::Lit { lenslet: lenslet as u32, bin: bin as u32 };
            assert_eq!(map.x(0)[0], lit_by(spot.lenslet[1], spot.bin[1]), "{row} {col}");
            assert_eq!(map.y(0)[0], lit_by(spot.lenslet[0], spot.bin[0]), "{row} {col}");
            lit += 1;
        }
        assert!(lit > 1500, "expected more than 1500 pixels behind a lens, found {lit}");
    }

    #[test]
    fn light_on_a_border_is_shared() {
        let panel = panel(&display());
        let even = vec![vec![0.4; 3 * 18 * 11]; 25];
        let (centres, means) = (panel.picture(&even, 1), panel.picture(&even, 4));
        let inner = 3 * (52 * 168 + 84);
        assert_eq!(centres[inner], 0.4);
        assert!((means[inner] - 0.4).abs() < 1e-6);
        assert!(means.iter().all(|&value| (0.0..=0.400_001).contains(&value)));
    }
}
