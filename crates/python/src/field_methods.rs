//! Methods of light fields.

use std::path::PathBuf;
use std::sync::Arc;

use lumistack_core::Tensor;
use lumistack_display::{FieldGeometry, LightField as Field, Projection, ViewGrid};
use lumistack_field_io::GeometryFlags;
use lumistack_pipeline::{PipelineError, ReferencePictures, References, expose_field, keep_missing, open_field};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple, PyType};
use serde_json::{Map, Value, json};

use crate::array::{Array, Part, Values};
use crate::display::{Display, display_of, unsigned};
use crate::error::{exception, raised, setting};
use crate::field::LightField;
use crate::json::{map_of, numbers, table, to_python};
use crate::keep;
use crate::own::{in_package, in_python};
use crate::stored::{self, Holds};
use crate::work::long;

#[pymethods]
impl LightField {
    #[new]
    #[pyo3(signature = (radiance, *rest, display=None, pitch_mm=None, fov_deg=None, slope_x=None, slope_y=None, distance_mm=None), text_signature = "(radiance, *, display=None, pitch_mm=None, fov_deg=None, slope_x=None, slope_y=None, distance_mm=None)")]
    fn new(
        py: Python<'_>,
        radiance: &Bound<'_, PyAny>,
        rest: &Bound<'_, PyTuple>,
        display: Option<&Bound<'_, PyAny>>,
        pitch_mm: Option<&Bound<'_, PyAny>>,
        fov_deg: Option<&Bound<'_, PyAny>>,
        slope_x: Option<&Bound<'_, PyAny>>,
        slope_y: Option<&Bound<'_, PyAny>>,
        distance_mm: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        if !rest.is_empty() {
            let message = "LightField: expected one argument without a name, radiance, found more; pass the others by name, such as display= or pitch_mm=";
            return Err(PyTypeError::new_err(message));
        }
        // Read the values, and check their shape.
        let radiance = Values::read(radiance, "radiance")?.tensor("radiance", Field::AXES)?;
        let [view_rows, view_cols, rows, cols, channels] = radiance.shape();
        if channels != 3 {
            let message = format!("radiance: expected 3 channels on the last axis, rgb, found {channels}");
            return Err(exception(py, "DataError", &message));
        }
        let pitch_mm: Option<f64> = numbers("pitch_mm", pitch_mm)?;
        let distance_mm: Option<f64> = numbers("distance_mm", distance_mm)?;
        let fov_deg: Option<[f64; 2]> = numbers("fov_deg", fov_deg)?;
        let slope_x: Option<Vec<f64>> = numbers("slope_x", slope_x)?;
        let slope_y: Option<Vec<f64>> = numbers("slope_y", slope_y)?;
        let own = [pitch_mm.is_some(), fov_deg.is_some(), slope_x.is_some(), slope_y.is_some(), distance_mm.is_some()];
        // Take the geometry from a display, or from numbers.
        let (grid, pitch_mm, display) = if let Some(display) = display {
            if own.contains(&true) {
                return Err(setting(
                    py,
                    "light field: expected either `display` or values of its geometry such as `pitch_mm`, found both",
                ));
            }
            let display = display_of(py, Some(display))?;
            let geometry = display.geometry().map_err(|source| {
                let path = PathBuf::from(&display.name);
                raised(py, &PipelineError::Display { path, text: String::new(), source })
            })?;
            (geometry.grid, geometry.pitch_mm, Some(display))
        } else {
            let Some(pitch_mm) = pitch_mm else {
                let expected = "light field: expected `display`, or `pitch_mm` together with `fov_deg` or slopes";
                return Err(setting(py, format!("{expected}, found no `pitch_mm`")));
            };
            let projection = match distance_mm {
                None => Projection::Oblique,
                Some(distance_mm) => Projection::Perspective { distance_mm },
            };
            let grid = match (fov_deg, slope_x, slope_y) {
                (Some(fov_deg), None, None) => ViewGrid::uniform(projection, [view_cols, view_rows], fov_deg)
                    .map_err(|error| raised(py, &PipelineError::Grid(error)))?,
                (None, Some(slope_x), Some(slope_y)) => ViewGrid { projection, slope_x, slope_y },
                (None, None, None) if [view_rows, view_cols] == [1, 1] => ViewGrid::single(projection, [0.0, 0.0]),
                _ => {
                    let message = "light field: expected either `fov_deg` or both `slope_x` and `slope_y`, found another combination of the three arguments";
                    return Err(setting(py, message));
                }
            };
            (grid, pitch_mm, None)
        };
        // Check that radiance and geometry agree.
        let geometry = FieldGeometry { rows, cols, pitch_mm, grid };
        let resolution = display.as_ref().map(|display| display.field.resolution);
        if let Some([display_cols, display_rows]) = resolution.filter(|resolution| *resolution != [cols, rows]) {
            let message = format!(
                "radiance: expected views of {display_rows} × {display_cols} pixels (rows × columns), as the display has, found views of {rows} × {cols} pixels"
            );
            return Err(exception(py, "DataError", &message));
        }
        let field = Field::new(geometry, radiance).map_err(|error| raised(py, &PipelineError::Grid(error)))?;
        Ok(Self { field: Arc::new(field), display, info: Map::new(), references: None })
    }

