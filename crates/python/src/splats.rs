//! Clouds of splats as mappings of arrays.

use glam::{Affine3A, Mat4, Quat, Vec3};
use lumistack_scene::{Cloud, Encoding, PlacedCloud, Scene, SceneParts};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::array::{Array, Part, Values};
use crate::error::setting;

/// Returns a dictionary of arrays for every placed cloud of a scene. A cloud that is placed twice
/// gives two dictionaries.
pub(crate) fn to_python<'py>(py: Python<'py>, scene: &Scene) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for placed in &scene.placed_clouds {
        let cloud = &scene.clouds[placed.cloud];
        let n = cloud.len();
        let map = Mat4::from(placed.scene_from_cloud).transpose();
        let arrays = [
            ("positions", vec![n, 3], cloud.positions.iter().flat_map(|at| at.to_array()).collect()),
            ("rotations", vec![n, 4], cloud.rotations.iter().flat_map(|rotation| rotation.to_array()).collect()),
            ("scales", vec![n, 3], cloud.scales.iter().flat_map(|scale| scale.to_array()).collect()),
            ("opacities", vec![n], cloud.opacities.clone()),
            ("harmonics", vec![n, cloud.coefficients(), 3], cloud.harmonics.clone()),
            ("scene_from_cloud", vec![4, 4], map.to_cols_array().to_vec()),
        ];
        let dict = PyDict::new(py);
        for (name, shape, values) in arrays {
            let values: Vec<f32> = values;
            dict.set_item(name, Array::numpy(py, Part::Values(shape, values.into()))?)?;
        }
        let encoding = match cloud.encoding {
            Encoding::Srgb => "srgb",
            Encoding::Linear => "linear",
        };
        dict.set_item("encoding", encoding)?;
        list.append(dict)?;
    }
    Ok(list)
}

/// Makes the parts of a scene from clouds: one mapping, or a sequence of mappings.
pub(crate) fn from_python(name: &str, splats: &Bound<'_, PyAny>) -> PyResult<SceneParts> {
    let py = splats.py();
    let mut parts = SceneParts { name: name.to_owned(), ..SceneParts::default() };
    let is_one = splats.hasattr("keys")?;
    let all: Vec<Bound<'_, PyAny>> =
        if is_one { vec![splats.clone()] } else { splats.try_iter()?.collect::<PyResult<_>>()? };
    for (number, one) in all.iter().enumerate() {
        let place = if is_one { "splats".to_owned() } else { format!("splats[{number}]") };
        let (cloud, scene_from_cloud) = cloud(py, &place, one)?;
        parts.placed_clouds.push(PlacedCloud { cloud: parts.clouds.len(), scene_from_cloud });
        parts.clouds.push(cloud);
    }
    Ok(parts)
}

const KEYS: [&str; 7] = ["positions", "rotations", "scales", "opacities", "harmonics", "encoding", "scene_from_cloud"];

fn cloud(py: Python<'_>, place: &str, one: &Bound<'_, PyAny>) -> PyResult<(Cloud, Affine3A)> {
    // Unknown keys are refused: a misspelt optional key would silently get its default.
    for key in one.call_method0("keys")?.try_iter()? {
        let key: String = key?.extract()?;
        if !KEYS.contains(&key.as_str()) {
            let message = format!("{place}: expected only the keys {}, found {key}", KEYS.join(", "));
            return Err(setting(py, message));
        }
    }
    let given = |key: &str| -> PyResult<Option<Bound<'_, PyAny>>> {
        let value = one.call_method1("get", (key,))?;
        Ok((!value.is_none()).then_some(value))
    };
    let read = |key: &str| -> PyResult<Option<(Vec<usize>, Vec<f32>)>> {
        let what = format!("{place}[\"{key}\"]");
        given(key)?.map(|value| Values::read(&value, &what).map(Values::into_parts)).transpose()
    };
    let needed =
        |key: &str| read(key)?.ok_or_else(|| setting(py, format!("{place}: expected an array `{key}`, found none")));
    let checked = |key: &str, shape: &[usize], expected: &[usize]| match shape == expected {
        true => Ok(()),
        false => {
            Err(setting(py, format!("{place}[\"{key}\"]: expected an array of shape {expected:?}, found {shape:?}")))
        }
    };
    // Read the required arrays, which determine the number of splats and the degree.
    let (shape, positions) = needed("positions")?;
    let count = shape.first().copied().unwrap_or(0);
    checked("positions", &shape, &[count, 3])?;
    let (shape, scales) = needed("scales")?;
    checked("scales", &shape, &[count, 3])?;
    let (shape, opacities) = needed("opacities")?;
    checked("opacities", &shape, &[count])?;
    let (shape, harmonics) = needed("harmonics")?;
    let degree = shape.get(1).and_then(|values| (0..=3).find(|degree: &usize| (degree + 1).pow(2) == *values));
    let Some(degree) = degree else {
        let message = format!(
            "{place}[\"harmonics\"]: expected an array [splat, coefficient, rgb] with 1, 4, 9 or 16 coefficients, found shape {shape:?}"
        );
        return Err(setting(py, message));
    };
    checked("harmonics", &shape, &[count, (degree + 1).pow(2), 3])?;
    // Read the optional values.
    let rotations = match read("rotations")? {
        Some((shape, values)) => {
            checked("rotations", &shape, &[count, 4])?;
            values.as_chunks::<4>().0.iter().copied().map(Quat::from_array).collect()
        }
        None => vec![Quat::IDENTITY; count],
    };
    let scene_from_cloud = match read("scene_from_cloud")? {
        Some((shape, values)) => {
            checked("scene_from_cloud", &shape, &[4, 4])?;
            let rows: [f32; 16] = values.try_into().unwrap_or([0.0; 16]);
            Affine3A::from_mat4(Mat4::from_cols_array(&rows).transpose())
        }
        None => Affine3A::IDENTITY,
    };
    let encoding = match given("encoding")?.map(|value| value.extract::<String>()).transpose()?.as_deref() {
        None | Some("srgb") => Encoding::Srgb,
        Some("linear") => Encoding::Linear,
        Some(other) => {
            return Err(setting(py, format!("{place}[\"encoding\"]: expected srgb or linear, found {other}")));
        }
    };
    let vectors =
        |values: Vec<f32>| -> Vec<Vec3> { values.as_chunks::<3>().0.iter().copied().map(Vec3::from).collect() };
    let (positions, scales) = (vectors(positions), vectors(scales));
    let cloud = Cloud { place: place.to_owned(), positions, rotations, scales, opacities, degree, harmonics, encoding };
    Ok((cloud, scene_from_cloud))
}

/// Returns the bytes of all values of the clouds. Their hash is part of the scene's key, which
/// distinguishes cached results.
pub(crate) fn content(parts: &SceneParts) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut put = |values: &mut dyn Iterator<Item = f32>| values.for_each(|value| bytes.extend(value.to_le_bytes()));
    for (cloud, placed) in parts.clouds.iter().zip(&parts.placed_clouds) {
        let header = [cloud.len() as f32, cloud.degree as f32, f32::from(u8::from(cloud.encoding == Encoding::Linear))];
        put(&mut header.into_iter());
        put(&mut placed.scene_from_cloud.to_cols_array().into_iter());
        put(&mut cloud.positions.iter().flat_map(|at| at.to_array()));
        put(&mut cloud.rotations.iter().flat_map(|rotation| rotation.to_array()));
        put(&mut cloud.scales.iter().flat_map(|scale| scale.to_array()));
        put(&mut cloud.opacities.iter().chain(&cloud.harmonics).copied());
    }
    bytes
}
