//! Cuts a display into tiles. A tile has own, free and held pixels on every layer. Only the values
//! of its own pixels are kept.
//!
//! ```text
//! held   ┌───────────────────────┐   hit by rays through free pixels; fixed in a solve
//! free   │   ┌───────────────┐   │   hit by rays through own pixels; solved with them, not kept
//! own    │   │   ┌───────┐   │   │   every pixel of the display is the own pixel of one tile
//! ```
//!
//! The map of rays is separable. So a range along x and a range along y define the tile's field
//! pixels. The same holds for its pixels on every layer and on the lenslets. The free and held
//! ranges come from the tables of [`RayMap`]. A tile's map is a section of these tables, so a ray
//! reads the same pixel in a tile as in the whole display.

use std::ops::Range;

use lumistack_core::Tensor;

use crate::{
    AxisTaps, Backlight, BacklightTap, Display, FieldGeometry, LayerMap, LayerStack, LensletBacklight, LightField,
    Projection, RayMap, Tap, Weights,
};

/// A rectangle of pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Rows, from the top.
    pub rows: Range<usize>,
    /// Columns, from the left.
    pub cols: Range<usize>,
}

/// The pixels of a tile on one layer or on the lenslets; the head of the file has a figure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TilePart {
    /// Pixels whose values in the whole display come from this tile; may be empty.
    pub own: Region,
    /// The own pixels, and further pixels that are solved together with them but belong to other
    /// tiles.
    pub free: Region,
    /// Pixels that rays through free pixels hit, so the tile must know their values. Never empty.
    pub held: Region,
}

/// A tile of a display.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Field pixels of the tile. The tile has the rays of all views through these pixels.
    pub field: Region,
    /// The tile's pixels on each layer, rear to front, and then on the lenslets.
    pub parts: Vec<TilePart>,
    /// [rows, columns] of each layer of the whole display, and then of the lenslets.
    pub whole: Vec<[usize; 2]>,
}

/// A display and its division into tiles.
#[derive(Clone, Debug)]
pub struct Tiling {
    map: RayMap,
    /// For x and for y: the tiles along the axis; then, in a second list, the number of pixels of
    /// each layer and the number of lenslets.
    axes: [(Vec<AxisTile>, Vec<usize>); 2],
}

impl Tiling {
    /// Cuts a display into `tiles` = [columns, rows] of about the same size. There are fewer tiles
    /// if a tile would have less than two field pixels to a side.
    pub fn new(display: &Display, geometry: &FieldGeometry, tiles: [usize; 2]) -> Self {
        let map = RayMap::new(display, geometry);
        let axes = [0, 1].map(|axis| {
            let cut = AxisCut::new(display, geometry, &map, axis, tiles[axis]);
            ((0..cut.tiles).map(|tile| cut.tile(tile)).collect(), cut.parts.iter().map(|part| part.count).collect())
        });
        Self { map, axes }
    }

    /// Returns the number of tiles.
    pub fn count(&self) -> usize {
        self.tiles().iter().product()
    }

    /// Returns the numbers of columns and rows of tiles.
    pub fn tiles(&self) -> [usize; 2] {
        [0, 1].map(|axis| self.axes[axis].0.len())
    }

    /// Returns the intersections of the rays of the whole display.
    pub fn map(&self) -> &RayMap {
        &self.map
    }

    /// Returns a tile by its number; tiles are numbered row by row.
    ///
    /// # Panics
    /// If there is no tile of this number.
    pub fn tile(&self, number: usize) -> Tile {
        let [(across, widths), (down, heights)] = &self.axes;
        let (cols, rows) = (&across[number % across.len()], &down[number / across.len()]);
        let region = |rows: &Range<usize>, cols: &Range<usize>| Region { rows: rows.clone(), cols: cols.clone() };
        let parts = rows.parts.iter().zip(&cols.parts).map(|([own_y, free_y, held_y], [own_x, free_x, held_x])| {
            TilePart { own: region(own_y, own_x), free: region(free_y, free_x), held: region(held_y, held_x) }
        });
        let whole = heights.iter().zip(widths).map(|(rows, cols)| [*rows, *cols]);
        Tile { field: region(&rows.field, &cols.field), parts: parts.collect(), whole: whole.collect() }
    }

