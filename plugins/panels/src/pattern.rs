//! Test patterns for panels.
//!
//! The crosshair array (section 5.1 of the paper) is a grid of crosses on the display plane. Every
//! layer draws the array in perspective for an eye e at the viewing distance D. If the layers are
//! aligned, the crosses of all layers coincide for this eye. On the layer at distance d, the point
//! P of the plane z = 0 is drawn at q:
//!
//! ```text
//! q = e + (P − e) · (D − d) / D        so        P = e + (q − e) · D / (D − d)
//! ```
//!
//! The crosses of neighbouring layers transmit different ones of red, green and blue. So where
//! crosses of different colours coincide on attenuating layers, they are black.

use std::str::FromStr;

use lumistack_plugin::display::{Backlight, Display, Formation, LayerStack};
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use thiserror::Error;

use crate::picture::pixels;
use crate::{Picture, Place, Shows};

/// A test pattern for the panels of a display.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// Crosses on every layer, which coincide for one eye position.
    Crosshairs,
    /// Equal steps of linear light in grey, red, green and blue, by the declared transfer function.
    Ramp,
    /// One RGB code in all pixels, which is sent unchanged. It serves to measure transfer
    /// functions.
    Code([u8; 3]),
    /// Light from all bins of one lenslet, [column, row].
    Lenslet([usize; 2]),
    /// Light from one angular bin, [x, y], of all lenslets.
    View([usize; 2]),
    /// All layers are clear.
    Clear,
    /// Each panel shows its own name as text.
    Identify,
}

/// The text is not a pattern, or the pattern does not match the display.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("pattern: expected {expected}, found {found}")]
pub struct PatternError {
    /// The expected text or range.
    pub expected: String,
    /// The invalid text or value.
    pub found: String,
}

/// The texts of all patterns, for messages.
pub const PATTERNS: &str = "crosshairs, ramp, code=V, code=R,G,B, lenslet=COLUMN,ROW, view=X,Y, clear or identify";

impl FromStr for Pattern {
    type Err = PatternError;

    fn from_str(text: &str) -> Result<Self, PatternError> {
        let (word, numbers) = text.split_once('=').unwrap_or((text, ""));
        let numbers: Option<Vec<usize>> = if numbers.is_empty() {
            Some(Vec::new())
        } else {
            numbers.split(',').map(|n| n.trim().parse().ok()).collect()
        };
        let code = |n: usize| u8::try_from(n).ok();
        let pattern = match (word, numbers.as_deref()) {
            ("crosshairs", Some([])) => Some(Self::Crosshairs),
            ("ramp", Some([])) => Some(Self::Ramp),
            ("clear", Some([])) => Some(Self::Clear),
            ("identify", Some([])) => Some(Self::Identify),
            ("code", Some(&[all])) => code(all).map(|all| Self::Code([all; 3])),
            ("code", Some(&[r, g, b])) => code(r).zip(code(g)).zip(code(b)).map(|((r, g), b)| Self::Code([r, g, b])),
            ("lenslet", Some(&[col, row])) => Some(Self::Lenslet([col, row])),
            ("view", Some(&[x, y])) => Some(Self::View([x, y])),
            _ => None,
        };
        pattern.ok_or_else(|| PatternError { expected: PATTERNS.into(), found: text.into() })
    }
}

/// Distance between crosses as a fraction of the field's width.
const SPACING: f64 = 0.125;
/// Length of a cross's arm, in units of the distance between crosses.
const ARM: f64 = 0.3;
/// Half the width of a cross's lines, panel pixels.
const HALF_LINE_PX: f64 = 1.5;
/// Offset of the disc that marks the central cross, to the right and upwards from the cross. The
/// unit is the distance between crosses.
const MARK: f64 = 0.22;
/// Radius of the disc at [`MARK`], in units of the distance between crosses.
const MARK_RADIUS: f64 = 0.07;
/// Number of steps of a ramp.
const STEPS: usize = 33;

/// Returns the distance between crosses on the display plane, millimetres.
pub fn spacing_mm(display: &Display) -> f64 {
    display.field.resolution[0] as f64 * display.field.pitch_mm * SPACING
}

/// Returns the largest numbers [columns, rows] of crosses on each side of the central cross that
/// fit into the field with their arms.
pub fn crosses(display: &Display) -> [usize; 2] {
    let spacing = spacing_mm(display);
    display.field.resolution.map(|count| {
        let half = 0.5 * count as f64 * display.field.pitch_mm / spacing;
        (half - ARM).floor().max(0.0) as usize
    })
}

