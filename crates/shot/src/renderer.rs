//! A scene prepared for rendering. The path tracer renders its triangles, and splats are blended
//! over the result.
//!
//! ```text
//! view = splats.over(traced view)
//! ```
//!
//! Splats are blended in their own colour space. Surfaces hide splats behind them. Splats have no
//! noise, so they are blended after denoising.

use std::sync::Arc;

use lumistack_core::{Cancelled, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, ViewGrid};
use lumistack_pathtracer::Renderer;
use lumistack_scene::{Scene, Window};
use lumistack_splats::{Renderer as Splats, Space, SplatView, Surfaces, Wanted};
#[cfg(feature = "parallel")]
use rayon::prelude::*;

use crate::error::ShotError;

/// Number of rays along each axis of a pixel. They find the surface that hides the splats behind
/// it.
const CUTS: usize = 2;

/// A scene prepared for rendering.
pub struct SceneRenderer {
    /// Renders the triangles and the light of the scene.
    pub tracer: Renderer,
    /// Renders splats, if the scene has any.
    pub splats: Option<Splats>,
    has_surfaces: bool,
}

impl SceneRenderer {
    /// Prepares a scene.
    ///
    /// # Errors
    /// If the scene cannot be rendered, or the task was cancelled.
    pub fn new(scene: Arc<Scene>, task: Task<'_>) -> Result<Self, ShotError> {
        let has_surfaces = !scene.instances.is_empty();
        // a scene of splats alone brings its own light, so warnings about missing light do not
        // apply
        let unused = Collector::default();
        let quiet = if has_surfaces { task } else { Task { warnings: &unused, ..task } };
        let tracer = Renderer::new(scene.clone(), quiet)?;
        Ok(Self { tracer, splats: Splats::new(scene), has_surfaces })
    }

    /// Returns z in display space, mm, on the central ray of every pixel of a view, `[row][col]`.
    /// It is z of the splat at which the transmittance falls below one half, or else of the first
    /// surface. NaN where the ray has neither.
    ///
    /// # Errors
    /// When the geometry or the view is out of range, or when cancelled.
    pub fn depth(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        task: Task<'_>,
    ) -> Result<Tensor<2>, ShotError> {
        let mut found = Tensor::zeros(["row", "col"], [geometry.rows, geometry.cols]);
        self.depths::<ShotError>(window, geometry, &[view], task, |_, depth| {
            found = depth;
            Ok(())
        })?;
        Ok(found)
    }

    /// Computes [`depth`](Self::depth) of several views, and calls `done` with the index and the
    /// depths of each view, in the order of `views`.
    ///
    /// # Errors
    /// The errors of [`depth`](Self::depth) and of `done`.
    pub fn depths<E: From<ShotError> + From<Cancelled>>(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        views: &[[usize; 2]],
        task: Task<'_>,
        mut done: impl FnMut(usize, Tensor<2>) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(splats) = &self.splats else {
            return views.iter().enumerate().try_for_each(|(number, view)| {
                done(number, self.tracer.depth(window, geometry, *view, task).map_err(ShotError::from)?)
            });
        };
        let slopes = slopes(geometry, views);
        // Take the depth of the splats. Where a ray goes through all splats, take the depth of the
        // surface behind them.
        let surfaces = |number: usize| self.surfaces(window, geometry, slopes[number], 1, task).map_err(E::from);
        splats.render(window, geometry, &slopes, &surfaces, Wanted::Depth, task, |number, view| {
            let mut z_mm = view.z_mm;
            if let Some(behind) = surfaces(number)? {
                let both = z_mm.data_mut().iter_mut().zip(behind.z_mm.data());
                both.filter(|(z, _)| z.is_nan()).for_each(|(z, behind)| *z = *behind);
            }
            done(number, z_mm)
        })
    }

    /// Returns 1 for every pixel of a view whose central ray hits a surface or ends in splats,
    /// otherwise 0: `[row][col]`.
    ///
    /// # Errors
    /// When the geometry or the view is out of range, or when cancelled.
    pub fn hit_mask(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        task: Task<'_>,
    ) -> Result<Tensor<2>, ShotError> {
        if self.splats.is_none() {
            return self.tracer.hit_mask(window, geometry, view, task).map_err(ShotError::from);
        }
        let mut mask = self.depth(window, geometry, view, task)?;
        mask.data_mut().iter_mut().for_each(|z| *z = f32::from(u8::from(z.is_finite())));
        Ok(mask)
    }

    /// Renders the splats of views at `slopes`, and calls `done` with the index and the result of
    /// each view, in the order of `slopes`. Without splats, this function does nothing. Only size
    /// and projection of `geometry` are used; its slopes are ignored.
    ///
    /// # Errors
    /// When the geometry is out of range, or when cancelled. Errors of `done` are returned too.
    pub fn splat_views<E: From<ShotError> + From<Cancelled>>(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        slopes: &[[f64; 2]],
        task: Task<'_>,
        done: impl FnMut(usize, SplatView) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(splats) = &self.splats else { return Ok(()) };
        let surfaces = |number: usize| self.surfaces(window, geometry, slopes[number], CUTS, task).map_err(E::from);
        splats.render(window, geometry, slopes, &surfaces, Wanted::Light, task, done)
    }

    /// Traces depths of the first surfaces on `per_axis`² rays of every pixel. `None` if the scene
    /// has no surfaces.
    fn surfaces(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        slope: [f64; 2],
        per_axis: usize,
        task: Task<'_>,
    ) -> Result<Option<Surfaces>, ShotError> {
        if !self.has_surfaces {
            return Ok(None);
        }
        let (rows, cols, pitch_mm) = (geometry.rows, geometry.cols, geometry.pitch_mm / per_axis as f64);
        let grid = ViewGrid::single(geometry.grid.projection, slope);
        let finer = FieldGeometry { rows: rows * per_axis, cols: cols * per_axis, pitch_mm, grid };
        let depth = self.tracer.depth(window, &finer, [0, 0], task)?;
        let mut z_mm = Tensor::zeros(["row", "col", "sample"], [rows, cols, per_axis * per_axis]);
        for (pixel, samples) in z_mm.data_mut().chunks_exact_mut(per_axis * per_axis).enumerate() {
            for (sample, z) in samples.iter_mut().enumerate() {
                let row = pixel / cols * per_axis + sample / per_axis;
                *z = depth.get([row, pixel % cols * per_axis + sample % per_axis]);
            }
        }
        Ok(Some(Surfaces { z_mm }))
    }
}

/// Returns the slopes (s_x, s_y) of the views [y, x] of a geometry's grid.
pub fn slopes(geometry: &FieldGeometry, views: &[[usize; 2]]) -> Vec<[f64; 2]> {
    let grid = &geometry.grid;
    views.iter().map(|[y, x]| [grid.slope_x[*x], grid.slope_y[*y]]).collect()
}

/// Blends the splats of a view over radiance `[..][rgb]` in place. Splats are `[..][r, g, b, T]`,
/// where T is the transmittance of all splats in the pixel.
pub fn put_before(space: Space, splats: &[f32], radiance: &mut [f32]) {
    let put = |(radiance, splats): (&mut [f32], &[f32])| {
        for (behind, pixel) in radiance.as_chunks_mut::<3>().0.iter_mut().zip(splats.as_chunks::<4>().0) {
            *behind = space.over(*pixel, *behind);
        }
    };
    #[cfg(feature = "parallel")]
    radiance.par_chunks_mut(3 * 4096).zip(splats.par_chunks(4 * 4096)).for_each(put);
    #[cfg(not(feature = "parallel"))]
    put((radiance, splats));
}
