//! Converts the values of a layer or a backlight into the codes of every pixel of one output.
//!
//! ```text
//! mask value f ─(crosstalk)⁻¹─▶ f' ─drive─▶ 0..1 of the panel's range ─transfer─▶ code
//! code = round(value · (2^bits − 1))
//! ```
//!
//! The crosstalk comes from the panel's calibration, and the solver did not model it. Masks are
//! linear light, and are resampled before values become codes. Outside the mask a panel is dark, or
//! clear if the display has `missing = "clear"`. In a colour sequence panels have no colour
//! filters, so all three channels get the value of one colour.

use lumistack_plugin::display::{
    Backlight, Display, Homography, LayerStack, LensletBacklight, Missing, Sampling, Transfer,
};
use lumistack_plugin::lenslets::LensletPanel;

use crate::{Place, Shows};

/// Number of sample points per axis whose mean is the value of a pixel behind lenslets.
const LENS_SAMPLES: usize = 4;
/// Bits per channel of an output.
const OUTPUT_BITS: u32 = 8;
/// Offset that is added to a position before it is rounded down. It is a little more than half a
/// pixel. So a position half-way between two pixels belongs to the right or lower pixel, despite
/// rounding errors.
const HALF: f64 = 0.5 + 1e-9;

/// Encodes layer stacks for one output. All data that are equal in all frames are computed once.
#[derive(Clone, Debug)]
pub struct Picture {
    shows: Shows,
    size: [usize; 2],
    lookup: Lookup,
    encoder: Encoder,
}

/// The mask pixels or emission values that every output pixel shows.
#[derive(Clone, Debug)]
enum Lookup {
    /// Index of a mask pixel, or [`OUTSIDE`].
    Nearest(Vec<u32>),
    /// Indices of four mask pixels, and the interpolation weights.
    Bilinear(Vec<Option<([u32; 4], [f32; 2])>>),
    /// Indices of `LENS_SAMPLES`² emission values per output pixel, or [`OUTSIDE`]. An index is bin
    /// · (number of lenslets) + lenslet.
    Lenses(Vec<u32>),
}

const OUTSIDE: u32 = u32::MAX;

/// Converts linear values to codes.
#[derive(Clone, Debug)]
struct Encoder {
    layer: Option<lumistack_plugin::display::Layer>,
    backlight: Option<LensletBacklight>,
    transfer: Transfer,
    bits: u32,
    unmix: Option<Homography>,
    outside: [u8; 3],
}

impl Encoder {
    /// Returns the codes of one linear RGB value.
    fn codes(&self, rgb: [f32; 3]) -> [u8; 3] {
        let wanted = match &self.unmix {
            None => rgb,
            // The matrix has the type of a homography, but is applied as a linear map, without
            // perspective division.
            Some(unmix) => unmix.0.map(|row| (0..3).map(|c| row[c] * f64::from(rgb[c])).sum::<f64>() as f32),
        };
        let top = (1u32 << self.bits) - 1;
        [0, 1, 2].map(|c| {
            let driven = match (&self.layer, &self.backlight) {
                (Some(layer), _) => layer.drive(wanted[c]),
                (None, Some(backlight)) => backlight.drive(wanted[c]),
                (None, None) => wanted[c],
            };
            let code = (self.transfer.encode(c, driven) * top as f32 + 0.5) as u32;
            ((code * 255 + top / 2) / top) as u8
        })
    }
}

