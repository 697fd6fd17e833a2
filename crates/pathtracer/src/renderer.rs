//! The renderer: prepares a scene once, and renders views tile by tile.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use lumistack_core::{Cancelled, Task, Tensor};
use lumistack_display::{FieldGeometry, GridError};
use lumistack_scene::{Image, Mesh, Pixels, Scene, Window};
#[cfg(feature = "parallel")]
use rayon::prelude::*;
use thiserror::Error;

use crate::bvh::{self, BEAM, Bvh, Stack};
use crate::clamp::Clamped;
use crate::geometry::{self, Geometry, Sharing};
use crate::light::Lights;
use crate::primary::PrimaryRays;
use crate::settings::{AngularFilter, Settings, SettingsError};
use crate::shading::Materials;
use crate::sparse::{pixels_of_group, whole_groups};
use crate::surface::First;
use crate::tracer::{Tracer, traits};

mod beams;
mod checks;
mod depth;
mod features;
mod first;
mod further;
mod misses;
mod split;
mod sums;

use beams::{ViewSamples, place_in_pixel};
#[cfg(test)]
pub(crate) use checks::Check;
pub use checks::Checks;
pub use features::{Feature, Features, GuidedView};
#[cfg(test)]
pub(crate) use first::FEATURES;
use first::{DisplayAxes, FirstSums};
pub use split::{GuidedSplit, SplitView};
use sums::{LightSums, PixelMean};

/// Edge of a tile in pixels. A tile is the unit of work and of progress.
const TILE: usize = 16;

/// A scene prepared for rendering, which all views and threads share.
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
    pub(crate) geometry: Geometry,
    bvh: Bvh,
    materials: Materials,
    lights: Lights,
    traits: Vec<u8>,
    backdrop: Option<Vec3>,
    memory: Memory,
}

/// Sizes of a prepared scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// Number of triangles, including the copies that instances make.
    pub triangles: usize,
    /// Number of triangles that are kept. In large scenes most meshes with several instances are
    /// kept once.
    pub unique_triangles: usize,
    /// Number of bytes of the tree's nodes, leaves and instances.
    pub tree_bytes: usize,
    /// Number of bytes of the triangles' records and of the instances' transforms.
    pub geometry_bytes: usize,
    /// Number of bytes of the scene's meshes and images.
    pub scene_bytes: usize,
    /// Number of bytes of the textures' coarser levels: about a third of the bytes of the images
    /// that materials use.
    pub texture_bytes: usize,
}

