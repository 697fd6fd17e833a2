//! Renders, one by one, the views that a display needs, and makes a light field of rendered views.

use lumistack_core::{Task, Tensor};
use lumistack_display::{Display, FieldGeometry, LightField, ViewGrid};
use lumistack_pathtracer::denoise::SharedLight;
use lumistack_pathtracer::{Settings as Paths, SplitView};
use lumistack_shot::{
    Brightest, Denoise, Depths, LightJob, LitScene, Placement, RenderJob, ToneMapping, WindowJob, coarser, place,
    put_before, seeded, slopes,
};
use lumistack_simd::{float_from_half, nearest_half};
use lumistack_splats::Space;

use crate::error::Error;
use crate::settings::Settings;

/// Number of the stream of random numbers for the target's views; the command uses the same number.
const TARGET: u64 = 0;
/// Seed of the job; the command uses the same seed.
const SEED: u64 = 1;

/// A selection of views: all pairs of these rows and columns of the grid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Picked {
    pub(crate) rows: Vec<usize>,
    pub(crate) cols: Vec<usize>,
}

/// Number of pixels of traced views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Detail {
    /// Half of the rows and columns, for the first picture. One path per pixel then takes a quarter
    /// of the time.
    Coarse,
    /// All pixels of the display's light field.
    Full,
}

/// The views of a scene in front of a display.
pub(crate) struct Views {
    held: LitScene,
    placement: Placement,
    /// Geometry of the display's light field.
    geometry: FieldGeometry,
    coarse: Traced,
    full: Traced,
    paths: Paths,
    denoise: Denoise,
    light: LightJob,
    splats: Vec<Option<Tensor<3>>>,
    /// True for views that were given to another thread to trace.
    given: Vec<bool>,
    /// Depths of all views, once they are traced.
    depths: Option<Depths>,
}

/// Traced views of one [`Detail`].
struct Traced {
    /// The pixels, and the slopes at which the scene is traced: the display's slopes times the
    /// depth scale.
    geometry: FieldGeometry,
    /// Number of paths per pixel of the last view that was kept.
    samples: u32,
    /// Views in the order of the grid, packed as in the command's cache, since pages have little
    /// memory; `None` for views that are not traced yet.
    splits: Vec<Option<Vec<u8>>>,
}

impl Picked {
    /// Returns all views of a grid.
    pub(crate) fn all(grid: &ViewGrid) -> Self {
        let [rows, cols] = grid.views();
        Self { rows: (0..rows).collect(), cols: (0..cols).collect() }
    }

    /// Picks at most `most` rows and at most `most` columns, evenly spread from the first to the
    /// last.
    pub(crate) fn some(grid: &ViewGrid, most: usize) -> Self {
        let pick = |count: usize| match count.min(most) {
            1 => vec![count / 2],
            some => (0..some).map(|i| (2 * i * (count - 1) + some - 1) / (2 * (some - 1))).collect(),
        };
        let [rows, cols] = grid.views();
        Self { rows: pick(rows), cols: pick(cols) }
    }

    /// Returns the picked views as [view_y, view_x], row by row.
    pub(crate) fn views(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        self.rows.iter().flat_map(|&y| self.cols.iter().map(move |&x| [y, x]))
    }

    fn of(&self, geometry: &FieldGeometry) -> FieldGeometry {
        let ViewGrid { projection, slope_x, slope_y } = &geometry.grid;
        let slopes = |of: &[f64], picked: &[usize]| picked.iter().map(|&i| of[i]).collect();
        geometry.with_grid(ViewGrid {
            projection: *projection,
            slope_x: slopes(slope_x, &self.cols),
            slope_y: slopes(slope_y, &self.rows),
        })
    }
}