impl Picture {
    /// Precomputes the lookup for an output of [columns, rows] pixels that drives the panel
    /// `shows`.
    pub fn new(display: &Display, shows: Shows, output: [usize; 2]) -> Self {
        // Make the lookup, which maps panel pixels to mask pixels, and the encoder, which maps
        // values to codes.
        let place = Place::new(display, shows, output);
        let (lookup, mut encoder) = match (shows, &display.backlight) {
            (Shows::Backlight, Backlight::Lenslets(backlight)) => {
                let panel = backlight.panel.clone().unwrap_or_default();
                let encoder = Encoder {
                    layer: None,
                    transfer: backlight.transfer.clone(),
                    bits: OUTPUT_BITS,
                    unmix: panel.crosstalk.map(|mix| Homography(mix).inverse()),
                    backlight: Some(backlight.clone()),
                    outside: [0; 3],
                };
                (lens_lookup(&place, backlight), encoder)
            }
            _ => {
                let n = if let Shows::Layer(n) = shows { n } else { 0 };
                let layer = &display.layers[n];
                let panel = layer.panel.clone().unwrap_or_default();
                let encoder = Encoder {
                    transfer: layer.transfer.clone(),
                    bits: layer.bits.unwrap_or(OUTPUT_BITS).min(OUTPUT_BITS),
                    unmix: panel.crosstalk.map(|mix| Homography(mix).inverse()),
                    layer: Some(layer.clone()),
                    backlight: None,
                    outside: [0; 3],
                };
                (mask_lookup(&place, layer.resolution, layer.pitch_mm, panel.resample), encoder)
            }
        };
        // Choose the codes outside a mask: clear with `missing = "clear"`, otherwise dark.
        if shows != Shows::Backlight {
            let outside = if display.missing == Missing::Clear { display.formation.neutral() } else { 0.0 };
            encoder.outside = encoder.codes([outside; 3]);
        }
        Self { shows, size: output, lookup, encoder }
    }

    /// Returns [columns, rows] of the output.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Returns [darkest, brightest] value of the panel, linear.
    pub(crate) fn range(&self) -> [f32; 2] {
        match (&self.encoder.layer, &self.encoder.backlight) {
            (Some(layer), _) => layer.range(),
            (None, Some(backlight)) => backlight.range(),
            (None, None) => [0.0, 1.0],
        }
    }

    /// Returns the codes of one linear RGB value.
    pub(crate) fn encode(&self, rgb: [f32; 3]) -> [u8; 3] {
        self.encoder.codes(rgb)
    }

    /// Returns the panel that the output drives.
    pub fn shows(&self) -> Shows {
        self.shows
    }

    /// Returns the codes `[row][col][red, green, blue, 255]` of one frame of a stack. In a colour
    /// sequence, `colour` selects the channel that all three channels show.
    ///
    /// # Panics
    /// If the stack does not match the display of [`Self::new`], or has no such frame.
    pub fn codes(&self, stack: &LayerStack, frame: usize, colour: Option<usize>) -> Vec<u8> {
        let code = |rgb: [f32; 3]| {
            let codes = self.encoder.codes(rgb);
            colour.map_or(codes, |channel| [codes[channel]; 3])
        };
        let values = match self.shows {
            Shows::Layer(n) => stack.layers[n].block([frame]),
            Shows::Backlight => stack.emission.as_ref().expect("a directional backlight").block([frame]),
        };
        let rgb = |i: u32| -> [f32; 3] { values[3 * i as usize..][..3].try_into().expect("three channels") };
        let outside = self.encoder.outside;
        // Without interpolation, encode every mask pixel once. With interpolation, mix the light of
        // mask pixels before the encoding.
        match &self.lookup {
            Lookup::Nearest(lookup) => {
                let mask: Vec<[u8; 3]> = values.chunks_exact(3).map(|v| code([v[0], v[1], v[2]])).collect();
                fill(lookup, |&i| if i == OUTSIDE { outside } else { mask[i as usize] })
            }
            Lookup::Bilinear(lookup) => fill(lookup, |read| {
                let Some((corners, [tx, ty])) = read else { return outside };
                let [a, b, c, d] = corners.map(rgb);
                code([0, 1, 2].map(|i| {
                    let (top, bottom) = (a[i] + tx * (b[i] - a[i]), c[i] + tx * (d[i] - c[i]));
                    top + ty * (bottom - top)
                }))
            }),
            Lookup::Lenses(lookup) => {
                let points = LENS_SAMPLES * LENS_SAMPLES;
                fill(lookup.chunks_exact(points), |places| {
                    let mut sum = [0.0f32; 3];
                    for &i in places.iter().filter(|i| **i != OUTSIDE) {
                        sum.iter_mut().zip(rgb(i)).for_each(|(sum, value)| *sum += value);
                    }
                    code(sum.map(|sum| sum / points as f32))
                })
            }
        }
    }
}

