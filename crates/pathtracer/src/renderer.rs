//! The renderer: a scene prepared once, views rendered tile by tile.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use lumistack_core::{Cancelled, Task, Tensor, seed};
use lumistack_display::{FieldGeometry, GridError};
use lumistack_scene::{Scene, Window};
#[cfg(feature = "parallel")]
use rayon::prelude::*;
use thiserror::Error;

use crate::bvh::{self, Bvh, Stack};
use crate::geometry::Geometry;
use crate::light::Lights;
use crate::primary::{PrimaryRay, PrimaryRays};
use crate::sampler::SampleBank;
use crate::settings::{AngularFilter, Settings, SettingsError};
use crate::shading::Materials;
use crate::tracer::Tracer;

/// Edge of a tile in pixels: the unit of work, of progress and of cancellation.
const TILE: usize = 16;

/// A scene prepared for rendering. Shared by all views and threads.
///
/// ```
/// # use std::sync::Arc;
/// # use lumistack_core::{Cancel, Collector, Task};
/// # use lumistack_display::{FieldGeometry, Projection, ViewGrid};
/// # use lumistack_pathtracer::{Renderer, Settings};
/// # use lumistack_scene::{Instance, Material, Mesh, SceneParts, Window};
/// # let (warnings, cancel) = (Collector::default(), Cancel::default());
/// # let task = Task::quiet(&warnings, &cancel);
/// # let parts = SceneParts {
/// #     meshes: vec![Mesh {
/// #         positions: vec![glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y],
/// #         triangles: vec![[0, 1, 2]],
/// #         ..Mesh::default()
/// #     }],
/// #     instances: vec![Instance { mesh: 0, scene_from_mesh: glam::Affine3A::IDENTITY }],
/// #     materials: vec![Material { emission: glam::Vec3::splat(2.0), ..Material::default() }],
/// #     ..SceneParts::default()
/// # };
/// # let scene = Arc::new(parts.validate(task)?);
/// let grid = ViewGrid::uniform(Projection::Oblique, [3, 3], [20.0, 20.0])?;
/// let geometry = FieldGeometry { rows: 10, cols: 16, pitch_mm: 3.0, grid };
/// let window = Window::framing(scene.bounds(), geometry.size_mm())?;
/// let renderer = Renderer::new(scene, task)?;
/// let radiance = renderer.render_view(&window, &geometry, [1, 1], &Settings::default(), task)?;
/// assert_eq!(radiance.shape(), [10, 16, 3]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Renderer {
    geometry: Geometry,
    bvh: Bvh,
    materials: Materials,
    lights: Lights,
}

