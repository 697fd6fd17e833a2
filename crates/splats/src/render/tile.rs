//! Renders a tile of all views of a block.
//!
//! The splats that any view shows in the tile are read in chunks, the chunk with the nearest splats
//! first. A chunk is projected for all views together. Each view blends in its own order. A splat
//! is blended as soon as no splat of a later chunk can be nearer. For this test, each chunk has a
//! lower bound of its splats' distances:
//!
//! ```text
//! parallel rays:   distance = −(s·p + z (1 + s²)) ≥ −s·c − |s|₁ r − z₁ (1 + s²)
//! from an eye:     distance² = (D − z)² (1 + s²)  ≥ (D − z₁)² (1 + least s²)
//!
//! s    slope of the ray through the splat's centre; |s|₁ = |s_x| + |s_y|
//! p, z projected centre of the splat, and its depth
//! D    distance of the eye from the window
//! c    centre of the tile
//! r    largest distance from c, along x or y, of the centres of the chunk's splats
//! z₁   depth of the chunk's first splat
//! ```
//!
//! A tile is finished when all of its pixels are finished in all views. Then the splats of later
//! chunks are never projected.

use glam::Vec3;
use lumistack_core::colour::{srgb_decode, srgb_encode};
use lumistack_scene::{Cloud, Encoding, Scene};
use lumistack_simd::{Backend, Function, prefetch};

use super::blend::{self, Blend, DARK, EDGE, Flat, PIXELS, Sums};
use super::harmonics::{MOST, basis};
use super::lanes::{self, Eyes, Lane, Project, Projected, VIEWS};
use super::prepare::{CUTOFF, Eye, PIXEL_VARIANCE, Prepared, Splat, TILE, ends, sortable};

/// Number of blocks of pixels along a tile's edge.
const ALONG: usize = TILE / EDGE;
/// Number of blocks of pixels in a tile.
const BLOCKS: usize = ALONG * ALONG;
/// Number of splats that are projected before any of them is blended.
const CHUNK: usize = 384;
/// Number of splats between the prefetch of a splat and its use. Splats are prefetched because they
/// are scattered in memory.
const AHEAD: usize = 12;
/// Number of values per pixel: red, green, blue, transmittance, depth in pixels.
pub(crate) const VALUES: usize = 5;
/// Bound of the rounding error of the distances of parallel rays, in pixels.
const ROUNDED: f32 = 0.05;
/// Bound of the rounding error of squared distances from an eye, as a fraction of these distances.
const ROUNDED_SHARE: f32 = 1e-5;

/// Data that all tiles of a call share.
pub(crate) struct Shared<'a> {
    scene: &'a Scene,
    prepared: &'a Prepared,
    /// The colour space in which splats are blended.
    space: Encoding,
    with_colour: bool,
    project: Function<Project>,
    blend: Function<Blend>,
}

impl<'a> Shared<'a> {
    pub(crate) fn new(scene: &'a Scene, prepared: &'a Prepared, space: Encoding, with_colour: bool) -> Self {
        let best = Backend::best();
        Self {
            scene,
            prepared,
            space,
            with_colour,
            project: best.function::<Project>(),
            blend: best.function::<Blend>(),
        }
    }

    /// Returns the harmonic coefficients of a splat, `[coefficient][rgb]`; empty if no colours are
    /// computed.
    fn harmonics(&self, splat: &Splat) -> &'a [f32] {
        if !self.with_colour {
            return &[];
        }
        let cloud = self.cloud(splat);
        let count = 3 * cloud.coefficients();
        &cloud.harmonics[splat.index as usize * count..][..count]
    }

    /// Prefetches the harmonics of a splat.
    fn request(&self, splat: &Splat) {
        // prefetch each cache line, which holds 16 floats
        self.harmonics(splat).chunks(16).for_each(|line| prefetch(line.as_ptr()));
    }

    fn cloud(&self, splat: &Splat) -> &'a Cloud {
        &self.scene.clouds[self.scene.placed_clouds[splat.placed as usize].cloud]
    }

    /// Returns true if a splat's colours are in the space in which splats are blended.
    fn is_same_space(&self, splat: &Splat) -> bool {
        self.cloud(splat).encoding == self.space
    }

    /// Converts a colour of the splat's cloud to the space in which splats are blended.
    fn in_space(&self, splat: &Splat, rgb: [f32; 3]) -> [f32; 3] {
        match (self.cloud(splat).encoding, self.space) {
            (Encoding::Linear, Encoding::Srgb) => rgb.map(srgb_encode),
            (Encoding::Srgb, Encoding::Linear) => rgb.map(|value| srgb_decode(value.min(1.0))),
            _ => rgb,
        }
    }
}

