//! Computes views of the data that the host submits: simulated views of a stack, or the views of a
//! light field.

use lumistack_plugin::display::{FieldGeometry, Projection, SeenDepth};
use lumistack_plugin::{FieldInput, PluginError, StackInput, ViewPoint};

/// The source of views.
#[derive(Clone, Copy)]
pub(crate) enum ViewSource<'a> {
    /// A stack, whose views are simulated and divided by β.
    Stack(&'a StackInput<'a>),
    /// A light field, whose own views are used.
    Field(&'a FieldInput<'a>),
}

impl ViewSource<'_> {
    pub(crate) fn geometry(&self) -> &FieldGeometry {
        match self {
            Self::Stack(stack) => stack.target(),
            Self::Field(field) => field.geometry(),
        }
    }

    /// Returns the depth of the central view; `None` if the host does not know it.
    pub(crate) fn depth(&self) -> Option<&SeenDepth> {
        match self {
            Self::Stack(stack) => stack.target_depth(),
            Self::Field(field) => field.depth(),
        }
    }

    /// Returns the values `[row][col][rgb]` of the grid's view `view` = [view_y, view_x].
    pub(crate) fn view(&self, view: [usize; 2]) -> Result<Vec<f32>, PluginError> {
        match self {
            Self::Stack(stack) => adapted(stack, ViewPoint::of_view(stack.target(), view)),
            Self::Field(field) => Ok(field.view(view)?.to_vec()),
        }
    }

    /// Returns the view at the position `at` = [view_y, view_x], in units of views. The position
    /// may lie between views of the grid. The view of a stack is simulated. For a light field, the
    /// nearest view is returned.
    pub(crate) fn between(&self, at: [f64; 2]) -> Result<Vec<f32>, PluginError> {
        match self {
            Self::Stack(stack) => {
                let grid = &stack.target().grid;
                let [x, y] = [slope_at(&grid.slope_x, at[1]), slope_at(&grid.slope_y, at[0])];
                let from = match grid.projection {
                    Projection::Oblique => ViewPoint::Slope([x, y]),
                    Projection::Perspective { distance_mm } => {
                        ViewPoint::Eye([x * distance_mm, y * distance_mm, distance_mm])
                    }
                };
                adapted(stack, from)
            }
            Self::Field(_) => self.view(nearest(self.geometry(), at)),
        }
    }

    /// Returns the number by which the views' radiance was divided: the brightness β of a stack, 1
    /// for a light field.
    pub(crate) fn divided_by(&self) -> f64 {
        match self {
            Self::Stack(stack) => stack.brightness(),
            Self::Field(_) => 1.0,
        }
    }
}

/// Returns the view [view_y, view_x] of the grid that is nearest to the position `at`.
pub(crate) fn nearest(geometry: &FieldGeometry, at: [f64; 2]) -> [usize; 2] {
    let views = geometry.grid.views();
    [0, 1].map(|axis| (at[axis].round().max(0.0) as usize).min(views[axis] - 1))
}

fn adapted(stack: &StackInput<'_>, from: ViewPoint) -> Result<Vec<f32>, PluginError> {
    let factor = (1.0 / stack.brightness()) as f32;
    let mut values = stack.simulate(from)?.to_vec();
    values.iter_mut().for_each(|value| *value *= factor);
    Ok(values)
}

/// Interpolates between the slopes of neighbouring views. `at` is the position in units of views,
/// from 0 to the index of the last view.
pub(crate) fn slope_at(slopes: &[f64], at: f64) -> f64 {
    let first = (at.floor() as usize).min(slopes.len() - 1);
    let second = (first + 1).min(slopes.len() - 1);
    slopes[first] + (at - first as f64) * (slopes[second] - slopes[first])
}
