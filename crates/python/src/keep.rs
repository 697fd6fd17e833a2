//! The parts of light fields that pickles contain but the constructor does not take: display,
//! settings, depth and reference pictures.

use std::sync::Arc;

use lumistack_display::{FieldGeometry, Projection, SeenDepth, ViewGrid};
use lumistack_pipeline::{ReferencePictures, References};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{Array, Part, Values};
use crate::display::Display;
use crate::error::exception;
use crate::field::LightField;
use crate::json::{map_of, to_python};

/// Direction of a reference: slope (x, y), and the viewing distance of a perspective view.
type Direction = ([f64; 2], Option<f64>);

/// Returns the parts of a light field that its constructor does not take.
pub(crate) fn of_field<'py>(py: Python<'py>, light_field: &LightField) -> PyResult<Bound<'py, PyDict>> {
    let kept = PyDict::new(py);
    kept.set_item("display", light_field.display.clone().map(Display))?;
    kept.set_item("info", to_python(py, &serde_json::Value::Object(light_field.info.clone()))?)?;
    if let Some(depth) = light_field.field.depth() {
        let z_mm: Vec<f32> = depth.z_mm.iter().map(|z| z.unwrap_or(f32::NAN)).collect();
        kept.set_item("depth", Array::numpy(py, Part::Values(vec![depth.rows, depth.cols], z_mm.into()))?)?;
    }
    if let Some((references, left_out)) = light_field.references.as_deref().and_then(References::pictures) {
        let geometry = light_field.field.geometry();
        let array =
            |picture: Arc<Vec<f32>>| Array::numpy(py, Part::Shared(vec![geometry.rows, geometry.cols, 3], picture));
        let mut all = Vec::new();
        for (direction, [a, b]) in references {
            let distance_mm = match direction.projection {
                Projection::Oblique => None,
                Projection::Perspective { distance_mm } => Some(distance_mm),
            };
            // Equal pictures are one object, which a pickle contains once.
            let first = array(a.clone())?;
            let second = if Arc::ptr_eq(&a, &b) { first.clone() } else { array(b)? };
            all.push((([direction.slope_x[0], direction.slope_y[0]], distance_mm), first, second));
        }
        kept.set_item("references", (left_out, all))?;
    }
    Ok(kept)
}

/// Returns the light field with the parts that [`of_field`] returned.
#[pyfunction]
pub(crate) fn _light_field_with(light_field: &LightField, kept: &Bound<'_, PyDict>) -> PyResult<LightField> {
    let py = kept.py();
    let item = |name: &str| Ok::<_, PyErr>(kept.get_item(name)?.filter(|value| !value.is_none()));
    let display = item("display")?.map(|display| Ok::<_, PyErr>(display.cast::<Display>()?.get().0.clone()));
    let info = item("info")?.map(|info| map_of("info", &info)).transpose()?.unwrap_or_default();
    let mut field = light_field.field.clone();
    if let Some(depth) = item("depth")? {
        let (shape, z_mm) = Values::read(&depth, "depth")?.into_parts();
        let [rows, cols] = shape[..] else {
            return Err(damaged(py, "depth: expected an array of two axes, found an array of another number of axes"));
        };
        let z_mm = z_mm.into_iter().map(|z| (!z.is_nan()).then_some(z)).collect();
        let depth = SeenDepth { rows, cols, z_mm };
        field = Arc::new((*field).clone().with_depth(Some(depth)));
    }
    let references = item("references")?.map(|references| references_of(&references, field.geometry())).transpose()?;
    Ok(LightField { field, display: display.transpose()?, info, references: references.map(Arc::new) })
}

fn references_of(kept: &Bound<'_, PyAny>, geometry: &FieldGeometry) -> PyResult<References> {
    let (left_out, all): (bool, Vec<(Direction, Bound<'_, PyAny>, Bound<'_, PyAny>)>) = kept.extract()?;
    let picture = |object: &Bound<'_, PyAny>| {
        let (shape, picture) = Values::read(object, "references")?.into_parts();
        if shape != [geometry.rows, geometry.cols, 3] {
            return Err(damaged(
                kept.py(),
                "references: expected pictures [row, col, rgb] with as many pixels as a view, found another shape",
            ));
        }
        Ok(Arc::new(picture))
    };
    let pictures = all.iter().map(|((slope, distance_mm), a, b)| {
        let projection = distance_mm.map_or(Projection::Oblique, |distance_mm| Projection::Perspective { distance_mm });
        let first = picture(a)?;
        let second = if a.is(b) { first.clone() } else { picture(b)? };
        Ok((ViewGrid::single(projection, *slope), [first, second]))
    });
    let pictures: Vec<ReferencePictures> = pictures.collect::<PyResult<_>>()?;
    Ok(References::of_pictures(geometry, pictures.into_iter(), left_out))
}

fn damaged(py: Python<'_>, message: &str) -> PyErr {
    exception(py, "DataError", &format!("pickle: {message}"))
}
