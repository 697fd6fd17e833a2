//! Assigns outputs to the panels of a display.

use lumistack_plugin::display::{Backlight, Display};
use thiserror::Error;

use crate::Shows;

/// An output of the computer. The output drives a monitor, or a panel through an adapter.
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// The output's name, which is the same in every session.
    pub name: String,
    /// [x, y] of the output's upper left corner in the layout of all outputs, pixels.
    pub position: [i32; 2],
    /// [columns, rows] of the output's pixels.
    pub size: [usize; 2],
    /// Refresh rate reported by the platform, hertz.
    pub refresh_hz: Option<f64>,
}

/// The outputs do not match the display.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AssignError {
    /// There are no outputs.
    #[error(
        "outputs: expected {needed}, one for each of {wanted}; found none. Check that a monitor is on, and that this session has a screen"
    )]
    None {
        /// Number of outputs required.
        needed: usize,
        /// The panels to show.
        wanted: String,
    },
    /// There are too few outputs.
    #[error("outputs: expected {needed}, one for each of {wanted}; found {found}")]
    TooFew {
        /// Number of outputs required.
        needed: usize,
        /// The panels to show.
        wanted: String,
        /// The names of the outputs that are present.
        found: String,
    },
    /// The display file names an output that is not present.
    #[error("{key}: expected one of the outputs {found}, found \"{name}\"")]
    Unknown {
        /// The key of the display file.
        key: String,
        /// The name of an output, which is the value of the key.
        name: String,
        /// The names of the outputs that are present.
        found: String,
    },
    /// The display file names an output twice.
    #[error("{key}: expected an output that no other panel uses, found \"{name}\" again")]
    Twice {
        /// The key of the display file.
        key: String,
        /// The name of an output, which is the value of the key.
        name: String,
    },
}

/// Returns the key of the display file that names a panel's output.
pub fn key(shows: Shows) -> String {
    match shows {
        Shows::Backlight => "backlight.panel.output".into(),
        Shows::Layer(n) => format!("layers[{n}].panel.output"),
    }
}

/// Returns the output that the display file names for a panel.
pub fn named(display: &Display, shows: Shows) -> Option<&str> {
    let panel = match (shows, &display.backlight) {
        (Shows::Layer(n), _) => display.layers[n].panel.as_ref(),
        (Shows::Backlight, Backlight::Lenslets(backlight)) => backlight.panel.as_ref(),
        (Shows::Backlight, Backlight::Uniform) => None,
    };
    panel.and_then(|panel| panel.output.as_deref())
}

/// Assigns an output to every panel, rear to front. Panels without a named output take the free
/// outputs, sorted by x, then by y, then by name.
///
/// # Errors
/// If there are too few outputs, or the display file names an output that is not present, or names
/// one output twice.
pub fn assign(display: &Display, outputs: &[Output]) -> Result<Vec<(Shows, Output)>, AssignError> {
    let all = Shows::all(display);
    let (needed, wanted) = (all.len(), list(all.iter().map(Shows::to_string)));
    let found = || list(outputs.iter().map(|output| output.name.clone()));
    if outputs.is_empty() {
        return Err(AssignError::None { needed, wanted });
    }
    // Check the named outputs first, so that unknown and repeated names are reported.
    let mut taken: Vec<&str> = Vec::new();
    for &shows in &all {
        let Some(name) = named(display, shows) else { continue };
        let (key, name_owned) = (key(shows), name.to_string());
        if taken.contains(&name) {
            return Err(AssignError::Twice { key, name: name_owned });
        }
        if !outputs.iter().any(|output| output.name == name) {
            return Err(AssignError::Unknown { key, name: name_owned, found: found() });
        }
        taken.push(name);
    }
    if outputs.len() < needed {
        return Err(AssignError::TooFew { needed, wanted, found: found() });
    }
    // Panels without a named output take the other outputs from left to right.
    let mut free: Vec<&Output> = outputs.iter().filter(|output| !taken.contains(&output.name.as_str())).collect();
    free.sort_by(|a, b| (a.position, &a.name).cmp(&(b.position, &b.name)));
    let mut free = free.into_iter();
    let chosen = all.into_iter().map(|shows| {
        let output = match named(display, shows) {
            Some(name) => outputs.iter().find(|output| output.name == name),
            None => free.next(),
        };
        (shows, output.expect("there are enough outputs, and all named outputs exist").clone())
    });
    Ok(chosen.collect())
}

/// A change of an output to which a panel is assigned.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// The output is no longer present.
    Gone,
    /// The output in its new state: its size has changed, or its position if positions are
    /// compared.
    Other(Output),
}

/// Compares the output `was` with the output of the same name in `now`. Returns `None` if size and
/// position are unchanged. Positions are compared only if `placed` is true.
pub fn change(was: &Output, now: &[Output], placed: bool) -> Option<Change> {
    let Some(is) = now.iter().find(|output| output.name == was.name) else { return Some(Change::Gone) };
    let same = is.size == was.size && (!placed || is.position == was.position);
    (!same).then(|| Change::Other(is.clone()))
}

