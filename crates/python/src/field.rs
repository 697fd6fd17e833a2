//! The class of light fields.

use std::sync::Arc;

use lumistack_display::{Display as Description, LightField as Field};
use lumistack_pipeline::References;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use serde_json::{Map, Value};

/// A light field: linear radiance of every view, 0 to 1 after exposure, and the geometry of its
/// rays.
///
/// radiance: array [view_y, view_x, row, col, rgb]; view (0, 0) is the leftmost and topmost, row 0
/// the top. Row-major float32 is used without a copy, so do not write to it while the light field
/// is in use. Other layouts and byte orders, float64 and float16 are copied. uint8 and uint16 are
/// sRGB codes and become linear. Other types raise TypeError.
///
/// The geometry comes from a display whose light field has the array's shape, or from numbers:
///
/// * display: a Display, or an argument for Display()
/// * pitch_mm: pixel pitch on the display plane, millimetres, above 0
/// * fov_deg: (horizontal, vertical) field of view, full angles in degrees, 0 to less than 180;
///   views are at the centres of equal bins
/// * slope_x, slope_y: instead of fov_deg, the slopes of the view columns from left to right, and
///   of the view rows from top to bottom. Slopes above 0 point to the right or up
/// * distance_mm: viewing distance of perspective views, millimetres; without it the views are
///   parallel projections
///
/// >>> zeros = memoryview(bytes(4 * 3 * 3 * 8 * 8 * 3)).cast("f", (3, 3, 8, 8, 3))
///
/// >>> light_field = LightField(zeros, pitch_mm=1.0, fov_deg=(20, 20))
/// >>> light_field.shape
/// (3, 3, 8, 8, 3)
/// >>> memoryview(light_field.array).nbytes
/// 6912
#[pyclass(frozen, module = "lumistack")]
pub(crate) struct LightField {
    pub(crate) field: Arc<Field>,
    /// The display for which the light field was made.
    pub(crate) display: Option<Arc<Description>>,
    /// Settings with which the light field was rendered, or the notes of its folder.
    pub(crate) info: Map<String, Value>,
    /// Reference pictures from directions all over the viewing zone, if they were rendered.
    pub(crate) references: Option<Arc<References>>,
}

impl LightField {
    /// Returns the light field that an argument gives.
    pub(crate) fn of<'a>(argument: &str, object: &'a Bound<'_, PyAny>) -> PyResult<&'a Self> {
        object.cast::<Self>().map(Bound::get).map_err(|_| {
            let found = object.get_type().name().map(|name| name.to_string()).unwrap_or_default();
            let remedy = "LightField(array, display=display) makes a LightField";
            PyTypeError::new_err(format!("{argument}: expected a LightField, found {found}; {remedy}"))
        })
    }

    pub(crate) fn plain(field: Field) -> Self {
        Self { field: Arc::new(field), display: None, info: Map::new(), references: None }
    }
}