    /// Returns the numbers of the tiles that have own pixels among the held pixels of tile
    /// `number`, ascending. The list includes `number`. The solver of tile `number` reads the
    /// patterns of all listed tiles.
    pub fn around(&self, number: usize) -> Vec<usize> {
        let tile = self.tile(number);
        let shares = |other: &usize| {
            let of_other = self.tile(*other);
            let overlaps = |(part, other): (&TilePart, &TilePart)| !part.held.common(&other.own).is_empty();
            // The tile itself is always included, since a small tile may have no own pixels.
            *other == number || tile.parts.iter().zip(&of_other.parts).any(overlaps)
        };
        (0..self.count()).filter(shares).collect()
    }
}

/// One axis of a display.
struct AxisCut {
    tiles: usize,
    pixels: usize,
    pitch_mm: f64,
    parts: Vec<AxisPart>,
}

/// One axis of a layer, or of the lenslets.
struct AxisPart {
    count: usize,
    pitch_mm: f64,
    /// Offset of the layer's centre in the direction of growing indices, millimetres.
    offset_mm: f64,
    /// Reach of the layer's blur, pixels.
    blur: usize,
    /// The two pixels that a ray reads, `[view][field pixel]`; `None` if the ray reads none.
    met: Vec<Vec<Option<[usize; 2]>>>,
}

/// Ranges of a tile along one axis: field pixels, and the own, free and held pixels of every layer
/// and of the lenslets.
#[derive(Clone, Debug)]
struct AxisTile {
    field: Range<usize>,
    parts: Vec<[Range<usize>; 3]>,
}

impl AxisCut {
    fn new(display: &Display, geometry: &FieldGeometry, map: &RayMap, axis: usize, tiles: usize) -> Self {
        let pixels = if axis == 0 { geometry.cols } else { geometry.rows };
        let views = geometry.grid.views()[1 - axis];
        let sign = if axis == 0 { 1.0 } else { -1.0 };
        let mut parts = Vec::new();
        for (layer, map) in display.layers.iter().zip(&map.layers) {
            let taps = if axis == 0 { &map.x } else { &map.y };
            let met = |tap: &Tap| (!tap.is_missed()).then_some([tap.first as usize, tap.second as usize]);
            let blur = layer.response().map_or(0, |response| response.taps().len() / 2);
            let count = layer.resolution[axis];
            let met = (0..views).map(|view| taps.of_view(view).iter().map(met).collect()).collect();
            let (pitch_mm, offset_mm) = (layer.pitch_mm, sign * layer.offset_mm[axis]);
            parts.push(AxisPart { count, pitch_mm, offset_mm, blur, met });
        }
        if let (Backlight::Lenslets(lenslets), Some(map)) = (&display.backlight, &map.backlight) {
            let met = |tap: &BacklightTap| match tap {
                BacklightTap::Lit { lenslet, .. } => Some([*lenslet as usize; 2]),
                _ => None,
            };
            let of_view = |view| if axis == 0 { map.x(view) } else { map.y(view) };
            let met = (0..views).map(|view| of_view(view).iter().map(met).collect()).collect();
            let (pitch_mm, offset_mm) = (lenslets.pitch_mm, sign * lenslets.offset_mm[axis]);
            parts.push(AxisPart { count: lenslets.lenslets[axis], pitch_mm, offset_mm, blur: 0, met });
        }
        let tiles = tiles.clamp(1, (pixels / 2).max(1));
        Self { tiles, pixels, pitch_mm: geometry.pitch_mm, parts }
    }

    /// Returns the first field pixel of a tile. It is even, so that pairs of pixels stay together
    /// at half the resolution.
    fn cut(&self, tile: usize) -> usize {
        if tile == self.tiles { self.pixels } else { self.pixels * tile / self.tiles / 2 * 2 }
    }

    fn tile(&self, tile: usize) -> AxisTile {
        let middle = self.cut(tile)..self.cut(tile + 1);
        let place_mm = |pixel: usize| (pixel as f64 - self.pixels as f64 / 2.0) * self.pitch_mm;
        let first = |part: &AxisPart, tile: usize| match tile {
            0 => 0,
            tile if tile == self.tiles => part.count,
            tile => part.first_from(place_mm(self.cut(tile))),
        };
        let own: Vec<_> = self.parts.iter().map(|part| first(part, tile)..first(part, tile + 1)).collect();
        let first_rays = self.rays(&own, &middle);
        let free: Vec<_> = self.parts.iter().zip(&own).map(|(part, own)| hull(own, &part.hits(&first_rays))).collect();
        let field = even(&self.rays(&free, &middle), self.pixels);
        let held = self.parts.iter().zip(&free).map(|(part, free)| {
            let held = hull(free, &part.hits(&field));
            // If no ray of the tile hits a layer, the tile still holds one pixel of the layer.
            let held =
                if held.is_empty() { held.start.min(part.count - 1)..held.start.min(part.count - 1) + 1 } else { held };
            even(&held, part.count)
        });
        let held: Vec<_> = held.collect();
        let parts = own.into_iter().zip(free).zip(held).map(|((own, free), held)| [own, free, held]).collect();
        AxisTile { field, parts }
    }

