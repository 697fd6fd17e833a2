//! The class of layer stacks.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use lumistack_core::Tensor;
use lumistack_display::{
    Display as Description, LayerStack as Stack, LightField as Field, RayMap, Simulator, ViewGrid, Weights, score,
};
use lumistack_pipeline::{FactorizeJob, PipelineError, References, RunFolder, weights_of};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple, PyType};

use crate::array::{Array, Part, Values};
use crate::display::{Display, display_of};
use crate::error::raised;
use crate::field::LightField;
use crate::json::numbers;
use crate::own::{in_package, in_python};
use crate::solved::{Solved, SolvedParts};
use crate::stored::{self, Holds};
use crate::work::long;

/// Largest difference between the slopes of equal views.
const SAME_SLOPE: f64 = 1e-6;

/// The patterns of a display: linear transmittances 0 to 1 of every layer and frame.
///
/// * layers: one array [frame, row, col, rgb] per layer, rear to front
/// * display: the Display that shows them, or an argument for Display()
/// * emission: for a directional backlight [frame, bin_y, bin_x, lenslet_row, lenslet_col, rgb]
/// * brightness: β of the patterns, above 0 and at most 1; by default the display's
///
/// Arrays may have the same types and layouts as for LightField. While the layer stack is in use,
/// do not write to arrays that are used without a copy.
///
/// >>> display = Display("fig7-uniform", resolution=(8, 8), frames=1)
///
/// >>> grey = memoryview(bytes(4 * 8 * 8 * 3)).cast("f", (1, 8, 8, 3))
/// >>> LayerStack([grey for _ in display.layer_shapes], display).frames
/// 1
#[pyclass(frozen, module = "lumistack")]
pub(crate) struct LayerStack {
    pub(crate) stack: Arc<Stack>,
    pub(crate) display: Arc<Description>,
    pub(crate) solved: Option<Solved>,
}

impl LayerStack {
    /// Returns the patterns that an argument gives.
    pub(crate) fn of<'a>(argument: &str, object: &'a Bound<'_, PyAny>) -> PyResult<&'a Self> {
        object.cast::<Self>().map(Bound::get).map_err(|_| {
            let found = object.get_type().name().map(|name| name.to_string()).unwrap_or_default();
            let remedy = "factorize(light_field) and LayerStack(layers, display) make a LayerStack";
            PyTypeError::new_err(format!("{argument}: expected a LayerStack, found {found}; {remedy}"))
        })
    }
}

#[pymethods]
impl LayerStack {
    #[new]
    #[pyo3(signature = (layers, display, *, emission=None, brightness=None))]
    fn new(
        py: Python<'_>,
        layers: &Bound<'_, PyAny>,
        display: &Bound<'_, PyAny>,
        emission: Option<&Bound<'_, PyAny>>,
        brightness: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let display = display_of(py, Some(display))?;
        let mut tensors = Vec::new();
        for (n, layer) in layers.try_iter()?.enumerate() {
            let what = format!("layers[{n}]");
            tensors.push(Values::read(&layer?, &what)?.tensor(&what, Stack::LAYER_AXES)?);
        }
        let emission = match emission.filter(|emission| !emission.is_none()) {
            None => None,
            Some(emission) => Some(Values::read(emission, "emission")?.tensor("emission", Stack::EMISSION_AXES)?),
        };
        let brightness = numbers("brightness", brightness)?.unwrap_or(display.brightness);
        let stack = Stack { layers: tensors, emission, brightness };
        stack
            .check(&display)
            .map_err(|source| raised(py, &PipelineError::Stack { path: "layer stack".into(), source }))?;
        Ok(Self { stack: Arc::new(stack), display, solved: None })
    }

    /// Reads patterns from a run's folder. With `display`, the folder may also be a folder `layers`
    /// alone, which does not contain its display.
    #[classmethod]
    #[pyo3(signature = (folder, *, display=None))]
    fn open(
        _class: &Bound<'_, PyType>,
        py: Python<'_>,
        folder: PathBuf,
        display: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let display = display.map(|display| display_of(py, Some(display))).transpose()?;
        let (stack, display) = long(py, None, |_| opened(&folder, display))?;
        Ok(Self { stack: Arc::new(stack), display, solved: None })
    }

