//! The 2D mode at full resolution: one panel shows a picture with all its pixels, and the other
//! panels are clear. Source: section 5.1.2 of the paper.
//!
//! The picture keeps its aspect ratio, and has the largest size that fits into the field. A panel
//! pixel takes a weighted mean of the linear light of the picture pixels that it covers. If picture
//! pixels are larger than panel pixels, a panel pixel interpolates between four picture pixels.

use image::Rgb32FImage;
use image::imageops::{FilterType, resize};
use lumistack_plugin::core::colour::srgb_decode;
use lumistack_plugin::display::{Display, Formation, LayerStack};

use crate::{Picture, Place, Shows};

/// Returns the codes `[row][col][red, green, blue, 255]` of one panel in the 2D mode. The panel
/// shows `picture`, which has sRGB codes; without a picture the panel is clear. A panel behind
/// lenslets is lit evenly.
pub fn flat_codes(display: &Display, shows: Shows, output: [usize; 2], picture: Option<&image::RgbImage>) -> Vec<u8> {
    let (neutral, field) = (display.formation.neutral(), &display.field);
    let Some(picture) = picture else {
        let one = Display { frames: 1, ..display.clone() };
        let mut stack = LayerStack::filled(&one, neutral);
        stack.emission.iter_mut().for_each(|emission| emission.data_mut().fill(1.0));
        return Picture::new(&one, shows, output).codes(&stack, 0, None);
    };
    let Shows::Layer(n) = shows else { return flat_codes(display, shows, output, None) };
    // Make a mask with one pixel per panel pixel over the field's area. `Picture` then computes the
    // codes.
    let place = Place::new(display, shows, output);
    let [cols, rows] =
        field.resolution.map(|count| ((count as f64 * field.pitch_mm / place.pitch_mm).round() as usize).max(1));
    let scale = (cols as f64 / f64::from(picture.width())).min(rows as f64 / f64::from(picture.height()));
    let [width, height] =
        [picture.width(), picture.height()].map(|count| ((f64::from(count) * scale).round() as u32).max(1));
    // Resample in linear light.
    let linear = Rgb32FImage::from_fn(picture.width(), picture.height(), |x, y| {
        image::Rgb(picture.get_pixel(x, y).0.map(|code| srgb_decode(f32::from(code) / 255.0)))
    });
    let fitted = resize(&linear, width, height, FilterType::Triangle);
    // Reduce the display to layer `n`, at panel resolution.
    let mut one = Display { frames: 1, ..display.clone() };
    one.layers.truncate(n + 1);
    one.layers.drain(..n);
    one.backlight = Default::default();
    let layer = &mut one.layers[0];
    (layer.resolution, layer.pitch_mm, layer.panel_pitch_mm) = ([cols, rows], place.pitch_mm, Some(place.pitch_mm));
    let [low, high] = layer.range();
    let crossed = display.formation == Formation::Polarization;
    let mut stack = LayerStack::filled(&one, low);
    let (left, top) = ((cols - width as usize) / 2, (rows - height as usize) / 2);
    for (x, y, pixel) in fitted.enumerate_pixels() {
        let value = stack.layers[0].block_mut([0, top + y as usize, left + x as usize]);
        for (value, light) in value.iter_mut().zip(pixel.0) {
            let light = light.clamp(0.0, 1.0);
            // crossed polarizers transmit sin² of the rotation
            let shown = if crossed { light.sqrt().asin() * std::f32::consts::FRAC_2_PI } else { light };
            // map 0..1 to the panel's range, from black to white
            *value = low + shown * (high - low);
        }
    }
    Picture::new(&one, Shows::Layer(0), output).codes(&stack, 0, None)
}

#[cfg(test)]
mod tests {
    use lumistack_plugin::display::{Backlight, LensletBacklight, Transfer};

    use super::*;

    #[test]
    fn one_panel_shows_every_pixel_of_a_picture_and_the_others_are_clear() {
        // The masks have half the panel's resolution, which the 2D mode must not use.
        let mut display = Display::uniform([8, 6], 1.0, [1, 1], [10.0, 10.0], &[-4.0, 0.0], 3);
        for layer in &mut display.layers {
            (layer.panel_pitch_mm, layer.panel_resolution) = (Some(0.5), Some([16, 12]));
        }
        let picture =
            image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([(16 * x) as u8, (20 * y) as u8, (x * y) as u8]));
        let shown = flat_codes(&display, Shows::Layer(1), [16, 12], Some(&picture));
        let expected: Vec<u8> = picture.pixels().flat_map(|p| [p.0[0], p.0[1], p.0[2], 255]).collect();
        assert_eq!(shown, expected, "the panel has the picture's transfer function, so codes stay as they are");
        assert!(flat_codes(&display, Shows::Layer(0), [16, 12], None).iter().all(|code| *code == 255));
        // A picture with another aspect ratio is centred, between dark rows.
        let wide = image::RgbImage::from_pixel(16, 4, image::Rgb([200; 3]));
        let shown = flat_codes(&display, Shows::Layer(1), [16, 12], Some(&wide));
        let rows: Vec<u8> = shown.chunks_exact(4 * 16).map(|row| row[4 * 5]).collect();
        assert_eq!(rows, [0, 0, 0, 0, 200, 200, 200, 200, 0, 0, 0, 0]);
    }

    #[test]
    fn the_panel_behind_lenses_is_lit_evenly() {
        let mut display = Display::uniform([8, 6], 1.0, [3, 3], [40.0, 40.0], &[0.0], 2);
        let mut backlight = LensletBacklight::new(-3.0, [2, 2], 4.0, [3, 3], [40.0, 40.0]);
        backlight.transfer = Transfer::Linear;
        display.backlight = Backlight::Lenslets(backlight);
        let codes = flat_codes(&display, Shows::Backlight, [8, 6], None);
        assert!(codes.iter().all(|code| *code == 255), "{codes:?}");
    }
}
