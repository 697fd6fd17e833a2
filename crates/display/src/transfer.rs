//! Transfer functions from linear values to a panel's code values and back: standard curves, or
//! measurements of the panel.
//!
//! A measured table holds pairs (code, amount of light), each in any unit. The first pair is the
//! darkest state, the last pair the brightest. Codes and light are scaled to 0..1:
//!
//! ```text
//! code → (code − code_first) / (code_last − code_first)
//! light → (light − light_first) / (light_last − light_first)
//! ```
//!
//! Between the pairs the function is linear. The table does not state the brightness of the darkest
//! and the brightest state: the display's keys `black_level` and `peak` state it.

use lumistack_core::colour::{srgb_decode, srgb_encode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A panel's transfer function.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Transfer {
    /// The sRGB curve, IEC 61966-2-1.
    #[default]
    Srgb,
    /// Codes are proportional to light.
    Linear,
    /// The light of a code is code^gamma.
    Gamma(Channels<f64>),
    /// Measured pairs [code, light], in which codes and light rise.
    Table(Channels<Vec<[f64; 2]>>),
}

/// One value for red, green and blue together, or one for each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected one value for all channels, or three values: red, green and blue")]
pub enum Channels<T> {
    /// One value for all channels.
    Same(T),
    /// The values of red, green and blue.
    Rgb([T; 3]),
}

impl<T> Channels<T> {
    /// Returns the value of a channel: 0 red, 1 green, 2 blue.
    ///
    /// # Panics
    /// If there is no such channel.
    pub fn of(&self, channel: usize) -> &T {
        match self {
            Self::Same(same) => same,
            Self::Rgb(rgb) => &rgb[channel],
        }
    }

    /// Iterates over the given values: one or three.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        match self {
            Self::Same(same) => std::slice::from_ref(same).iter(),
            Self::Rgb(rgb) => rgb.iter(),
        }
    }
}

impl Transfer {
    /// Makes the transfer function light = code^gamma for all channels.
    pub fn gamma(gamma: f64) -> Self {
        Self::Gamma(Channels::Same(gamma))
    }

    /// Returns the code, 0..1, of a linear value of a channel. Values outside 0..1 are clamped; NaN
    /// becomes 0.
    pub fn encode(&self, channel: usize, linear: f32) -> f32 {
        let linear = if linear.is_nan() { 0.0 } else { linear.clamp(0.0, 1.0) };
        match self {
            Self::Srgb => srgb_encode(linear).clamp(0.0, 1.0),
            Self::Linear => linear,
            Self::Gamma(gamma) => f64::from(linear).powf(1.0 / gamma.of(channel)) as f32,
            Self::Table(table) => interpolate(table.of(channel), [1, 0], linear),
        }
    }

    /// Returns the linear value, 0..1, of a code, 0..1, of a channel.
    pub fn decode(&self, channel: usize, code: f32) -> f32 {
        match self {
            Self::Srgb => srgb_decode(code),
            Self::Linear => code,
            Self::Gamma(gamma) => f64::from(code).powf(*gamma.of(channel)) as f32,
            Self::Table(table) => interpolate(table.of(channel), [0, 1], code),
        }
    }

    /// Returns true if the channels have functions of their own.
    pub fn is_per_channel(&self) -> bool {
        matches!(self, Self::Gamma(Channels::Rgb(_)) | Self::Table(Channels::Rgb(_)))
    }

    /// Returns the first invalid key under `transfer`, the expected value and the value found;
    /// `None` if all keys are valid.
    pub(crate) fn problem(&self) -> Option<(String, &'static str, String)> {
        let key = |name: &str, channels: usize, i: usize| {
            if channels == 1 { name.to_string() } else { format!("{name}[{i}]") }
        };
        match self {
            Self::Srgb | Self::Linear => None,
            Self::Gamma(gammas) => {
                let bad = gammas.iter().position(|gamma| !(*gamma > 0.0 && gamma.is_finite()))?;
                let found = gammas.of(bad).to_string();
                Some((key("gamma", gammas.iter().count(), bad), "a number above 0", found))
            }
            Self::Table(tables) => {
                let rising = |table: &Vec<[f64; 2]>| {
                    table.len() >= 2
                        && table.iter().flatten().all(|number| number.is_finite())
                        && table.windows(2).all(|pair| pair[0][0] < pair[1][0] && pair[0][1] < pair[1][1])
                };
                let bad = tables.iter().position(|table| !rising(table))?;
                let expected = "two or more pairs [code, light] whose codes and amounts of light both rise";
                Some((key("table", tables.iter().count(), bad), expected, format!("{:?}", tables.of(bad))))
            }
        }
    }
}