/// A scene or a view that cannot be rendered, or a cancelled render.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RenderError {
    /// A setting is out of its range.
    #[error("render settings: {0}")]
    Settings(#[from] SettingsError),
    /// The light field's geometry is not possible.
    #[error(transparent)]
    Geometry(#[from] GridError),
    /// The view is not in the grid.
    #[error("view: expected a row below {} and a column below {}, found row {} and column {}", .views[0], .views[1], .view[0], .view[1])]
    View {
        /// Number of views, [vertical, horizontal].
        views: [usize; 2],
        /// The requested view, [y, x].
        view: [usize; 2],
    },
    /// The tree cannot hold as many triangles as the scene has.
    #[error(
        "scene: expected at most {} triangles (a mesh that is placed several times counts once, unless it emits light or has fewer than 16 triangles), found {found}",
        bvh::MAX_TRIANGLES
    )]
    TooManyTriangles {
        /// Number of triangles.
        found: usize,
    },
    /// The tree cannot hold as many instances as the scene has.
    #[error("scene: expected at most {} instances, found {found}", bvh::MAX_INSTANCES)]
    TooManyInstances {
        /// Number of instances.
        found: usize,
    },
    /// The render was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl Renderer {
    /// Prepares a scene: image pyramids, tree, lights. Time and memory depend on the size of the
    /// scene, not on the number of views. In scenes of more than a million triangles, most meshes
    /// with several instances are kept only once.
    ///
    /// # Errors
    /// If more than 2²⁹ − 1 triangles must be kept, if the scene has more than 2³⁰ − 1 instances,
    /// or when cancelled.
    pub fn new(scene: Arc<Scene>, task: Task<'_>) -> Result<Self, RenderError> {
        Self::with_sharing(scene, Sharing::Auto, task)
    }

    fn with_sharing(scene: Arc<Scene>, sharing: Sharing, task: Task<'_>) -> Result<Self, RenderError> {
        // references in the tree have few bits, which limits the scene's size
        let found = geometry::unique_triangles(&scene, sharing);
        if found > bvh::MAX_TRIANGLES {
            return Err(RenderError::TooManyTriangles { found });
        }
        if scene.instances.len() > bvh::MAX_INSTANCES {
            return Err(RenderError::TooManyInstances { found: scene.instances.len() });
        }
        let geometry = Geometry::new(scene.clone(), sharing);
        task.cancel.check()?;
        let materials = Materials::new(scene.clone());
        task.cancel.check()?;
        // build the tree; only the build needs its input of corners and flags
        let flags: Vec<u32> = (0..found as u32).map(|t| materials.flags(geometry.material_index(t))).collect();
        let corners: Vec<_> = (0..found as u32).map(|t| geometry.corners(t)).collect();
        let bvh = Bvh::new(&bvh::Input {
            triangles: &corners,
            flags: &flags,
            loose: geometry.loose.clone(),
            shared: &geometry.shared,
            placements: &geometry.placements,
        });
        drop((corners, flags));
        task.cancel.check()?;
        let lights = Lights::new(&scene, &geometry, &materials);
        if lights.is_dark() {
            task.warn(
                &scene.name,
                "nothing in the scene emits light, so every view is black. Add a light or an environment to the scene, or let Lumistack add the studio light (in a job `light.automatic = true`, in Rust `lumistack_shot::light::lit`)",
            );
        }
        let memory = Memory {
            triangles: scene.triangle_count(),
            unique_triangles: found,
            tree_bytes: bvh.bytes(),
            geometry_bytes: geometry.bytes(),
            scene_bytes: scene_bytes(&scene),
            texture_bytes: materials.bytes(),
        };
        let traits = scene.materials.iter().map(traits).collect();
        Ok(Self { geometry, bvh, materials, lights, traits, backdrop: scene.backdrop, memory })
    }

    /// Returns the sizes of the prepared scene.
    pub fn memory(&self) -> Memory {
        self.memory
    }

    /// Leaves out the light that microfacets scatter more than once, for comparisons with renderers
    /// that leave it out too. Rough metals and rough glass are then too dark.
    #[must_use]
    pub fn single_scattering(mut self) -> Self {
        self.materials.without_compensation();
        self
    }

    /// Makes rays that miss the scene see the environment, even if the scene has a backdrop. This
    /// is for comparisons with renderers without backdrops.
    #[must_use]
    pub fn without_backdrop(mut self) -> Self {
        self.backdrop = None;
        self
    }

    /// Returns the number of steps by which one call of [`render_view`](Self::render_view) advances
    /// the progress: the number of its tiles.
    pub fn steps_per_view(geometry: &FieldGeometry) -> u64 {
        Tiles::new(geometry).count() as u64
    }

    /// Renders one view, `view` = [view_y, view_x] of the geometry's grid: scene-linear radiance
    /// `[row][col][rgb]`, not exposed.
    ///
    /// The pixel filter is a box as wide as the pixel. The caller begins and ends the progress
    /// stage, which may span many views; this call advances it by
    /// [`steps_per_view`](Self::steps_per_view). Samples that are not finite numbers are left out
    /// of the mean. They are reported as a warning, and so is the light that [`Settings::clamp`]
    /// removes.
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
        let mean = |pixel: &PixelMean, _: &FirstSums| pixel.mean.to_array();
        self.view_of::<false, 3>(window, geometry, view, settings, [settings.samples; 2], task, mean, rgb)
    }

    /// Computes `K` values for every pixel of a view by the function `values`: `[row][col][k]`.
    /// With `count` = [paths, rays], each pixel has `rays` rays, of which the first `paths`
    /// continue as paths. `radiance` extracts the radiance from the values of a pixel. `values`
    /// receives data of the rays' first surfaces only if `FIRST` is true.
    fn view_of<const FIRST: bool, const K: usize>(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        count: [u32; 2],
        task: Task<'_>,
        values: impl Fn(&PixelMean, &FirstSums) -> [f32; K] + Sync,
        radiance: fn(&[f32]) -> [f32; 3],
    ) -> Result<Tensor<3>, RenderError> {
        let samples = self.samples_of(window, geometry, view, settings, count[1])?;
        let (lost, clamped) = (AtomicU64::new(0), Clamped::default());
        // With few samples per pixel, several pixels share a beam. Compared with a beam per pixel,
        // renders of still-life with 1, 2, 3 and 4 samples take 16, 9, 7 and 6 % less time.
        let most = (BEAM / count[1] as usize).max(1);
        let most = if settings.sparse_paths { whole_groups(most) } else { most };
        // only plain views leave out pixels
        let is_rendered = |pixel: &[usize; 2]| FIRST || settings.pixels.contains(*pixel);
        let filled = self.by_groups(geometry, task, ["row", "col", "rgb"], most, |pixels, buffers, filled| {
            let seed = |at| samples.pixel_seed(at);
            for pixels in pixels.chunk_by(|a, b| is_rendered(a) == is_rendered(b)) {
                if !is_rendered(&pixels[0]) {
                    filled.resize(filled.len() + pixels.len(), [0.0; K]);
                    continue;
                }
                self.pixels::<FIRST>(&samples, pixels, seed, count, settings, &clamped, buffers, |pixel, first| {
                    if pixel.not_finite > 0 {
                        lost.fetch_add(u64::from(pixel.not_finite), Ordering::Relaxed);
                    }
                    filled.push(values(pixel, first));
                });
            }
        })?;
        // report samples that could not be used, and light that was removed
        let lost = lost.into_inner();
        if lost > 0 {
            let all_pixels = (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| [row, col]));
            let all = settings.samples as usize * all_pixels.filter(is_rendered).count();
            task.warn(
                format!("view {},{}", view[0], view[1]),
                format!("{lost} of {all} samples are left out, since they are not finite numbers"),
            );
        }
        if let Some(message) = clamped.message(settings, filled.data().chunks_exact(K).map(radiance)) {
            task.warn(format!("view {},{}", view[0], view[1]), message);
        }
        Ok(filled)
    }

    /// Returns `[row][col]`, with 1 for every pixel whose central ray hits a surface that viewers
    /// see, and 0 for all other pixels. Does not advance the progress.
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
            let rays = rays.pixel(row, col);
            [f32::from(u8::from(rays.in_bounds && self.tracer().hits_surface(rays.central(), stack)))]
        })?;
        let [rows, cols, _] = mask.shape();
        let mut flat = Tensor::zeros(["row", "col"], [rows, cols]);
        flat.data_mut().copy_from_slice(mask.data());
        Ok(flat)
    }

    /// Returns the fraction of a view's pixels, 0..1, whose central rays hit a surface that viewers
    /// see.
    ///
    /// # Errors
    /// The same errors as [`hit_mask`](Self::hit_mask).
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
        window: &Window,
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
            AngularFilter::Lens(diameter) => [diameter; 2],
        };
        let round = matches!(angular_filter, AngularFilter::Lens(_));
        Ok(PrimaryRays::new(window, geometry, view, self.geometry.space, slope_width, round))
    }

    /// Checks the settings, and prepares the samples of a view, `view` = [view_y, view_x]. A pixel
    /// has at most `rays_per_pixel` rays.
    fn samples_of<'a>(
        &self,
        window: &Window,
        geometry: &'a FieldGeometry,
        view: [usize; 2],
        settings: &Settings,
        rays_per_pixel: u32,
    ) -> Result<ViewSamples<'a>, RenderError> {
        settings.check()?;
        let rays = self.primary_rays(window, geometry, view, settings.angular_filter)?;
        Ok(ViewSamples::new(rays, DisplayAxes::new(window, self.geometry.space), view, settings, rays_per_pixel))
    }

    fn tracer(&self) -> Tracer<'_> {
        Tracer {
            geometry: &self.geometry,
            bvh: &self.bvh,
            materials: &self.materials,
            lights: &self.lights,
            traits: &self.traits,
            backdrop: self.backdrop,
        }
    }

    /// Renders pixels, and calls `take` with the means of each pixel, in the given order. With
    /// `rays_of_pixel` = [paths, rays], each pixel has `rays` rays, of which the first `paths`
    /// continue as paths. If `FIRST` is true, also adds up data of the first surfaces of the rays.
    /// Several pixels may only be given together if all their rays fit into a beam.
    fn pixels<const FIRST: bool>(
        &self,
        samples: &ViewSamples<'_>,
        pixels: &[[usize; 2]],
        seed: impl Fn([usize; 2]) -> u64,
        rays_of_pixel: [u32; 2],
        settings: &Settings,
        clamped: &Clamped,
        buffers: &mut Buffers,
        mut take: impl FnMut(&PixelMean, &FirstSums),
    ) {
        let tracer = self.tracer();
        let Buffers { stack, sums } = buffers;
        sums.clear();
        sums.resize_with(pixels.len(), Default::default);
        // trace beam by beam, and add each ray to the sums of its pixel
        samples.for_each_beam_of(pixels, seed, rays_of_pixel, |beam, draws| {
            let (paths, sparse, each, in_bounds) = (beam.paths, beam.sparse, beam.each, beam.in_bounds);
            let (rays, cones) = beam.parts();
            let mut first = [First::default(); BEAM];
            let radiance = tracer.radiance::<FIRST>(
                rays,
                paths,
                sparse,
                cones,
                in_bounds,
                settings,
                draws,
                stack,
                if FIRST { &mut first } else { &mut [] },
            );
            for ((of_first, of_light), at) in sums.iter_mut().zip((0..).step_by(each)) {
                let mut light = *of_light;
                for (index, &traced) in radiance.iter().enumerate().skip(at).take(each) {
                    let is_path = if FIRST { first[index].is_path } else { paths & (1 << index) != 0 };
                    if FIRST {
                        let first = &mut first[index];
                        if let Some(limit) = settings.clamp {
                            first.seen *= (limit / first.seen.max_element()).min(1.0);
                        }
                        of_first.add(first, place_in_pixel(draws, index), &samples.axes);
                    }
                    if !is_path {
                        continue;
                    }
                    let sample = settings.clamp.map_or(traced, |limit| clamped.dim(traced, limit));
                    let is_finite = light.add(sample);
                    if FIRST && is_finite {
                        // `Settings::clamp` may have dimmed the sample; dim its diffuse light by
                        // the same factor
                        let kept = if sample == traced { 1.0 } else { sample.max_element() / traced.max_element() };
                        of_first.add_diffuse(kept * first[index].diffuse);
                    }
                }
                *of_light = light;
            }
        });
        if FIRST && settings.has_sparse_paths() {
            let [paths, rays] = rays_of_pixel.map(|count| count as usize);
            sums.chunks_exact_mut(pixels_of_group(rays, paths)).for_each(FirstSums::lend);
        }
        // pass the means to `take`; normals are converted to display space once per pixel
        for (first, light) in sums.drain(..) {
            take(&light.mean(), &if FIRST { first.turned(&samples.axes) } else { first });
        }
    }

    /// Computes `[row][col][k]` tile by tile. The values of a pixel depend only on the pixel, so
    /// the result is the same for any number of threads.
    fn by_tiles<const K: usize>(
        &self,
        geometry: &FieldGeometry,
        task: Task<'_>,
        axes: [&'static str; 3],
        pixel: impl Fn(usize, usize, &mut Stack) -> [f32; K] + Sync,
    ) -> Result<Tensor<3>, RenderError> {
        self.by_groups(geometry, task, axes, 1, |pixels, buffers, values| {
            values.extend(pixels.iter().map(|[row, col]| pixel(*row, *col, &mut buffers.stack)));
        })
    }

    /// Computes `[row][col][k]` tile by tile, with groups of up to `most` neighbouring pixels.
    /// `group` appends the values of the given pixels, in the given order.
    fn by_groups<const K: usize>(
        &self,
        geometry: &FieldGeometry,
        task: Task<'_>,
        axes: [&'static str; 3],
        most: usize,
        group: impl Fn(&[[usize; 2]], &mut Buffers, &mut Vec<[f32; K]>) + Sync,
    ) -> Result<Tensor<3>, RenderError> {
        let tiles = Tiles::new(geometry);
        let fill = |tile: usize| -> Result<Vec<[f32; K]>, Cancelled> {
            let mut buffers = Buffers { stack: self.bvh.stack(), sums: Vec::new() };
            let pixels: Vec<[usize; 2]> = tiles.pixels(tile).collect();
            let mut values = Vec::with_capacity(pixels.len());
            for pixels in pixels.chunks(most) {
                // Cancellation is checked at every group, since a tile may take long: a pixel of
                // very many samples takes seconds.
                task.cancel.check()?;
                group(pixels, &mut buffers, &mut values);
            }
            task.progress.advance(1, "");
            Ok(values)
        };
        #[cfg(feature = "parallel")]
        let filled: Result<Vec<_>, Cancelled> = (0..tiles.count()).into_par_iter().map(fill).collect();
        #[cfg(not(feature = "parallel"))]
        let filled: Result<Vec<_>, Cancelled> = (0..tiles.count()).map(fill).collect();
        // copy the tiles into the picture
        let mut image = Tensor::zeros(axes, [geometry.rows, geometry.cols, K]);
        for (tile, values) in filled?.into_iter().enumerate() {
            for ([row, col], value) in tiles.pixels(tile).zip(values) {
                image.block_mut([row, col]).copy_from_slice(&value);
            }
        }
        Ok(image)
    }
}

/// Memory that a tile uses again for each group of its pixels.
struct Buffers {
    stack: Stack,
    /// For each pixel, sums over its rays and over its paths.
    sums: Vec<(FirstSums, LightSums)>,
}

/// Extracts the radiance from the values of a pixel: the first three values.
fn rgb(values: &[f32]) -> [f32; 3] {
    [values[0], values[1], values[2]]
}

/// Divides the values of pixels, `[row][col][k]`, into successive ranges of k. Each range has a
/// name and a length.
fn ranges<const N: usize>(values: &Tensor<3>, lengths: [(&'static str, usize); N]) -> [Tensor<3>; N] {
    let [rows, cols, all] = values.shape();
    let mut first = 0;
    lengths.map(|(name, length)| {
        let mut range = Tensor::zeros(["row", "col", name], [rows, cols, length]);
        for (to, from) in range.data_mut().chunks_exact_mut(length).zip(values.data().chunks_exact(all)) {
            to.copy_from_slice(&from[first..first + length]);
        }
        first += length;
        range
    })
}

fn scene_bytes(scene: &Scene) -> usize {
    let mesh = |mesh: &Mesh| {
        size_of_val(mesh.positions.as_slice())
            + size_of_val(mesh.normals.as_slice())
            + size_of_val(mesh.tangents.as_slice())
            + mesh.uvs.iter().map(|uvs| size_of_val(uvs.as_slice())).sum::<usize>()
            + size_of_val(mesh.colors.as_slice())
            + size_of_val(mesh.triangles.as_slice())
    };
    let image = |image: &Image| match &image.pixels {
        Pixels::Rgba8(texels) => size_of_val(texels.as_slice()),
        Pixels::Rgba16(texels) => size_of_val(texels.as_slice()),
        Pixels::RgbF32(texels) => size_of_val(texels.as_slice()),
    };
    scene.meshes.iter().map(mesh).sum::<usize>() + scene.images.iter().map(image).sum::<usize>()
}

impl Memory {
    /// Returns the sum of all bytes.
    pub fn bytes(&self) -> usize {
        self.tree_bytes + self.geometry_bytes + self.scene_bytes + self.texture_bytes
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

    /// Returns the pixels [row, col] of a tile. Successive pixels are close together: they follow
    /// Morton's curve, whose even bits are the column and whose odd bits are the row.
    fn pixels(self, tile: usize) -> impl Iterator<Item = [usize; 2]> {
        let across = self.cols.div_ceil(TILE);
        let (row, col) = (tile / across * TILE, tile % across * TILE);
        let bits = |number: usize| (0..TILE.ilog2()).fold(0, |value, bit| value | (number >> bit & 1 << bit));
        let all = (0..TILE * TILE).map(move |number| [row + bits(number >> 1), col + bits(number)]);
        all.filter(move |[row, col]| *row < self.rows && *col < self.cols)
    }
}

#[cfg(test)]
mod tests {
    use glam::{Affine3A, Quat, Vec2, Vec4};
    use lumistack_core::{Cancel, Collector};
    use lumistack_display::{Projection, ViewGrid};
    use lumistack_scene::{AlphaMode, Environment, Filter, Instance, Material, SceneParts, Texture, TextureUse, Wrap};

    use super::*;

    /// Returns a scene with 30 instances of a textured bowl: turned, stretched, and every second
    /// one mirrored. The bowl's material has the given alpha mode.
    fn bowls(alpha_mode: AlphaMode) -> Arc<Scene> {
        // make a grid of points on a paraboloid, at some distance from the mesh's origin
        let size = 7;
        let mut mesh = Mesh::default();
        for row in 0..=size {
            for col in 0..=size {
                let at = Vec2::new(col as f32, row as f32) / size as f32;
                let from_centre = at - 0.5;
                mesh.positions.push(Vec3::new(from_centre.x, 3.0 + from_centre.length_squared(), from_centre.y));
                mesh.normals.push(Vec3::new(-2.0 * from_centre.x, 1.0, -2.0 * from_centre.y).normalize());
                mesh.uvs[0].push(at);
                if row < size && col < size {
                    let corner = (row * (size + 1) + col) as u32;
                    let below = corner + size as u32 + 1;
                    mesh.triangles.extend([[corner, below, below + 1], [corner, below + 1, corner + 1]]);
                }
            }
        }
        // turn, stretch and move every instance differently
        let instances = (0..30).map(|i| {
            let i = i as f32;
            let turn = Quat::from_euler(glam::EulerRot::XYZ, 0.9 * i, 0.4 * i, 1.7 * i);
            let stretch = Vec3::new(if (i as usize).is_multiple_of(2) { 0.5 } else { -0.6 }, 0.4, 0.7);
            let place = Vec3::new((2.4 * i).sin(), (1.3 * i).cos(), (0.8 * i).sin());
            let scene_from_mesh =
                Affine3A::from_scale_rotation_translation(stretch, turn, place - turn * (stretch * 3.0 * Vec3::Y));
            Instance { mesh: 0, scene_from_mesh }
        });
        // the colour texture has an alpha, and the normal map varies
        let texels = (0..64).map(|i| [90 + 2 * i as u8, 200, 160, if i % 3 == 0 { 80 } else { 250 }]).collect();
        let relief = (0..64).map(|i| [100 + i as u8, 150, 230, 255]).collect();
        let image =
            |name: &str, pixels| Image { name: name.into(), width: 8, height: 8, pixels: Pixels::Rgba8(pixels) };
        let texture = |image| Texture { image, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, filter: Filter::Linear };
        let slot = |texture| Some(TextureUse { texture, uv_set: 0, texture_from_mesh: glam::Affine2::IDENTITY });
        let sky = Image { name: "sky".into(), width: 1, height: 2, pixels: Pixels::RgbF32(vec![[1.0; 3], [0.1; 3]]) };
        let parts = SceneParts {
            meshes: vec![mesh],
            instances: instances.collect(),
            materials: vec![Material {
                base_color: Vec4::ONE,
                base_color_texture: slot(0),
                normal_texture: slot(1),
                metallic: 0.0,
                roughness: 0.4,
                alpha_mode,
                double_sided: alpha_mode == AlphaMode::Blend,
                ..Material::default()
            }],
            textures: vec![texture(0), texture(1)],
            images: vec![image("color", texels), image("relief", relief), sky],
            environment: Some(Environment { image: 2, strength: Vec3::ONE, scene_from_environment: Quat::IDENTITY }),
            ..SceneParts::default()
        };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).unwrap())
    }

    /// The light of a pixel is the same if its rays are traced alone or together with the rays of
    /// its neighbours, in both projections.
    #[test]
    fn pixels_are_the_same_in_any_company() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let scene = bowls(AlphaMode::Opaque);
        let renderer = Renderer::with_sharing(scene.clone(), Sharing::Auto, task).unwrap();
        for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 700.0 }] {
            let grid = ViewGrid::single(projection, [0.1, 0.05]);
            let geometry = FieldGeometry { rows: 21, cols: 38, pitch_mm: 8.0, grid };
            let window = Window::framing(scene.bounds(), geometry.size_mm()).unwrap();
            for count in [1, 3, 5, 8] {
                let settings = Settings { samples: count, ..Settings::default() };
                let together = renderer.render_view(&window, &geometry, [0, 0], &settings, task).unwrap();
                let samples = renderer.samples_of(&window, &geometry, [0, 0], &settings, count).unwrap();
                let alone = renderer.by_groups(&geometry, task, ["row", "col", "rgb"], 1, |pixels, buffers, values| {
                    let (seed, clamped) = (|at| samples.pixel_seed(at), Clamped::default());
                    renderer.pixels::<false>(
                        &samples,
                        pixels,
                        seed,
                        [count; 2],
                        &settings,
                        &clamped,
                        buffers,
                        |p, _| {
                            values.push(p.mean.to_array());
                        },
                    );
                });
                assert_eq!(together, alone.unwrap(), "{projection:?}, {count} samples");
                assert!(together.data().iter().any(|&light| light > 0.1));
            }
        }
    }

    /// Instances that share a tree show the same scene as copies in one tree. The same random
    /// numbers make the same paths except where rounding decides. So the pictures differ far less
    /// than by noise. A transparent surface draws other numbers if its tree is shared, so its
    /// pictures differ by the noise.
    #[test]
    fn shared_and_copied_meshes_look_the_same() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let grid = ViewGrid::single(Projection::Oblique, [0.1, 0.05]);
        let geometry = FieldGeometry { rows: 40, cols: 60, pitch_mm: 5.0, grid };
        let settings = Settings { samples: 16, ..Settings::default() };
        for alpha_mode in [AlphaMode::Opaque, AlphaMode::Blend] {
            let scene = bowls(alpha_mode);
            let window = Window::framing(scene.bounds(), geometry.size_mm()).unwrap();
            let render = |sharing, seed| {
                let renderer = Renderer::with_sharing(scene.clone(), sharing, task).unwrap();
                let settings = Settings { seed, ..settings };
                (renderer.memory(), renderer.render_view(&window, &geometry, [0, 0], &settings, task).unwrap())
            };
            let (copied_memory, copied) = render(Sharing::Auto, 0);
            let (shared_memory, shared) = render(Sharing::Always, 0);
            let (_, other_noise) = render(Sharing::Auto, 1);
            assert_eq!(shared_memory.unique_triangles * 30, shared_memory.triangles);
            assert_eq!(copied_memory.unique_triangles, copied_memory.triangles);
            assert!(shared_memory.tree_bytes * 10 < copied_memory.tree_bytes, "{shared_memory:?} {copied_memory:?}");
            let mean =
                |image: &Tensor<3>| image.data().iter().map(|&v| f64::from(v)).sum::<f64>() / image.data().len() as f64;
            let square = |a: &Tensor<3>, b: &Tensor<3>| {
                let sum = a.data().iter().zip(b.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
                sum / a.data().len() as f64
            };
            let noise = square(&copied, &other_noise);
            let share = if alpha_mode == AlphaMode::Opaque { 0.05 } else { 1.3 };
            assert!(square(&copied, &shared) < share * noise, "{} against noise {noise}", square(&copied, &shared));
            // The bound is five standard errors of the difference of two means. The three channels
            // of a pixel come from the same paths, so they are treated as one sample.
            let bound = 5.0 * (noise / (copied.data().len() / 3) as f64).sqrt();
            assert!((mean(&copied) - mean(&shared)).abs() < bound, "{} and {}", mean(&copied), mean(&shared));
            assert!(mean(&copied) > 0.1);
        }
    }
}
