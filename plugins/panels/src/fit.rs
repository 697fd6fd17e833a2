//! Compares mask sizes with panel sizes, and scales masks to panels of other sizes.
//!
//! Along an axis a mask has W pixels of pitch p, and its panel, turned upright, has w pixels. If
//! the panel's pixels have the pitch s, the mask covers W·p / s panel pixels. All masks fit if all
//! panels are assumed to have the pitch
//!
//! ```text
//! s = max over panels and axes of W·p / w
//! ```
//!
//! If a pixel of the finest mask covers at least one panel pixel, s is then raised until the mask
//! pixel covers a whole number of panel pixels. On panels of the real pitch r, the scene appears
//! scaled by r / s. The parallax is right only if the distances between the panels are also scaled
//! by r / s.

use lumistack_plugin::display::{Backlight, Display};

use crate::assign::Output;
use crate::{Place, Shows};

/// Returns [columns, rows] of panel pixels that the mask covers. Also returns [columns, rows] of
/// the panel after it is turned upright; with a crop, of the cropped region.
pub fn cover(display: &Display, shows: Shows, output: [usize; 2]) -> ([f64; 2], [f64; 2]) {
    let place = Place::new(display, shows, output);
    let ([cols, rows], pitch_mm) = match (shows, &display.backlight) {
        (Shows::Backlight, Backlight::Lenslets(backlight)) => (backlight.lenslets, backlight.pitch_mm),
        (Shows::Backlight, Backlight::Uniform) => ([0, 0], 1.0),
        (Shows::Layer(n), _) => (display.layers[n].resolution, display.layers[n].pitch_mm),
    };
    let there = place.crop().map_or(place.upright_size(), |[_, _, cols, rows]| [cols, rows]);
    ([cols, rows].map(|count| count as f64 * pitch_mm / place.pitch_mm), there.map(|count| count as f64))
}

/// Returns one message for every mismatch between a display and the outputs assigned to its panels.
pub fn misfits(display: &Display, assigned: &[(Shows, Output)]) -> Vec<String> {
    let mut found = Vec::new();
    for (shows, Output { name, size, .. }) in assigned {
        let (key, declared) = match (shows, &display.backlight) {
            (Shows::Layer(n), _) => (format!("layers[{n}]"), display.layers[*n].panel_resolution),
            (_, Backlight::Lenslets(backlight)) => ("backlight".into(), backlight.panel_resolution),
            _ => continue,
        };
        // The declared resolution must equal the output's size.
        if let Some(declared) = declared.filter(|declared| declared != size) {
            found.push(format!(
                "{key}.panel_resolution: expected the {} × {} pixels of output {name}, found {} × {}; check that {name} is the right output, and that {name} runs at the native resolution of its panel",
                size[0], size[1], declared[0], declared[1]
            ));
        }
        // Warn if the mask exceeds the panel on an axis, or covers less than half of the panel on
        // both axes.
        let (covers, there) = cover(display, *shows, *size);
        let text = format!(
            "{shows} covers {:.0} × {:.0} pixels, and output {name} has {} × {} pixels",
            covers[0], covers[1], there[0], there[1]
        );
        // Allow an excess of one panel pixel, which comes from rounding. For a lens array allow an
        // excess of one lens, since the outer lenses may be cut off.
        let slack = match (shows, &display.backlight) {
            (Shows::Backlight, Backlight::Lenslets(backlight)) => covers[0] / backlight.lenslets[0].max(1) as f64,
            _ => 1.0,
        };
        if (0..2).any(|axis| covers[axis] > there[axis] + slack) {
            found.push(format!(
                "{text}, so a part of the mask is not shown. Check panel_pitch_mm, the pitch of the panel's pixels; or use --fit, which scales the masks until all of them fit"
            ));
        } else if (0..2).all(|axis| covers[axis] < 0.5 * there[axis]) {
            found.push(format!(
                "{text}. Check panel_pitch_mm, the pitch of the panel's pixels; or use --fit, which enlarges the masks"
            ));
        }
    }
    // All outputs should have the same refresh rate, within 1 %.
    let rates = assigned.iter().filter_map(|(_, output)| Some((output.refresh_hz?, &output.name)));
    let slowest = rates.clone().min_by(|a, b| a.0.total_cmp(&b.0));
    let fastest = rates.max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((slow, fast)) = slowest.zip(fastest).filter(|(slow, fast)| fast.0 > 1.01 * slow.0) {
        found.push(format!(
            "output {} refreshes at {:.2} Hz and output {} at {:.2} Hz. All panels show new frames at the slower rate, so frame durations on the faster output vary",
            slow.1, slow.0, fast.1, fast.0
        ));
    }
    found
}

/// Returns the display with one panel pitch for all panels, so that every mask fits. Also returns
/// this pitch, millimetres.
pub fn fitted(display: &Display, assigned: &[(Shows, Output)]) -> (Display, f64) {
    let wanted = assigned.iter().map(|(shows, output)| {
        let (covers, there) = cover(display, *shows, output.size);
        let pitch_mm = Place::new(display, *shows, output.size).pitch_mm;
        pitch_mm * (covers[0] / there[0]).max(covers[1] / there[1])
    });
    // Compute the smallest pitch with which every mask fits its panel.
    let mut pitch_mm = wanted.fold(0.0, f64::max);
    // Raise the pitch until a pixel of the finest mask covers a whole number of panel pixels.
    let finest = display.layers.iter().map(|layer| layer.pitch_mm).fold(f64::INFINITY, f64::min);
    let whole = (finest / pitch_mm + 1e-9).floor();
    if whole >= 1.0 {
        pitch_mm = finest / whole;
    }
    let mut display = display.clone();
    // Remove the homographies, since they hold for the real pitches of the panels.
    for layer in &mut display.layers {
        layer.panel_pitch_mm = Some(pitch_mm);
        layer.panel.iter_mut().for_each(|panel| panel.homography = None);
    }
    if let Backlight::Lenslets(backlight) = &mut display.backlight {
        backlight.panel_pitch_mm = Some(pitch_mm);
        backlight.panel.iter_mut().for_each(|panel| panel.homography = None);
    }
    (display, pitch_mm)
}