    /// Writes a run's folder: display.toml, and `layers` with stack.json, one .npy array per layer
    /// and, for a directional backlight, emission.npy. The folder does not contain `history` and
    /// `solution`; pickles do.
    fn save(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        stored::check_free(py, &folder, Holds::Patterns)?;
        long(py, None, |_| {
            let layers = folder.join("layers");
            lumistack_field_io::write_stack(&layers, &self.display, &self.stack).map_err(PipelineError::Field)?;
            let path = folder.join("display.toml");
            lumistack_field_io::atomic::write_bytes(&path, self.display.to_toml().as_bytes())
                .map_err(PipelineError::Field)
        })
    }

    /// One read-only NumPy array [frame, row, col, rgb] per layer, rear to front, without copies.
    #[getter]
    fn layers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let layers = (0..self.stack.layers.len()).map(|n| Array::numpy(py, Part::Layer(self.stack.clone(), n)));
        PyTuple::new(py, layers.collect::<PyResult<Vec<_>>>()?)
    }

    /// The layers for use without NumPy: one object per layer, for memoryview(...).
    #[getter]
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let layers =
            (0..self.stack.layers.len()).map(|n| Bound::new(py, Array::new(Part::Layer(self.stack.clone(), n))));
        PyTuple::new(py, layers.collect::<PyResult<Vec<_>>>()?)
    }

    /// For a directional backlight a read-only array [frame, bin_y, bin_x, lenslet_row,
    /// lenslet_col, rgb]; None for a uniform backlight.
    #[getter]
    fn emission<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let lent = || Array::numpy(py, Part::Emission(self.stack.clone()));
        self.stack.emission.is_some().then(lent).transpose()
    }

    /// The display that shows the patterns.
    #[getter]
    fn display(&self) -> Display {
        Display(self.display.clone())
    }

    /// Number M of time-multiplexed frames.
    #[getter]
    fn frames(&self) -> usize {
        self.stack.frames()
    }

    /// β: the display emits β times the target.
    #[getter]
    fn brightness(&self) -> f64 {
        self.stack.brightness
    }

    /// For factorized patterns: a list of (number of iterations, Σ w (βL − L̃)², PSNR in dB). The
    /// first entry is for 0 iterations. For all other patterns the list is empty.
    #[getter]
    fn history(&self) -> Vec<(u32, f64, f64)> {
        let steps = self.solved.iter().flat_map(|solved| &solved.steps);
        steps.map(|step| (step.iteration, step.objective, step.psnr_view)).collect()
    }

    /// For factorized patterns: a dictionary with the solver, start and coarse_levels that were
    /// used, and with kkt_residual (rms) and levels. For layers with few bits, levels contains the
    /// PSNRs of continuous, rounded and re-optimized masks; otherwise it is None. For patterns that
    /// were not factorized, None.
    #[getter]
    fn solution<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(Solved { solution, .. }) = &self.solved else { return Ok(None) };
        let dict = PyDict::new(py);
        dict.set_item("solver", &solution.solver)?;
        dict.set_item("start", &solution.start)?;
        dict.set_item("coarse_levels", solution.coarse_levels)?;
        dict.set_item("kkt_residual", solution.kkt_residual)?;
        dict.set_item("levels", solution.levels)?;
        Ok(Some(dict))
    }

    /// Returns the PSNR in dB, with peak 1, of the emitted light field against the target light
    /// field. All rays with a weight above 0 count equally; weights: as for factorize().
    ///
    /// The PSNR compares L̃/β, which an adapted viewer sees, with L. With raw=True it compares L̃
    /// with βL, which gives a PSNR that is higher by −20 log10 β.
    #[pyo3(signature = (light_field, *, weights=None, raw=false))]
    fn psnr(
        &self,
        py: Python<'_>,
        light_field: &Bound<'_, PyAny>,
        weights: Option<&Bound<'_, PyAny>>,
        raw: bool,
    ) -> PyResult<f64> {
        let light_field = LightField::of("light_field", light_field)?;
        let weights = weights.map(|weights| Values::read(weights, "weights")).transpose()?.map(Values::into_parts);
        let target = &*light_field.field;
        long(py, None, |_| {
            let weights = weights_of(&FactorizeJob::default(), weights, target)?;
            let score = score(&self.display, &self.stack, target, &weights);
            Ok(if raw { score.psnr_raw() } else { score.psnr_view() })
        })
    }

    /// Returns the zone score: PSNR of seen pictures in directions that the solver did not use, dB.
    /// A seen picture is the mean over every pixel's area.
    ///
    /// references: a LightField that render() made with zone_directions; its reference pictures are
    /// compared with the seen pictures. If the light field has no reference pictures, its views are
    /// compared. Then the light field should not be the target of the patterns; a warning counts
    /// the views that the solver has used. Returns a dictionary with psnr_zone,
    /// psnr_zone_worst_tenth (over the worst tenth of the directions) and directions, a list of
    /// (slope, psnr).
    #[pyo3(signature = (references, *, callback=None))]
    fn psnr_zone<'py>(
        &self,
        py: Python<'py>,
        references: &Bound<'py, PyAny>,
        callback: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let references = LightField::of("references", references)?;
        let of = references.references.clone();
        let score = long(py, callback, |task| {
            let of = of.unwrap_or_else(|| {
                let grid = &references.field.geometry().grid;
                let (all, used) = (grid.iter().count(), used_views(&self.display, grid));
                if used > 0 {
                    task.warn(
                        "psnr_zone",
                        format!("the light field has no reference pictures, so its own {all} views are the references; the solver used {used} of these views to compute the patterns. Remedy: render with zone_directions=32, or pass other views"),
                    );
                }
                Arc::new(References::views_of(&references.field))
            });
            of.score(&self.display, &self.stack, task)
        })?;
        let dict = PyDict::new(py);
        dict.set_item("psnr_zone", score.psnr())?;
        dict.set_item("psnr_zone_worst_tenth", score.worst_tenth())?;
        let directions = score.directions.iter().filter(|direction| direction.pixels > 0);
        dict.set_item("directions", directions.map(|d| (d.slope, d.psnr())).collect::<Vec<_>>())?;
        Ok(dict)
    }

    /// Simulates the rays of a light field: returns L̃/β, or with raw=True L̃ itself, as a light
    /// field. Rays that miss the display have the value 0.
    #[pyo3(signature = (like, *, raw=false, callback=None))]
    fn views(
        &self,
        py: Python<'_>,
        like: &Bound<'_, PyAny>,
        raw: bool,
        callback: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<LightField> {
        let like = LightField::of("like", like)?;
        let scale = if raw { 1.0 } else { (1.0 / self.stack.brightness) as f32 };
        let field = long(py, callback, |task| {
            let mut shown = Field::black(like.field.geometry().clone())?;
            let geometry = like.field.geometry();
            let (simulator, map) = (Simulator::new(&self.display, &self.stack), RayMap::new(&self.display, geometry));
            task.progress.begin("simulate", geometry.grid.iter().count() as u64, "views");
            for view in geometry.grid.iter() {
                task.cancel.check()?;
                let emitted = simulator.view(&map, geometry, view);
                shown.view_mut(view).iter_mut().zip(emitted.radiance.data()).for_each(|(to, from)| *to = from * scale);
                task.progress.advance(1, "");
            }
            task.progress.end();
            Ok(shown)
        })?;
        Ok(LightField::plain(field))
    }

    /// Returns the weight of every ray of a light field, [view_y, view_x, row, col].
    ///
    /// A ray that misses the display has weight 0. Other rays have their weight in `weights`, or 1.
    ///
    /// Let d be views(light_field).radiance - light_field.radiance. Then psnr() is -10 log10 of the
    /// mean of d² over all channels and all rays with a weight above 0.
    #[pyo3(signature = (light_field, *, weights=None))]
    fn weights<'py>(
        &self,
        py: Python<'py>,
        light_field: &Bound<'py, PyAny>,
        weights: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let light_field = LightField::of("light_field", light_field)?;
        let weights = weights.map(|weights| Values::read(weights, "weights")).transpose()?.map(Values::into_parts);
        let target = &*light_field.field;
        let weights = long(py, None, |_| {
            let weights = weights_of(&FactorizeJob::default(), weights, target)?;
            Ok(ray_weights(&self.display, &self.stack, target, &weights))
        })?;
        Array::numpy(py, Part::Weights(Arc::new(weights)))
    }

    /// Equivalent to lumistack.simulate(stack, ...).
    #[pyo3(signature = (slope=None, **viewpoint))]
    fn simulate<'py>(
        slf: &Bound<'py, Self>,
        slope: Option<&Bound<'py, PyAny>>,
        viewpoint: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        in_python(slf.py(), "simulate", (slf, slope), viewpoint)
    }

    /// Equivalent to lumistack.write(stack, plugin, folder, ...).
    #[pyo3(signature = (plugin, folder, **params))]
    fn write<'py>(
        slf: &Bound<'py, Self>,
        plugin: &Bound<'py, PyAny>,
        folder: &Bound<'py, PyAny>,
        params: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        in_python(slf.py(), "write", (slf, plugin, folder), params)
    }

    /// Draws the masks of a frame with matplotlib, rear to front, and the seen picture from the
    /// middle. Returns the axes.
    #[pyo3(signature = (frame=0))]
    fn plot<'py>(slf: &Bound<'py, Self>, frame: usize) -> PyResult<Bound<'py, PyAny>> {
        in_package(slf.py(), "_show", "plot_patterns", (slf, frame), None)
    }

    /// Draws PSNR over iterations with matplotlib, into the axes `ax` or into new axes. Returns the
    /// axes.
    #[pyo3(signature = (*, ax=None))]
    fn plot_history<'py>(slf: &Bound<'py, Self>, ax: Option<&Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyAny>> {
        in_package(slf.py(), "_show", "plot_history", (slf, ax), None)
    }

    fn _repr_html_<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        in_package(slf.py(), "_show", "layer_stack", (slf,), None)
    }

    fn __repr__(&self) -> String {
        let psnr = self.solved.as_ref().and_then(|solved| solved.steps.last());
        let psnr = psnr.map_or(String::new(), |step| format!(", {:.2} dB", step.psnr_view));
        let (layers, frames) = (self.stack.layers.len(), self.stack.frames());
        format!("<lumistack.LayerStack for \"{}\", layers={layers}, frames={frames}{psnr}>", self.display.name)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let rebuild = py.import("lumistack._pickle")?.getattr("layer_stack")?;
        let display = Bound::new(py, self.display())?;
        let parts =
            (self.layers(py)?, self.emission(py)?, display, self.brightness(), self.solved.as_ref().map(Solved::parts));
        Ok((rebuild, parts.into_pyobject(py)?))
    }
}