/// Returns the value in column `to` of a table at the position where column `from` has `value`, by
/// linear interpolation between the pairs. Both columns are scaled to 0..1.
fn interpolate(table: &[[f64; 2]], [from, to]: [usize; 2], value: f32) -> f32 {
    let (first, last) = (table[0], table[table.len() - 1]);
    let scaled = |pair: [f64; 2], column: usize| (pair[column] - first[column]) / (last[column] - first[column]);
    let value = f64::from(value).clamp(0.0, 1.0);
    let above = table.partition_point(|pair| scaled(*pair, from) < value).clamp(1, table.len() - 1);
    let [low, high] = [table[above - 1], table[above]];
    let t = (value - scaled(low, from)) / (scaled(high, from) - scaled(low, from));
    (scaled(low, to) + t * (scaled(high, to) - scaled(low, to))) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tolerance of f32 arithmetic on values in 0..1.
    const ROUNDING: f32 = 1e-6;

    fn measured() -> Transfer {
        // The pairs have codes of 8 bits, and light in candela per square metre.
        let red = vec![[0.0, 0.3], [64.0, 10.3], [128.0, 40.3], [255.0, 200.3]];
        let green = vec![[0.0, 0.0], [255.0, 1.0]];
        Transfer::Table(Channels::Rgb([red, green.clone(), green]))
    }

    #[test]
    fn a_table_goes_through_its_pairs_and_straight_between() {
        let transfer = measured();
        for (channel, code, light) in [
            (0, 0.0, 0.0),
            (0, 64.0 / 255.0, 0.05),
            (0, 96.0 / 255.0, 0.125),
            (0, 128.0 / 255.0, 0.2),
            (0, 1.0, 1.0),
            (1, 0.25, 0.25),
            (2, 0.75, 0.75),
        ] {
            assert!((transfer.decode(channel, code) - light).abs() < ROUNDING, "{channel} {code}");
            assert!((transfer.encode(channel, light) - code).abs() < ROUNDING, "{channel} {light}");
        }
        assert_eq!([-1.0, 2.0, f32::NAN].map(|value| transfer.encode(0, value)), [0.0, 1.0, 0.0]);
    }

    #[test]
    fn every_code_survives_its_light() {
        let per_channel = Transfer::Gamma(Channels::Rgb([2.1, 2.2, 2.4]));
        for transfer in [Transfer::Srgb, Transfer::Linear, Transfer::gamma(2.2), per_channel, measured()] {
            for (channel, code) in (0..3).flat_map(|channel| (0..=255).map(move |code| (channel, code as f32 / 255.0)))
            {
                let back = transfer.encode(channel, transfer.decode(channel, code));
                assert!((back - code).abs() < 2e-6, "{transfer:?} {channel}: {code} became {back}");
            }
        }
    }

    #[test]
    fn files_say_one_for_all_channels_or_one_for_each() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct File {
            transfer: Transfer,
        }
        for (text, transfer) in [
            ("transfer = \"linear\"", Transfer::Linear),
            ("transfer = { gamma = 2.2 }", Transfer::gamma(2.2)),
            ("transfer = { gamma = [2.0, 2.1, 2.2] }", Transfer::Gamma(Channels::Rgb([2.0, 2.1, 2.2]))),
            (
                "transfer = { table = [[0, 0.1], [255, 9]] }",
                Transfer::Table(Channels::Same(vec![[0.0, 0.1], [255.0, 9.0]])),
            ),
            (
                "transfer = { table = [[[0, 0], [1, 1]], [[0, 0], [1, 2]], [[0, 0], [1, 3]]] }",
                Transfer::Table(Channels::Rgb([1.0, 2.0, 3.0].map(|light| vec![[0.0, 0.0], [1.0, light]]))),
            ),
        ] {
            let file: File = toml::from_str(text).unwrap();
            assert_eq!(file.transfer, transfer);
            assert_eq!(toml::from_str::<File>(&toml::to_string(&file).unwrap()).unwrap(), file);
        }
        let error = toml::from_str::<File>("transfer = { gamma = [1.0, 2.0] }").unwrap_err().to_string();
        assert!(error.contains("expected one value for all channels, or three values"), "{error}");
    }

    #[test]
    fn tables_that_fall_are_found() {
        assert_eq!(measured().problem(), None);
        for bad in [vec![], vec![[0.0, 0.0]], vec![[0.0, 0.0], [1.0, 0.0]], vec![[0.0, 0.0], [1.0, f64::NAN]]] {
            assert_eq!(Transfer::Table(Channels::Same(bad)).problem().unwrap().0, "table");
        }
        let falling = vec![[0.0, 1.0], [1.0, 0.0]];
        let good = vec![[0.0, 0.0], [1.0, 1.0]];
        assert_eq!(Transfer::Table(Channels::Rgb([good.clone(), falling, good])).problem().unwrap().0, "table[1]");
        assert_eq!(Transfer::gamma(0.0).problem().unwrap().0, "gamma");
    }
}
