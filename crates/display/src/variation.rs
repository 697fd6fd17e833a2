//! Changes of a display's values, for the comparison of designs.

use serde::{Deserialize, Serialize};

use crate::{Backlight, Display, DisplayError};

/// Changes to a display. A value that is `None` stays the same.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Variation {
    /// Number of layers N. Layers are `gap_mm` apart around the middle of the old stack; new layers
    /// are like the frontmost one. A directional backlight keeps its distance from the rearmost
    /// layer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub layers: Option<usize>,
    /// Number of frames M.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Brightness scale β.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub brightness: Option<f64>,
    /// Distance of neighbouring layers Δd, millimetres. If only `layers` is given, the distance is
    /// the mean of the old distances.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gap_mm: Option<f64>,
    /// [horizontal, vertical] full angles of view of the light field and the backlight, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_deg: Option<[f64; 2]>,
    /// [columns, rows] of lenslets. Their pitch changes so that their total width stays the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lenslets: Option<[usize; 2]>,
}

impl Variation {
    /// Returns the changed display, after a check of its values.
    ///
    /// # Errors
    /// If a value is out of range, or if layers are added to a single layer without a gap.
    pub fn applied_to(&self, base: &Display) -> Result<Display, DisplayError> {
        let mut display = base.clone();
        display.frames = self.frames.unwrap_or(display.frames);
        display.brightness = self.brightness.unwrap_or(display.brightness);
        if let Some(fov_deg) = self.fov_deg {
            display.field.fov_deg = fov_deg;
        }
        if self.layers.is_some() || self.gap_mm.is_some() {
            self.restack(&mut display)?;
        }
        if let Backlight::Lenslets(backlight) = &mut display.backlight {
            if let Some(lenslets) = self.lenslets {
                backlight.pitch_mm *= backlight.lenslets[0] as f64 / lenslets[0].max(1) as f64;
                backlight.lenslets = lenslets;
            }
            backlight.fov_deg = self.fov_deg.unwrap_or(backlight.fov_deg);
        }
        display.check()?;
        Ok(display)
    }

    fn restack(&self, display: &mut Display) -> Result<(), DisplayError> {
        let fail = |key: &str, expected: &str, found: String| {
            Err(DisplayError::Value { key: key.into(), expected: expected.into(), found })
        };
        let old = display.layers.len();
        let count = self.layers.unwrap_or(old);
        if !(1..=MOST_LAYERS).contains(&count) {
            return fail("layers", "1 to 64 layers", count.to_string());
        }
        let (Some(first), Some(last)) = (display.layers.first().cloned(), display.layers.last().cloned()) else {
            return fail("layers", "at least one layer", "none".into());
        };
        // use the given gap, or the mean of the old gaps
        let mean_gap = (old > 1).then(|| (last.d_mm - first.d_mm) / (old as f64 - 1.0));
        let gap_mm = match self.gap_mm.or(mean_gap) {
            Some(gap_mm) if gap_mm.is_finite() && gap_mm > 0.0 => gap_mm,
            Some(gap_mm) => return fail("gap_mm", "a distance above 0", gap_mm.to_string()),
            None if count == 1 => 0.0,
            None => {
                return fail(
                    "gap_mm",
                    "the distance between layers, since the display has a single layer and therefore no gap",
                    "none".into(),
                );
            }
        };
        let middle = 0.5 * (first.d_mm + last.d_mm);
        display.layers = (0..count)
            .map(|n| {
                let mut layer = display.layers.get(n).unwrap_or(&last).clone();
                layer.d_mm = middle + (n as f64 - 0.5 * (count as f64 - 1.0)) * gap_mm;
                layer
            })
            .collect();
        if let Backlight::Lenslets(backlight) = &mut display.backlight {
            backlight.d_mm += display.layers[0].d_mm - first.d_mm;
        }
        Ok(())
    }
}

/// Largest number of layers. Larger numbers are surely mistakes, since such a stack would transmit
/// no light.
const MOST_LAYERS: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LensletBacklight;
    use crate::config::tests::small_display;

    #[test]
    fn layers_stand_around_the_old_middle() {
        let base = small_display();
        let two = Variation { layers: Some(2), ..Variation::default() }.applied_to(&base).unwrap();
        assert_eq!(two.layers.iter().map(|layer| layer.d_mm).collect::<Vec<_>>(), [-6.0, 6.0]);
        let wide = Variation { gap_mm: Some(20.0), frames: Some(7), ..Variation::default() }.applied_to(&base).unwrap();
        assert_eq!(wide.layers.iter().map(|layer| layer.d_mm).collect::<Vec<_>>(), [-20.0, 0.0, 20.0]);
        assert_eq!((wide.frames, wide.brightness), (7, 0.2));
        assert_eq!(Variation::default().applied_to(&base).unwrap(), base);
    }

    #[test]
    fn a_backlight_keeps_its_distance_and_its_area() {
        let mut base = Display::uniform([16, 10], 1.0, [3, 3], [20.0, 20.0], &[0.0], 2);
        base.backlight = Backlight::Lenslets(LensletBacklight::new(-8.5, [4, 3], 4.0, [3, 3], [20.0, 20.0]));
        let error = Variation { layers: Some(3), ..Variation::default() }.applied_to(&base).unwrap_err();
        assert!(error.to_string().starts_with("gap_mm: expected the distance between layers"), "{error}");
        let change = Variation {
            layers: Some(3),
            gap_mm: Some(40.0),
            lenslets: Some([8, 6]),
            fov_deg: Some([30.0, 20.0]),
            ..Variation::default()
        };
        let display = change.applied_to(&base).unwrap();
        let Backlight::Lenslets(backlight) = &display.backlight else { panic!("no backlight") };
        assert_eq!((backlight.d_mm, backlight.pitch_mm, backlight.fov_deg), (-48.5, 2.0, [30.0, 20.0]));
        assert_eq!(display.field.fov_deg, [30.0, 20.0]);
        for wrong in [
            Variation { layers: Some(0), ..Variation::default() },
            Variation { gap_mm: Some(-1.0), ..Variation::default() },
            Variation { lenslets: Some([0, 3]), ..Variation::default() },
            Variation { brightness: Some(2.0), ..Variation::default() },
        ] {
            assert!(wrong.applied_to(&base).is_err(), "{wrong:?}");
        }
    }
}