    /// Returns the smallest range that holds `middle` and all field pixels whose rays hit a pixel
    /// of `ranges`. `ranges` has one range per layer, and one for the lenslets.
    fn rays(&self, ranges: &[Range<usize>], middle: &Range<usize>) -> Range<usize> {
        self.parts.iter().zip(ranges).fold(middle.clone(), |all, (part, range)| hull(&all, &part.rays(range)))
    }
}

impl AxisPart {
    /// Returns the first pixel whose centre is at `place_mm` or after it.
    fn first_from(&self, place_mm: f64) -> usize {
        let pixel = (place_mm - self.offset_mm) / self.pitch_mm + (self.count as f64 - 1.0) / 2.0;
        (pixel.ceil().max(0.0) as usize).min(self.count)
    }

    /// Returns the range of field pixels whose rays depend on pixels of `range`, also through the
    /// blur.
    fn rays(&self, range: &Range<usize>) -> Range<usize> {
        if range.is_empty() {
            return 0..0;
        }
        let range = self.widened(range);
        let reads = |met: &Option<[usize; 2]>| met.is_some_and(|met| met.iter().any(|pixel| range.contains(pixel)));
        (0..self.met.len()).fold(0..0, |all, view| {
            let first = self.met[view].iter().position(reads);
            let last = self.met[view].iter().rposition(reads);
            first.zip(last).map_or(all.clone(), |(first, last)| hull(&all, &(first..last + 1)))
        })
    }

    /// Returns the range of layer pixels on which the rays through a range of field pixels depend.
    fn hits(&self, field: &Range<usize>) -> Range<usize> {
        let met = self.met.iter().flat_map(|view| view[field.clone()].iter().flatten().flatten());
        let range = met.fold(0..0, |all, &pixel| hull(&all, &(pixel..pixel + 1)));
        if range.is_empty() { range } else { self.widened(&range) }
    }

    /// Extends a range by all pixels whose values the blur mixes into the range.
    fn widened(&self, range: &Range<usize>) -> Range<usize> {
        range.start.saturating_sub(self.blur)..(range.end + self.blur).min(self.count)
    }
}

/// Returns the smallest range that holds `a` and `b`.
fn hull(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    match (a.is_empty(), b.is_empty()) {
        (_, true) => a.clone(),
        (true, false) => b.clone(),
        _ => a.start.min(b.start)..a.end.max(b.end),
    }
}

/// Extends a range to an even start and an even end, but not past `count`.
fn even(range: &Range<usize>, count: usize) -> Range<usize> {
    range.start / 2 * 2..range.end.next_multiple_of(2).min(count)
}

impl Region {
    /// Returns the number of rows and columns.
    pub fn size(&self) -> [usize; 2] {
        [self.rows.len(), self.cols.len()]
    }

    /// Returns true if the region has no pixels.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty() || self.cols.is_empty()
    }

    /// Returns this region with indices relative to the first pixel of `around`, a region that
    /// contains this one.
    #[must_use]
    pub fn within(&self, around: &Self) -> Self {
        let shift = |range: &Range<usize>, by: usize| range.start.saturating_sub(by)..range.end.saturating_sub(by);
        Self { rows: shift(&self.rows, around.rows.start), cols: shift(&self.cols, around.cols.start) }
    }

    /// Returns the pixels common to this region and `other`; may be empty.
    #[must_use]
    pub fn common(&self, other: &Self) -> Self {
        let common = |a: &Range<usize>, b: &Range<usize>| {
            let start = a.start.max(b.start);
            start..a.end.min(b.end).max(start)
        };
        Self { rows: common(&self.rows, &other.rows), cols: common(&self.cols, &other.cols) }
    }
}

