//! Selects the views that are measured and shown one by one. If an axis has more than [`MOST`]
//! views, the report has pictures of only some of them. The zone score measures the quality over
//! the whole zone.

use lumistack_core::Tensor;
use lumistack_display::{FieldGeometry, LightField, ViewGrid, Weights, spread};

/// Largest number of views per axis that the report measures and shows.
const MOST: usize = 7;

/// Returns evenly spread views of a light field, with their weights. The outermost views are among
/// them and, for an odd number of views along an axis, also the central view. `None` if the light
/// field has at most [`MOST`] views along each axis.
pub(crate) fn thinned(field: &LightField, weights: &Weights) -> Option<(LightField, Weights)> {
    let geometry = field.geometry();
    let views = geometry.grid.views();
    if views.iter().all(|count| *count <= MOST) {
        return None;
    }
    // Keep views that are spread over the grid, with their depth and weights.
    let [rows, cols] = views.map(|count| spread(count, MOST));
    let pick = |slopes: &[f64], places: &[usize]| places.iter().map(|&place| slopes[place]).collect();
    let grid = ViewGrid {
        projection: geometry.grid.projection,
        slope_x: pick(&geometry.grid.slope_x, &cols),
        slope_y: pick(&geometry.grid.slope_y, &rows),
    };
    let geometry: FieldGeometry = geometry.with_grid(grid);
    let mut thin = LightField::black(geometry.clone()).ok()?.with_depth(field.depth().cloned());
    for view in geometry.grid.iter() {
        thin.view_mut(view).copy_from_slice(field.view([rows[view[0]], cols[view[1]]]));
    }
    let weights = match weights {
        Weights::Uniform => Weights::Uniform,
        Weights::PerView(all) => {
            let mut some = Tensor::zeros(["view_y", "view_x"], geometry.grid.views());
            geometry.grid.iter().for_each(|[y, x]| *some.at_mut([y, x]) = all.block([rows[y], cols[x]])[0]);
            Weights::PerView(some)
        }
        Weights::PerRay(all) => {
            let [view_rows, view_cols] = geometry.grid.views();
            let shape = [view_rows, view_cols, geometry.rows, geometry.cols];
            let mut some = Tensor::zeros(["view_y", "view_x", "row", "col"], shape);
            for [y, x] in geometry.grid.iter() {
                some.block_mut([y, x]).copy_from_slice(all.block([rows[y], cols[x]]));
            }
            Weights::PerRay(some)
        }
    };
    Some((thin, weights))
}

#[cfg(test)]
mod tests {
    use lumistack_display::Projection;

    use super::*;

    #[test]
    fn values_and_weights_are_those_of_their_views() {
        let grid = ViewGrid::uniform(Projection::Oblique, [13, 3], [20.0, 8.0]).unwrap();
        let geometry = FieldGeometry { rows: 2, cols: 3, pitch_mm: 1.0, grid };
        let mut field = LightField::black(geometry.clone()).unwrap();
        let number = |[y, x]: [usize; 2]| (100 * y + x) as f32;
        geometry.grid.iter().for_each(|view| field.view_mut(view).fill(number(view)));
        let mut per_view = Tensor::zeros(["view_y", "view_x"], [3, 13]);
        geometry.grid.iter().for_each(|view| *per_view.at_mut(view) = number(view));
        let mut per_ray = Tensor::zeros(["view_y", "view_x", "row", "col"], [3, 13, 2, 3]);
        geometry.grid.iter().for_each(|view| per_ray.block_mut(view).fill(number(view)));
        for weights in [Weights::Uniform, Weights::PerView(per_view), Weights::PerRay(per_ray)] {
            let (thin, thin_weights) = thinned(&field, &weights).unwrap();
            let views = thin.geometry().grid.clone();
            assert_eq!(views.views(), [3, 7]);
            thin_weights.check(thin.geometry()).unwrap();
            for [y, x] in views.iter() {
                let from = [y, 2 * x];
                assert_eq!(
                    (views.slope_x[x], views.slope_y[y]),
                    (geometry.grid.slope_x[2 * x], geometry.grid.slope_y[y])
                );
                assert!(thin.view([y, x]).iter().all(|value| *value == number(from)));
                let same = match &thin_weights {
                    Weights::Uniform => true,
                    Weights::PerView(weights) => weights.block([y, x])[0] == number(from),
                    Weights::PerRay(weights) => weights.block([y, x]).iter().all(|weight| *weight == number(from)),
                };
                assert!(same);
            }
        }
        let few = ViewGrid::uniform(Projection::Oblique, [7, 5], [20.0, 20.0]).unwrap();
        assert!(thinned(&LightField::black(geometry.with_grid(few)).unwrap(), &Weights::Uniform).is_none());
    }
}