/// Depths of the surfaces of meshes in one view, `[row][col][sample]`, in pixels. A ray that misses
/// all surfaces has −∞.
#[derive(Clone, Copy)]
pub(crate) struct Cuts<'a> {
    pub(crate) z: &'a [f32],
    pub(crate) samples: usize,
    pub(crate) cols: usize,
    pub(crate) rows: usize,
}

/// A block of views that are rendered together.
pub(crate) struct Views<'a> {
    pub(crate) eyes: Vec<Eye>,
    /// Two eyes whose projections bound the projections of all eyes.
    pub(crate) ends: Vec<Eye>,
    cuts: Vec<Option<Cuts<'a>>>,
    lanes: Eyes,
    /// For each placed cloud, the basis functions Y_lm of each view's direction. They are used only
    /// for parallel rays.
    bases: Vec<[Lane; MOST]>,
    /// For each placed cloud, the columns of the map from directions in pixels to directions of the
    /// cloud.
    cloud_from_pixels: Vec<[[f32; 3]; 3]>,
}

impl<'a> Views<'a> {
    /// Prepares a block of 1 to [`VIEWS`] views.
    pub(crate) fn new(eyes: Vec<Eye>, cuts: Vec<Option<Cuts<'a>>>, prepared: &Prepared) -> Self {
        let of_cloud = |map: &glam::Mat3| {
            let mut bases = [[0.0; VIEWS]; MOST];
            for (v, eye) in eyes.iter().enumerate() {
                let direction = *map * Vec3::from(eye.direction([0.0; 3]));
                let of_view = basis(direction.normalize_or_zero().to_array());
                (0..MOST).for_each(|k| bases[k][v] = of_view[k]);
            }
            bases
        };
        let bases = prepared.cloud_from_pixels.iter().map(of_cloud).collect();
        let cloud_from_pixels = prepared.cloud_from_pixels.iter().map(|map| map.to_cols_array_2d()).collect();
        Self { lanes: Eyes::new(&eyes), ends: ends(&eyes), eyes, cuts, bases, cloud_from_pixels }
    }
}

/// The state of one tile in one view while splats are blended.
struct Canvas {
    /// Colour, transmittance and depth so far, `[sample][block]`.
    sums: Vec<[Sums; BLOCKS]>,
    cuts: Vec<[[f32; PIXELS]; BLOCKS]>,
    /// For each sample of a pixel, one bit for each block with an unfinished pixel.
    open: Vec<u16>,
    /// Splats that are projected but not yet blended: [`key`] of the order, and index into `flats`.
    pending: Vec<(u64, u32)>,
    /// Projected splats, with a bit for each block that they cover; the first `used` are valid.
    flats: Vec<(Flat, u16)>,
    used: usize,
}

impl Canvas {
    fn new(cuts: Option<Cuts<'_>>, tile: [usize; 2]) -> Self {
        let samples = cuts.map_or(1, |cuts| cuts.samples);
        let mut own = vec![[[f32::NEG_INFINITY; PIXELS]; BLOCKS]; samples];
        if let Some(of_view) = cuts {
            for (sample, of_sample) in own.iter_mut().enumerate() {
                for (block, cuts) in of_sample.iter_mut().enumerate() {
                    for (pixel, cut) in cuts.iter_mut().enumerate() {
                        let [row, col] = place(block, pixel);
                        let (row, col) = (tile[1] * TILE + row, tile[0] * TILE + col);
                        if row < of_view.rows && col < of_view.cols {
                            *cut = of_view.z[(row * of_view.cols + col) * samples + sample];
                        }
                    }
                }
            }
        }
        Self {
            sums: vec![[Sums::EMPTY; BLOCKS]; samples],
            cuts: own,
            open: vec![u16::MAX; samples],
            pending: Vec::new(),
            flats: Vec::new(),
            used: 0,
        }
    }

