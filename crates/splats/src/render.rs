//! Renders views of splats. The splats are sorted, and listed per tile, once for many views. They
//! are blended in each view's exact order.
//!
//! ```text
//! C = Σ_i c_i α_i Π_{j<i} (1 − α_j)
//! α_i = o_i √(|Σ'| / |Σ' + P|) exp(−½ dᵀ (Σ' + P)⁻¹ d)
//!
//! i, j    splats by increasing distance of their centres from the viewer
//! c, o    colour, in the colour space of the blending, and opacity
//! Σ'      covariance of the splat, projected onto z = 0
//! P       variance of a pixel's box
//! d       from the splat's projected centre to the pixel's
//! ```
//!
//! A naive renderer projects, shades and sorts all splats for every view. This renderer transforms
//! the splats, and sorts them by depth, once per window. Blocks of views share lists of splats per
//! tile. Each view sorts the splats of a list again, in chunks, by their distances in this view. If
//! nearer chunks hide the whole tile in all views, later chunks are not projected and shaded.
//!
//! The filter, which widens a splat by P and lowers its peak, is the 2D filter of mip-splatting (Yu
//! et al., CVPR 2024).

mod blend;
mod harmonics;
mod lanes;
mod prepare;
mod space;
mod tile;

use std::sync::Arc;

use lumistack_core::{Cancelled, Task, Tensor};
use lumistack_display::FieldGeometry;
use lumistack_scene::{Scene, Window};
#[cfg(feature = "parallel")]
use rayon::prelude::*;

use lanes::VIEWS;
use prepare::{CUTOFF, Eye, PIXEL_VARIANCE, Prepared, Splat, TILE};
pub use space::Space;
use tile::{Cuts, Shared, VALUES, Views};

/// Renders the splats of a scene.
pub struct Renderer {
    scene: Arc<Scene>,
    space: Space,
}

/// The picture of the splats in one view.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatView {
    /// `[row][col][r, g, b, T]`: the colour, blended in the scene's [`Space`] over black, and the
    /// transmittance T of all splats, 0..1.
    pub light: Tensor<3>,
    /// `[row][col]`: z in display space, in millimetres, of the splat at which the transmittance
    /// falls below one half. NaN if the transmittance never falls below one half.
    pub z_mm: Tensor<2>,
}

/// Depths of the surfaces of meshes in a scene that also has splats.
#[derive(Clone, Debug, PartialEq)]
pub struct Surfaces {
    /// `[row][col][sample]`: z in display space, in millimetres, of the first hit of each of a
    /// pixel's rays; NaN for a miss.
    pub z_mm: Tensor<3>,
}

/// The quantities that a render computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Light and depth.
    Light,
    /// Depth and transmittance; colours are black, which saves reading the harmonics.
    Depth,
}

impl Renderer {
    /// Returns a renderer of the scene's splats; `None` if the scene has none.
    pub fn new(scene: Arc<Scene>) -> Option<Self> {
        let space = Space::of(&scene)?;
        Some(Self { scene, space })
    }

    /// Returns the memory in bytes that the prepared splats take while views are rendered.
    pub fn bytes(&self) -> usize {
        self.scene.splat_count() * size_of::<Splat>()
    }

    /// Renders a view per slope, and calls `done` with each view's index and the view, in the order
    /// of the slopes.
    ///
    /// `slopes` replace the slopes of `geometry`'s grid. `surfaces` returns the depths of surfaces
    /// in a view, or `None`. The bytes of a view do not depend on the other views of the call, nor
    /// on the number of threads.
    ///
    /// # Errors
    /// If the task is cancelled, or if `surfaces` or `done` returns an error.
    pub fn render<E: From<Cancelled>>(
        &self,
        window: &Window,
        geometry: &FieldGeometry,
        slopes: &[[f64; 2]],
        surfaces: &dyn Fn(usize) -> Result<Option<Surfaces>, E>,
        wanted: Wanted,
        task: Task<'_>,
        mut done: impl FnMut(usize, SplatView) -> Result<(), E>,
    ) -> Result<(), E> {
        // The window's splats are transformed and sorted once, for all views.
        let prepared = Prepared::new(&self.scene, window, geometry);
        let shared = Shared::new(&self.scene, &prepared, self.space.0, wanted == Wanted::Light);
        for (number, block) in slopes.chunks(VIEWS).enumerate() {
            task.cancel.check()?;
            let first = number * VIEWS;
            let surfaces: Vec<Option<Surfaces>> =
                (0..block.len()).map(|i| surfaces(first + i)).collect::<Result<_, E>>()?;
            // Divide depths by the pitch, which gives pixels; a miss is farther than all splats.
            let cuts: Vec<Option<Vec<f32>>> = surfaces
                .iter()
                .map(|surfaces| {
                    let pixels = |z: &f32| if z.is_nan() { f32::NEG_INFINITY } else { z / geometry.pitch_mm as f32 };
                    surfaces.as_ref().map(|surfaces| surfaces.z_mm.data().iter().map(pixels).collect())
                })
                .collect();
            let (rows, cols) = (geometry.rows, geometry.cols);
            let cuts: Vec<Option<Cuts<'_>>> = cuts
                .iter()
                .map(|z| z.as_deref().map(|z| Cuts { z, samples: z.len() / (rows * cols), cols, rows }))
                .collect();
            // A splat is projected into all views of a block at once, so these views are rendered
            // together.
            let eyes = block.iter().map(|slope| Eye::new(geometry, *slope)).collect();
            let views = Views::new(eyes, cuts, &prepared);
            for (i, view) in block_of(&shared, &prepared, geometry, &views, task)?.into_iter().enumerate() {
                done(first + i, view)?;
            }
        }
        Ok(())
    }
}