impl Pattern {
    /// Returns the codes `[row][col][red, green, blue, 255]` of the output that drives the panel
    /// `shows`. With `only`, all layers except `only` are clear. The crosses on `only` are black,
    /// or white if layers do not attenuate. The patterns [`Self::Lenslet`] and [`Self::View`]
    /// ignore `only`. `eye_mm` is the eye position for which the crosses coincide, in display
    /// space, millimetres.
    ///
    /// # Errors
    /// If the display has no such lenslet or bin.
    pub fn codes(
        self,
        display: &Display,
        shows: Shows,
        output: [usize; 2],
        only: Option<Shows>,
        eye_mm: [f64; 3],
    ) -> Result<Vec<u8>, PatternError> {
        let one = Display { frames: 1, ..display.clone() };
        let picture = Picture::new(&one, shows, output);
        let mut stack = LayerStack::filled(&one, display.formation.neutral());
        stack.emission.iter_mut().for_each(|emission| emission.data_mut().fill(1.0));
        self.set_emission(display, &mut stack)?;
        let plain = picture.codes(&stack, 0, None);
        let apart = only.is_some_and(|only| only != shows);
        let is_backlight = shows == Shows::Backlight;
        Ok(match self {
            Self::Clear | Self::Lenslet(_) | Self::View(_) => plain,
            _ if apart => plain,
            // If the layers draw a pattern, the backlight must be lit evenly behind them.
            Self::Crosshairs => {
                if is_backlight {
                    plain
                } else {
                    self.draw(display, &picture, output, only, eye_mm)
                }
            }
            Self::Ramp | Self::Code(_) if is_backlight && only.is_none() => plain,
            _ => self.draw(display, &picture, output, only, eye_mm),
        })
    }

    /// Refuses the test pattern of a lenslet or bin that the display does not have.
    pub(crate) fn check(self, display: &Display) -> Result<(), PatternError> {
        let (kind, at) = match self {
            Self::Lenslet(at) => ("lenslet", at),
            Self::View(at) => ("view", at),
            _ => return Ok(()),
        };
        let Backlight::Lenslets(backlight) = &display.backlight else {
            let expected = format!("a display with a lenslet backlight for `{kind}`");
            return Err(PatternError { expected, found: "a display with a uniform backlight".into() });
        };
        let counts = if kind == "lenslet" { backlight.lenslets } else { backlight.views };
        if at[0] >= counts[0] || at[1] >= counts[1] {
            let expected = format!("{kind}=0,0 to {},{}", counts[0] - 1, counts[1] - 1);
            return Err(PatternError { expected, found: format!("{},{}", at[0], at[1]) });
        }
        Ok(())
    }

    /// For the test patterns of a backlight, lights only the chosen lenslet or angular bin. Other
    /// test patterns leave the emission unchanged.
    fn set_emission(self, display: &Display, stack: &mut LayerStack) -> Result<(), PatternError> {
        self.check(display)?;
        if !matches!(self, Self::Lenslet(_) | Self::View(_)) {
            return Ok(());
        }
        let (Backlight::Lenslets(backlight), Some(emission)) = (&display.backlight, &mut stack.emission) else {
            return Ok(());
        };
        emission.data_mut().fill(0.0);
        let ([bins_x, bins_y], [cols, rows]) = (backlight.views, backlight.lenslets);
        let lit = |bin: [usize; 2], lenslet: [usize; 2]| self == Self::Lenslet(lenslet) || self == Self::View(bin);
        for (y, x) in (0..bins_y).flat_map(|y| (0..bins_x).map(move |x| (y, x))) {
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                if lit([x, y], [col, row]) {
                    emission.block_mut([0, y, x, row, col]).fill(1.0);
                }
            }
        }
        Ok(())
    }

    /// Draws a pattern that is defined for the pixels of the panel, not for mask pixels.
    fn draw(
        self,
        display: &Display,
        picture: &Picture,
        output: [usize; 2],
        only: Option<Shows>,
        eye_mm: [f64; 3],
    ) -> Vec<u8> {
        let place = Place::new(display, picture.shows(), output);
        let neutral = display.formation.neutral();
        let mark = if display.formation == Formation::Attenuating { 0.0 } else { 1.0 };
        let mixed = |share: f32| neutral + share * (mark - neutral);
        let [cols, rows] = place.upright_size();
        let label = Label::new(&picture.shows().to_string(), [cols, rows]);
        let layer = if let Shows::Layer(layer) = picture.shows() { layer } else { 0 };
        let crosses = Crosses::new(display, layer, place.pitch_mm, eye_mm);
        // Compute the code of every output pixel by its position in the upright picture.
        let code = |at: [f64; 2]| -> [u8; 3] {
            let [u, v] = place.upright(at);
            match self {
                Self::Code(code) => code,
                Self::Ramp => {
                    let step = (((u + 0.5) / cols as f64 * STEPS as f64) as usize).min(STEPS - 1);
                    let band = (((v + 0.5) / rows as f64 * 4.0) as usize).min(3);
                    let light = step as f32 / (STEPS - 1) as f32;
                    let [low, high] = picture.range();
                    let value = low + light * (high - low);
                    picture.encode([0, 1, 2].map(|c| if band == 0 || band == c + 1 { value } else { low }))
                }
                Self::Identify => picture.encode([mixed(label.at(u, v)); 3]),
                _ => {
                    let share = place.mm(at).map_or(0.0, |mm| crosses.share(mm));
                    // On attenuating layers, a cross of the panel `only` is black. Without `only`,
                    // the crosses of each layer absorb two of the three channels.
                    let kept = if only.is_some() { 3 } else { layer % 3 };
                    picture.encode([0, 1, 2].map(|c| if c == kept { neutral } else { mixed(share) }))
                }
            }
        };
        pixels(output)
            .flat_map(|at| {
                let [r, g, b] = code(at);
                [r, g, b, 255]
            })
            .collect()
    }
}