    /// Returns one bit for each block in which a sample has an unfinished pixel.
    fn open(&self) -> u16 {
        self.open.iter().fold(0, |all, open| all | open)
    }

    /// Marks blocks as finished if their surfaces hide all splats at depth `z` and farther.
    fn close_behind(&mut self, z: f32) {
        for (open, cuts) in self.open.iter_mut().zip(&self.cuts) {
            for (block, cuts) in cuts.iter().enumerate() {
                if cuts.iter().all(|cut| *cut > z) {
                    *open &= !(1 << block);
                }
            }
        }
    }
}

/// Renders a whole tile in every view: `[view][row][col]`, with [`VALUES`] values each.
pub(crate) fn render(shared: &Shared<'_>, views: &Views<'_>, list: &[u32], tile: [usize; 2]) -> Vec<f32> {
    let origin = tile.map(|number| (number * TILE) as f32);
    let mut canvases: Vec<Canvas> = views.cuts.iter().map(|cuts| Canvas::new(*cuts, tile)).collect();
    let splat = |number: usize| &shared.prepared.splats[list[number] as usize];
    // For each chunk, find the depth of its first splat, and the largest extent of its splats.
    let mut chunks = Vec::with_capacity(list.len().div_ceil(CHUNK));
    for first in (0..list.len()).step_by(CHUNK) {
        let mut most = 0.0f32;
        for i in first..(first + CHUNK).min(list.len()) {
            if let Some(later) = list.get(i + AHEAD) {
                prefetch(&raw const shared.prepared.splats[*later as usize]);
            }
            most = most.max(reach(splat(i), &views.ends));
        }
        chunks.push((splat(first).centre[2], most));
    }
    // For each chunk and view, find a lower bound of the distances in this chunk and all later
    // chunks.
    let mut least: Vec<[f32; VIEWS]> = vec![[f32::INFINITY; VIEWS]; chunks.len() + 1];
    for (number, (z, reach)) in chunks.iter().enumerate().rev() {
        for (v, eye) in views.eyes.iter().enumerate() {
            least[number][v] = least[number + 1][v].min(least_distance(*eye, origin, *z, *reach));
        }
    }
    // Project chunk by chunk, until every view is finished.
    let mut projected = Projected::NONE;
    let mut scratch = Scratch::default();
    for (number, chunk) in list.chunks(CHUNK).enumerate() {
        let mut open = 0;
        for (v, canvas) in canvases.iter_mut().enumerate() {
            canvas.close_behind(chunks[number].0);
            open |= u32::from(canvas.open() != 0) << v;
        }
        if open == 0 {
            break;
        }
        for i in number * CHUNK..number * CHUNK + chunk.len() {
            if i + AHEAD < list.len() {
                shared.request(splat(i + AHEAD));
            }
            let splat = splat(i);
            let args = lanes::Args {
                splat,
                eyes: &views.lanes,
                origin,
                harmonics: shared.harmonics(splat),
                bases: &views.bases[splat.placed as usize],
                cloud_from_pixels: &views.cloud_from_pixels[splat.placed as usize],
                to: &mut projected,
            };
            // SAFETY: the kernel demands nothing of its arguments
            unsafe { (shared.project)(args) };
            let same_space = shared.is_same_space(splat);
            let mut seen = projected.seen & open;
            while seen != 0 {
                let v = seen.trailing_zeros() as usize;
                seen &= seen - 1;
                if let Some(canvas) = canvases.get_mut(v) {
                    take(shared, canvas, splat, &projected, v, i as u32, origin, same_space);
                }
            }
        }
        for (v, canvas) in canvases.iter_mut().enumerate() {
            if open & 1 << v != 0 {
                // Blend the splats that are nearer than all splats of later chunks.
                blend_up_to(shared, canvas, least[number + 1][v], origin, &mut scratch);
            }
        }
    }
    let mut out = Vec::with_capacity(views.eyes.len() * TILE * TILE * VALUES);
    canvases.iter().for_each(|canvas| write(canvas, &mut out));
    out
}

