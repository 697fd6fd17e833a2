//! The class of light fields.

use std::sync::Arc;

use lumistack_display::{Display as Description, LightField as Field};
use lumistack_pipeline::References;
use pyo3::prelude::*;
use serde_json::{Map, Value};

/// A light field: linear radiance, 0 to 1 after exposure, of every view, and where its rays are.
///
/// radiance: array [view_y, view_x, row, col, rgb]; view (0, 0) is the leftmost and topmost, row 0 the top. Row-major float32 is used where it is, without a
/// copy: do not write to it while the light field is in use. Other layouts, float64, float16 and the other byte order are copied; uint8 and uint16 are
/// sRGB code values and become linear; other types raise TypeError.
///
/// The rays' geometry is that of a display whose views have the array's shape, or is given:
///
/// * display: a Display, or what makes one
/// * pitch_mm: pixel pitch on the plane of zero parallax, millimetres, above 0
/// * fov_deg: (horizontal, vertical) full angles of view, degrees, 0 to less than 180; views stand at the centres of equal bins
/// * slope_x, slope_y: instead, tangents of every view column (left to right) and row (y up, top to bottom)
/// * distance_mm: viewing distance of perspective views, millimetres; without it the views are parallel projections
///
/// >>> light_field = LightField(memoryview(bytes(4 * 3 * 3 * 8 * 8 * 3)).cast("f", (3, 3, 8, 8, 3)), pitch_mm=1.0, fov_deg=(20, 20))
/// >>> light_field.shape
/// (3, 3, 8, 8, 3)
/// >>> memoryview(light_field.array).nbytes
/// 6912
#[pyclass(frozen, module = "lumistack")]
pub(crate) struct LightField {
    pub(crate) field: Arc<Field>,
    /// What it was rendered for.
    pub(crate) display: Option<Arc<Description>>,
    /// How it was made.
    pub(crate) info: Map<String, Value>,
    /// The scene all over the zone, where it was rendered with that.
    pub(crate) references: Option<Arc<References>>,
}

impl LightField {
    pub(crate) fn plain(field: Field) -> Self {
        Self { field: Arc::new(field), display: None, info: Map::new(), references: None }
    }
}
