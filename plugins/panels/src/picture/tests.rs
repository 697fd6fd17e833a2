use lumistack_plugin::core::seed::Stream;
use lumistack_plugin::display::{Channels, Flip, Formation, Layer, Panel};

use super::*;

fn display() -> Display {
    let mut display = Display::uniform([7, 5], 1.0, [1, 1], [10.0, 10.0], &[-4.0, 4.0], 3);
    display.layers[0].transfer = Transfer::gamma(2.2);
    display
}

fn noise(display: &Display) -> LayerStack {
    let mut stack = LayerStack::filled(display, 0.0);
    let mut random = Stream::new(8);
    let data =
        stack.layers.iter_mut().map(|layer| layer.data_mut()).chain(stack.emission.as_mut().map(|e| e.data_mut()));
    data.flatten().for_each(|value| *value = random.next_f32());
    stack
}

/// Returns the code of a value by the definition in the documentation of the display. This is the
/// oracle of the tests.
fn code(layer: &Layer, channel: usize, value: f32) -> u8 {
    let [low, high] = layer.range();
    let driven = ((value - low) / (high - low)).clamp(0.0, 1.0);
    (layer.transfer.encode(channel, driven) * 255.0).round() as u8
}

fn pixel(codes: &[u8], cols: usize, row: usize, col: usize) -> [u8; 3] {
    codes[4 * (row * cols + col)..][..3].try_into().unwrap()
}

#[test]
fn a_panel_of_twice_the_pixels_shows_every_mask_pixel_as_four() {
    let mut display = display();
    display.layers[0].panel_pitch_mm = Some(0.5);
    let stack = noise(&display);
    let picture = Picture::new(&display, Shows::Layer(0), [20, 12]);
    for frame in 0..3 {
        let codes = picture.codes(&stack, frame, None);
        assert_eq!(codes.len(), 4 * 20 * 12);
        for (row, col) in (0..12).flat_map(|row| (0..20).map(move |col| (row, col))) {
            let found = pixel(&codes, 20, row, col);
            // The mask covers 14 × 10 panel pixels in the centre of the 20 × 12 pixels of the
            // panel.
            let inside = (1..11).contains(&row) && (3..17).contains(&col);
            let expected = if inside {
                let value = stack.layers[0].block([frame, (row - 1) / 2, (col - 3) / 2]);
                [0, 1, 2].map(|c| code(&display.layers[0], c, value[c]))
            } else {
                [0; 3]
            };
            assert_eq!(found, expected, "frame {frame}, row {row}, column {col}");
        }
    }
}

#[test]
fn equal_pitch_never_doubles_or_skips_a_pixel() {
    // The mask has an odd number of columns and the output an even number. So every output pixel is
    // half-way between two mask pixels. The pitch is no binary fraction, so positions have rounding
    // errors.
    let mut display = Display::uniform([161, 3], 0.3, [1, 1], [10.0, 10.0], &[0.0], 1);
    display.layers[0].transfer = Transfer::Linear;
    let mut stack = LayerStack::filled(&display, 0.0);
    for (i, value) in stack.layers[0].data_mut().iter_mut().enumerate() {
        *value = (i / 3 % 161) as f32 / 255.0;
    }
    let codes = Picture::new(&display, Shows::Layer(0), [400, 4]).codes(&stack, 0, None);
    let line: Vec<u8> = codes[4 * 400..8 * 400].chunks_exact(4).map(|rgba| rgba[0]).collect();
    let first = line.iter().position(|code| *code == 1).unwrap() - 1;
    assert!(line[first..first + 161].iter().copied().eq(0..161), "{line:?}");
}

#[test]
fn turned_and_mirrored_panels_show_the_same_pixels_elsewhere() {
    let mut display = display();
    let stack = noise(&display);
    let upright = Picture::new(&display, Shows::Layer(1), [7, 5]).codes(&stack, 1, None);
    for (rotate_deg, flip) in [(90, Flip::None), (180, Flip::Horizontal), (270, Flip::Vertical)] {
        display.layers[1].panel = Some(Panel { rotate_deg, flip, ..Panel::default() });
        let output = if rotate_deg == 180 { [7, 5] } else { [5, 7] };
        let place = Place::new(&display, Shows::Layer(1), output);
        let found = Picture::new(&display, Shows::Layer(1), output).codes(&stack, 1, None);
        for (i, at) in pixels(output).enumerate() {
            let [u, v] = place.upright(at).map(|at| at as usize);
            assert_eq!(found[4 * i..][..3], pixel(&upright, 7, v, u), "{rotate_deg} {flip:?} {at:?}");
        }
    }
}