/// Renders a block of views, tile by tile.
fn block_of(
    shared: &Shared<'_>,
    prepared: &Prepared,
    geometry: &FieldGeometry,
    views: &Views<'_>,
    task: Task<'_>,
) -> Result<Vec<SplatView>, Cancelled> {
    let (rows, cols) = (geometry.rows, geometry.cols);
    let tiles = [cols.div_ceil(TILE), rows.div_ceil(TILE)];
    // Tiles are independent: any thread renders the splats of a tile for all views of the block.
    let (starts, lists) = bin(prepared, &views.ends, tiles);
    let of_tile = |number: usize| {
        if task.cancel.is_cancelled() {
            return Vec::new();
        }
        let list = &lists[starts[number]..starts[number + 1]];
        if list.is_empty() {
            return Vec::new();
        }
        tile::render(shared, views, list, [number % tiles[0], number / tiles[0]])
    };
    let count = tiles[0] * tiles[1];
    #[cfg(feature = "parallel")]
    let rendered: Vec<Vec<f32>> = (0..count).into_par_iter().map(of_tile).collect();
    #[cfg(not(feature = "parallel"))]
    let rendered: Vec<Vec<f32>> = (0..count).map(of_tile).collect();
    task.cancel.check()?;
    // Assemble a picture per view from the tiles; a tile without splats is empty.
    let pitch = geometry.pitch_mm as f32;
    let view = |number: usize| {
        let mut light = Tensor::zeros(["row", "col", "rgbt"], [rows, cols, 4]);
        let mut z_mm = Tensor::zeros(["row", "col"], [rows, cols]);
        for row in 0..rows {
            for tile_col in 0..tiles[0] {
                let values = &rendered[row / TILE * tiles[0] + tile_col];
                for col in tile_col * TILE..(tile_col * TILE + TILE).min(cols) {
                    let at = row * cols + col;
                    let to = &mut light.data_mut()[4 * at..][..4];
                    if values.is_empty() {
                        to.copy_from_slice(&[0.0, 0.0, 0.0, 1.0]);
                        z_mm.data_mut()[at] = f32::NAN;
                        continue;
                    }
                    let from = (number * TILE * TILE + row % TILE * TILE + col % TILE) * VALUES;
                    to.copy_from_slice(&values[from..from + 4]);
                    z_mm.data_mut()[at] = values[from + 4] * pitch;
                }
            }
        }
        SplatView { light, z_mm }
    };
    #[cfg(feature = "parallel")]
    let all = (0..views.eyes.len()).into_par_iter().map(view).collect();
    #[cfg(not(feature = "parallel"))]
    let all = (0..views.eyes.len()).map(view).collect();
    Ok(all)
}

/// Lists, for each tile, the splats that may be visible there in any of the views, nearest first.
///
/// Returns the start of each tile's list, and all lists one after another.
fn bin(prepared: &Prepared, ends: &[Eye], tiles: [usize; 2]) -> (Vec<usize>, Vec<u32>) {
    let count = tiles[0] * tiles[1];
    let reach = |splat: &Splat| tiles_of(splat, ends, tiles);
    #[cfg(feature = "parallel")]
    let reaches: Vec<[u16; 4]> = prepared.splats.par_iter().map(reach).collect();
    #[cfg(not(feature = "parallel"))]
    let reaches: Vec<[u16; 4]> = prepared.splats.iter().map(reach).collect();
    let each_row = |[left, end, top, bottom]: [u16; 4]| {
        (top..bottom).map(move |row| {
            let row = usize::from(row) * tiles[0];
            row + usize::from(left)..row + usize::from(end)
        })
    };
    // Sort by counting: count the splats of each tile, sum the counts to starts, then fill the
    // lists, the nearest splats first.
    let mut starts = vec![0usize; count + 1];
    for reach in &reaches {
        for range in each_row(*reach) {
            starts[1..][range].iter_mut().for_each(|count| *count += 1);
        }
    }
    for tile in 0..count {
        starts[tile + 1] += starts[tile];
    }
    let mut next = starts.clone();
    let mut lists = vec![0u32; starts[count]];
    for &i in &prepared.by_depth {
        for range in each_row(reaches[i as usize]) {
            for at in &mut next[range] {
                lists[*at] = i;
                *at += 1;
            }
        }
    }
    (starts, lists)
}

/// Returns the tiles in which a splat may be visible: first column, end of columns, first row, end
/// of rows. All four are 0 if there is no such tile.
fn tiles_of(splat: &Splat, ends: &[Eye], tiles: [usize; 2]) -> [u16; 4] {
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for eye in ends {
        let Some(seen) = eye.project(splat) else { return [0; 4] };
        for (axis, variance) in [seen.covariance[0], seen.covariance[2]].into_iter().enumerate() {
            // take slightly more than the cutoff, since rounding differs between views
            let reach = 1.001 * CUTOFF * (variance.max(0.0) + PIXEL_VARIANCE).sqrt() + 0.01;
            low[axis] = low[axis].min(seen.at[axis] - reach);
            high[axis] = high[axis].max(seen.at[axis] + reach);
        }
    }
    let mut reach = [0; 4];
    for axis in 0..2 {
        let last = tiles[axis] as f32 - 1.0;
        let first = (low[axis] / TILE as f32).floor().max(0.0);
        let end = (high[axis] / TILE as f32).floor().min(last);
        if first > end {
            return [0; 4];
        }
        reach[2 * axis] = first as u16;
        reach[2 * axis + 1] = end as u16 + 1;
    }
    reach
}
