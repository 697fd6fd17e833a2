//! The tables of a run: the line and column of every factor that a ray reads, and the rays through
//! a line.
//!
//! All tables follow from [`RayMap`]: one entry per view column and field column, and one per view
//! row and field row.

use std::ops::Range;

use lumistack_display::{
    AxisTaps, Backlight, BacklightTap, Display, FieldGeometry, Formation, LayerMap, Missing, RayMap, Region, Tap,
};
use lumistack_simd::Backend;

use crate::map::{FactorMap, RawMap, snapped};
use crate::problem::{FactorizeError, Problem};
use crate::rows::RowFunctions;
use crate::target::Target;

/// The constants of a problem during a run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Numbers of view rows and view columns.
    pub(crate) views: [usize; 2],
    /// Number of field rows: rows of pixels of a view.
    pub(crate) rows: usize,
    /// Number of field columns: columns of pixels of a view.
    pub(crate) cols: usize,
    /// Number of frames M.
    pub(crate) frames: usize,
    /// Number of layers N. The backlight's map, if any, follows the layers' maps.
    pub(crate) layers: usize,
    /// The rule by which layers form the light of a ray.
    pub(crate) formation: Formation,
    /// True if layers attenuate and every map is a constant shift per view.
    pub(crate) shifted: bool,
    /// A row of ones, one for each field column.
    pub(crate) ones: Vec<f32>,
    /// Layers rear to front, then the directional backlight.
    pub(crate) maps: Vec<FactorMap>,
    /// Per view column, its runs: the ranges of field columns whose rays are valid; normally one
    /// range.
    pub(crate) runs: Vec<Vec<Range<usize>>>,
    /// Per view row, true for field rows whose rays are valid.
    pub(crate) valid_rows: Vec<Vec<bool>>,
    pub(crate) target: Target,
    /// Number of valid rays with a weight above 0.
    pub rays: u64,
    /// For a tile, its position in the whole display and its free pixels.
    pub(crate) tile: Option<TilePlace>,
    /// Instruction set of all kernels of the run.
    pub(crate) backend: Backend,
    pub(crate) row: RowFunctions,
}

/// The position of a tile in its display.
#[derive(Clone, Debug)]
pub(crate) struct TilePlace {
    /// Per factor: first [row, column] of the tile in the whole factor, and [rows, columns] of the
    /// whole factor.
    pub(crate) place: Vec<[[usize; 2]; 2]>,
    /// Per factor, the pixels that may change, counted within the tile; `None` if all may.
    pub(crate) free: Option<Vec<Region>>,
}

impl TilePlace {
    /// Returns the same tile at half the resolution, with all pixels free.
    pub(crate) fn halved(&self, display: &Display) -> Self {
        let halve = |(n, place): (usize, &[[usize; 2]; 2])| match display.layers.get(n) {
            Some(_) => place.map(|both| both.map(|pixels| pixels.div_ceil(2))),
            None => *place,
        };
        Self { place: self.place.iter().enumerate().map(halve).collect(), free: None }
    }
}

/// Checks that at least one ray of a display's light field is valid, so that a solver can find
/// patterns. The test takes far less time than a solve.
///
/// # Errors
/// [`FactorizeError::NoRays`] if no ray is valid.
pub fn check_rays(display: &Display, geometry: &FieldGeometry) -> Result<(), FactorizeError> {
    let lines = valid_lines(display, geometry, &RayMap::new(display, geometry));
    if lines.iter().all(|axis| axis.iter().flatten().any(|valid| *valid)) {
        Ok(())
    } else {
        Err(FactorizeError::NoRays)
    }
}

