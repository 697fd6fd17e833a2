//! Writes an animated PNG: the views from a viewpoint that swings through the viewing zone.
//!
//! The grid has A_x × A_y views. The viewpoint's position (x, y) is relative to the grid's centre,
//! in units of views. Let φ = 2πt/T at time t of the period T. Then x = (A_x − 1)/2 · sin φ. On an
//! ellipse, y = (A_y − 1)/2 · cos φ. If the viewpoint moves only from side to side, y is 0. After
//! the period the viewpoint is at its start, so the animation loops without a jump.

use std::f64::consts::TAU;
use std::io::BufWriter;

use image::imageops::FilterType;
use image::{ImageBuffer, Rgb};
use lumistack_plugin::display::Transfer;
use lumistack_plugin::encoding::codes8;
use lumistack_plugin::{Host, PluginError};

use crate::encode::png_error;
use crate::views::ViewSource;

/// The path of the viewpoint, and the size of the animation.
pub(crate) struct Swing {
    /// Number of pictures in one period.
    pub(crate) pictures: u32,
    pub(crate) pictures_per_second: u16,
    /// True if the viewpoint also moves up and down, on an ellipse.
    pub(crate) ellipse: bool,
    /// Largest width of the animation, pixels; 0 for the width of the views.
    pub(crate) width: usize,
}

impl Swing {
    /// Returns the viewpoint of every picture, [view_y, view_x] in units of views from the first
    /// view.
    pub(crate) fn path(&self, views: [usize; 2]) -> Vec<[f64; 2]> {
        let half = views.map(|count| (count as f64 - 1.0) / 2.0);
        let place = |i: u32| {
            let phase = TAU * f64::from(i) / f64::from(self.pictures);
            let up = if self.ellipse { phase.cos() } else { 0.0 };
            [half[0] * (1.0 - up), half[1] * (1.0 + phase.sin())]
        };
        (0..self.pictures).map(place).collect()
    }

    /// Returns the animation's size [columns, rows] for views of [rows, cols] pixels.
    pub(crate) fn size(&self, [rows, cols]: [usize; 2]) -> [usize; 2] {
        if self.width == 0 || self.width >= cols {
            return [cols, rows];
        }
        [self.width, ((rows * self.width) as f64 / cols as f64).round().max(1.0) as usize]
    }

    /// Writes the animation with only one picture in memory at a time.
    pub(crate) fn write(&self, host: &Host, path: &str, source: &ViewSource<'_>) -> Result<(), PluginError> {
        let geometry = source.geometry();
        let [rows, cols] = [geometry.rows, geometry.cols];
        let [width, height] = self.size([rows, cols]).map(|side| side as u32);
        let mut file = host.create(path)?;
        let mut writer = BufWriter::new(&mut file);
        let mut encoder = png::Encoder::new(&mut writer, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
        encoder.set_compression(png::Compression::Fast);
        encoder.set_animated(self.pictures, 0).map_err(png_error)?;
        encoder.set_frame_delay(1, self.pictures_per_second).map_err(png_error)?;
        let mut encoder = encoder.write_header().map_err(png_error)?;
        let stage = host.stage("animation", u64::from(self.pictures), "pictures");
        for place in self.path(geometry.grid.views()) {
            host.check_cancelled()?;
            let rgb = reduced(source.between(place)?, [cols, rows], [width, height]);
            encoder.write_image_data(&codes8(&Transfer::Srgb, &rgb)).map_err(png_error)?;
            stage.advance(1, "");
        }
        encoder.finish().map_err(png_error)?;
        let flushed = writer.into_inner().map(drop).map_err(|error| error.into_error());
        flushed.map_err(|error| PluginError::from_io(path, error))?;
        file.commit()
    }
}

/// Reduces a picture of [`cols`, `rows`] pixels to [`width`, `height`] pixels.
pub(crate) fn reduced(rgb: Vec<f32>, [cols, rows]: [usize; 2], [width, height]: [u32; 2]) -> Vec<f32> {
    if [cols, rows] == [width as usize, height as usize] {
        return rgb;
    }
    let picture = ImageBuffer::<Rgb<f32>, _>::from_raw(cols as u32, rows as u32, rgb).expect("values fill the picture");
    image::imageops::resize(&picture, width, height, FilterType::Triangle).into_raw()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_viewer_reaches_both_ends_and_comes_back() {
        let swing = |ellipse| Swing { pictures: 8, pictures_per_second: 24, ellipse, width: 0 };
        let path = swing(false).path([3, 5]);
        let x: Vec<f64> = path.iter().map(|place| (1e6 * place[1]).round() / 1e6).collect();
        assert_eq!(x, [2.0, 3.414_214, 4.0, 3.414_214, 2.0, 0.585_786, 0.0, 0.585_786]);
        assert!(path.iter().all(|place| place[0] == 1.0));
        let path = swing(true).path([3, 5]);
        assert!(path[0][0].abs() < 1e-9 && (path[4][0] - 2.0).abs() < 1e-9, "the path is not from top to bottom");
        assert_eq!(swing(true).path([1, 1]), [[0.0, 0.0]; 8]);
    }

    #[test]
    fn pictures_are_only_reduced() {
        let swing = |width| Swing { pictures: 1, pictures_per_second: 24, ellipse: false, width };
        assert_eq!(
            [0, 840, 841, 420, 1].map(|width| swing(width).size([525, 840])),
            [[840, 525], [840, 525], [840, 525], [420, 263], [1, 1]]
        );
    }
}
