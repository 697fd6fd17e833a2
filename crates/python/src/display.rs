//! The class of displays.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_display::{Display as Description, LightField as Field, ProjectionKind};
use lumistack_pipeline::{DisplayJob, PipelineError, presets};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyMapping, PyString, PyTuple};

use crate::error::{of_call, raised};
use crate::field::LightField;
use crate::json::{map_of, parsed, table, to_python};

/// A tensor display, and the geometry of the light field that it shows.
///
/// `what` selects a display, and the other arguments change it:
///
/// * `what`: name of a preset (displays() lists them), path of a display file (.toml), a mapping
///   with the keys of such a file, or another Display; by default "paper-three-layer"
/// * resolution: (columns, rows) of the light field; the layers' resolutions change by the same
///   factor, and sizes in millimetres stay the same
/// * views: (horizontal, vertical) number of views; "auto": enough views for a display that is also
///   correct in directions between them; {"step": (x, y)}: views at multiples of these slopes
/// * fov_deg: (horizontal, vertical) field of view, full angles in degrees, 0 to less than 180
/// * frames: time-multiplexed frames M, 1 to 1000
/// * brightness: brightness scale β, above 0 and at most 1: the display emits β times the target
/// * sampling: "nearest" or "bilinear" interpolation of a layer between pixel centres
/// * missing: value of rays that miss a layer: "drop" (weight 0) or "clear" (as if the layer were
///   not there)
///
/// Displays are immutable; they compare by value, and can be keys of dictionaries and be pickled.
///
/// >>> display = Display("fig7-uniform", resolution=(64, 40), views=(3, 3), frames=4)
/// >>> display.frames, display.light_field_shape
/// (4, (3, 3, 40, 64, 3))
#[pyclass(frozen, eq, module = "lumistack")]
#[derive(PartialEq)]
pub(crate) struct Display(pub(crate) Arc<Description>);

#[pymethods]
impl Display {
    #[new]
    #[pyo3(signature = (what=None, *, resolution=None, views=None, fov_deg=None, frames=None, brightness=None, sampling=None, missing=None))]
    fn new(
        py: Python<'_>,
        what: Option<&Bound<'_, PyAny>>,
        resolution: Option<&Bound<'_, PyAny>>,
        views: Option<&Bound<'_, PyAny>>,
        fov_deg: Option<&Bound<'_, PyAny>>,
        frames: Option<&Bound<'_, PyAny>>,
        brightness: Option<&Bound<'_, PyAny>>,
        sampling: Option<&Bound<'_, PyAny>>,
        missing: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let arguments = [
            ("resolution", resolution),
            ("views", views),
            ("fov_deg", fov_deg),
            ("frames", frames),
            ("brightness", brightness),
            ("sampling", sampling),
            ("missing", missing),
        ];
        let changes: DisplayJob = table(py, "display", &arguments)?;
        let display = display_of(py, what)?;
        let changed = changes.changed(Path::new(&display.name), (*display).clone());
        changed.map(|display| Self(Arc::new(display))).map_err(|error| raised(py, &of_call("display", error)))
    }

    /// Name of the display.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Number M of time-multiplexed frames.
    #[getter]
    fn frames(&self) -> usize {
        self.0.frames
    }

    /// Brightness scale β: the display emits β times the target.
    #[getter]
    fn brightness(&self) -> f64 {
        self.0.brightness
    }