/// The crosshair array as it is drawn on one layer.
struct Crosses {
    eye_mm: [f64; 3],
    /// Ratio of a distance on the display plane to the drawn distance on the layer.
    spread: f64,
    spacing_mm: f64,
    counts: [usize; 2],
    /// Size of a panel pixel as it appears on the display plane from the eye, millimetres.
    pixel_mm: f64,
}

impl Crosses {
    fn new(display: &Display, layer: usize, pitch_mm: f64, eye_mm: [f64; 3]) -> Self {
        let d_mm = display.layers.get(layer).map_or(0.0, |layer| layer.d_mm);
        let spread = eye_mm[2] / (eye_mm[2] - d_mm);
        let spacing_mm = spacing_mm(display);
        Self { eye_mm, spread, spacing_mm, counts: crosses(display), pixel_mm: pitch_mm * spread }
    }

    /// Returns the fraction of a pixel that crosses and the central mark cover, 0 to 1. `mm` is the
    /// pixel's position on the layer.
    fn share(&self, mm: [f64; 2]) -> f32 {
        let on_plane = [0, 1].map(|axis| self.eye_mm[axis] + (mm[axis] - self.eye_mm[axis]) * self.spread);
        let nearest = on_plane.map(|at| (at / self.spacing_mm).round());
        let away = [0, 1].map(|axis| on_plane[axis] - nearest[axis] * self.spacing_mm);
        let covered = |distance: f64| (0.5 + distance / self.pixel_mm).clamp(0.0, 1.0);
        let mut share: f64 = 0.0;
        if (0..2).all(|axis| nearest[axis].abs() <= self.counts[axis] as f64) {
            let line = |along: f64, across: f64| {
                covered(ARM * self.spacing_mm - along.abs()) * covered(HALF_LINE_PX * self.pixel_mm - across.abs())
            };
            share = line(away[0], away[1]).max(line(away[1], away[0]));
        }
        if nearest == [0.0, 0.0] {
            let from_mark = [0, 1].map(|axis| away[axis] - MARK * self.spacing_mm);
            let distance = from_mark[0].hypot(from_mark[1]);
            share = share.max(covered(MARK_RADIUS * self.spacing_mm - distance));
        }
        share as f32
    }
}

/// Large text in the centre of a panel.
struct Label {
    letters: Vec<Vec<Vec<u8>>>,
    size: [usize; 2],
}

/// Raster size of the letters.
const LETTER: RasterHeight = RasterHeight::Size32;

impl Label {
    fn new(text: &str, size: [usize; 2]) -> Self {
        let letter = |c: char| {
            get_raster(c, FontWeight::Bold, LETTER).map(|raster| raster.rows().map(|row| row.to_vec()).collect())
        };
        Self { letters: text.chars().filter_map(letter).collect(), size }
    }

