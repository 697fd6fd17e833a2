//! Writes the calibration of panels into the text of a display file. Values change, and missing
//! keys are added; comments and layout of the text stay.

use lumistack_plugin::display::{Backlight, Display, Panel};
use thiserror::Error;
use toml_edit::{Array, DocumentMut, Item, Table, TableLike, value};

/// The text cannot be updated, since it is not the file of this display.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{key}: expected {expected}, found {found}")]
pub struct KeepError {
    key: String,
    expected: String,
    found: String,
}

/// Returns the text of a display file, updated with the nudges (shifts of a panel's picture),
/// homographies and outputs of the display's panels. All else stays unchanged.
///
/// # Errors
/// If the text is not TOML, if its layers do not match the display, or if the updated text is not a
/// valid display file.
pub fn keep_panels(text: &str, display: &Display) -> Result<String, KeepError> {
    let wrong =
        |key: &str, expected: &str, found: String| KeepError { key: key.into(), expected: expected.into(), found };
    let mut document: DocumentMut =
        text.parse().map_err(|error: toml_edit::TomlError| wrong("display file", "TOML", error.message().into()))?;
    let count = display.layers.len();
    let found = match document.get_mut("layers") {
        Some(Item::ArrayOfTables(layers)) if layers.len() == count => {
            for (table, layer) in layers.iter_mut().zip(&display.layers) {
                keep(table, layer.panel.as_ref());
            }
            None
        }
        Some(Item::ArrayOfTables(layers)) => Some(format!("{}", layers.len())),
        _ => Some("none".into()),
    };
    if let Some(found) = found {
        return Err(wrong(
            "layers",
            &format!("one table [[layers]] for each layer of the display, {count} in all"),
            found,
        ));
    }
    if let Backlight::Lenslets(backlight) = &display.backlight
        && let Some(table) = document.get_mut("backlight").and_then(Item::as_table_like_mut)
    {
        keep(table, backlight.panel.as_ref());
    }
    let text = document.to_string();
    // Read the new text as a display, to verify it.
    match Display::from_toml(&text) {
        Ok(_) => Ok(text),
        Err(error) => Err(wrong("display file", "a display without errors", error.to_string())),
    }
}

fn keep(table: &mut dyn TableLike, panel: Option<&Panel>) {
    let Some(panel) = panel else { return };
    let entry = table.entry("panel").or_insert_with(|| Item::Table(Table::new()));
    let Some(own) = entry.as_table_like_mut() else { return };
    let mut put = |key: &str, new: Item| match own.get_mut(key) {
        // keep the comment after the value
        Some(Item::Value(old)) => {
            let decor = old.decor().clone();
            if let Item::Value(mut new) = new {
                *new.decor_mut() = decor;
                *old = new;
            }
        }
        _ => drop(own.insert(key, new)),
    };
    if let Some(output) = &panel.output {
        put("output", value(output.as_str()));
    }
    let numbers = |numbers: &[f64]| numbers.iter().copied().collect::<Array>();
    put("nudge_px", value(numbers(&panel.nudge_px)));
    if let Some(rows) = &panel.homography {
        let matrix: Array = rows.iter().map(|row| toml_edit::Value::Array(numbers(row))).collect();
        put("homography", value(matrix));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
# measured on a Tuesday
name = "two" # ours
frames = 1
[field]
resolution = [8, 6]
pitch_mm = 1.0
views = [1, 1]
fov_deg = [10.0, 10.0]
[[layers]]
d_mm = -4.0 # acrylic, 4.03 mm with a calliper
resolution = [8, 6]
pitch_mm = 1.0
[layers.panel]
output = "DP-1"
nudge_px = [1.0, 0.0] # by eye
[[layers]]
d_mm = 0.0
resolution = [8, 6]
pitch_mm = 1.0
"#;

    #[test]
    fn values_change_and_comments_stay() {
        let mut display = Display::from_toml(TEXT).unwrap();
        display.layers[0].panel.as_mut().unwrap().nudge_px = [2.5, -3.0];
        let second = display.layers[1].panel.get_or_insert_default();
        second.nudge_px = [0.0, 0.1];
        second.homography = Some([[1.0, 0.0, 0.25], [0.0, 1.0, 0.0], [0.0, 1e-5, 1.0]]);
        let text = keep_panels(TEXT, &display).unwrap();
        assert_eq!(Display::from_toml(&text).unwrap(), display);
        for comment in ["# measured on a Tuesday", "# ours", "# acrylic, 4.03 mm with a calliper"] {
            assert!(text.contains(comment), "{text}");
        }
        assert!(text.contains("nudge_px = [2.5, -3.0] # by eye"), "{text}");
        assert_eq!(keep_panels(&text, &display).unwrap(), text);
    }

    #[test]
    fn a_file_of_another_display_is_refused() {
        let mut display = Display::from_toml(TEXT).unwrap();
        display.layers.pop();
        let error = keep_panels(TEXT, &display).unwrap_err().to_string();
        assert_eq!(error, "layers: expected one table [[layers]] for each layer of the display, 1 in all, found 2");
        assert!(keep_panels("layers = 3", &display).is_err() && keep_panels("= 3", &display).is_err());
    }
}