/// Returns a stack with the history and the solution of a pickle.
#[pyfunction]
pub(crate) fn _layer_stack_with(stack: &LayerStack, solved: SolvedParts) -> LayerStack {
    let solved = Some(Solved::from_parts(solved));
    LayerStack { stack: stack.stack.clone(), display: stack.display.clone(), solved }
}

/// Returns the number of views of a grid that are also views of a display. Patterns are solved for
/// the views of their display.
fn used_views(display: &Description, grid: &ViewGrid) -> usize {
    let Ok(geometry) = display.geometry() else { return 0 };
    let same = |a: f64, b: f64| (a - b).abs() < SAME_SLOPE;
    let is_used = |slope: f64, all: &[f64]| all.iter().any(|other| same(slope, *other));
    let count = |slopes: &[f64], all: &[f64]| slopes.iter().filter(|slope| is_used(**slope, all)).count();
    if grid.projection != geometry.grid.projection {
        return 0;
    }
    count(&grid.slope_x, &geometry.grid.slope_x) * count(&grid.slope_y, &geometry.grid.slope_y)
}

/// Returns the weight of every ray, `[view_y][view_x][row][col]`; 0 for rays that miss the display.
fn ray_weights(display: &Description, stack: &Stack, target: &Field, weights: &Weights) -> Tensor<4> {
    let geometry = target.geometry();
    let [view_rows, view_cols] = geometry.grid.views();
    let (simulator, map) = (Simulator::new(display, stack), RayMap::new(display, geometry));
    let shape = [view_rows, view_cols, geometry.rows, geometry.cols];
    let mut all = Tensor::zeros(["view_y", "view_x", "row", "col"], shape);
    let of_views = all.data_mut().chunks_exact_mut(geometry.rows * geometry.cols);
    for (view, of_view) in geometry.grid.iter().zip(of_views) {
        let valid = simulator.view(&map, geometry, view).valid;
        for (i, (weight, valid)) in of_view.iter_mut().zip(valid).enumerate() {
            *weight = if valid { weights.at(view, i / geometry.cols, i % geometry.cols) } else { 0.0 };
        }
    }
    all
}

fn opened(folder: &Path, display: Option<Arc<Description>>) -> Result<(Stack, Arc<Description>), PipelineError> {
    let Some(display) = display else {
        let run = RunFolder::open(folder)?;
        return Ok((run.stack, Arc::new(run.display)));
    };
    let layers = folder.join("layers");
    let layers = if layers.join("stack.json").is_file() { &layers } else { folder };
    let stack = lumistack_field_io::read_stack(layers).map_err(PipelineError::Field)?;
    stack.check(&display).map_err(|source| PipelineError::Stack { path: layers.to_owned(), source })?;
    Ok((stack, display))
}
