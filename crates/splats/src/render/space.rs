//! The colour space in which splats are blended with one another, and with the surfaces behind
//! them.

use lumistack_core::colour::srgb_decode;
use lumistack_scene::{Encoding, Scene};

/// The colour space in which a scene's splats are blended.
///
/// Captures are trained by blending sRGB values, so light is converted to linear radiance only
/// after all splats are blended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space(pub(crate) Encoding);

impl Space {
    /// Returns the space of a scene's splats, or `None` if the scene has no splats. A scene with
    /// clouds of both encodings is blended in sRGB.
    pub fn of(scene: &Scene) -> Option<Self> {
        let mut encodings = scene.placed_clouds.iter().map(|placed| scene.clouds[placed.cloud].encoding).peekable();
        encodings.peek()?;
        let all_linear = encodings.all(|encoding| encoding == Encoding::Linear);
        Some(Self(if all_linear { Encoding::Linear } else { Encoding::Srgb }))
    }

    /// Blends splats `[r, g, b, T]` of this space, with transmittance T, over linear radiance.
    /// Returns linear radiance.
    pub fn over(self, splats: [f32; 4], behind: [f32; 3]) -> [f32; 3] {
        let [r, g, b, through] = splats;
        // without splats the radiance stays the same to the last bit
        if splats == [0.0, 0.0, 0.0, 1.0] {
            return behind;
        }
        match self.0 {
            Encoding::Linear => [0, 1, 2].map(|c| splats[c] + through * behind[c]),
            Encoding::Srgb => {
                let own = [r, g, b];
                [0, 1, 2].map(|c| srgb_decode(own[c] + through * encode(behind[c])))
            }
        }
    }

    /// Blends a picture over a background. The picture is linear radiance that was rendered over
    /// black. `missed` is the fraction of the background that is visible.
    pub fn before(self, seen: [f32; 3], missed: f32, background: [f32; 3]) -> [f32; 3] {
        let [r, g, b] = if self.0 == Encoding::Srgb { seen.map(encode) } else { seen };
        self.over([r, g, b, missed], background)
    }
}

/// Returns the sRGB encoding, extended to values above 1.
fn encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear.max(0.0) } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_changes_nothing_and_captures_blend_code_values() {
        let behind = [0.3, 1.7, 0.0];
        for space in [Space(Encoding::Srgb), Space(Encoding::Linear)] {
            assert_eq!(space.over([0.0, 0.0, 0.0, 1.0], behind), behind);
            // a black background changes no value
            let seen = space.over([0.2, 0.3, 0.1, 0.5], [0.0; 3]);
            for (now, then) in space.before(seen, 0.5, [0.0; 3]).into_iter().zip(seen) {
                assert!((now - then).abs() < 1e-6, "{now} {then}");
            }
        }
        // a white splat of opacity one half over white is white; over black the two spaces differ
        let half = [0.5, 0.5, 0.5, 0.5];
        let [white, dark] = [[1.0; 3], [0.0; 3]].map(|behind| Space(Encoding::Srgb).over(half, behind)[0]);
        assert!((white - 1.0).abs() < 1e-6 && (dark - 0.214_04).abs() < 1e-4, "{white} {dark}");
        assert_eq!(Space(Encoding::Linear).over(half, [0.0; 3])[0], 0.5);
    }
}