    /// Reads a light field of any format: a light-field folder, a run's folder, HCI and Stanford
    /// folders, a quilt, .npy.
    ///
    /// These arguments give geometry that the files lack, and override the geometry of the files:
    ///
    /// * grid: "oblique" or "perspective"
    /// * fov_deg, pitch_mm, distance_mm: as for LightField
    /// * views: (columns, rows), number of views to keep
    /// * quilt, tiles: (columns, rows) of views in a quilt, or in another picture of tiles
    /// * resolution: (columns, rows) to which every view is reduced
    /// * focus_px: pixels by which content that appears on the display plane moves to the left from
    ///   one view to the next view on the right
    /// * mirror: (x, y), True reverses the order of views on that axis
    ///
    /// If neither the files nor these arguments state the size or the angles, `display` provides
    /// them. If `views` leaves out views of the file, psnr_zone() and report() use some of the
    /// omitted views as references.
    ///
    /// The result has the `info` of a light-field folder. Its display is the argument `display`, or
    /// else the display that save() wrote into the folder.
    /// `callback(stage, fraction)` receives progress.
    #[classmethod]
    #[pyo3(signature = (path, *, display=None, callback=None, **geometry))]
    fn open(
        _class: &Bound<'_, PyType>,
        py: Python<'_>,
        path: PathBuf,
        display: Option<&Bound<'_, PyAny>>,
        callback: Option<&Bound<'_, PyAny>>,
        geometry: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let flags: GeometryFlags = match geometry {
            Some(geometry) => {
                if geometry.contains("slope_x")? || geometry.contains("slope_y")? {
                    let remedy = "LightField(numpy.load(path), slope_x=..., slope_y=..., pitch_mm=...) takes slopes";
                    return Err(setting(py, format!("LightField.open: expected `fov_deg`, found slopes; {remedy}")));
                }
                crate::json::table_of("LightField.open", geometry.as_any())?
            }
            None => table(py, "geometry", &[])?,
        };
        let display = display.map(|display| display_of(py, Some(display))).transpose()?;
        let (field, references) = long(py, callback, |task| open_field(&path, &flags, display.as_deref(), task))?;
        let (own, info) = stored::notes(&path);
        let (field, references) = (Arc::new(field), references.map(Arc::new));
        Ok(Self { field, display: display.or(own), info, references })
    }

    /// Returns the light field with another exposure: values are multiplied by 2^exposure_ev, and
    /// then mapped by a tone curve.
    ///
    /// tone: "linear" clips to 0..1; "khronos-neutral" and "agx" compress bright values. All
    /// views have the same curve. Use this method for light fields with values outside 0..1, which
    /// no display can show; factorize() and report() warn of such values.
    ///
    /// The reference pictures of the zone score change in the same way. `info["exposed"]` lists all
    /// such changes.
    #[pyo3(signature = (exposure_ev=None, *, tone="linear"), text_signature = "($self, exposure_ev=0.0, *, tone='linear')")]
    fn exposed(&self, py: Python<'_>, exposure_ev: Option<&Bound<'_, PyAny>>, tone: &str) -> PyResult<Self> {
        let exposure_ev: f64 = numbers("exposure_ev", exposure_ev)?.unwrap_or(0.0);
        let exposed = py.detach(|| {
            let field = expose_field(&self.field, exposure_ev, tone)?;
            // The reference pictures of the zone score get the same exposure and tone curve.
            let references = self.references.as_deref().and_then(References::pictures);
            let references = references.map(|(pictures, left_out)| {
                let geometry = self.field.geometry();
                let exposed = |(direction, [a, b]): ReferencePictures| {
                    let first = exposed_picture(geometry, &direction, &a, exposure_ev, tone)?;
                    let is_one = Arc::ptr_eq(&a, &b);
                    let second = if is_one {
                        first.clone()
                    } else {
                        exposed_picture(geometry, &direction, &b, exposure_ev, tone)?
                    };
                    Ok((direction, [first, second]))
                };
                let pictures = pictures.map(exposed).collect::<Result<Vec<_>, PipelineError>>()?;
                Ok::<_, PipelineError>(Arc::new(References::of_pictures(geometry, pictures.into_iter(), left_out)))
            });
            Ok((Arc::new(field), references.transpose()?))
        });
        let (field, references) = exposed.map_err(|error| raised(py, &error))?;
        let mut info = self.info.clone();
        // `exposure` and `tone` describe the rendering, so later changes have a list of their own.
        if let Value::Array(list) = info.entry("exposed").or_insert_with(|| json!([])) {
            list.push(json!({ "exposure_ev": exposure_ev, "tone": tone }));
        }
        Ok(Self { field, display: self.display.clone(), info, references })
    }

