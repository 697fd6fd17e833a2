//! Positions of views in their grid, and names for them.

use lumistack_display::ViewGrid;

/// Returns the indices of view columns from left to right.
pub(crate) fn left_to_right(grid: &ViewGrid) -> Vec<usize> {
    let mut order: Vec<usize> = (0..grid.slope_x.len()).collect();
    order.sort_by(|a, b| grid.slope_x[*a].total_cmp(&grid.slope_x[*b]));
    order
}

/// Returns the indices of view rows from top to bottom.
pub(crate) fn top_to_bottom(grid: &ViewGrid) -> Vec<usize> {
    let mut order: Vec<usize> = (0..grid.slope_y.len()).collect();
    order.sort_by(|a, b| grid.slope_y[*b].total_cmp(&grid.slope_y[*a]));
    order
}

/// Returns the central view and the corner views, in this order.
pub(crate) fn outstanding_views(grid: &ViewGrid) -> Vec<[usize; 2]> {
    let (down, across) = (top_to_bottom(grid), left_to_right(grid));
    let (bottom, right) = (down.len() - 1, across.len() - 1);
    let places = [[down.len() / 2, across.len() / 2], [0, 0], [0, right], [bottom, 0], [bottom, right]];
    distinct(places.map(|[y, x]| [down[y], across[x]]))
}

/// Returns a central view and two opposite corners, as samples of a grid that is not the target's
/// grid. If the grid has only two views, returns both.
pub(super) fn sample_views(grid: &ViewGrid) -> Vec<[usize; 2]> {
    let (down, across) = (top_to_bottom(grid), left_to_right(grid));
    if down.len() * across.len() == 2 {
        return vec![[down[0], across[0]], [down[down.len() - 1], across[across.len() - 1]]];
    }
    let places = [[down.len() / 2, across.len() / 2], [0, 0], [down.len() - 1, across.len() - 1]];
    distinct(places.map(|[y, x]| [down[y], across[x]]))
}

fn distinct<const N: usize>(views: [[usize; 2]; N]) -> Vec<[usize; 2]> {
    let mut list = Vec::with_capacity(N);
    views.into_iter().for_each(|view| {
        if !list.contains(&view) {
            list.push(view)
        }
    });
    list
}

/// Names a view by its position among the views of the target.
pub(super) fn title(grid: &ViewGrid, target: &ViewGrid, view: [usize; 2]) -> String {
    if grid != target {
        return foreign_title([grid.slope_x[view[1]], grid.slope_y[view[0]]], target).into();
    }
    let rank = |order: Vec<usize>, index: usize| (order.iter().position(|i| *i == index).unwrap_or(0), order.len());
    let ((y, rows), (x, cols)) = (rank(top_to_bottom(grid), view[0]), rank(left_to_right(grid), view[1]));
    let edge = |rank: usize, count: usize, [first, last]: [&'static str; 2]| match rank {
        _ if count == 1 => "",
        0 => first,
        r if r == count - 1 => last,
        _ => "",
    };
    match (edge(y, rows, ["Top", "Bottom"]), edge(x, cols, ["left", "right"])) {
        ("", "") if (y, x) == (rows / 2, cols / 2) => "Central view".into(),
        ("Top", "") if cols == 1 => "Top view".into(),
        ("Bottom", "") if cols == 1 => "Bottom view".into(),
        ("", "left") if rows == 1 => "Leftmost view".into(),
        ("", "right") if rows == 1 => "Rightmost view".into(),
        (vertical, horizontal) if !vertical.is_empty() && !horizontal.is_empty() => {
            format!("{vertical} {horizontal} view")
        }
        _ => format!("View in row {} of {rows}, column {} of {cols}", y + 1, x + 1),
    }
}

/// Names a view that is not in the grid of the target.
fn foreign_title(slope: [f64; 2], target: &ViewGrid) -> &'static str {
    /// Slopes that differ by less than this are regarded as one direction.
    const SAME: f64 = 1e-9;
    let place = |slope: f64, of: &[f64]| {
        let (low, high) = of.iter().fold((f64::MAX, f64::MIN), |(low, high), s| (low.min(*s), high.max(*s)));
        (of.iter().any(|s| (s - slope).abs() < SAME), slope < low - SAME || slope > high + SAME)
    };
    let ((on_x, outside_x), (on_y, outside_y)) = (place(slope[0], &target.slope_x), place(slope[1], &target.slope_y));
    match (outside_x || outside_y, on_x && on_y) {
        (true, _) => "View outside the zone",
        (false, true) => "Another picture of a target view",
        (false, false) => "In-between view",
    }
}