    /// Distances of the layers from the display plane, rear to front, millimetres; above 0 towards
    /// the viewer.
    #[getter]
    fn layer_distances_mm<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.0.layers.iter().map(|layer| layer.d_mm))
    }

    /// Shapes of the layers' masks, rear to front: (frame, row, col, rgb).
    #[getter]
    fn layer_shapes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let shape = |n| lumistack_display::LayerStack::layer_shape(&self.0, n).into();
        PyTuple::new(py, (0..self.0.layers.len()).map(shape).collect::<Vec<(usize, usize, usize, usize)>>())
    }

    /// Shape of the emission of a directional backlight, (frame, bin_y, bin_x, lenslet_row,
    /// lenslet_col, rgb); None for a uniform backlight.
    #[getter]
    fn emission_shape(&self) -> Option<(usize, usize, usize, usize, usize, usize)> {
        lumistack_display::LayerStack::emission_shape(&self.0).map(Into::into)
    }

    /// Shape of the light field that the display is made for: (view_y, view_x, row, col, rgb).
    #[getter]
    fn light_field_shape(&self) -> (usize, usize, usize, usize, usize) {
        let (field, [view_cols, view_rows]) = (&self.0.field, self.0.views());
        (view_rows, view_cols, field.resolution[1], field.resolution[0], 3)
    }

    /// Slopes of the view columns from left to right, and of the view rows from top to bottom. A
    /// slope above 0 points to the right or up.
    #[getter]
    fn slopes(&self, py: Python<'_>) -> PyResult<(Vec<f64>, Vec<f64>)> {
        let place = PathBuf::from(&self.0.name);
        let geometry = self
            .0
            .geometry()
            .map_err(|source| raised(py, &PipelineError::Display { path: place, text: String::new(), source }))?;
        Ok((unsigned(&geometry.grid.slope_x), unsigned(&geometry.grid.slope_y)))
    }

    /// Pixel pitch of the light field on the display plane, millimetres.
    #[getter]
    fn pitch_mm(&self) -> f64 {
        self.0.field.pitch_mm
    }

    /// Viewing distance of perspective views, millimetres; None for parallel projections.
    #[getter]
    fn distance_mm(&self) -> Option<f64> {
        (self.0.field.projection == ProjectionKind::Perspective).then_some(self.0.field.distance_mm).flatten()
    }

    /// Depths (low, high) between which the display shows the light field's finest detail,
    /// millimetres, above 0 towards the viewer; None if there are no such depths.
    fn depth_of_field_mm(&self) -> Option<(f64, f64)> {
        self.0.depth_of_field(self.0.field.pitch_mm).map(Into::into)
    }

    /// Returns this display, adapted to a light field. The result has the views, angles and size of
    /// the light field. The resolutions of the masks, the lenslets and the angular bins change
    /// accordingly. Raises SettingError if a directional backlight cannot separate the views.
    fn adapted_to(&self, py: Python<'_>, light_field: &Bound<'_, PyAny>) -> PyResult<Self> {
        let light_field = LightField::of("light_field", light_field)?;
        adapted(py, &self.0, &light_field.field).map(Self)
    }

    /// Returns the content of the display's file as a dictionary, which Display() accepts.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &serde_json::to_value(&*self.0).expect("displays serialize"))
    }

    /// Returns the text of the display's file, with the values of all defaults.
    fn to_toml(&self) -> String {
        self.0.to_toml()
    }

    /// Writes a display file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        lumistack_field_io::atomic::write_bytes(&path, self.0.to_toml().as_bytes())
            .map_err(|error| raised(py, &PipelineError::Field(error)))
    }

    fn __repr__(&self) -> String {
        let field = &self.0.field;
        let [cols, rows] = field.resolution;
        let [x, y] = self.0.views();
        let layers = self.0.layers.len();
        let backlight =
            if self.0.backlight == lumistack_display::Backlight::Uniform { "" } else { ", directional backlight" };
        let frames = self.0.frames;
        format!(
            "<lumistack.Display \"{}\", layers={layers}, frames={frames}, views={x}×{y} of {cols}×{rows}{backlight}>",
            self.0.name
        )
    }

    /// Returns a hash of some of the values. Equal displays have equal hashes.
    fn __hash__(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        let display = &*self.0;
        (&display.name, display.frames, display.layers.len(), display.field.resolution).hash(&mut hasher);
        hasher.finish()
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyAny>,))> {
        Ok((py.get_type::<Self>().into_any(), (self.to_dict(py)?,)))
    }
}

/// Returns the slopes with +0.0 instead of -0.0.
pub(crate) fn unsigned(slopes: &[f64]) -> Vec<f64> {
    slopes.iter().map(|slope| slope + 0.0).collect()
}

/// Returns the display that an argument selects; without an argument the default display.
pub(crate) fn display_of(py: Python<'_>, what: Option<&Bound<'_, PyAny>>) -> PyResult<Arc<Description>> {
    let Some(what) = what.filter(|what| !what.is_none()) else { return preset(py, lumistack_cli::DEFAULT_DISPLAY) };
    if let Ok(display) = what.cast::<Display>() {
        return Ok(display.get().0.clone());
    }
    if let Ok(text) = what.cast::<PyString>() {
        return preset(py, text.to_str()?);
    }
    if what.cast::<PyMapping>().is_ok() {
        let display: Description = parsed(py, "display", map_of("display", what)?)?;
        let place = PathBuf::from(&display.name);
        let checked = display.check();
        return checked
            .map(|()| Arc::new(display))
            .map_err(|source| raised(py, &PipelineError::Display { path: place, text: String::new(), source }));
    }
    let Ok(path) = what.extract::<PathBuf>() else {
        let found = what.get_type().name()?;
        let expected = "a Display, a name, a file or a mapping";
        return Err(PyTypeError::new_err(format!("display: expected {expected}, found {found}")));
    };
    presets::load_file(&path).map(Arc::new).map_err(|error| raised(py, &error))
}

fn preset(py: Python<'_>, name: &str) -> PyResult<Arc<Description>> {
    lumistack_pipeline::DisplayJob::by_name_or_path(name).resolve().map(Arc::new).map_err(|error| raised(py, &error))
}

/// Returns the display, adapted to a light field; unchanged if it has the light field's geometry.
///
/// # Errors
/// If the backlight cannot separate the light field's views.
pub(crate) fn adapted(py: Python<'_>, display: &Arc<Description>, field: &Field) -> PyResult<Arc<Description>> {
    match display.geometry() {
        Ok(geometry) if geometry == *field.geometry() => Ok(display.clone()),
        _ => display.adapted_to(field.geometry()).map(Arc::new).map_err(|source| {
            let path = PathBuf::from(&display.name);
            raised(py, &PipelineError::Display { path, text: String::new(), source })
        }),
    }
}
