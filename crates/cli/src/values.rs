//! Types of option values (sizes, angles, lists of numbers), and texts of sizes and durations.

use std::str::FromStr;

/// Two whole numbers, such as "420x262".
#[derive(Clone, Copy, Debug)]
pub(crate) struct Size(pub(crate) [usize; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Option<Vec<usize>> = text.split(['x', '×']).map(|part| part.trim().parse().ok()).collect();
        match parts.as_deref() {
            Some(&[a, b]) if a > 0 && b > 0 => Ok(Self([a, b])),
            _ => Err("expected two whole numbers above 0, such as 420x262".into()),
        }
    }
}

/// Two angles in degrees, such as "20x20".
#[derive(Clone, Copy, Debug)]
pub(crate) struct Angles(pub(crate) [f64; 2]);

impl FromStr for Angles {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Option<Vec<f64>> = text.split(['x', '×']).map(|part| part.trim().parse().ok()).collect();
        match parts.as_deref() {
            Some(&[a, b]) if (0.0..180.0).contains(&a) && (0.0..180.0).contains(&b) => Ok(Self([a, b])),
            _ => Err("expected two angles from 0 to less than 180 degrees, such as 20x20".into()),
        }
    }
}

/// `N` numbers, separated by commas.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers<const N: usize>(pub(crate) [f64; N]);

impl<const N: usize> FromStr for Numbers<N> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        parts
            .filter(|parts| parts.iter().all(|value| value.is_finite()))
            .and_then(|parts| parts.try_into().ok())
            .map(Self)
            .ok_or_else(|| format!("expected {N} numbers separated by commas"))
    }
}

/// Formats a number of bytes with a fitting unit.
pub(crate) fn size_text(bytes: u64) -> String {
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}

/// Formats a duration in a fitting unit.
pub(crate) fn duration_text(seconds: f64) -> String {
    match seconds {
        0.0 => "0 s".into(),
        s if s < 1.0 => format!("{:.0} ms", (1e3 * s).max(1.0)),
        s if s < 100.0 => format!("{s:.1} s"),
        s if s < 6000.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_numbers_are_checked() {
        assert_eq!("420x262".parse::<Size>().unwrap().0, [420, 262]);
        assert!("420".parse::<Size>().is_err() && "0x3".parse::<Size>().is_err());
        assert_eq!("-1.5,2".parse::<Numbers<2>>().unwrap().0, [-1.5, 2.0]);
        assert!("1,nan".parse::<Numbers<2>>().is_err() && "1".parse::<Numbers<2>>().is_err());
        assert!("20x180".parse::<Angles>().is_err());
    }

    #[test]
    fn durations_have_a_fitting_unit() {
        let found = [0.0, 1e-5, 0.25, 12.34, 600.0, 36000.0].map(duration_text);
        assert_eq!(found, ["0 s", "1 ms", "250 ms", "12.3 s", "10 min", "10.0 h"]);
    }
}