/// Returns the largest extent of a splat from its centre, along x or y, in any view between `ends`,
/// in pixels.
fn reach(splat: &Splat, ends: &[Eye]) -> f32 {
    let seen = ends.iter().filter_map(|eye| eye.project(splat));
    let variance = seen.map(|seen| seen.covariance[0].max(seen.covariance[2])).fold(0.0, f32::max);
    CUTOFF * (variance + PIXEL_VARIANCE).sqrt()
}

/// Returns a lower bound of the distances of the splats that the eye shows in the tile. For an eye
/// at a position, it is a bound of the squared distances.
///
/// The depths of the splats are at most `z`, and they extend at most `reach` from their centres.
fn least_distance(eye: Eye, origin: [f32; 2], z: f32, reach: f32) -> f32 {
    let half = 0.5 * (TILE as f32 - 1.0);
    let (centre, reach) = (origin.map(|first| first + half), half + reach);
    match eye {
        Eye::Slope([sx, sy]) => {
            let across = sx * centre[0] + sy * centre[1] + (sx.abs() + sy.abs()) * reach;
            -across - z * (1.0 + sx * sx + sy * sy) - ROUNDED
        }
        Eye::At(at, distance) => {
            let slope = [0, 1].map(|axis| (((at[axis] - centre[axis]).abs() - reach) / distance).max(0.0));
            let before = (distance - z).max(0.0);
            before * before * (1.0 + slope[0] * slope[0] + slope[1] * slope[1]) * (1.0 - ROUNDED_SHARE)
        }
    }
}

/// Adds a splat to the pending splats if it covers an unfinished block.
fn take(
    shared: &Shared<'_>,
    canvas: &mut Canvas,
    splat: &Splat,
    projected: &Projected,
    v: usize,
    number: u32,
    origin: [f32; 2],
    same_space: bool,
) {
    // Along each axis, set a bit for each row or column of blocks that has the centre of a pixel
    // within the splat's extent.
    let blocks = |axis: usize| -> u32 {
        let (middle, reach) = (projected.at[axis][v] - origin[axis], projected.reach[axis][v]);
        // conversions to integers truncate, so `last` is rounded down; `first` is rounded up
        let (low, last) = ((middle - reach).max(0.0), (middle + reach).min(TILE as f32 - 1.0) as i32);
        let first = low as i32 + i32::from(low > low as i32 as f32);
        if first > last || middle + reach < 0.0 {
            return 0;
        }
        let (first, last) = (first as u32 / EDGE as u32, last as u32 / EDGE as u32);
        ((1 << (last - first + 1)) - 1) << first
    };
    let (cols, rows) = (blocks(0), blocks(1));
    let mask = (0..ALONG).filter(|row| rows & 1 << row != 0).fold(0, |mask, row| mask | cols << (row * ALONG)) as u16;
    if mask & canvas.open() == 0 {
        return;
    }
    if canvas.used == canvas.flats.len() {
        canvas.flats.push((Flat::default(), 0));
    }
    // write field by field, since a whole struct would be copied through memory
    let (flat, own) = &mut canvas.flats[canvas.used];
    *own = mask;
    (0..2).for_each(|axis| flat.at[axis] = projected.at[axis][v]);
    (0..3).for_each(|i| flat.conic[i] = projected.conic[i][v]);
    flat.opacity = projected.opacity[v];
    (0..3).for_each(|c| flat.colour[c] = projected.colour[c][v]);
    if !same_space {
        flat.colour = shared.in_space(splat, flat.colour);
    }
    flat.z = splat.centre[2];
    canvas.pending.push((key(projected.distance[v], number), canvas.used as u32));
    canvas.used += 1;
}