    /// Writes a light-field folder: lightfield.json and one OpenEXR picture of half floats per
    /// view. lightfield.json also contains `info` and the display. Views that an earlier light
    /// field left in the folder are removed.
    ///
    /// The folder does not contain the reference pictures of zone_directions; pickles do. If the
    /// path ends in .npy, only the values are written, as one float32 array. Then LightField.open()
    /// needs the geometry as arguments.
    #[pyo3(signature = (path, *, info=None))]
    fn save(&self, py: Python<'_>, path: PathBuf, info: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        if path.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("npy")) {
            if info.is_some() {
                return Err(setting(
                    py,
                    "save: expected no `info`, since a file of an array (.npy) cannot contain `info`, found a value",
                ));
            }
            let radiance = self.field.radiance();
            return long(py, None, |_| {
                lumistack_field_io::npy::write(&path, &radiance.shape(), radiance.data()).map_err(PipelineError::Field)
            });
        }
        let folder = path;
        stored::check_free(py, &folder, Holds::Views)?;
        let mut all = self.info.clone();
        if let Some(display) = &self.display {
            all.insert(stored::DISPLAY.into(), serde_json::to_value(&**display).expect("displays serialize"));
        }
        if let Some(info) = info {
            all.extend(map_of("info", info)?);
        }
        long(py, None, |_| {
            let old = stored::views(&folder);
            lumistack_field_io::write_field(&folder, &self.field, &all).map_err(PipelineError::Field)?;
            stored::remove_stale(&folder, &old, self.field.geometry().grid.views())
        })
    }

    /// All values, [view_y, view_x, row, col, rgb], as a read-only NumPy array without a copy.
    #[getter]
    fn radiance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Array::numpy(py, Part::Field(self.field.clone()))
    }

    /// All values for use without NumPy: memoryview(light_field.array) shares their memory.
    #[getter]
    fn array(&self) -> Array {
        Array::new(Part::Field(self.field.clone()))
    }

    /// Lengths of the axes (view_y, view_x, row, col, rgb).
    #[getter]
    fn shape(&self) -> (usize, usize, usize, usize, usize) {
        self.field.radiance().shape().into()
    }

    /// Pixel pitch on the display plane, millimetres.
    #[getter]
    fn pitch_mm(&self) -> f64 {
        self.field.geometry().pitch_mm
    }

    /// Slopes of the view columns, left to right.
    #[getter]
    fn slope_x(&self) -> Vec<f64> {
        unsigned(&self.field.geometry().grid.slope_x)
    }

    /// Slopes of the view rows from top to bottom; a slope above 0 points up.
    #[getter]
    fn slope_y(&self) -> Vec<f64> {
        unsigned(&self.field.geometry().grid.slope_y)
    }

    /// Viewing distance of perspective views, millimetres; None for parallel projections.
    #[getter]
    fn distance_mm(&self) -> Option<f64> {
        match self.field.geometry().grid.projection {
            Projection::Oblique => None,
            Projection::Perspective { distance_mm } => Some(distance_mm),
        }
    }

    /// The display for which the light field was made; None if there is none.
    #[getter]
    fn display(&self) -> Option<Display> {
        self.display.clone().map(Display)
    }

    /// Settings of a rendered light field: scene, exposure, tone, and the depth that the display
    /// must show. After open() the notes in the folder's lightfield.json.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &Value::Object(self.info.clone()))
    }

    /// Type of the values, float32, as a NumPy dtype.
    #[getter]
    fn dtype<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.radiance(py)?.getattr("dtype")
    }

    /// Number of axes: 5.
    #[getter]
    fn ndim(&self) -> usize {
        Field::AXES.len()
    }

    /// Number of view rows, the length of the array's first axis.
    fn __len__(&self) -> usize {
        self.field.radiance().shape()[0]
    }

    /// light_field[view_y, view_x] is a view [row, col, rgb]. Every index of NumPy is allowed, and
    /// values are copied only if NumPy copies them.
    fn __getitem__<'py>(&self, py: Python<'py>, index: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        self.radiance(py)?.get_item(index)
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(self.radiance(py)?.try_iter()?.into_any())
    }

    /// The values for libraries with DLPack, such as torch.from_dlpack(). The memory is shared with
    /// libraries that support read-only memory (NumPy 2.1 or newer), and copied for others.
    #[pyo3(signature = (**options))]
    fn __dlpack__<'py>(&self, py: Python<'py>, options: Option<&Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyAny>> {
        in_package(py, "_arrays", "dlpack", (self.radiance(py)?,), options)
    }

    fn __dlpack_device__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.radiance(py)?.call_method0("__dlpack_device__")
    }

    /// Equivalent to lumistack.factorize(light_field, display, ...).
    #[pyo3(signature = (display=None, **settings))]
    fn factorize<'py>(
        slf: &Bound<'py, Self>,
        display: Option<&Bound<'py, PyAny>>,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        in_python(slf.py(), "factorize", (slf, display), settings)
    }

    /// The values as an xarray.DataArray, without a copy. Its axes are view_y, view_x, row, col and
    /// rgb; coordinates are slopes, positions on the display in millimetres and channels. Requires
    /// xarray.
    fn to_xarray<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        in_package(slf.py(), "_arrays", "to_xarray", (slf,), None)
    }

    /// Draws a view with matplotlib, encoded as sRGB, with axes in millimetres on the display.
    /// `view` is (view_y, view_x), by default the middle view. Draws into the axes `ax`, or into
    /// new axes, and returns them.
    #[pyo3(signature = (view=None, *, ax=None))]
    fn plot<'py>(
        slf: &Bound<'py, Self>,
        view: Option<[usize; 2]>,
        ax: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        in_package(slf.py(), "_show", "plot_view", (slf, view, ax), None)
    }

    fn _repr_html_<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        in_package(slf.py(), "_show", "light_field", (slf,), None)
    }

    #[pyo3(signature = (dtype=None, copy=None))]
    fn __array__<'py>(
        &self,
        py: Python<'py>,
        dtype: Option<&Bound<'py, PyAny>>,
        copy: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        as_array(self.radiance(py)?, dtype, copy)
    }

    fn __repr__(&self) -> String {
        let (view_rows, view_cols, rows, cols, _) = self.shape();
        let kind = if self.distance_mm().is_some() { "perspective" } else { "parallel" };
        format!("<lumistack.LightField: {view_cols}×{view_rows} {kind} views of {cols}×{rows}, {} mm>", self.pitch_mm())
    }

    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyAny>, Bound<'py, PyDict>, Bound<'py, PyDict>))> {
        let how = PyDict::new(py);
        how.set_item("pitch_mm", self.pitch_mm())?;
        how.set_item("slope_x", self.slope_x())?;
        how.set_item("slope_y", self.slope_y())?;
        how.set_item("distance_mm", self.distance_mm())?;
        let rebuild = py.import("lumistack._pickle")?.getattr("light_field")?;
        Ok((rebuild, (self.radiance(py)?, how, keep::of_field(py, self)?)))
    }
}

