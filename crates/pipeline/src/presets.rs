//! Presets of displays: the paper's prototypes, and the displays of the paper's figures.

use std::path::Path;

use lumistack_core::config::nearest;
use lumistack_display::Display;
pub use lumistack_display::PRESETS;

use crate::error::{PipelineError, read_to_string};

/// Returns the names of the presets.
pub fn names() -> impl Iterator<Item = &'static str> {
    PRESETS.iter().map(|(name, _)| *name)
}

/// Loads the preset `name`.
///
/// # Errors
/// If there is no such preset; the error suggests a similar name, if there is one.
pub fn load(name: &str) -> Result<Display, PipelineError> {
    let Some((_, text)) = PRESETS.iter().find(|(preset, _)| *preset == name) else {
        return Err(PipelineError::UnknownDisplay {
            name: name.into(),
            nearest: nearest(name, names()).map(String::from),
        });
    };
    parse(Path::new(name), text)
}

/// Reads a display file.
///
/// # Errors
/// If the file cannot be read, does not parse, or has a wrong value.
pub fn load_file(path: &Path) -> Result<Display, PipelineError> {
    parse(path, &read_to_string(path)?)
}

fn parse(path: &Path, text: &str) -> Result<Display, PipelineError> {
    Display::from_toml(text).map_err(|source| PipelineError::Display {
        path: path.to_owned(),
        text: text.into(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_loads_and_every_value_names_its_source() {
        for (name, text) in PRESETS {
            let display = load(name).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert!(display.frames >= 1);
            let first = text.lines().next().unwrap();
            assert!(first.ends_with('.'), "{name}: `lumistack displays` prints the first line, a sentence: {first}");
            for line in text.lines().filter(|line| line.contains(" = ") && !line.starts_with('#')) {
                let source = line.split_once(" # ").map_or("", |(_, source)| source);
                let known = ["paper: ", "derived: ", "ours"].iter().any(|tag| source.starts_with(tag));
                assert!(known, "{name}: `{line}` does not say where its value comes from");
            }
        }
    }

    #[test]
    fn every_preset_file_is_built_in() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/displays");
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
            assert!(PRESETS.iter().any(|(name, _)| *name == stem), "{stem} is not in the list");
        }
    }

    #[test]
    fn an_unknown_name_suggests_the_nearest() {
        let error = load("paper-three-layers").unwrap_err().to_string();
        assert!(error.contains("did you mean `paper-three-layer`"), "{error}");
    }

    #[test]
    fn the_prototype_has_the_papers_parameters() {
        let display = load("paper-three-layer").unwrap();
        assert_eq!(display.layers.iter().map(|layer| layer.d_mm).collect::<Vec<_>>(), [-40.0, 0.0, 40.0]);
        assert_eq!((display.frames, display.brightness, display.refresh_hz), (12, 0.2, 120.0));
        assert_eq!(display.views(), [25, 25]);
        let directional = load("paper-directional").unwrap();
        let lumistack_display::Backlight::Lenslets(lenslets) = &directional.backlight else {
            panic!("no directional backlight")
        };
        assert_eq!((lenslets.lenslets, lenslets.d_mm, lenslets.pitch_mm), ([187, 117], -8.5, 2.54));
    }
}