#[test]
fn limits_of_the_panel_and_beside_it() {
    let mut display = display();
    let layer = &mut display.layers[1];
    (layer.peak, layer.black_level) = (0.8, 0.05);
    layer.transfer = Transfer::Gamma(Channels::Rgb([2.0, 2.2, 2.4]));
    let mut stack = noise(&display);
    stack.layers[1].data_mut()[..3].copy_from_slice(&[0.0, 0.8, 1.0]);
    let codes = Picture::new(&display, Shows::Layer(1), [9, 5]).codes(&stack, 0, None);
    assert_eq!(pixel(&codes, 9, 0, 1), [0, 255, 255]);
    assert_eq!(pixel(&codes, 9, 0, 0), [0; 3]);
    for (row, col) in (0..5).flat_map(|row| (0..7).map(move |col| (row, col))) {
        let value = stack.layers[1].block([0, row, col]);
        assert_eq!(pixel(&codes, 9, row, col + 1), [0, 1, 2].map(|c| code(&display.layers[1], c, value[c])));
    }
    display.missing = Missing::Clear;
    assert_eq!(pixel(&Picture::new(&display, Shows::Layer(1), [9, 5]).codes(&stack, 0, None), 9, 0, 0), [255; 3]);
    display.formation = Formation::Additive;
    assert_eq!(pixel(&Picture::new(&display, Shows::Layer(1), [9, 5]).codes(&stack, 0, None), 9, 0, 0), [0; 3]);
    // A panel of two bits has four codes. They must be evenly spread over the output's codes.
    display.layers[1].bits = Some(2);
    display.layers[1].transfer = Transfer::Linear;
    let codes = Picture::new(&display, Shows::Layer(1), [7, 5]).codes(&stack, 0, None);
    assert!(codes.chunks_exact(4).flat_map(|rgba| &rgba[..3]).all(|code| [0, 85, 170, 255].contains(code)));
}

#[test]
fn crosstalk_that_the_patterns_do_not_know_is_made_up_for() {
    let mut display = display();
    display.layers[0].transfer = Transfer::Linear;
    let mix = [[0.9, 0.1, 0.0], [0.05, 0.9, 0.05], [0.0, 0.1, 0.9]];
    display.layers[0].panel = Some(Panel { crosstalk: Some(mix), ..Panel::default() });
    let mut stack = noise(&display);
    // The values must be in the range in which the panel can compensate the crosstalk.
    stack.layers[0].data_mut().iter_mut().for_each(|value| *value = 0.3 + 0.4 * *value);
    let codes = Picture::new(&display, Shows::Layer(0), [7, 5]).codes(&stack, 2, None);
    for (i, wanted) in stack.layers[0].block([2]).chunks_exact(3).enumerate() {
        let shown = [0, 1, 2].map(|c| f64::from(codes[4 * i + c]) / 255.0);
        for c in 0..3 {
            let emitted: f64 = (0..3).map(|k| mix[c][k] * shown[k]).sum();
            // The tolerance is half a code per channel.
            assert!((emitted - f64::from(wanted[c])).abs() < 0.5 / 255.0 + 1e-4, "{i} {c}");
        }
    }
}

#[test]
fn a_colour_in_turn_is_shown_by_all_channels() {
    let display = display();
    let stack = noise(&display);
    let picture = Picture::new(&display, Shows::Layer(0), [7, 5]);
    let together = picture.codes(&stack, 1, None);
    for channel in 0..3 {
        let alone = picture.codes(&stack, 1, Some(channel));
        for (alone, together) in alone.chunks_exact(4).zip(together.chunks_exact(4)) {
            assert_eq!(alone[..3], [together[channel]; 3]);
        }
    }
}

#[test]
fn bilinear_reading_mixes_light_and_not_codes() {
    let mut display = display();
    display.layers[0].panel = Some(Panel { resample: Sampling::Bilinear, nudge_px: [0.25, -0.5], ..Panel::default() });
    let stack = noise(&display);
    let codes = Picture::new(&display, Shows::Layer(0), [7, 5]).codes(&stack, 0, None);
    let value = |row: usize, col: usize, c: usize| stack.layers[0].block([0, row, col])[c];
    for (row, col) in (0..4).flat_map(|row| (1..7).map(move |col| (row, col))) {
        // Relative to the centre of mask pixel (row, col), the output pixel is a quarter of a mask
        // pixel further left. It is also half a mask pixel lower.
        let expected = [0, 1, 2].map(|c| {
            let line = |row| 0.25 * value(row, col - 1, c) + 0.75 * value(row, col, c);
            0.5 * line(row) + 0.5 * line(row + 1)
        });
        for c in 0..3 {
            let found = pixel(&codes, 7, row, col)[c];
            let expected = code(&display.layers[0], c, expected[c]);
            assert!(found.abs_diff(expected) <= 1, "{row} {col}: {found}, expected {expected}");
        }
    }
}

#[test]
fn the_panel_behind_the_lenses_agrees_with_the_lens_model() {
    let mut display = Display::uniform([20, 12], 1.0, [3, 3], [40.0, 40.0], &[0.0], 2);
    let mut backlight = LensletBacklight::new(-8.0, [5, 3], 4.0, [3, 3], [40.0, 40.0]);
    backlight.transfer = Transfer::Linear;
    (backlight.panel_resolution, backlight.panel_pitch_mm) = (Some([63, 41]), Some(0.31));
    display.backlight = Backlight::Lenslets(backlight.clone());
    let stack = noise(&display);
    let emission = stack.emission.as_ref().unwrap();
    let lenses = LensletPanel::new(&backlight, [63, 41], 0.31);
    let picture = Picture::new(&display, Shows::Backlight, [63, 41]);
    for frame in 0..2 {
        let planes: Vec<Vec<f32>> = (0..9).map(|bin| emission.block([frame, bin / 3, bin % 3]).to_vec()).collect();
        let expected = lenses.picture(&planes, LENS_SAMPLES);
        let codes = picture.codes(&stack, frame, None);
        for (found, expected) in codes.chunks_exact(4).zip(expected.chunks_exact(3)) {
            for c in 0..3 {
                assert!((f32::from(found[c]) - 255.0 * expected[c]).abs() <= 0.501, "{found:?} {expected:?}");
            }
        }
    }
}