/// Returns `[axis][view][pixel]`, x before y: a ray is valid if both its column and its row are. A
/// valid ray hits every layer, unless the display allows misses. It also hits the grid of lenslets,
/// if there is one.
fn valid_lines(display: &Display, geometry: &FieldGeometry, map: &RayMap) -> [Vec<Vec<bool>>; 2] {
    let drop = display.missing == Missing::Drop;
    let valid = |view: usize, i: usize, axis: fn(&LayerMap) -> &AxisTaps, lit: &dyn Fn(usize, usize) -> bool| {
        (!drop || map.layers.iter().all(|layer| !axis(layer).of_view(view)[i].is_missed())) && lit(view, i)
    };
    let backlight = map.backlight.as_ref();
    let lit_x = |view: usize, i: usize| backlight.is_none_or(|b| b.x(view)[i] != BacklightTap::Missed);
    let lit_y = |view: usize, i: usize| backlight.is_none_or(|b| b.y(view)[i] != BacklightTap::Missed);
    let [views_y, views_x] = geometry.grid.views();
    let of_col = |view: usize| (0..geometry.cols).map(|i| valid(view, i, |l| &l.x, &lit_x)).collect();
    let of_row = |view: usize| (0..geometry.rows).map(|i| valid(view, i, |l| &l.y, &lit_y)).collect();
    [(0..views_x).map(of_col).collect(), (0..views_y).map(of_row).collect()]
}

impl Plan {
    /// Builds the tables, and checks the problem.
    pub(crate) fn new(problem: &Problem) -> Result<Self, FactorizeError> {
        problem.check_all_but_target()?;
        let target = Target::new(problem)?;
        if target.may_be_infinite() {
            problem.check_target()?;
        }
        Ok(Self::with_target(problem.display, problem.target.geometry(), target))
    }

    /// Builds the tables of a tile, and checks its problem; `map` maps the tile's rays to its
    /// pixels.
    pub(crate) fn of_tile(problem: &Problem, map: &RayMap, tile: TilePlace) -> Result<Self, FactorizeError> {
        problem.check_all_but_target()?;
        let target = Target::new(problem)?;
        if target.may_be_infinite() {
            problem.check_target()?;
        }
        Ok(Self { tile: Some(tile), ..Self::with_map(problem.display, problem.target.geometry(), map, target) })
    }

    /// Builds the tables for rays of `geometry` with the radiance `target`.
    pub(crate) fn with_target(display: &Display, geometry: &FieldGeometry, target: Target) -> Self {
        Self::with_map(display, geometry, &RayMap::new(display, geometry), target)
    }

    fn with_map(display: &Display, geometry: &FieldGeometry, map: &RayMap, target: Target) -> Self {
        let views = geometry.grid.views();
        let (rows, cols) = (geometry.rows, geometry.cols);
        let [valid_cols, valid_rows] = valid_lines(display, geometry, map);
        let runs: Vec<_> = valid_cols.iter().map(|valid| runs_of(valid)).collect();
        // Make the map of every layer and of the backlight.
        let frames = display.frames;
        let maps: Vec<_> = raw_maps(display, map, views)
            .into_iter()
            .map(|raw| FactorMap::new(raw, frames, &runs, &valid_rows))
            .collect();
        let formation = display.formation;
        let shifted = formation == Formation::Attenuating && maps.iter().all(|map| map.shifted);
        let mut plan = Self {
            views,
            rows,
            cols,
            frames,
            layers: map.layers.len(),
            formation,
            shifted,
            ones: vec![1.0; cols],
            maps,
            runs,
            valid_rows,
            target,
            rays: 0,
            tile: None,
            backend: Backend::best(),
            row: RowFunctions::new(Backend::best()),
        };
        plan.rays = plan.count_rays();
        plan
    }

    /// Selects the instruction set.
    pub(crate) fn use_backend(&mut self, backend: Backend) {
        self.backend = backend;
        self.row = RowFunctions::new(backend);
    }

    /// Returns the number of factors: layers and backlight.
    pub fn factor_count(&self) -> usize {
        self.maps.len()
    }

    /// Returns true if an update of factor `n` reports the error of all rays. In a tile with fixed
    /// pixels, an update leaves out lines without free pixels.
    pub fn sees_all_rays(&self, n: usize) -> bool {
        self.maps[n].complete && self.free(n).is_none()
    }

    /// Returns true if layers attenuate.
    pub(crate) fn is_product(&self) -> bool {
        self.formation == Formation::Attenuating
    }

    /// Returns true if L̃ is linear in the values of factor `n`. The Gram matrix then bounds the
    /// curvature.
    pub fn is_bounded(&self, n: usize) -> bool {
        self.formation != Formation::Polarization || n >= self.layers
    }

