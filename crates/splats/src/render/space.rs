//! The space in which splats are blended, with one another and with what stands behind them.

use lumistack_core::colour::srgb_decode;
use lumistack_scene::{Encoding, Scene};

/// Values in which the splats of a scene are blended. Captures are trained to blend sRGB code values, so nothing is linear light before all is blended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space(pub(crate) Encoding);

impl Space {
    /// The space of a scene; `None` where it has no splats. Clouds of both kinds are blended in sRGB.
    pub fn of(scene: &Scene) -> Option<Self> {
        let mut encodings = scene.placed_clouds.iter().map(|placed| scene.clouds[placed.cloud].encoding).peekable();
        encodings.peek()?;
        let all_linear = encodings.all(|encoding| encoding == Encoding::Linear);
        Some(Self(if all_linear { Encoding::Linear } else { Encoding::Srgb }))
    }

    /// What is seen in linear light where splats `[r, g, b, T]` of this space stand before linear light.
    pub fn over(self, splats: [f32; 4], behind: [f32; 3]) -> [f32; 3] {
        let [r, g, b, through] = splats;
        // nothing of splats: not even rounding
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

    /// What was seen before black, in linear light, as it is seen before a background of which the share `missed` comes through.
    pub fn before(self, seen: [f32; 3], missed: f32, background: [f32; 3]) -> [f32; 3] {
        let [r, g, b] = if self.0 == Encoding::Srgb { seen.map(encode) } else { seen };
        self.over([r, g, b, missed], background)
    }
}

/// The sRGB encoding, which goes on above white.
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
            // before a background of black it stays what it was
            let seen = space.over([0.2, 0.3, 0.1, 0.5], [0.0; 3]);
            for (now, then) in space.before(seen, 0.5, [0.0; 3]).into_iter().zip(seen) {
                assert!((now - then).abs() < 1e-6, "{now} {then}");
            }
        }
        // half of a white splat before white is white in either space, before black it is not
        let half = [0.5, 0.5, 0.5, 0.5];
        let [white, dark] = [[1.0; 3], [0.0; 3]].map(|behind| Space(Encoding::Srgb).over(half, behind)[0]);
        assert!((white - 1.0).abs() < 1e-6 && (dark - 0.214_04).abs() < 1e-4, "{white} {dark}");
        assert_eq!(Space(Encoding::Linear).over(half, [0.0; 3])[0], 0.5);
    }
}