    /// Returns the fraction of pixel (u, v) of the upright picture that letters cover, 0 to 1.
    fn at(&self, u: f64, v: f64) -> f32 {
        let (width, height) = (get_raster_width(FontWeight::Bold, LETTER), LETTER.val());
        let total = width * self.letters.len().max(1);
        let scale =
            ((self.size[0] as f64 * 0.8 / total as f64).min(self.size[1] as f64 * 0.8 / height as f64)).max(1e-9);
        let x = (u - self.size[0] as f64 / 2.0) / scale + total as f64 / 2.0;
        let y = (v - self.size[1] as f64 / 2.0) / scale + height as f64 / 2.0;
        if x < 0.0 || y < 0.0 {
            return 0.0;
        }
        let (x, y) = (x as usize, y as usize);
        let letter = self.letters.get(x / width).and_then(|letter| letter.get(y)).and_then(|row| row.get(x % width));
        letter.map_or(0.0, |value| f32::from(*value) / 255.0)
    }
}

#[cfg(test)]
mod tests {
    use lumistack_plugin::display::{LensletBacklight, Panel, Transfer};
    use lumistack_plugin::lenslets::LensletPanel;

    use super::*;

    fn display() -> Display {
        let mut display = Display::uniform([160, 100], 0.5, [1, 1], [10.0, 10.0], &[-20.0, 0.0, 30.0], 1);
        for layer in &mut display.layers {
            (layer.panel_pitch_mm, layer.transfer) = (Some(0.25), Transfer::Linear);
        }
        display
    }

    const OUTPUT: [usize; 2] = [400, 260];
    const EYE: [f64; 3] = [0.0, 0.0, 600.0];

    /// Returns the centre of mass of the dark pixels in a window around a position on the layer,
    /// relative to this position, in pixels.
    fn centre(codes: &[u8], pitch_mm: f64, mm: [f64; 2], half: usize, channel: usize) -> [f64; 2] {
        let col = mm[0] / pitch_mm + (OUTPUT[0] as f64 - 1.0) / 2.0;
        let row = (OUTPUT[1] as f64 - 1.0) / 2.0 - mm[1] / pitch_mm;
        let (mut sum, mut moment) = (0.0, [0.0; 2]);
        for r in row.round() as usize - half..=row.round() as usize + half {
            for c in col.round() as usize - half..=col.round() as usize + half {
                let dark = 255.0 - f64::from(codes[4 * (r * OUTPUT[0] + c) + channel]);
                sum += dark;
                moment = [moment[0] + dark * c as f64, moment[1] + dark * r as f64];
            }
        }
        [moment[0] / sum - col, moment[1] / sum - row]
    }

