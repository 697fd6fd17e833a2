//! Normals of diffuse scattering, and the shadows of the bumps that a normal map represents.

use glam::Vec3;

/// Normals of diffuse scattering, unit vectors on the viewer's side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Normals {
    /// Normal interpolated from the vertices, then turned by a normal map.
    pub(crate) mapped: Vec3,
    /// Normal interpolated from the vertices.
    smooth: Vec3,
    /// α² of the GGX distribution of the bumps that the normal map represents; 0 without a normal
    /// map.
    alpha2: f32,
}

impl Normals {
    /// Returns the normals of a point with a normal map. The bumps that the map represents have α²
    /// = tan²(angle between `mapped` and `smooth`) / 8, at most 1.
    #[inline]
    pub(crate) fn new(mapped: Vec3, smooth: Vec3) -> Self {
        if mapped == smooth {
            return Self::smooth(smooth);
        }
        let cosine2 = mapped.dot(smooth).powi(2);
        Self { mapped, smooth, alpha2: ((1.0 - cosine2) / (8.0 * cosine2).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0) }
    }

    /// Returns the normals of a point without a normal map.
    #[inline]
    pub(crate) fn smooth(normal: Vec3) -> Self {
        Self { mapped: normal, smooth: normal, alpha2: 0.0 }
    }

    /// Returns the same normals in another frame; `turn` maps a vector to that frame.
    pub(crate) fn turned(&self, turn: impl Fn(Vec3) -> Vec3) -> Self {
        let mapped = turn(self.mapped);
        Self { mapped, smooth: if self.alpha2 == 0.0 { mapped } else { turn(self.smooth) }, alpha2: self.alpha2 }
    }

    /// Returns the fraction of the light from `direction` that the bumps do not shadow. θ is the
    /// angle between `direction` and the smooth normal:
    ///
    /// ```text
    /// 2 cos θ / (cos θ + √(cos² θ + α² sin² θ))
    /// ```
    ///
    /// This is Smith's shadowing of a GGX surface with this α. With the cosine to the mapped normal
    /// alone, light would end in a hard edge where the smooth surface turns away. It would also
    /// reach slopes that neighbouring bumps hide. Source: Estevez, Lecocq, Stein 2019, "A
    /// microfacet-based shadowing function to solve the bump terminator problem", Ray Tracing Gems.
    #[inline]
    pub(crate) fn unshadowed(&self, direction: Vec3) -> f32 {
        if self.alpha2 == 0.0 {
            return 1.0;
        }
        let cosine = self.smooth.dot(direction).max(0.0);
        let cosine2 = cosine * cosine;
        2.0 * cosine / (cosine + (cosine2 + self.alpha2 * (1.0 - cosine2).max(0.0)).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bumps shadow all light that arrives along the smooth surface, and no light from straight
    /// above. In between, the shadow grows steadily with the bumps' steepness, and as the light
    /// gets lower.
    #[test]
    fn the_shadow_of_bumps_ends_softly() {
        let from = |degrees: f32| Vec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos());
        let [mild, steep] = [20.0, 55.0].map(|degrees| Normals::new(from(degrees), Vec3::Z));
        for normals in [mild, steep] {
            assert!((normals.unshadowed(Vec3::Z) - 1.0).abs() < 1e-6);
            assert!(normals.unshadowed(from(89.99)) < 0.01 && normals.unshadowed(from(95.0)) == 0.0);
            for degrees in 0..80 {
                let step = normals.unshadowed(from(degrees as f32)) - normals.unshadowed(from(degrees as f32 + 1.0));
                assert!((0.0..0.05).contains(&step), "{degrees}: {step}");
            }
        }
        assert!(steep.unshadowed(from(70.0)) < mild.unshadowed(from(70.0)));
        // an angle of 45° gives α² = tan² 45° / 8 = 1/8, and light at θ = 45° keeps 2 / (1 +
        // √1.125)
        let even = Normals::new(from(45.0), Vec3::Z);
        assert!((even.unshadowed(from(45.0)) - 2.0 / (1.0 + 1.125f32.sqrt())).abs() < 1e-5);
        assert_eq!(Normals::new(Vec3::X, Vec3::X).unshadowed(Vec3::Z), 1.0, "vertex normals alone");
    }
}