impl Views {
    /// Places the display in a lit scene.
    ///
    /// # Errors
    /// If scene and display do not fit each other.
    pub(crate) fn new(held: LitScene, display: &Display, settings: &Settings, task: Task<'_>) -> Result<Self, Error> {
        let geometry = display.geometry()?;
        let placement = place(&held, &WindowJob::default(), display, &geometry, task)?;
        let grid = geometry.grid.scaled(placement.depth_scale);
        let coarse = coarser(&geometry, grid.clone(), geometry.cols.div_ceil(2));
        let count = geometry.grid.iter().count();
        let render = settings.render();
        let samples = render.samples_of_view(count);
        let paths = render.settings(SEED, samples, false, placement.depth_scale, display.angular_footprint());
        let denoise = if held.scene.needs_paths() { Settings::denoise(display) } else { Denoise::Off };
        let paths = RenderJob::split_settings(paths, display, denoise);
        Ok(Self {
            denoise,
            held,
            placement,
            coarse: Traced::none(coarse),
            full: Traced::none(geometry.with_grid(grid)),
            paths: seeded(paths, TARGET, &[]),
            light: LightJob::default(),
            splats: (0..count).map(|_| None).collect(),
            given: vec![false; count],
            depths: None,
            geometry,
        })
    }

    /// Returns the scene, so that another display can be placed in it.
    pub(crate) fn into_held(self) -> LitScene {
        self.held
    }

    pub(crate) fn grid(&self) -> &ViewGrid {
        &self.geometry.grid
    }

    /// Returns the number of paths per pixel of a finished view.
    pub(crate) fn samples(&self) -> u32 {
        self.paths.samples
    }

    pub(crate) fn is_traced(&self) -> bool {
        self.held.scene.needs_paths()
    }

    pub(crate) fn has_splats(&self) -> bool {
        self.held.renderer.splats.is_some()
    }

    /// Traces a view with `samples` paths per pixel.
    ///
    /// # Errors
    /// If the view cannot be rendered.
    pub(crate) fn trace(
        &self,
        view: [usize; 2],
        detail: Detail,
        samples: u32,
        task: Task<'_>,
    ) -> Result<SplitView, Error> {
        let paths = Paths { samples, ..self.paths };
        let geometry = &self.traced(detail).geometry;
        Ok(self.held.renderer.tracer.render_split(&self.placement.window, geometry, view, &paths, task)?)
    }

    fn traced(&self, detail: Detail) -> &Traced {
        match detail {
            Detail::Coarse => &self.coarse,
            Detail::Full => &self.full,
        }
    }

    /// Traces the view of this number with all its samples.
    ///
    /// # Errors
    /// If the view cannot be rendered.
    pub(crate) fn trace_whole(&self, number: usize, task: Task<'_>) -> Result<SplitView, Error> {
        let cols = self.geometry.grid.views()[1];
        self.trace([number / cols, number % cols], Detail::Full, self.samples(), task)
    }

    /// Keeps a view that was traced with `samples` paths per pixel. It replaces an earlier result
    /// for this view.
    pub(crate) fn keep(&mut self, view: [usize; 2], detail: Detail, samples: u32, split: &SplitView) {
        let number = self.number(view);
        let traced = match detail {
            Detail::Coarse => &mut self.coarse,
            Detail::Full => &mut self.full,
        };
        traced.samples = samples;
        traced.splits[number] = Some(split.to_bytes());
    }

    /// Keeps the values of a view that another thread traced.
    ///
    /// # Errors
    /// If there is no such view, or `values` is not as long as the values of the view.
    pub(crate) fn keep_values(&mut self, number: usize, values: Vec<f32>) -> Result<(), Error> {
        let found = values.len();
        let mut split = Tensor::zeros(
            ["row", "col", "part"],
            [self.geometry.rows, self.geometry.cols, SplitView::values_of(&self.paths)],
        );
        self.full.samples = self.paths.samples;
        match self.full.splits.get_mut(number) {
            Some(place) if split.data().len() == found => {
                split.data_mut().copy_from_slice(&values);
                *place = SplitView::from_values(split).map(|split| split.to_bytes());
                Ok(())
            }
            _ => Err(Error::value("view", "an existing view with all its values", format!("{found} values"))),
        }
    }

    /// Returns the number of a view at the first call for this view, and `None` at later calls.
    pub(crate) fn give(&mut self, view: [usize; 2]) -> Option<usize> {
        let number = self.number(view);
        (!std::mem::replace(&mut self.given[number], true)).then_some(number)
    }

