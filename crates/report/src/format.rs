//! Formats numbers for readers. Units are in the surrounding text, unless the name or the comment
//! of a function names a unit.

use serde_json::Value;

/// Converts a number to JSON: `"Infinity"` or `"-Infinity"` for infinite values, null for NaN.
pub(crate) fn figure(value: f64) -> Value {
    match value {
        f64::INFINITY => "Infinity".into(),
        f64::NEG_INFINITY => "-Infinity".into(),
        // For NaN this gives null, as serde_json does for every NaN.
        finite => finite.into(),
    }
}

/// Formats decibels with one decimal; "∞" for equal pictures, "–" if no rays were compared.
pub(crate) fn decibels(value: f64) -> String {
    match value {
        v if v.is_nan() => "–".into(),
        f64::INFINITY => "∞".into(),
        v => minus(format!("{v:.1}")),
    }
}

/// Formats small differences in decibels: two decimals below 1 dB.
pub(crate) fn decibels_fine(value: f64) -> String {
    match value.abs() {
        v if v < 0.005 => "0.00".into(),
        v if v < 0.995 => minus(format!("{value:.2}")),
        _ => decibels(value),
    }
}

/// Formats a value with two decimals below 9.95, one below 99.5, and none above.
pub(crate) fn number_short(value: f64) -> String {
    match value.abs() {
        v if v >= 99.5 => format!("{value:.0}"),
        v if v >= 9.95 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

/// Formats SSIM or FLIP with three decimals; "–" if no rays were compared.
pub(crate) fn similarity(value: f64) -> String {
    if value.is_nan() { "–".into() } else { minus(format!("{value:.3}")) }
}

/// Formats seconds with a unit: "0.42 s", "12.3 s", "3 min 05 s".
pub(crate) fn duration(seconds: f64) -> String {
    match seconds {
        s if !s.is_finite() => "–".into(),
        s if s < 9.995 => format!("{s:.2} s"),
        s if s < 99.95 => format!("{s:.1} s"),
        s => {
            let total = s.round() as u64;
            match total / 3600 {
                0 => format!("{} min {:02} s", total / 60, total % 60),
                hours => format!("{hours} h {:02} min", total % 3600 / 60),
            }
        }
    }
}

/// Formats round numbers of seconds without unnecessary digits: "20 ms", "0.5 s", "50 s". Longer
/// times have the format of [`duration`].
pub(crate) fn duration_short(seconds: f64) -> String {
    match seconds {
        s if s < 0.0995 => format!("{} ms", number_short_round(1e3 * s)),
        s if s < 99.95 => format!("{} s", number_short_round(s)),
        s => duration(s),
    }
}

/// Formats a number with at most two decimals, without trailing zeros.
fn number_short_round(value: f64) -> String {
    format!("{value:.2}").trim_end_matches('0').trim_end_matches('.').into()
}

/// Formats a slope (tangent) as a signed angle with its unit: "+8.0°".
pub(crate) fn angle(slope: f64) -> String {
    let degrees = slope.atan().to_degrees();
    // Avoid "−0.0°".
    if degrees.abs() < 0.05 { "0.0°".into() } else { minus(format!("{degrees:+.1}°")) }
}

/// Formats a number with at most four decimals, without trailing zeros.
pub(crate) fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    minus(if text == "-0" { "0".into() } else { text.into() })
}

/// Formats a fraction as a percentage. A fraction below 1 gives at most 99.9 %, 1 or more gives
/// 100 %, and NaN gives "–".
pub(crate) fn percent(share: f64) -> String {
    if share.is_nan() {
        return "–".into();
    }
    if share < 1.0 { format!("{:.1} %", (share * 100.0).min(99.9)) } else { "100 %".into() }
}

/// Formats a count with its noun: "1 frame", "3 frames".
pub(crate) fn counted(count: usize, noun: &str) -> String {
    if count == 1 { format!("1 {noun}") } else { format!("{count} {noun}s") }
}

/// Converts a relative path to a link. Replaces `\` by `/`, and percent-encodes all other bytes
/// except `/` and unreserved characters. So the link cannot contain a scheme.
pub(crate) fn relative_href(path: &str) -> String {
    let mut href = String::from("./");
    for byte in path.trim_start_matches(['/', '\\']).bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' | b'/' => href.push(byte.into()),
            b'\\' => href.push('/'),
            _ => href.push_str(&format!("%{byte:02X}")),
        }
    }
    href
}

fn minus(text: String) -> String {
    text.replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(decibels(31.25), "31.2");
        assert_eq!(decibels(-3.04), "−3.0");
        assert_eq!((decibels(f64::INFINITY), decibels(f64::NAN)), ("∞".into(), "–".into()));
        assert_eq!(
            [0.4249, 12.34, 185.4, 7265.0, f64::NAN].map(duration),
            ["0.42 s", "12.3 s", "3 min 05 s", "2 h 01 min", "–"]
        );
        assert_eq!([-0.141, 0.0, -1e-9].map(angle), ["−8.0°", "0.0°", "0.0°"]);
        assert_eq!([-40.0, 0.2827, 2.961, -0.00001].map(number), ["−40", "0.2827", "2.961", "0"]);
        assert_eq!([0.03, 0.999, -2.0, -0.001].map(decibels_fine), ["0.03", "1.0", "−2.0", "0.00"]);
        assert_eq!([0.719, 12.34, 250.4].map(number_short), ["0.72", "12.3", "250"]);
        assert_eq!(
            [0.02, 0.5, 0.737, 50.0, 200.0].map(duration_short),
            ["20 ms", "0.5 s", "0.74 s", "50 s", "3 min 20 s"]
        );
        assert_eq!([0.9312, f64::NAN].map(similarity), ["0.931", "–"]);
        assert_eq!([1.0, 0.99999, 0.913, f64::NAN].map(percent), ["100 %", "99.9 %", "91.3 %", "–"]);
    }

    #[test]
    fn a_path_cannot_become_a_scheme() {
        assert_eq!(relative_href("javascript:alert(1)"), "./javascript%3Aalert%281%29");
        assert_eq!(relative_href("//host/a b#c.png"), "./host/a%20b%23c.png");
        assert_eq!(relative_href("outputs/layer 0.png"), "./outputs/layer%200.png");
    }
}
