//! Values of options: sizes, angles, lists of numbers.

use std::str::FromStr;

/// Two whole numbers, "420x262".
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

/// Two angles, "20x20".
#[derive(Clone, Copy, Debug)]
pub(crate) struct Angles(pub(crate) [f64; 2]);

impl FromStr for Angles {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Option<Vec<f64>> = text.split(['x', '×']).map(|part| part.trim().parse().ok()).collect();
        match parts.as_deref() {
            Some(&[a, b]) if (0.0..180.0).contains(&a) && (0.0..180.0).contains(&b) => Ok(Self([a, b])),
            _ => Err("expected two angles of 0 to less than 180 degrees, such as 20x20".into()),
        }
    }
}

/// Numbers between commas.
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
            .ok_or_else(|| format!("expected {N} numbers between commas"))
    }
}

/// A size on disk or in memory, for people.
pub(crate) fn size_text(bytes: u64) -> String {
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
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
}
