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
        other => Err(PluginError::display(display, "layers that attenuate", format!("{other:?}").to_lowercase())),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_name_their_cause() {
        let mut display = Display::uniform([8, 6], 1.0, [3, 2], [20.0, 14.0], &[-3.0, 3.0], 4);
        display.name = "bench".into();
        assert_eq!((layers(&display, 2), attenuating(&display), uniform_backlight(&display)), (Ok(()), Ok(()), Ok(())));
        let refused = |text: &str| PluginError::Refused(text.into());
        assert_eq!(layers(&display, 3), Err(refused("display `bench`: expected 3 layers, found 2")));
        let expected = "display `bench`: expected a directional backlight, found a uniform one";
        assert_eq!(lenslets(&display).err(), Some(refused(expected)));
        display.formation = Formation::Additive;
        assert_eq!(
            attenuating(&display),
            Err(refused("display `bench`: expected layers that attenuate, found additive"))
        );
        display.backlight = Backlight::Lenslets(LensletBacklight::new(-6.0, [4, 3], 2.0, [3, 2], [20.0, 14.0]));
        assert!(lenslets(&display).is_ok() && uniform_backlight(&display).is_err());
    }
}