/// A view that cannot be rendered.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RenderError {
    /// A setting is out of its range.
    #[error("render settings: {0}")]
    Settings(#[from] SettingsError),
    /// The light field's geometry makes no sense.
    #[error(transparent)]
    Geometry(#[from] GridError),
    /// The view is not in the grid.
    #[error("view: expected a row below {} and a column below {}, found row {} and column {}", .views[0], .views[1], .view[0], .view[1])]
    View {
        /// Number of views, [vertical, horizontal].
        views: [usize; 2],
        /// The view that was asked for, [y, x].
        view: [usize; 2],
    },
    /// The tree cannot hold so many triangles.
    #[error("scene: expected at most {} triangles with instances counted, found {found}", bvh::MAX_TRIANGLES)]
    TooManyTriangles {
        /// Number of triangles.
        found: usize,
    },
    /// Stopped from outside.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl Renderer {
    /// Prepares a scene: image pyramids, tree, lights. Takes time and memory in proportion to the scene, not to the views.
    ///
    /// # Errors
    /// If the scene has more than 2²⁹ − 1 triangles with instances counted, or when cancelled.
    pub fn new(scene: Arc<Scene>, task: Task<'_>) -> Result<Self, RenderError> {
        let found = scene.triangle_count();
        if found > bvh::MAX_TRIANGLES {
            return Err(RenderError::TooManyTriangles { found });
        }
        let geometry = Geometry::new(scene.clone());
        task.cancel.check()?;
        let materials = Materials::new(scene.clone());
        task.cancel.check()?;
        let flags: Vec<u32> = (0..found as u32).map(|t| materials.flags(geometry.material_index(t))).collect();
        let bvh = Bvh::build(&geometry.triangles, &flags);
        task.cancel.check()?;
        let lights = Lights::new(&scene, &geometry, &materials);
        if lights.is_dark() {
            task.warn(&scene.name, "nothing in the scene emits light, so every view is black");
        }
        Ok(Self { geometry, bvh, materials, lights })
    }

    /// Steps by which one call of [`render_view`](Self::render_view) advances the progress: its tiles.
    pub fn steps_per_view(geometry: &FieldGeometry) -> u64 {
        Tiles::new(geometry).count() as u64
    }

    /// Renders one view, `view` = [view_y, view_x] of the geometry's grid: scene-linear radiance `[row][col][rgb]`, not exposed.
    ///
    /// The pixel filter is a box as wide as the pixel. The caller begins and ends the progress stage, which may span many views;
    /// this call advances it by [`steps_per_view`](Self::steps_per_view). Samples that are not finite numbers are left out of the mean
    /// and reported as a warning.
    ///
    /// # Errors
    /// If a setting, the geometry or the view is out of range, or when cancelled.
    pub fn render_view(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        task: Task<'_>,
    ) -> Result<Tensor<3>, RenderError> {
        settings.check()?;
        let rays = self.primary_rays(window, geometry, view, settings.angular_filter)?;
        let bank = SampleBank::new(settings.samples);
        let view_seed = seed::derive(settings.seed, &[view[0] as u64, view[1] as u64]);
        let lost = AtomicU64::new(0);
        let radiance = self.by_tiles(geometry, task, ["row", "col", "rgb"], |row, col, stack| {
            let pixel_seed = seed::derive(view_seed, &[row as u64, col as u64]);
            let (mean, not_finite) = self.pixel(&rays, row, col, &bank, pixel_seed, settings, stack);
            if not_finite > 0 {
                lost.fetch_add(u64::from(not_finite), Ordering::Relaxed);
            }
            mean.to_array()
        })?;
        let lost = lost.into_inner();
        if lost > 0 {
            let all = settings.samples as usize * geometry.rows * geometry.cols;
            task.warn(
                format!("view {},{}", view[0], view[1]),
                format!("{lost} of {all} samples are not finite numbers and are left out"),
            );
        }
        Ok(radiance)
    }

    /// 1 for every pixel whose central ray meets a surface, else 0: `[row][col]`. Does not advance the progress.
    ///
    /// # Errors
    /// If the geometry or the view is out of range, or when cancelled.
    pub fn hit_mask(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        task: Task<'_>,
    ) -> Result<Tensor<2>, RenderError> {
        let rays = self.primary_rays(window, geometry, view, AngularFilter::Point)?;
        let quiet = Task { progress: &lumistack_core::NoProgress, ..task };
        let mask = self.by_tiles(geometry, quiet, ["row", "col", "hit"], |row, col, stack| {
            let PrimaryRay { ray, in_bounds, .. } = rays.ray(row, col, [0.0; 2], [0.0; 2]);
            [f32::from(u8::from(in_bounds && self.tracer().meets_surface(ray, stack)))]
        })?;
        let [rows, cols, _] = mask.shape();
        let mut flat = Tensor::zeros(["row", "col"], [rows, cols]);
        flat.data_mut().copy_from_slice(mask.data());
        Ok(flat)
    }

    /// Share of the window, 0..1, where the central rays of a view meet a surface.
    ///
    /// # Errors
    /// As [`hit_mask`](Self::hit_mask).
    pub fn coverage(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        task: Task<'_>,
    ) -> Result<f64, RenderError> {
        let mask = self.hit_mask(window, geometry, view, task)?;
        let hits: f64 = mask.data().iter().map(|&hit| f64::from(hit)).sum();
        Ok(hits / mask.data().len() as f64)
    }

    fn primary_rays<'a>(
        &self,
        window: &'a Window,
        geometry: &'a FieldGeometry,
        view: [usize; 2],
        angular_filter: AngularFilter,
    ) -> Result<PrimaryRays<'a>, RenderError> {
        geometry.check()?;
        let views = geometry.grid.views();
        if view[0] >= views[0] || view[1] >= views[1] {
            return Err(RenderError::View { views, view });
        }
        let slope_width = match angular_filter {
            AngularFilter::Point => [0.0; 2],
            AngularFilter::Bin => geometry.grid.bin_width(),
            AngularFilter::Width(width) => width,
        };
        Ok(PrimaryRays { window, geometry, view, space: self.geometry.space, slope_width })
    }

    fn tracer(&self) -> Tracer<'_> {
        Tracer { geometry: &self.geometry, bvh: &self.bvh, materials: &self.materials, lights: &self.lights }
    }

    /// Mean radiance of a pixel, and how many samples were not finite.
    fn pixel(
        &self,
        rays: &PrimaryRays<'_>,
        row: usize,
        col: usize,
        bank: &SampleBank,
        pixel_seed: u64,
        settings: &Settings,
        stack: &mut Stack,
    ) -> (Vec3, u32) {
        let tracer = self.tracer();
        let mut sum = [0.0f64; 3];
        let mut not_finite = 0;
        for index in 0..settings.samples {
            let mut sampler = bank.sampler(pixel_seed, index);
            let centred = |pair: [f32; 2]| pair.map(|u| f64::from(u) - 0.5);
            let (in_pixel, in_bin) = (centred(sampler.pair()), centred(sampler.pair()));
            let PrimaryRay { ray, cone, in_bounds } = rays.ray(row, col, in_pixel, in_bin);
            let radiance = tracer.radiance(ray, cone, in_bounds, settings, &mut sampler, stack);
            if radiance.is_finite() {
                (0..3).for_each(|c| sum[c] += f64::from(radiance[c]));
            } else {
                not_finite += 1;
            }
        }
        let count = f64::from((settings.samples - not_finite).max(1));
        (Vec3::from_array(sum.map(|s| (s / count) as f32)), not_finite)
    }

    /// Fills `[row][col][k]` tile by tile. Values depend only on the pixel, so threads do not matter.
    fn by_tiles<const K: usize>(
        &self,
        geometry: &FieldGeometry,
        task: Task<'_>,
        axes: [&'static str; 3],
        pixel: impl Fn(usize, usize, &mut Stack) -> [f32; K] + Sync,
    ) -> Result<Tensor<3>, RenderError> {
        let tiles = Tiles::new(geometry);
        let fill = |tile: usize| -> Result<Vec<[f32; K]>, Cancelled> {
            task.cancel.check()?;
            let mut stack = self.bvh.stack();
            let values = tiles.pixels(tile).map(|(row, col)| pixel(row, col, &mut stack)).collect();
            task.progress.advance(1, "");
            Ok(values)
        };
        #[cfg(feature = "parallel")]
        let filled: Result<Vec<_>, Cancelled> = (0..tiles.count()).into_par_iter().map(fill).collect();
        #[cfg(not(feature = "parallel"))]
        let filled: Result<Vec<_>, Cancelled> = (0..tiles.count()).map(fill).collect();
        let mut image = Tensor::zeros(axes, [geometry.rows, geometry.cols, K]);
        for (tile, values) in filled?.into_iter().enumerate() {
            for ((row, col), value) in tiles.pixels(tile).zip(values) {
                image.block_mut([row, col]).copy_from_slice(&value);
            }
        }
        Ok(image)
    }
}

/// Division of an image into tiles, row by row.
#[derive(Clone, Copy)]
struct Tiles {
    rows: usize,
    cols: usize,
}

impl Tiles {
    fn new(geometry: &FieldGeometry) -> Self {
        Self { rows: geometry.rows, cols: geometry.cols }
    }

    fn count(self) -> usize {
        self.rows.div_ceil(TILE) * self.cols.div_ceil(TILE)
    }

    fn pixels(self, tile: usize) -> impl Iterator<Item = (usize, usize)> {
        let across = self.cols.div_ceil(TILE);
        let (row, col) = (tile / across * TILE, tile % across * TILE);
        (row..(row + TILE).min(self.rows)).flat_map(move |r| (col..(col + TILE).min(self.cols)).map(move |c| (r, c)))
    }
}
