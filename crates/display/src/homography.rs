//! Projective maps of the plane. They map a panel's pixels to their real positions
//! ([`Panel`](crate::Panel)), and to the positions where a camera sees them.

/// A projective map of the plane, as the rows of a 3 × 3 matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub [[f64; 3]; 3]);

impl Homography {
    /// The identity, which maps every point to itself.
    pub const IDENTITY: Self = Self([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);

    /// Maps a point.
    #[inline]
    pub fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [a, b, c] = self.0.map(|row| row[0] * x + row[1] * y + row[2]);
        [a / c, b / c]
    }

    /// Returns the inverse map, computed by cofactors.
    pub fn inverse(&self) -> Self {
        let m = &self.0;
        let minor = |r: usize, c: usize| {
            let (r0, r1, c0, c1) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
            m[r0][c0] * m[r1][c1] - m[r0][c1] * m[r1][c0]
        };
        let determinant: f64 = (0..3).map(|c| m[0][c] * minor(0, c)).sum();
        Self([0, 1, 2].map(|r| [0, 1, 2].map(|c| minor(c, r) / determinant)))
    }

    /// Returns the map that applies `first`, then `self`.
    pub fn after(&self, first: &Self) -> Self {
        Self([0, 1, 2].map(|r| [0, 1, 2].map(|c| (0..3).map(|k| self.0[r][k] * first.0[k][c]).sum())))
    }

    /// Returns the map that takes the corners (0,0), (1,0), (1,1), (0,1) of the unit square to four
    /// points. `None` if the points span no area, or if the map would take a point of the square to
    /// infinity. Source: Heckbert, "Fundamentals of Texture Mapping and Image Warping" (1989),
    /// section 2.2.3.
    pub fn of_unit_square([a, b, c, d]: [[f64; 2]; 4]) -> Option<Self> {
        let (dx1, dx2, sx) = (b[0] - c[0], d[0] - c[0], a[0] - b[0] + c[0] - d[0]);
        let (dy1, dy2, sy) = (b[1] - c[1], d[1] - c[1], a[1] - b[1] + c[1] - d[1]);
        let area = dx1 * dy2 - dx2 * dy1;
        let (g, h) = ((sx * dy2 - dx2 * sy) / area, (dx1 * sy - sx * dy1) / area);
        let found = Self([
            [b[0] - a[0] + g * b[0], d[0] - a[0] + h * d[0], a[0]],
            [b[1] - a[1] + g * b[1], d[1] - a[1] + h * d[1], a[1]],
            [g, h, 1.0],
        ]);
        let sound = area.abs() > 1e-9 && [1.0, 1.0 + g, 1.0 + h, 1.0 + g + h].iter().all(|w| *w > 1e-9);
        (sound && found.0.iter().flatten().all(|value| value.is_finite())).then_some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_go_where_they_should_and_back() {
        let corners = [[3.0, 1.0], [9.0, 2.0], [8.0, 7.5], [2.0, 6.0]];
        let map = Homography::of_unit_square(corners).unwrap();
        let back = map.inverse();
        for (from, to) in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].into_iter().zip(corners) {
            let (there, again) = (map.apply(from), back.apply(to));
            assert!((0..2).all(|i| (there[i] - to[i]).abs() < 1e-12 && (again[i] - from[i]).abs() < 1e-12));
        }
        let same = map.after(&back).apply([4.0, 5.0]);
        assert!((same[0] - 4.0).abs() < 1e-12 && (same[1] - 5.0).abs() < 1e-12);
        // `None` for four equal points. Also `None` if one point is in the triangle of the other
        // three, since the map then takes a point of the square to infinity.
        assert_eq!(Homography::of_unit_square([[0.0, 0.0]; 4]), None);
        assert_eq!(Homography::of_unit_square([[0.0, 0.0], [10.0, 0.0], [3.0, 3.0], [0.0, 10.0]]), None);
    }
}
