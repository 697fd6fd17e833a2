//! The curve of a film and a printer: the film's transmittance for each printed code.
//!
//! A measured curve is a list of pairs `code transmittance`, for example `0 0.02, 64 0.09, 128 0.3,
//! 255 0.88`. Three lists, separated by `;`, are for red, green and blue. Codes rise from 0 to 255.
//! Transmittances are in 0..1 and rise, too. The last pair belongs to clear film.
//!
//! A mask value f is printed relative to clear film, of transmittance T_clear. Let `peak` be the
//! layer's largest value, and T_dark the transmittance of the film's darkest state. At f the film
//! has the fraction f / peak of T_clear, but at least T_dark:
//!
//! ```text
//! T(code) / T_clear = max(f / peak, T_dark / T_clear)
//! ```
//!
//! Thus the whole layer is darker by the factor T_clear, and only values below the darkest state
//! are lost.

use lumistack_plugin::PluginError;
use lumistack_plugin::display::{Channels, Layer, Transfer};

/// The curve of a film and the printer that prints on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Maps values from 0 (the darkest state) to 1 (clear film) to codes.
    transfer: Transfer,
    /// Transmittance of the darkest state relative to clear film, per channel.
    pub dark: [f64; 3],
    /// Transmittance of clear film per channel; `None` if not measured.
    pub clear: Option<[f64; 3]>,
}

impl Film {
    /// Makes a film with the measured curve in the text `curve`. If the text is empty, codes are
    /// sRGB, and `dark` is the transmittance of the darkest state relative to clear film.
    ///
    /// # Errors
    /// If a list is not a curve from code 0 to code 255, or if there are neither one nor three
    /// lists.
    pub fn new(curve: &str, dark: f64) -> Result<Self, PluginError> {
        if curve.trim().is_empty() {
            return Ok(Self { transfer: Transfer::Srgb, dark: [dark; 3], clear: None });
        }
        let refused = |found: &str| {
            PluginError::Refused(format!(
                "parameter `curve`: expected one list, or three lists (red, green, blue) separated by semicolons, found {found:?}. A list has two or more pairs `CODE TRANSMITTANCE` separated by commas: codes rise from 0 to 255, transmittances rise within 0..1"
            ))
        };
        let tables: Vec<Vec<[f64; 2]>> =
            curve.split(';').map(|list| table(list).ok_or_else(|| refused(list.trim()))).collect::<Result<_, _>>()?;
        let ends = |table: &Vec<[f64; 2]>| (table[0][1], table[table.len() - 1][1]);
        let (table, all) = match <[Vec<[f64; 2]>; 3]>::try_from(tables) {
            Ok(rgb) => {
                let all = rgb.each_ref().map(ends);
                (Channels::Rgb(rgb), all)
            }
            Err(mut one) if one.len() == 1 => {
                let all = [ends(&one[0]); 3];
                (Channels::Same(one.swap_remove(0)), all)
            }
            Err(_) => return Err(refused(curve)),
        };
        Ok(Self {
            transfer: Transfer::Table(table),
            dark: all.map(|(dark, clear)| dark / clear),
            clear: Some(all.map(|(_, clear)| clear)),
        })
    }

    /// Returns the 8-bit codes of values `[..][rgb]` of a layer, transmittances in 0..peak. Also
    /// returns the number of lost values. A lost value, divided by `peak`, is below the darkest
    /// state by more than half a step between codes.
    pub fn codes(&self, layer: &Layer, rgb: &[f32]) -> (Vec<u8>, usize) {
        let mut lost = 0;
        let codes = rgb.iter().enumerate().map(|(i, &value)| {
            let (wanted, dark) = (f64::from(value) / layer.peak, self.dark[i % 3]);
            lost += usize::from(wanted < dark - HALF_CODE);
            let share = ((wanted - dark) / (1.0 - dark)).clamp(0.0, 1.0) as f32;
            (self.transfer.encode(i % 3, share) * 255.0 + 0.5) as u8
        });
        (codes.collect(), lost)
    }

    /// Returns the transmittance of the film at a code, relative to clear film.
    pub fn transmittance(&self, channel: usize, code: u8) -> f64 {
        let share = f64::from(self.transfer.decode(channel, f32::from(code) / 255.0));
        self.dark[channel] + (1.0 - self.dark[channel]) * share
    }
}

/// Half a step between codes, as a fraction of the transmittance of clear film.
const HALF_CODE: f64 = 0.5 / 255.0;

/// Parses a list of pairs. It must contain the codes 0 and 255, so that no code is outside the
/// measured range.
fn table(list: &str) -> Option<Vec<[f64; 2]>> {
    let pair = |text: &str| {
        let numbers: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
        <[f64; 2]>::try_from(numbers).ok()
    };
    let table: Vec<[f64; 2]> = list.split(',').map(pair).collect::<Option<_>>()?;
    let rises = table.windows(2).all(|pair| pair[0][0] < pair[1][0] && pair[0][1] < pair[1][1]);
    let whole = table.len() >= 2 && table[0][0] == 0.0 && table[table.len() - 1][0] == 255.0;
    let light = table.iter().all(|pair| (0.0..=1.0).contains(&pair[1]));
    (rises && whole && light).then_some(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measured_curve_is_inverted_relative_to_clear_film() {
        let film = Film::new("0 0.04, 128 0.24, 255 0.8", 0.0).unwrap();
        assert!((film.dark[0] - 0.05).abs() < 1e-12);
        assert_eq!(film.clear, Some([0.8; 3]));
        let layer = Layer { peak: 0.9, ..Layer::new(0.0, [1, 1], 1.0) };
        // The value 0.27 is 0.3 of the peak 0.9. Clear film transmits 0.8, and 0.3 of 0.8 is 0.24,
        // which is code 128. Values below 0.04 / 0.8 = 0.05 of the peak are lost.
        let (codes, lost) = film.codes(&layer, &[0.9, 0.27, 0.9 * 0.05, 0.01, 0.0, 1.0]);
        assert_eq!((codes, lost), (vec![255, 128, 0, 0, 0, 255], 2));
        for code in [0, 60, 128, 200, 255] {
            let (back, _) = film.codes(&layer, &[(0.9 * film.transmittance(0, code)) as f32, 0.5, 0.5]);
            assert_eq!(back[0], code);
        }
    }

    #[test]
    fn channels_may_have_their_own() {
        let film = Film::new("0 0, 255 1; 0 0.1, 255 1; 0 0, 255 0.5", 0.3).unwrap();
        assert_eq!(film.dark, [0.0, 0.1, 0.0]);
        let (codes, _) = film.codes(&Layer::new(0.0, [1, 1], 1.0), &[0.5; 3]);
        assert_eq!(codes, [128, 113, 128]);
    }

    #[test]
    fn without_a_curve_codes_are_srgb_above_the_darkest_state() {
        let film = Film::new(" ", 0.1).unwrap();
        let (codes, lost) = film.codes(&Layer::new(0.0, [1, 1], 1.0), &[0.0, 0.1, 1.0]);
        assert_eq!((codes, lost), (vec![0, 0, 255], 1));
    }

    #[test]
    fn texts_that_are_no_curve_are_refused() {
        for bad in [
            "0 0",
            "0 0, 255 0",
            "0 0, 200 1",
            "1 0, 255 1",
            "0 0 255 1",
            "0 0, 255 2",
            "a b, c d",
            "0 0, 255 1; 0 0, 255 1",
        ] {
            let error = Film::new(bad, 0.0).unwrap_err().to_string();
            assert!(error.starts_with("parameter `curve`: expected one list, or three"), "{bad}: {error}");
        }
    }
}
