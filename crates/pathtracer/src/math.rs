//! Elementary functions without library calls: faster, and with equal results on every platform.

/// Returns the sine and cosine of an angle of −1..1 turns; absolute error below 1e-6.
#[inline]
pub(crate) fn sin_cos_turns(turns: f32) -> (f32, f32) {
    // split the angle into the nearest quarter turn and a remainder of at most an eighth of a turn
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

/// Returns the angle from the x axis to the vector (x, y), in turns, −0.5..0.5. The absolute error
/// is below 2e-7. The zero vector gives 0.
#[inline]
pub(crate) fn angle_turns(y: f32, x: f32) -> f32 {
    let (across, up) = (x.abs(), y.abs());
    let steep = up > across;
    let ratio = if steep { across / up } else { up / across.max(f32::MIN_POSITIVE) };
    // least-squares fit of atan(√s)/(2π √s) at Chebyshev nodes
    let s = ratio * ratio;
    let sum = 0.015_766_043 + s * (-0.009_448_567 + s * (0.003_846_168_5 + s * -0.000_743_058_34));
    let turns = ratio * (0.159_154_92 + s * (-0.053_049_46 + s * (0.031_782_024 + s * (-0.022_308_089 + s * sum))));
    let turns = if steep { 0.25 - turns } else { turns };
    let turns = if x < 0.0 { 0.5 - turns } else { turns };
    turns.copysign(y)
}

/// Maps the unit square to the unit disc, equal areas to equal areas (concentric map of Shirley,
/// Chiu 1997). The square is first scaled to coordinates a and b, each −1..1. It has two halves,
/// |a| > |b| and |a| ≤ |b|. One formula serves both halves; in the second half, x and y are
/// exchanged at the end. A branch would be slower, since no branch predictor can guess the half.
#[inline]
pub(crate) fn concentric_disc(u: [f32; 2]) -> (f32, f32) {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    let across = a.abs() > b.abs();
    let (radius, other) = if across { (a, b) } else { (b, a) };
    let x = std::f32::consts::FRAC_PI_4 * if radius == 0.0 { 0.0 } else { other / radius };
    let x2 = x * x;
    // Taylor series of sine and cosine, the sine with one term less than in `sin_cos_turns`; |x| is
    // at most π/4
    let sin = x * (1.0 + x2 * (-1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5040.0))));
    let cos = 1.0 + x2 * (-0.5 + x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40_320.0))));
    let (along, aside) = (radius * cos, radius * sin);
    if across { (along, aside) } else { (aside, along) }
}

/// Returns a number whose `count` lowest bits are set.
#[inline]
pub(crate) fn all_ones(count: usize) -> u32 {
    (1 << count) - 1
}

/// Returns the indices of the bits that are set.
#[inline]
pub(crate) fn ones(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = bits.trailing_zeros();
        bits &= bits.wrapping_sub(1);
        (place < u32::BITS).then_some(place as usize)
    })
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

    #[test]
    fn angles_are_those_of_the_library() {
        for i in -1000..=1000 {
            let angle = f64::from(i) / 1000.0 * std::f64::consts::PI;
            for length in [1e-6, 1.0, 1e6] {
                let (y, x) = ((length * angle.sin()) as f32, (length * angle.cos()) as f32);
                let expected = f64::from(y).atan2(f64::from(x)) / std::f64::consts::TAU;
                assert!((f64::from(angle_turns(y, x)) - expected).abs() < 2e-7, "{y} {x}");
            }
        }
        assert_eq!(angle_turns(0.0, 0.0), 0.0);
    }

    #[test]
    fn the_square_becomes_a_disc() {
        for i in 0..=100 {
            for j in 0..=100 {
                let u = [i as f32 / 100.0, j as f32 / 100.0];
                let (x, y) = concentric_disc(u);
                let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
                // a square around the centre becomes a circle, whose radius is the larger of |a|
                // and |b|
                assert!((x.hypot(y) - a.abs().max(b.abs())).abs() < 1e-5, "{u:?}");
                // Each eighth of the square becomes an eighth of the disc. In it, the angle to the
                // nearest axis is proportional to the ratio of the coordinates.
                let turn = |x: f32, y: f32| f64::from(y).atan2(f64::from(x));
                let expected = if a.abs() > b.abs() {
                    std::f64::consts::FRAC_PI_4 * f64::from(b / a) + if a < 0.0 { std::f64::consts::PI } else { 0.0 }
                } else if b != 0.0 {
                    std::f64::consts::FRAC_PI_2 - std::f64::consts::FRAC_PI_4 * f64::from(a / b)
                        + if b < 0.0 { std::f64::consts::PI } else { 0.0 }
                } else {
                    continue;
                };
                let difference = (turn(x, y) - expected).rem_euclid(std::f64::consts::TAU);
                assert!(difference.min(std::f64::consts::TAU - difference) < 1e-5, "{u:?}");
            }
        }
    }
}
