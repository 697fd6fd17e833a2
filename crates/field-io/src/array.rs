//! `.npy` light fields, axes `[view_y][view_x][row][col][rgb]`, with an optional JSON file of the
//! same name.
//!
//! Floats are linear light, unless the JSON has `"linear": false`. Integers are decoded as sRGB
//! code values, unless the JSON has `"linear": true`. If integers are decoded without the key
//! `linear`, a warning reports the decoding.

use std::path::{Path, PathBuf};

use lumistack_core::{Task, colour};

use crate::FieldError;
use crate::geometry::{GeometryJson, Hints, place};
use crate::index::{parse_json, read_index};
use crate::npy::{NpyFile, zeros};
use crate::source::{Kind, Source, Views};

struct ArrayViews {
    path: PathBuf,
    array: NpyFile,
    encoded: bool,
}

/// Opens an array without reading its values.
pub(crate) fn source(path: &Path, task: Task<'_>) -> Result<Source, FieldError> {
    let array = NpyFile::open(path)?;
    let &[rows, cols, height, width, 3] = array.shape() else {
        let expected = "[view_y, view_x, row, col, 3]";
        return Err(FieldError::malformed(path, "shape", expected, format!("{:?}", array.shape())));
    };
    if array.is_empty() {
        return Err(FieldError::malformed(
            path,
            "shape",
            "at least one view, and at least one pixel in a view",
            format!("{:?}", array.shape()),
        ));
    }
    // A JSON file of the same name describes the geometry and the encoding.
    let views = [rows, cols];
    let json = path.with_extension("json");
    let mut linear = None;
    let mut hints = Hints::default();
    if lumistack_files::is_file(&json) {
        let text = read_index(&json)?;
        let geometry: GeometryJson = parse_json(&json, &text)?;
        linear = geometry.linear;
        hints = geometry.into_hints(&json, views)?;
    }
    // Unless the JSON file states the encoding, integers are sRGB codes and floats are linear.
    let encoded = !linear.unwrap_or(!array.scalar().is_code());
    if encoded && linear.is_none() {
        task.warn(
            place(path),
            "the array's integers are taken as sRGB code values; if the integers are linear, write \"linear\": true in a JSON file with the array's name",
        );
    }
    Ok(Source {
        kind: Kind::Array,
        path: path.to_path_buf(),
        views,
        size: [width, height],
        hints,
        info: serde_json::Map::new(),
        reader: Box::new(ArrayViews { path: path.to_path_buf(), array, encoded }),
    })
}

impl Views for ArrayViews {
    fn load(&mut self, view: [usize; 2]) -> Result<Vec<f32>, FieldError> {
        let shape = self.array.shape();
        let index = view[0] * shape[1] + view[1];
        let count = shape[2..].iter().product();
        let mut values = zeros(&self.path, count)?;
        self.array.read_values(index * count, &mut values)?;
        if self.encoded {
            values.iter_mut().for_each(|value| *value = colour::srgb_decode(*value));
        }
        Ok(values)
    }

    fn file(&self, _view: [usize; 2]) -> PathBuf {
        self.path.clone()
    }
}