    #[test]
    fn crosses_stand_where_the_eye_s_rays_meet_each_layer() {
        let display = display();
        let spacing = spacing_mm(&display);
        assert_eq!((spacing, crosses(&display)), (10.0, [3, 2]));
        for eye in [EYE, [30.0, -10.0, 500.0]] {
            for n in 0..3 {
                let codes =
                    Pattern::Crosshairs.codes(&display, Shows::Layer(n), OUTPUT, Some(Shows::Layer(n)), eye).unwrap();
                for (i, j) in [(-3.0, 2.0), (1.0, -1.0), (3.0, -2.0)] {
                    let target = [i * spacing, j * spacing, 0.0];
                    // intersect the layer with the ray from the eye through the cross's point of
                    // the display plane
                    let t = (display.layers[n].d_mm - eye[2]) / (target[2] - eye[2]);
                    let mm = [0, 1].map(|axis| eye[axis] + t * (target[axis] - eye[axis]));
                    // Arms are 12 pixels long, so a window of 8 pixels around the centre contains
                    // no ends of lines. The centre of mass of the lines must be the window's
                    // centre, up to rounding.
                    let found = centre(&codes, 0.25, mm, 8, 1);
                    assert!(found[0].abs() < 0.35 && found[1].abs() < 0.35, "layer {n}, {i} {j}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn layers_take_away_different_colours_and_together_all() {
        let display = display();
        let middle = |codes: &[u8]| -> [u8; 3] { codes[4 * (130 * OUTPUT[0] + 200)..][..3].try_into().unwrap() };
        let shown =
            |n: usize| middle(&Pattern::Crosshairs.codes(&display, Shows::Layer(n), OUTPUT, None, EYE).unwrap());
        assert_eq!([shown(0), shown(1), shown(2)], [[255, 0, 0], [0, 255, 0], [0, 0, 255]]);
        let only = Some(Shows::Layer(1));
        let alone =
            |n: usize| middle(&Pattern::Crosshairs.codes(&display, Shows::Layer(n), OUTPUT, only, EYE).unwrap());
        // With `only` = layer 1, this layer draws its central cross in black, and layers 0 and 2
        // are clear.
        assert_eq!([alone(0), alone(1), alone(2)], [[255; 3], [0; 3], [255; 3]]);
    }

    #[test]
    fn a_ramp_has_equal_steps_of_light_by_the_declared_transfer() {
        let mut display = display();
        display.layers[0].transfer = Transfer::gamma(2.2);
        display.layers[0].panel = Some(Panel { rotate_deg: 180, ..Panel::default() });
        let codes = Pattern::Ramp.codes(&display, Shows::Layer(0), OUTPUT, None, EYE).unwrap();
        // The panel is upside down, so the steps of the grey ramp in the last row rise to the left.
        let line: Vec<f64> =
            codes[4 * 259 * 400..].chunks_exact(4).map(|rgba| (f64::from(rgba[0]) / 255.0).powf(2.2)).collect();
        for step in 0..STEPS {
            let col = 399 - (400.0 * (step as f64 + 0.5) / STEPS as f64) as usize;
            assert!((line[col] - step as f64 / 32.0).abs() < 0.006, "{step}: {}", line[col]);
        }
        // Upside down, the blue ramp is at the top, and its brightest step is on the left.
        assert_eq!(codes[..4], [0, 0, 255, 255]);
    }

    #[test]
    fn single_lenslets_and_views_agree_with_the_lens_model() {
        let mut display = Display::uniform([20, 12], 1.0, [3, 3], [40.0, 40.0], &[0.0], 1);
        let mut backlight = LensletBacklight::new(-8.0, [5, 3], 4.0, [3, 3], [40.0, 40.0]);
        (backlight.panel_pitch_mm, backlight.transfer) = (Some(0.25), Transfer::Linear);
        display.backlight = Backlight::Lenslets(backlight.clone());
        let output = [80, 48];
        let lenses = LensletPanel::new(&backlight, output, 0.25);
        for pattern in [Pattern::Lenslet([3, 1]), Pattern::View([0, 2])] {
            let codes = pattern.codes(&display, Shows::Backlight, output, None, EYE).unwrap();
            for (i, [col, row]) in pixels(output).enumerate() {
                let corners = [[-0.4, -0.4], [0.4, -0.4], [-0.4, 0.4], [0.4, 0.4]].map(|[dx, dy]| {
                    let spot = lenses.spot([(col + dx - 39.5) * 0.25, (23.5 - row - dy) * 0.25]);
                    spot.is_some_and(|spot| match pattern {
                        Pattern::Lenslet(at) => spot.lenslet == [at[1], at[0]],
                        _ => spot.bin == [2, 0],
                    })
                });
                match corners {
                    [true, true, true, true] => assert_eq!(codes[4 * i], 255),
                    [false, false, false, false] => assert_eq!(codes[4 * i], 0),
                    _ => {}
                }
            }
            assert!(codes.chunks_exact(4).any(|rgba| rgba[0] == 255));
            let layer = pattern.codes(&display, Shows::Layer(0), [20, 12], None, EYE).unwrap();
            assert!(layer.iter().all(|code| *code == 255));
        }
        let error = Pattern::View([3, 0]).codes(&display, Shows::Backlight, output, None, EYE).unwrap_err();
        assert_eq!(error.to_string(), "pattern: expected view=0,0 to 2,2, found 3,0");
        display.backlight = Backlight::Uniform;
        assert!(Pattern::Lenslet([0, 0]).codes(&display, Shows::Layer(0), [20, 12], None, EYE).is_err());
    }

    #[test]
    fn every_word_is_read() {
        for (text, pattern) in [
            ("crosshairs", Pattern::Crosshairs),
            ("ramp", Pattern::Ramp),
            ("code=7", Pattern::Code([7; 3])),
            ("code=7,8, 9", Pattern::Code([7, 8, 9])),
            ("lenslet=3,1", Pattern::Lenslet([3, 1])),
            ("view=0,2", Pattern::View([0, 2])),
            ("clear", Pattern::Clear),
            ("identify", Pattern::Identify),
        ] {
            assert_eq!(text.parse(), Ok(pattern));
        }
        for text in ["", "cross", "code", "code=256", "view=1", "ramp=1", "lenslet=-1,0"] {
            assert!(text.parse::<Pattern>().is_err(), "{text}");
        }
    }
}