    /// Renders the splats of some views.
    ///
    /// # Errors
    /// If the splats cannot be rendered.
    pub(crate) fn render_splats(&mut self, views: &[[usize; 2]], task: Task<'_>) -> Result<(), Error> {
        let (held, window, traced) = (&self.held, &self.placement.window, &self.full.geometry);
        let slopes = slopes(traced, views);
        let splats = &mut self.splats;
        let cols = traced.grid.views()[1];
        held.renderer.splat_views(window, traced, &slopes, task, |number, view| {
            let [y, x] = views[number];
            splats[y * cols + x] = Some(view.light);
            Ok::<(), Error>(())
        })
    }

    pub(crate) fn number(&self, [y, x]: [usize; 2]) -> usize {
        y * self.geometry.grid.views()[1] + x
    }

    /// Makes a light field of the picked views. The steps are those of the command: average the
    /// light that views share, add splats, apply exposure and tone curve, and round. At the
    /// end, coarse views are interpolated to all pixels.
    ///
    /// # Errors
    /// If the depths, from which the exposure is chosen, cannot be traced, or the light cannot be
    /// averaged.
    pub(crate) fn field(&mut self, picked: &Picked, detail: Detail, task: Task<'_>) -> Result<LightField, Error> {
        let of_display = picked.of(&self.geometry);
        let traced = picked.of(&self.traced(detail).geometry);
        let depths = self.depths_of(picked, &traced, detail, task)?;
        let numbers: Vec<usize> = picked.views().map(|view| self.number(view)).collect();
        let mut field = LightField::black(traced.with_grid(of_display.grid.clone()))?;
        let places: Vec<[usize; 2]> = field.geometry().grid.iter().collect();
        // Write the radiance of surfaces. With the filter `Denoise::Shared`, light is averaged over
        // the views.
        let packed = &self.traced(detail).splits;
        if numbers.iter().all(|&number| packed[number].is_some()) {
            let splits = || {
                let packed = numbers.iter().filter_map(|&number| packed[number].as_ref());
                packed.filter_map(|bytes| SplitView::from_bytes(bytes, [traced.rows, traced.cols], &self.paths))
            };
            let shared = if self.denoise == Denoise::Shared {
                let mut light =
                    SharedLight::new(&traced, &Paths { samples: self.traced(detail).samples, ..self.paths });
                splits().for_each(|split| light.add(&split));
                Some(light.averaged(task)?)
            } else {
                None
            };
            for (number, (&place, split)) in places.iter().zip(splits()).enumerate() {
                let radiance = match &shared {
                    Some(shared) => shared.on(number, &split),
                    None => split.radiance(),
                };
                field.view_mut(place).copy_from_slice(radiance.data());
            }
        }
        // Draw splats in front of the surfaces. Splats have no noise, so they were not averaged.
        if let Some(space) = Space::of(&self.held.scene) {
            for (&place, &number) in places.iter().zip(&numbers) {
                if let Some(splats) = &self.splats[number] {
                    put_before(space, splats.data(), field.view_mut(place));
                }
            }
        }
        // Apply one exposure and tone curve to all views.
        let brightest = Brightest::new(field.geometry(), places.len(), &depths);
        let of_view = |(number, &view)| brightest.of_view(number, view, field.view(view));
        let rays: Vec<(f32, bool)> = places.iter().enumerate().flat_map(of_view).collect();
        let tone_mapping = ToneMapping::choose(&self.light, &self.held.scene, &rays);
        tone_mapping.apply(&mut field);
        // Round to half floats as the command does. After the tone curve values are at most 1, so
        // they cannot overflow.
        field.radiance_mut().data_mut().iter_mut().for_each(|value| *value = float_from_half(nearest_half(*value)));
        match detail {
            Detail::Coarse => finer(&field, of_display),
            Detail::Full => Ok(field),
        }
    }

    fn depths_of(
        &mut self,
        picked: &Picked,
        traced: &FieldGeometry,
        detail: Detail,
        task: Task<'_>,
    ) -> Result<Depths, Error> {
        let all = detail == Detail::Full && *picked == Picked::all(&self.geometry.grid);
        if let Some(depths) = self.depths.as_ref().filter(|_| all) {
            return Ok(depths.clone());
        }
        let depths = Depths::trace(&self.held.renderer, &self.placement.window, traced, task)?;
        if all {
            self.depths = Some(depths.clone());
        }
        Ok(depths)
    }
}