impl Tile {
    /// Returns a display that consists of the tile's held pixels. Its origin is the centre of the
    /// tile's field pixels.
    pub fn display(&self, whole: &Display, geometry: &FieldGeometry) -> Display {
        let mut display = whole.without_panels();
        display.field.resolution = [self.field.cols.len(), self.field.rows.len()];
        let field_mm = centre_mm(&self.field, [geometry.rows, geometry.cols], geometry.pitch_mm);
        for ((layer, part), whole) in display.layers.iter_mut().zip(&self.parts).zip(&self.whole) {
            let held = &part.held;
            let centre_mm = centre_mm(held, *whole, layer.pitch_mm);
            layer.resolution = [held.cols.len(), held.rows.len()];
            layer.offset_mm = [0, 1].map(|axis| layer.offset_mm[axis] + centre_mm[axis] - field_mm[axis]);
            (layer.panel_resolution, layer.panel_pitch_mm) = (None, None);
            // Rotate the list of colour filters, so that every column keeps its filter.
            let stripes = layer.filters.len();
            if stripes > 0 {
                layer.filters.rotate_left(held.cols.start % stripes);
            }
        }
        if let (Backlight::Lenslets(lenslets), Some(part), Some(whole)) =
            (&mut display.backlight, self.parts.last(), self.whole.last())
        {
            let centre_mm = centre_mm(&part.held, *whole, lenslets.pitch_mm);
            lenslets.lenslets = [part.held.cols.len(), part.held.rows.len()];
            lenslets.offset_mm = [0, 1].map(|axis| lenslets.offset_mm[axis] + centre_mm[axis] - field_mm[axis]);
            let LensletBacklight { panel_resolution, panel_pitch_mm, .. } = lenslets;
            (*panel_resolution, *panel_pitch_mm) = (None, None);
        }
        display
    }

    /// Returns the geometry of the tile's part of the light field.
    pub fn geometry(&self, whole: &FieldGeometry) -> FieldGeometry {
        let mut grid = whole.grid.clone();
        if let Projection::Perspective { distance_mm } = grid.projection {
            // The eyes keep their positions in the whole display. So their positions relative to
            // the tile's centre change.
            let [x, y] = centre_mm(&self.field, [whole.rows, whole.cols], whole.pitch_mm);
            grid.slope_x.iter_mut().for_each(|slope| *slope -= x / distance_mm);
            grid.slope_y.iter_mut().for_each(|slope| *slope -= y / distance_mm);
        }
        let [rows, cols] = self.field.size();
        FieldGeometry { rows, cols, pitch_mm: whole.pitch_mm, grid }
    }

    /// Returns the intersections of the tile's rays with its pixels. These intersections are copied
    /// from the map of the whole display, so that no position is rounded again.
    pub fn map(&self, whole: &RayMap) -> RayMap {
        let tap = |tap: &Tap, first: usize| {
            let shifted = |pixel: u32| pixel.wrapping_sub(first as u32);
            if tap.is_missed() {
                *tap
            } else {
                Tap { first: shifted(tap.first), second: shifted(tap.second), t: tap.t }
            }
        };
        let layers = whole.layers.iter().zip(&self.parts).map(|(map, part)| {
            let cut = |taps: &AxisTaps, field: &Range<usize>, held: &Range<usize>| {
                taps.cut(field, |ray| tap(ray, held.start))
            };
            let [rows, cols] = part.held.size();
            let (x, y) =
                (cut(&map.x, &self.field.cols, &part.held.cols), cut(&map.y, &self.field.rows, &part.held.rows));
            LayerMap { x, y, rows, cols }
        });
        let lit = |tap: &BacklightTap, first: usize| match tap {
            BacklightTap::Lit { lenslet, bin } => {
                BacklightTap::Lit { lenslet: lenslet.wrapping_sub(first as u32), bin: *bin }
            }
            other => *other,
        };
        let backlight = whole.backlight.as_ref().zip(self.parts.last()).map(|(map, part)| {
            let Region { rows, cols } = &part.held;
            map.cut([&self.field.cols, &self.field.rows], [cols.start, rows.start], lit)
        });
        RayMap { layers: layers.collect(), backlight }
    }

    /// Returns the part of a light field that belongs to the tile's rays.
    ///
    /// # Panics
    /// If `whole` is not the light field that was divided into tiles.
    pub fn light_field(&self, whole: &LightField) -> LightField {
        let geometry = self.geometry(whole.geometry());
        let mut target = LightField::black(geometry).expect("a tile has pixels");
        let (Region { rows, cols }, width) = (&self.field, whole.geometry().cols);
        for view in whole.geometry().grid.iter() {
            let from = whole.view(view);
            let lines = target.view_mut(view).chunks_exact_mut(3 * cols.len());
            for (line, row) in lines.zip(rows.clone()) {
                line.copy_from_slice(&from[3 * (row * width + cols.start)..][..3 * cols.len()]);
            }
        }
        target
    }