/// Returns the sort key of a splat. The order is by distance, then by `number`, the splat's
/// position in the order by depth.
fn key(distance: f32, number: u32) -> u64 {
    u64::from(sortable(distance)) << 32 | u64::from(number)
}

#[derive(Default)]
struct Scratch {
    ordered: Vec<Flat>,
    /// For each block, indices of the splats that cover it, in blending order.
    over: [Vec<u16>; BLOCKS],
    kept: Vec<(Flat, u16)>,
}

/// Blends the pending splats whose distance is less than `distance`, and keeps the others.
fn blend_up_to(shared: &Shared<'_>, canvas: &mut Canvas, distance: f32, origin: [f32; 2], scratch: &mut Scratch) {
    canvas.pending.sort_unstable_by_key(|(key, _)| *key);
    let ready = canvas.pending.partition_point(|(found, _)| *found < key(distance, 0));
    // Blend parts of at most 4096 splats, so that their indices fit into 16 bits. Each splat is
    // listed in the blocks that it covers.
    for part in canvas.pending[..ready].chunks(1 << 12) {
        scratch.ordered.clear();
        scratch.over.iter_mut().for_each(Vec::clear);
        for (_, place) in part {
            let (flat, mut mask) = canvas.flats[*place as usize];
            while mask != 0 {
                scratch.over[mask.trailing_zeros() as usize].push(scratch.ordered.len() as u16);
                mask &= mask - 1;
            }
            scratch.ordered.push(flat);
        }
        for (sample, open) in canvas.open.iter_mut().enumerate() {
            for (block, chosen) in scratch.over.iter().enumerate() {
                if *open & 1 << block == 0 || chosen.is_empty() {
                    continue;
                }
                let [row, col] = place(block, 0);
                let args = blend::Args {
                    splats: &scratch.ordered,
                    chosen,
                    first: [origin[0] + col as f32, origin[1] + row as f32],
                    cuts: &canvas.cuts[sample][block],
                    sums: &mut canvas.sums[sample][block],
                };
                // SAFETY: `chosen` holds indices of `ordered`
                if !unsafe { (shared.blend)(args) } {
                    *open &= !(1 << block);
                }
            }
        }
    }
    // Move the remaining splats to the front of `flats`.
    canvas.pending.drain(..ready);
    scratch.kept.clear();
    for (i, (_, place)) in canvas.pending.iter_mut().enumerate() {
        scratch.kept.push(canvas.flats[*place as usize]);
        *place = i as u32;
    }
    canvas.used = scratch.kept.len();
    canvas.flats[..canvas.used].copy_from_slice(&scratch.kept);
}

/// Appends a tile's pixels to the output. A pixel's light is the mean of its samples; its depth is
/// the depth of its last sample.
fn write(canvas: &Canvas, out: &mut Vec<f32>) {
    let first = out.len();
    out.resize(first + TILE * TILE * VALUES, 0.0);
    let share = 1.0 / canvas.sums.len() as f32;
    for (block, sums) in canvas.sums.iter().flat_map(|sums| sums.iter().enumerate()) {
        for pixel in 0..PIXELS {
            let [row, col] = place(block, pixel);
            let to = &mut out[first + (row * TILE + col) * VALUES..][..VALUES];
            (0..3).for_each(|c| to[c] += share * sums.rgb[c][pixel]);
            let through = sums.transmittance[pixel];
            to[3] += share * if through < DARK { 0.0 } else { through };
            to[4] = sums.z[pixel];
        }
    }
}

/// Returns the row and column, within the tile, of a pixel of a block.
fn place(block: usize, pixel: usize) -> [usize; 2] {
    [block / ALONG * EDGE + pixel / EDGE, block % ALONG * EDGE + pixel % EDGE]
}