#[cfg(test)]
mod tests {
    use lumistack_plugin::display::{LayerStack, LensletBacklight, Panel};

    use super::*;
    use crate::Picture;

    fn outputs(sizes: &[[usize; 2]]) -> Vec<(Shows, Output)> {
        let output = |(n, size): (usize, &[usize; 2])| {
            let name = format!("O{n}");
            (Shows::Layer(n), Output { name, position: [0, 0], size: *size, refresh_hz: Some(60.0) })
        };
        sizes.iter().enumerate().map(output).collect()
    }

    #[test]
    fn masks_fill_the_smallest_panel_by_whole_pixels() {
        let display = Display::uniform([10, 6], 4.0, [1, 1], [10.0, 10.0], &[0.0, 5.0], 1);
        let outputs = outputs(&[[64, 48], [55, 30]]);
        // The smallest panel has room for 55 / 10 panel pixels per mask pixel across, and for 30 /
        // 6 down. The smaller number is five.
        let (display, pitch_mm) = fitted(&display, &outputs);
        assert_eq!(pitch_mm, 4.0 / 5.0);
        for (shows, output) in &outputs {
            let codes = Picture::new(&display, *shows, output.size).codes(&LayerStack::filled(&display, 1.0), 0, None);
            assert_eq!(codes.chunks_exact(4).filter(|code| code[0] == 255).count(), 50 * 30);
        }
        assert!(misfits(&display, &outputs).is_empty());
    }

    #[test]
    fn masks_larger_than_a_panel_are_made_smaller() {
        let display = Display::uniform([100, 60], 1.0, [1, 1], [10.0, 10.0], &[0.0], 1);
        let outputs = outputs(&[[40, 30]]);
        let found = misfits(&display, &outputs);
        assert!(
            found[0].starts_with("layer 0 covers 100 × 60 pixels, and output O0 has 40 × 30 pixels, so a part"),
            "{found:?}"
        );
        let (display, pitch_mm) = fitted(&display, &outputs);
        assert_eq!((pitch_mm, cover(&display, Shows::Layer(0), [40, 30])), (2.5, ([40.0, 24.0], [40.0, 30.0])));
        assert!(misfits(&display, &outputs).is_empty());
    }

    #[test]
    fn rotated_and_cropped_panels_count_by_their_remaining_part() {
        let mut display = Display::uniform([10, 6], 1.0, [1, 1], [10.0, 10.0], &[0.0], 1);
        display.layers[0].panel = Some(Panel { rotate_deg: 90, ..Panel::default() });
        assert_eq!(cover(&display, Shows::Layer(0), [60, 100]).1, [100.0, 60.0]);
        display.layers[0].panel.as_mut().unwrap().crop = Some([10, 0, 50, 60]);
        assert_eq!(fitted(&display, &outputs(&[[60, 100]])).1, 0.2);
    }

    #[test]
    fn mismatches_cause_warnings() {
        let mut display = Display::uniform([30, 20], 1.0, [1, 1], [10.0, 10.0], &[0.0, 5.0], 1);
        display.layers[1].panel_resolution = Some([30, 20]);
        let mut outputs = outputs(&[[100, 80], [40, 30]]);
        outputs[1].1.refresh_hz = Some(75.0);
        let found = misfits(&display, &outputs);
        assert_eq!(found.len(), 3, "{found:?}");
        assert!(
            found[0].starts_with("layer 0 covers 30 × 20 pixels, and output O0 has 100 × 80 pixels. Check"),
            "{found:?}"
        );
        assert!(
            found[1].starts_with("layers[1].panel_resolution: expected the 40 × 30 pixels of output O1, found 30 × 20")
        );
        assert!(found[2].starts_with("output O0 refreshes at 60.00 Hz and output O1 at 75.00 Hz"), "{found:?}");
    }

    #[test]
    fn a_panel_behind_lenses_is_fitted_with_the_layers() {
        let mut display = Display::uniform([40, 30], 1.0, [3, 3], [20.0, 20.0], &[0.0], 1);
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-8.0, [21, 16], 2.0, [3, 3], [20.0, 20.0]));
        let mut outputs = outputs(&[[100, 90], [100, 90]]);
        (outputs[0].0, outputs[1].0) = (Shows::Backlight, Shows::Layer(0));
        let (display, pitch_mm) = fitted(&display, &outputs);
        // The 21 lenslets are 42 mm wide, so 100 panel pixels need a pitch of 0.42 mm. The pitch is
        // raised to 0.5 mm, with which a mask pixel of 1 mm covers two panel pixels.
        assert_eq!(pitch_mm, 0.5);
        let Backlight::Lenslets(backlight) = &display.backlight else { unreachable!() };
        assert_eq!(
            (backlight.panel_pitch_mm, cover(&display, Shows::Backlight, [100, 90]).0),
            (Some(0.5), [84.0, 64.0])
        );
    }
}
