//! Folders of the HCI 4D light field benchmark: `input_Cam%03d.png` and `parameters.cfg`.
//!
//! Camera i is in row i / num_cams_x (0 the topmost) and column i % num_cams_x (0 the leftmost).
//! Pictures are shifted so that the plane at `focus_distance_m` has no disparity. With baseline b,
//! the slope between neighbouring cameras is b / focus distance.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lumistack_core::Task;

use crate::FieldError;
use crate::cameras::{PictureGrid, pictures};
use crate::geometry::{Cameras, Hints, place};
use crate::index::read_index;
use crate::source::{Kind, Source};

const PARAMETERS: &str = "parameters.cfg";

/// Opens the folder if it contains `input_Cam` pictures.
pub(crate) fn source(folder: &Path, task: Task<'_>) -> Result<Option<Source>, FieldError> {
    let mut numbered = BTreeMap::<usize, PathBuf>::new();
    for file in pictures(folder)? {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let number = stem.strip_prefix("input_Cam").and_then(|digits| digits.parse().ok());
        if let Some(number) = number
            && let Some(other) = numbered.insert(number, file.clone())
        {
            let found = format!("also {}", other.display());
            return Err(FieldError::malformed(file, "camera number", "one picture per camera", found));
        }
    }
    if numbered.is_empty() {
        return Ok(None);
    }
    let path = folder.join(PARAMETERS);
    let parameters = if lumistack_files::is_file(&path) {
        // names and notes may have any encoding; only numbers are used
        let bytes = read_index(&path)?;
        Parameters { path, values: parse(&String::from_utf8_lossy(&bytes)) }
    } else {
        Parameters { path, values: BTreeMap::new() }
    };
    let views = grid_size(folder, &parameters, numbered.len(), task)?;
    let mut files = Vec::new();
    for number in 0..views[0] * views[1] {
        let file = numbered.remove(&number).ok_or_else(|| {
            let expected = format!("input_Cam000 to input_Cam{:03}", views[0] * views[1] - 1);
            FieldError::malformed(folder, "views", expected, format!("no input_Cam{number:03}"))
        })?;
        files.push(file);
    }
    // Report the pictures of further cameras, since they are not read.
    if let Some(file) = numbered.values().next() {
        let (count, [rows, cols]) = (numbered.len(), views);
        let message = format!(
            "pictures: expected {cols} × {rows} cameras, as in {PARAMETERS}, found more; further pictures are not read (number: {count}; first: {})",
            file.file_name().unwrap_or_default().to_string_lossy()
        );
        task.warn(place(folder), message);
    }
    let reader = PictureGrid::new(files, views)?;
    let focal_px = match (parameters.length("focal_length_mm")?, parameters.length("sensor_size_mm")?) {
        (Some(focal_mm), Some(sensor_mm)) => {
            let longest = reader.size()[0].max(reader.size()[1]);
            Some(focal_mm / sensor_mm * longest as f64)
        }
        _ => None,
    };
    let slope_per_step = match (parameters.length("baseline_mm")?, parameters.length("focus_distance_m")?) {
        (Some(baseline_mm), Some(focus_m)) => baseline_mm / (1000.0 * focus_m),
        _ => 0.0,
    };
    let centred =
        |count: usize, sign: f64| (0..count).map(|i| sign * (i as f64 - (count as f64 - 1.0) / 2.0)).collect();
    let positions = [centred(views[1], 1.0), centred(views[0], -1.0)];
    let cameras = Cameras { positions, focal_px, slope_per_step, plane_unknown: false };
    Ok(Some(Source {
        kind: Kind::Hci,
        path: folder.to_path_buf(),
        views,
        size: reader.size(),
        hints: Hints { cameras: Some(cameras), ..Hints::default() },
        info: serde_json::Map::new(),
        reader: Box::new(reader),
    }))
}

/// Values of `parameters.cfg` by their keys. Sections are ignored, since every key occurs only once
/// in the file.
struct Parameters {
    path: PathBuf,
    values: BTreeMap<String, String>,
}

impl Parameters {
    fn length(&self, key: &str) -> Result<Option<f64>, FieldError> {
        let Some(text) = self.values.get(key) else { return Ok(None) };
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() && value > 0.0 => Ok(Some(value)),
            _ => Err(FieldError::malformed(&self.path, key, "a finite number above 0", text)),
        }
    }

    fn count(&self, key: &str) -> Result<Option<usize>, FieldError> {
        let Some(text) = self.values.get(key) else { return Ok(None) };
        match text.parse::<usize>() {
            Ok(value) if (1..=10_000).contains(&value) => Ok(Some(value)),
            _ => Err(FieldError::malformed(&self.path, key, "a whole number from 1 to 10000", text)),
        }
    }
}

fn parse(text: &str) -> BTreeMap<String, String> {
    let pair = |line: &str| {
        let (key, value) = line.split_once('=')?;
        Some((key.trim().to_string(), value.trim().to_string()))
    };
    text.lines().filter(|line| !line.trim_start().starts_with(['#', ';'])).filter_map(pair).collect()
}

/// Returns the number of cameras, [vertical, horizontal].
fn grid_size(folder: &Path, parameters: &Parameters, count: usize, task: Task<'_>) -> Result<[usize; 2], FieldError> {
    if let (Some(cols), Some(rows)) = (parameters.count("num_cams_x")?, parameters.count("num_cams_y")?) {
        if count < rows * cols {
            let expected = format!("{cols} × {rows} pictures, as in {PARAMETERS}");
            return Err(FieldError::malformed(folder, "views", expected, count.to_string()));
        }
        return Ok([rows, cols]);
    }
    let side = count.isqrt();
    if side * side != count {
        let expected = format!("num_cams_x and num_cams_y in {PARAMETERS}, or a square number of pictures");
        return Err(FieldError::malformed(
            folder,
            "views",
            expected,
            format!("{count} pictures, and at most one of the two keys"),
        ));
    }
    task.warn(
        place(folder),
        format!("{PARAMETERS} does not state the arrangement of the cameras; {side} × {side} cameras are assumed"),
    );
    Ok([side, side])
}