/// Returns a picture with another exposure and a tone curve, as [`LightField::exposed`] does.
fn exposed_picture(
    geometry: &FieldGeometry,
    direction: &ViewGrid,
    picture: &[f32],
    exposure_ev: f64,
    tone: &str,
) -> Result<Arc<Vec<f32>>, PipelineError> {
    let geometry = geometry.with_grid(direction.clone());
    let shape = [1, 1, geometry.rows, geometry.cols, 3];
    let radiance = Tensor::from_vec(Field::AXES, shape, picture.to_vec()).expect("references have the shape of views");
    let field = Field::new(geometry, radiance).map_err(PipelineError::Grid)?;
    let mut exposed = expose_field(&field, exposure_ev, tone)?.radiance().data().to_vec();
    keep_missing(picture, &mut exposed);
    Ok(Arc::new(exposed))
}

/// Returns the result of `__array__`: the array itself, or a copy if the caller requests a copy or
/// another dtype.
pub(crate) fn as_array<'py>(
    array: Bound<'py, PyAny>,
    dtype: Option<&Bound<'py, PyAny>>,
    copy: Option<bool>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = array.py();
    let is_other = match dtype {
        Some(dtype) => !array.getattr("dtype")?.eq(dtype)?,
        None => false,
    };
    if is_other && copy == Some(false) {
        return Err(setting(
            py,
            "__array__: expected the dtype of the values with `copy=False`, found another dtype, which needs a copy",
        ));
    }
    match dtype {
        Some(dtype) if is_other => array.call_method1("astype", (dtype,)),
        _ if copy == Some(true) => array.call_method0("copy"),
        _ => Ok(array),
    }
}