    /// Returns the pixels of factor `n` that may change; `None` if all may.
    pub(crate) fn free(&self, n: usize) -> Option<&Region> {
        self.tile.as_ref()?.free.as_ref()?.get(n)
    }

    /// Returns true if a line of factor `n` has pixels that may change.
    pub(crate) fn may_change(&self, n: usize, line: usize) -> bool {
        let rows = self.maps[n].layout.size[0];
        self.free(n).is_none_or(|free| free.rows.contains(&(line % rows)))
    }

    /// Returns, for each column of factor `n`'s padded lines, true if the column may not change,
    /// `[x]`; `None` if all columns may change.
    pub(crate) fn fixed_columns(&self, n: usize) -> Option<Vec<bool>> {
        let (free, layout) = (self.free(n)?, &self.maps[n].layout);
        let mut fixed = vec![true; layout.stride];
        for column in 0..layout.cols() {
            fixed[layout.pad + column] = !free.cols.contains(&(column % layout.size[1]));
        }
        Some(fixed)
    }

    /// Returns the number of pixels of factor `n` that may change, in all bins.
    pub(crate) fn changing(&self, n: usize) -> usize {
        let layout = &self.maps[n].layout;
        let [rows, cols] = self.free(n).map_or(layout.size, Region::size);
        layout.bins.iter().product::<usize>() * rows * cols
    }

    fn count_rays(&self) -> u64 {
        let mut count = 0;
        for (view_y, rows) in self.valid_rows.iter().enumerate() {
            for row in (0..self.rows).filter(|&row| rows[row]) {
                for (view_x, runs) in self.runs.iter().enumerate() {
                    count += runs.iter().map(|run| self.target.count(self.view(view_y, view_x), row, run)).sum::<u64>();
                }
            }
        }
        count
    }

    /// Returns the index of a view in the target.
    #[inline(always)]
    pub(crate) fn view(&self, view_y: usize, view_x: usize) -> usize {
        view_y * self.views[1] + view_x
    }
}

/// Converts the taps (the pixels that rays read) of layers and lenslets to one form, in which a
/// miss is `None`.
fn raw_maps(display: &Display, map: &RayMap, views: [usize; 2]) -> Vec<RawMap> {
    // for layers, a miss becomes `None`, and weights that are only rounding are removed
    let hit = |taps: &[Tap]| taps.iter().map(|tap| (!tap.is_missed()).then(|| snapped(*tap))).collect();
    let mut maps: Vec<RawMap> = map
        .layers
        .iter()
        .map(|layer| RawMap {
            bins: [1, 1],
            size: [layer.rows, layer.cols],
            outside: display.formation.neutral(),
            x: (0..views[1]).map(|view| hit(layer.x.of_view(view))).collect(),
            y: (0..views[0]).map(|view| hit(layer.y.of_view(view))).collect(),
        })
        .collect();
    // a lenslet of an angular bin is a pixel of the backlight's factor
    if let (Backlight::Lenslets(lenslets), Some(map)) = (&display.backlight, &map.backlight) {
        let lit = |taps: &[BacklightTap], count: usize| {
            let tap = |tap: &BacklightTap| match tap {
                BacklightTap::Lit { lenslet, bin } => {
                    let index = bin * count as u32 + lenslet;
                    Some(Tap { first: index, second: index, t: 0.0 })
                }
                _ => None,
            };
            taps.iter().map(tap).collect()
        };
        let ([cols, rows], [bins_x, bins_y]) = (lenslets.lenslets, lenslets.views);
        maps.push(RawMap {
            bins: [bins_y, bins_x],
            size: [rows, cols],
            outside: 0.0,
            x: (0..views[1]).map(|view| lit(map.x(view), cols)).collect(),
            y: (0..views[0]).map(|view| lit(map.y(view), rows)).collect(),
        });
    }
    maps
}

/// Returns the ranges of consecutive `true` values.
fn runs_of(valid: &[bool]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for i in (0..valid.len()).filter(|&i| valid[i]) {
        match runs.last_mut() {
            Some(run) if run.end == i => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs
}
