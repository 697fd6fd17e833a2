//! The distance between neighbouring views.

use lumistack_display::{Display, Projection, Views};

/// Returns the difference of slope between neighbouring views, [horizontal, vertical]. For a fixed
/// number of views, this is the width of one of the equal bins of the zone, also for one view. If
/// the number of views is not fixed, the step of an axis with one view is 0. It is also 0 if the
/// views of the display are invalid.
pub(crate) fn view_step(display: &Display) -> [f64; 2] {
    match display.field.views {
        Views::Fixed(views) => {
            [0, 1].map(|axis| 2.0 * (0.5 * display.field.fov_deg[axis].to_radians()).tan() / views[axis] as f64)
        }
        Views::Auto | Views::Step(_) => {
            display.view_grid(Projection::Oblique).map_or([0.0; 2], |grid| grid.bin_width())
        }
    }
}