/// Returns the upper left corner [x, y] and the size [columns, rows] of the bounding rectangle of
/// outputs.
///
/// # Panics
/// If there are no outputs.
pub fn bounds<'a>(outputs: impl IntoIterator<Item = &'a Output>) -> ([i32; 2], [usize; 2]) {
    let corners = outputs.into_iter().map(|output| {
        let end = [0, 1].map(|axis| output.position[axis] + output.size[axis] as i32);
        (output.position, end)
    });
    let all = corners.reduce(|(low, high), (start, end)| {
        ([0, 1].map(|axis| low[axis].min(start[axis])), [0, 1].map(|axis| high[axis].max(end[axis])))
    });
    let (low, high) = all.expect("at least one output");
    (low, [0, 1].map(|axis| (high[axis] - low[axis]) as usize))
}

fn list(words: impl Iterator<Item = String>) -> String {
    words.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use lumistack_plugin::display::{LensletBacklight, Panel};

    use super::*;

    fn output(name: &str, x: i32) -> Output {
        Output { name: name.into(), position: [x, 0], size: [100, 50], refresh_hz: Some(60.0) }
    }

    fn display(names: &[Option<&str>]) -> Display {
        let d_mm: Vec<f64> = (0..names.len()).map(|n| n as f64).collect();
        let mut display = Display::uniform([10, 5], 1.0, [1, 1], [10.0, 10.0], &d_mm, 1);
        for (layer, name) in display.layers.iter_mut().zip(names) {
            layer.panel = name.map(|name| Panel { output: Some(name.into()), ..Panel::default() });
        }
        display
    }

    fn names(display: &Display, outputs: &[Output]) -> Result<Vec<String>, AssignError> {
        Ok(assign(display, outputs)?.into_iter().map(|(shows, output)| format!("{shows}: {}", output.name)).collect())
    }

    #[test]
    fn named_outputs_first_and_the_others_from_left_to_right() {
        let outputs = [output("C", 0), output("A", 200), output("B", 100)];
        let found = names(&display(&[None, None, None]), &outputs).unwrap();
        assert_eq!(found, ["layer 0: C", "layer 1: B", "layer 2: A"]);
        let found = names(&display(&[None, Some("C"), None]), &outputs).unwrap();
        assert_eq!(found, ["layer 0: B", "layer 1: C", "layer 2: A"]);
        let mut directional = display(&[None]);
        directional.backlight = Backlight::Lenslets(LensletBacklight::new(-8.0, [2, 2], 2.0, [3, 3], [20.0, 20.0]));
        assert_eq!(names(&directional, &outputs).unwrap(), ["backlight: C", "layer 0: B"]);
    }

    #[test]
    fn missing_outputs_are_named() {
        let three = display(&[None, Some("B"), None]);
        let error = names(&three, &[]).unwrap_err().to_string();
        assert!(
            error.starts_with("outputs: expected 3, one for each of layer 0, layer 1, layer 2; found none"),
            "{error}"
        );
        let error = names(&three, &[output("A", 0), output("B", 1)]).unwrap_err().to_string();
        assert!(error.ends_with("found A, B"), "{error}");
        let error = names(&three, &[output("A", 0), output("C", 1), output("D", 1)]).unwrap_err().to_string();
        assert_eq!(error, "layers[1].panel.output: expected one of the outputs A, C, D, found \"B\"");
        let twice = display(&[Some("A"), Some("A")]);
        let error = names(&twice, &[output("A", 0), output("B", 1)]).unwrap_err().to_string();
        assert!(error.starts_with("layers[1].panel.output: expected an output that no other panel"), "{error}");
    }

    #[test]
    fn outputs_that_change_are_noticed() {
        let (a, b) = (output("A", 0), output("B", 100));
        let smaller = Output { size: [50, 25], ..a.clone() };
        let moved = Output { position: [0, 50], refresh_hz: None, ..a.clone() };
        assert_eq!(change(&a, &[b.clone(), a.clone()], true), None);
        assert_eq!(change(&a, std::slice::from_ref(&b), false), Some(Change::Gone));
        assert_eq!(change(&a, &[], false), Some(Change::Gone));
        assert_eq!(change(&a, &[smaller.clone(), b.clone()], false), Some(Change::Other(smaller)));
        assert_eq!(change(&a, &[moved.clone(), b.clone()], false), None);
        assert_eq!(change(&a, &[moved.clone(), b], true), Some(Change::Other(moved)));
    }

    #[test]
    fn bounds_hold_every_output() {
        let low = Output { position: [-50, 20], ..output("B", 0) };
        assert_eq!(bounds([&output("A", 0), &low]), ([-50, 0], [150, 70]));
    }
}