impl Traced {
    fn none(geometry: FieldGeometry) -> Self {
        Self { splits: geometry.grid.iter().map(|_| None).collect(), samples: 1, geometry }
    }
}

/// Interpolates the pixels of a light field bilinearly at the centres of the finer pixels of
/// `geometry`. The two geometries have the same centre and the same views.
fn finer(coarse: &LightField, geometry: FieldGeometry) -> Result<LightField, Error> {
    let from = coarse.geometry();
    let taps = |count: usize, of: usize| -> Vec<(usize, usize, f32)> {
        let tap = |i: usize| {
            let centre_mm = (i as f64 + 0.5 - 0.5 * count as f64) * geometry.pitch_mm;
            let place = centre_mm / from.pitch_mm + 0.5 * of as f64 - 0.5;
            let place = place.clamp(0.0, (of - 1) as f64);
            let first = place as usize;
            (first, (first + 1).min(of - 1), (place - first as f64) as f32)
        };
        (0..count).map(tap).collect()
    };
    let (rows, cols) = (taps(geometry.rows, from.rows), taps(geometry.cols, from.cols));
    let mut field = LightField::black(geometry)?;
    let places: Vec<[usize; 2]> = from.grid.iter().collect();
    for place in places {
        let pixels = coarse.view(place).as_chunks::<3>().0;
        let mut to = field.view_mut(place).as_chunks_mut::<3>().0.iter_mut();
        for &(top, bottom, down) in &rows {
            for (&(left, right, over), pixel) in cols.iter().zip(&mut to) {
                let mix = |row: usize, c: usize| {
                    let [a, b] = [left, right].map(|col| pixels[row * from.cols + col][c]);
                    a + over * (b - a)
                };
                *pixel = std::array::from_fn(|c| {
                    let [a, b] = [top, bottom].map(|row| mix(row, c));
                    a + down * (b - a)
                });
            }
        }
    }
    Ok(field)
}

#[cfg(test)]
mod tests {
    use lumistack_display::Projection;

    use super::*;

    /// Interpolation keeps values that are linear functions of the place on the display. This also
    /// holds if the coarse rectangle is a little higher than the fine rectangle. Fine pixels
    /// outside of the centres of the outermost coarse pixels have the values of these coarse
    /// pixels.
    #[test]
    fn finer_pixels_show_the_same_places() {
        let grid = ViewGrid::uniform(Projection::Oblique, [2, 1], [20.0, 0.0]).unwrap();
        let geometry = FieldGeometry { rows: 7, cols: 12, pitch_mm: 1.5, grid };
        let coarse = coarser(&geometry, geometry.grid.clone(), 6);
        assert_eq!((coarse.rows, coarse.cols, coarse.pitch_mm), (4, 6, 3.0));
        let value = |of: &FieldGeometry, view: usize, row: usize, col: usize| {
            let x_mm = (col as f64 + 0.5 - 0.5 * of.cols as f64) * of.pitch_mm;
            let y_mm = (row as f64 + 0.5 - 0.5 * of.rows as f64) * of.pitch_mm;
            [x_mm as f32, y_mm as f32, 0.1 * (x_mm - 2.0 * y_mm) as f32 + view as f32]
        };
        let mut from = LightField::black(coarse.clone()).unwrap();
        for view in 0..2 {
            for (i, pixel) in from.view_mut([0, view]).as_chunks_mut::<3>().0.iter_mut().enumerate() {
                *pixel = value(&coarse, view, i / coarse.cols, i % coarse.cols);
            }
        }
        let found = finer(&from, geometry.clone()).unwrap();
        for view in 0..2 {
            for (i, pixel) in found.view([0, view]).as_chunks::<3>().0.iter().enumerate() {
                let (row, col) = (i / geometry.cols, i % geometry.cols);
                let is_inside = (1..geometry.cols - 1).contains(&col);
                let expected = value(&geometry, view, row, col);
                let far = pixel.iter().zip(expected).any(|(a, b)| (a - b).abs() > 1e-4);
                assert_eq!(far, !is_inside, "view {view}, row {row}, column {col}: {pixel:?}, expected {expected:?}");
            }
        }
        assert_eq!(found.view([0, 0])[0], value(&coarse, 0, 0, 0)[0]);
    }
}
