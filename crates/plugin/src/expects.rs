//! Functions by which nodes refuse displays that they do not support. Each error names the display,
//! the expected and the found property.

use lumistack_display::{Backlight, Display, Formation, LensletBacklight};

use crate::PluginError;

/// Requires `count` layers.
///
/// # Errors
/// If the display has another number of layers.
pub fn layers(display: &Display, count: usize) -> Result<(), PluginError> {
    let found = display.layers.len();
    let expected = match count {
        1 => "one layer".into(),
        2 => "two layers".into(),
        _ => format!("{count} layers"),
    };
    if found == count { Ok(()) } else { Err(PluginError::display(display, expected, found)) }
}

/// Requires attenuating layers.
///
/// # Errors
/// If the layers form the picture in another way.
pub fn attenuating(display: &Display) -> Result<(), PluginError> {
    match display.formation {
        Formation::Attenuating => Ok(()),
        other => Err(PluginError::display(
            display,
            "the formation `attenuating`",
            format!("the formation `{}`", format!("{other:?}").to_lowercase()),
        )),
    }
}

/// Requires a uniform backlight.
///
/// # Errors
/// If the backlight is directional.
pub fn uniform_backlight(display: &Display) -> Result<(), PluginError> {
    match display.backlight {
        Backlight::Uniform => Ok(()),
        Backlight::Lenslets(_) => Err(PluginError::display(display, "a uniform backlight", "a directional one")),
    }
}

/// Requires a directional backlight, and returns it.
///
/// # Errors
/// If the backlight is uniform.
pub fn lenslets(display: &Display) -> Result<&LensletBacklight, PluginError> {
    match &display.backlight {
        Backlight::Lenslets(lenslets) => Ok(lenslets),
        Backlight::Uniform => Err(PluginError::display(display, "a directional backlight", "a uniform one")),
    }
}

/// Requires that the pixels of every layer have the size and the places of the light field's
/// pixels. Displays may have layers with other pixels; for these,
/// [`RayMap`](lumistack_display::RayMap) returns the pixels that a ray hits.
///
/// # Errors
/// If a layer has other pixels, or the display's geometry is invalid.
pub fn same_pixels(display: &Display) -> Result<(), PluginError> {
    let geometry = display.geometry().map_err(|error| PluginError::Refused(error.to_string()))?;
    let wanted = ([geometry.cols, geometry.rows], geometry.pitch_mm, [0.0; 2]);
    let text = |([cols, rows], pitch_mm, [x, y]): ([usize; 2], f64, [f64; 2])| {
        format!("{cols} × {rows} pixels of {pitch_mm} mm and an offset of {x}, {y} mm")
    };
    for (number, layer) in display.layers.iter().enumerate() {
        let found = (layer.resolution, layer.pitch_mm, layer.offset_mm);
        if found != wanted {
            let expected = format!("layers with the pixels of the light field ({})", text(wanted));
            return Err(PluginError::display(display, expected, format!("layer {number} with {}", text(found))));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_name_their_cause() {
        let mut display = Display::uniform([8, 6], 1.0, [3, 2], [20.0, 14.0], &[-3.0, 3.0], 4);
        display.name = "bench".into();
        assert_eq!((layers(&display, 2), attenuating(&display), uniform_backlight(&display)), (Ok(()), Ok(()), Ok(())));
        assert_eq!(same_pixels(&display), Ok(()));
        let refused = |text: &str| PluginError::Refused(text.into());
        assert_eq!(layers(&display, 3), Err(refused("display `bench`: expected 3 layers, found 2")));
        let expected = "display `bench`: expected a directional backlight, found a uniform one";
        assert_eq!(lenslets(&display).err(), Some(refused(expected)));
        display.layers[1].resolution = [4, 3];
        display.layers[1].pitch_mm = 2.0;
        let expected = "display `bench`: expected layers with the pixels of the light field (8 × 6 pixels of 1 mm and an offset of 0, 0 mm), \
                        found layer 1 with 4 × 3 pixels of 2 mm and an offset of 0, 0 mm";
        assert_eq!(same_pixels(&display), Err(refused(expected)));
        display.formation = Formation::Additive;
        assert_eq!(
            attenuating(&display),
            Err(refused("display `bench`: expected the formation `attenuating`, found the formation `additive`"))
        );
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-6.0, [4, 3], 2.0, [3, 2], [20.0, 14.0]));
        assert!(lenslets(&display).is_ok() && uniform_backlight(&display).is_err());
    }
}
