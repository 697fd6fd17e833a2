//! Arranges all views in one picture, for the section "Look around" of the page.

use lumistack_core::Task;
use lumistack_display::{FieldGeometry, Simulator, ViewGrid};
use rayon::prelude::*;

use super::names::{left_to_right, top_to_bottom};
use crate::picture::{self, Embedded, Encoding, Linear, Picture};
use crate::{ReportError, ReportInput, format};

/// Two pictures. One has all target views, with the topmost row and the leftmost column first. The
/// other has all simulated views in the same arrangement.
#[derive(Clone, Debug)]
pub(crate) struct Sheets {
    pub(crate) target: Embedded,
    pub(crate) simulated: Embedded,
    /// For each column of views on a sheet, its direction as text, from left to right.
    pub(crate) across: Vec<String>,
    /// For each row of views on a sheet, its direction as text, from top to bottom.
    pub(crate) up: Vec<String>,
}

/// Maximum number of pixels of one sheet.
const SHEET_BUDGET: usize = 2_800_000;
/// Largest width of a view on a sheet, pixels. It is about the width of a view on the page.
const VIEW_COLS: usize = 640;

/// The two sheets, while views are added.
pub(super) struct SheetPair {
    factor: usize,
    down: Vec<usize>,
    across: Vec<usize>,
    target: Picture,
    simulated: Picture,
}

impl SheetPair {
    pub(super) fn new(geometry: &FieldGeometry) -> Self {
        let [view_rows, view_cols] = geometry.grid.views();
        let sizes = vec![(geometry.rows, geometry.cols); view_rows * view_cols];
        let factor = picture::shrink_factor(&sizes, SHEET_BUDGET).max(geometry.cols.div_ceil(VIEW_COLS));
        let (rows, cols) = (view_rows * geometry.rows.div_ceil(factor), view_cols * geometry.cols.div_ceil(factor));
        let blank = Picture { rows, cols, rgb: vec![0; rows * cols * 3] };
        Self {
            factor,
            down: top_to_bottom(&geometry.grid),
            across: left_to_right(&geometry.grid),
            target: blank.clone(),
            simulated: blank,
        }
    }

    /// Adds all views of the target, and the seen pictures in their directions.
    pub(super) fn fill(&mut self, input: &ReportInput, simulator: &Simulator, task: Task) -> Result<(), ReportError> {
        let geometry = input.target.geometry();
        let (factor, scale) = (self.factor, (1.0 / input.stack.brightness) as f32);
        let tile =
            |values: &[f32], scale| Linear::new(geometry.rows, geometry.cols, values, scale).shrunk(factor).encoded();
        let views: Vec<[usize; 2]> = geometry.grid.iter().collect();
        for together in views.chunks(rayon::current_num_threads()) {
            task.cancel.check()?;
            let both = |&view: &[usize; 2]| {
                let seen = simulator.seen(geometry, view);
                [tile(input.target.view(view), 1.0), tile(seen.radiance.data(), scale)]
            };
            let tiles: Vec<_> = together.par_iter().map(both).collect();
            for (&view, tiles) in together.iter().zip(&tiles) {
                self.place(view, tiles);
            }
        }
        Ok(())
    }

    /// Copies the tiles of a view, target and simulated, to their place on the sheets.
    fn place(&mut self, view: [usize; 2], tiles: &[Picture; 2]) {
        let rank = |order: &[usize], index: usize| order.iter().position(|i| *i == index).unwrap_or(0);
        let (y, x) = (rank(&self.down, view[0]), rank(&self.across, view[1]));
        for (sheet, tile) in [&mut self.target, &mut self.simulated].into_iter().zip(tiles) {
            for (row, line) in tile.rgb.chunks_exact(tile.cols * 3).enumerate() {
                let start = ((y * tile.rows + row) * sheet.cols + x * tile.cols) * 3;
                sheet.rgb[start..start + line.len()].copy_from_slice(line);
            }
        }
    }

    pub(super) fn embedded(&self, grid: &ViewGrid) -> Result<Sheets, ReportError> {
        let encoding = Encoding::for_pixels(2 * self.target.rows * self.target.cols);
        Ok(Sheets {
            target: self.target.embedded(encoding)?,
            simulated: self.simulated.embedded(encoding)?,
            across: self.across.iter().map(|x| format::angle(grid.slope_x[*x])).collect(),
            up: self.down.iter().map(|y| format::angle(grid.slope_y[*y])).collect(),
        })
    }
}