fn fill<T>(lookup: impl IntoIterator<Item = T>, code: impl Fn(T) -> [u8; 3]) -> Vec<u8> {
    lookup
        .into_iter()
        .flat_map(|read| {
            let [r, g, b] = code(read);
            [r, g, b, 255]
        })
        .collect()
}

fn mask_lookup(place: &Place, [cols, rows]: [usize; 2], pitch_mm: f64, resample: Sampling) -> Lookup {
    // `at` converts a position on the output to a position on the mask, in mask pixels.
    let at = |output: [f64; 2]| {
        let [x, y] = place.mm(output)?;
        Some([x / pitch_mm + (cols as f64 - 1.0) / 2.0, (rows as f64 - 1.0) / 2.0 - y / pitch_mm])
    };
    let inside = |place: [f64; 2]| {
        let [col, row] = place.map(|at| (at + HALF).floor());
        (col >= 0.0 && row >= 0.0 && col < cols as f64 && row < rows as f64).then_some([col as usize, row as usize])
    };
    let pixels = pixels(place.output);
    match resample {
        Sampling::Nearest => Lookup::Nearest(
            pixels
                .map(|pixel| at(pixel).and_then(inside).map_or(OUTSIDE, |[col, row]| (row * cols + col) as u32))
                .collect(),
        ),
        Sampling::Bilinear => {
            let read = |pixel: [f64; 2]| {
                let place = at(pixel)?;
                inside(place)?;
                // Positions outside the outermost pixel centres have the values of the border
                // pixels.
                let [x, y] = [place[0].clamp(0.0, cols as f64 - 1.0), place[1].clamp(0.0, rows as f64 - 1.0)];
                let (left, top) = (x.floor() as usize, y.floor() as usize);
                let (right, bottom) = ((left + 1).min(cols - 1), (top + 1).min(rows - 1));
                let corner = |row: usize, col: usize| (row * cols + col) as u32;
                let corners = [corner(top, left), corner(top, right), corner(bottom, left), corner(bottom, right)];
                Some((corners, [(x - x.floor()) as f32, (y - y.floor()) as f32]))
            };
            Lookup::Bilinear(pixels.map(read).collect())
        }
    }
}

fn lens_lookup(place: &Place, backlight: &LensletBacklight) -> Lookup {
    let lenses = LensletPanel::new(backlight, place.upright_size(), place.pitch_mm);
    let lenslets = lenses.lenslets[0] * lenses.lenslets[1];
    let offset = |sample: usize| (sample as f64 + 0.5) / LENS_SAMPLES as f64 - 0.5;
    let mut lookup = Vec::with_capacity(place.output[0] * place.output[1] * LENS_SAMPLES * LENS_SAMPLES);
    for [x, y] in pixels(place.output) {
        for (sy, sx) in (0..LENS_SAMPLES).flat_map(|sy| (0..LENS_SAMPLES).map(move |sx| (sy, sx))) {
            let spot = place.mm([x + offset(sx), y + offset(sy)]).and_then(|mm| lenses.spot(mm));
            lookup.push(spot.map_or(OUTSIDE, |spot| {
                let bin = spot.bin[0] * lenses.bins[0] + spot.bin[1];
                (bin * lenslets + spot.lenslet[0] * lenses.lenslets[0] + spot.lenslet[1]) as u32
            }));
        }
    }
    Lookup::Lenses(lookup)
}

/// Iterates over all pixels [column, row], row by row.
pub(crate) fn pixels([cols, rows]: [usize; 2]) -> impl Iterator<Item = [f64; 2]> {
    (0..rows).flat_map(move |row| (0..cols).map(move |col| [col as f64, row as f64]))
}

#[cfg(test)]
mod tests;