    /// Returns the weights of the tile's rays. `None` for weights per ray that are all 0 in the
    /// tile.
    pub fn weights(&self, whole: &Weights) -> Option<Weights> {
        let Weights::PerRay(weights) = whole else { return Some(whole.clone()) };
        let [view_rows, view_cols, _, _] = weights.shape();
        let Region { rows, cols } = &self.field;
        let mut values = Vec::with_capacity(view_rows * view_cols * rows.len() * cols.len());
        for view in 0..view_rows * view_cols {
            for row in rows.clone() {
                values.extend_from_slice(&weights.block([view / view_cols, view % view_cols, row])[cols.clone()]);
            }
        }
        if values.iter().all(|weight| *weight == 0.0) {
            return None;
        }
        let shape = [view_rows, view_cols, rows.len(), cols.len()];
        Tensor::from_vec(weights.axes(), shape, values).ok().map(Weights::PerRay)
    }
}

/// Returns the centre of a region relative to the centre of the whole grid of `rows` × `cols`
/// pixels, [x, y] in millimetres.
fn centre_mm(region: &Region, [rows, cols]: [usize; 2], pitch_mm: f64) -> [f64; 2] {
    let beside = |range: &Range<usize>, count: usize| 0.5 * (range.start + range.end) as f64 - 0.5 * count as f64;
    [beside(&region.cols, cols) * pitch_mm, -beside(&region.rows, rows) * pitch_mm]
}

impl LayerStack {
    /// Returns a stack of the pixels in `regions`: one region per layer, and one for the lenslets.
    /// The regions must be within this stack.
    #[must_use]
    pub fn cut(&self, regions: &[Region]) -> Self {
        let layers = self.layers.iter().zip(regions).map(|(layer, region)| {
            let [frames, ..] = layer.shape();
            let mut part = Tensor::zeros(Self::LAYER_AXES, [frames, region.rows.len(), region.cols.len(), 3]);
            copy(layer.data(), layer.shape()[1..3].try_into().unwrap_or_default(), region, part.data_mut());
            part
        });
        let layers: Vec<_> = layers.collect();
        let emission = self.emission.as_ref().zip(regions.get(layers.len())).map(|(emission, region)| {
            let [frames, bins_y, bins_x, rows, cols, _] = emission.shape();
            let shape = [frames, bins_y, bins_x, region.rows.len(), region.cols.len(), 3];
            let mut part = Tensor::zeros(Self::EMISSION_AXES, shape);
            copy(emission.data(), [rows, cols], region, part.data_mut());
            part
        });
        Self { layers, emission, brightness: self.brightness }
    }
}

impl LayerStack {
    /// Copies from `other` the pixels that both stacks have. `regions` and `others` state the
    /// pixels of this stack and of `other` within the whole display: one region per layer, and one
    /// for the lenslets.
    pub fn paste(&mut self, regions: &[Region], other: &Self, others: &[Region]) {
        for (n, (to, from)) in self.layers.iter_mut().zip(&other.layers).enumerate() {
            paste(to.data_mut(), &regions[n], from.data(), &others[n]);
        }
        let n = self.layers.len();
        if let (Some(to), Some(from)) = (&mut self.emission, &other.emission) {
            paste(to.data_mut(), &regions[n], from.data(), &others[n]);
        }
    }
}

/// Copies the pixels common to `region` and `other`, in every plane `[row][col][rgb]`.
fn paste(to: &mut [f32], region: &Region, from: &[f32], other: &Region) {
    let common = region.common(other);
    if common.is_empty() {
        return;
    }
    let [rows, cols] = region.size();
    let [other_rows, other_cols] = other.size();
    let width = 3 * common.cols.len();
    let planes = to.chunks_exact_mut(3 * rows * cols).zip(from.chunks_exact(3 * other_rows * other_cols));
    for (to, from) in planes {
        for row in common.rows.clone() {
            let place = |of: &Region| 3 * ((row - of.rows.start) * of.cols.len() + common.cols.start - of.cols.start);
            to[place(region)..][..width].copy_from_slice(&from[place(other)..][..width]);
        }
    }
}

/// Copies a region of every plane `[row][col][rgb]` of `rows` × `cols` pixels, plane after plane.
fn copy(from: &[f32], [rows, cols]: [usize; 2], region: &Region, to: &mut [f32]) {
    let width = 3 * region.cols.len();
    if region.is_empty() {
        return;
    }
    let planes = from.chunks_exact(3 * rows * cols).zip(to.chunks_exact_mut(width * region.rows.len()));
    for (from, to) in planes {
        for (row, line) in region.rows.clone().zip(to.chunks_exact_mut(width)) {
            line.copy_from_slice(&from[3 * (row * cols + region.cols.start)..][..width]);
        }
    }
}
