//! Elementary functions without library calls: quicker, and the same on every platform.

/// Sine and cosine of an angle in turns, −1..1; absolute error below 1e-6.
#[inline]
pub(crate) fn sin_cos_turns(turns: f32) -> (f32, f32) {
    // nearest quarter and what is left, at most an eighth of a turn
    let quarters = (4.0 * turns + if turns < 0.0 { -0.5 } else { 0.5 }) as i32;
    let x = (turns - 0.25 * quarters as f32) * std::f32::consts::TAU;
    let x2 = x * x;
    // Taylor series; the first term left out is below 4e-8 for |x| ≤ π/4
    let sin = x * (1.0 + x2 * (-1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5040.0 + x2 * (1.0 / 362_880.0)))));
    let cos = 1.0 + x2 * (-0.5 + x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40_320.0))));
    match quarters & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_circle_is_round() {
        for i in -1000..=1000 {
            let turns = i as f32 / 1000.0;
            let (sin, cos) = sin_cos_turns(turns);
            let angle = f64::from(turns) * std::f64::consts::TAU;
            assert!(
                (f64::from(sin) - angle.sin()).abs() < 1e-6 && (f64::from(cos) - angle.cos()).abs() < 1e-6,
                "{turns}"
            );
        }
    }
}
