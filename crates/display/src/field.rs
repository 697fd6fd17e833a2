//! The light field that a viewer should see.

use lumistack_core::Tensor;

use crate::{FieldGeometry, GridError};

/// Display-referred linear radiance of every view: `radiance[view_y][view_x][row][col][rgb]`, 0..1
/// after exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct LightField {
    geometry: FieldGeometry,
    radiance: Tensor<5>,
    depth: Option<SeenDepth>,
}

/// Depth of the surfaces in the middle view of a light field. Light fields of scenes have a depth;
/// light fields of pictures have none.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenDepth {
    /// Number of rows of the map, which covers the whole height of the view. This number may be
    /// smaller than the view's number of rows.
    pub rows: usize,
    /// Number of columns of the map, which covers the whole width of the view.
    pub cols: usize,
    /// z of the first surface in display space, `[row][col]`, millimetres towards the viewer;
    /// `None` where a ray hits nothing.
    pub z_mm: Vec<Option<f32>>,
}

impl SeenDepth {
    /// Returns z at a pixel of a view of `size` = [rows, columns] pixels, from the nearest entry of
    /// the map. Returns `None` if the ray hits nothing.
    pub fn at(&self, row: usize, col: usize, size: [usize; 2]) -> Option<f32> {
        let place = |i: usize, from: usize, to: usize| ((2 * i + 1) * to / (2 * from)).min(to.saturating_sub(1));
        let index = place(row, size[0], self.rows) * self.cols + place(col, size[1], self.cols);
        self.z_mm.get(index).copied().flatten()
    }
}

impl LightField {
    /// Axis names of [`radiance`](Self::radiance).
    pub const AXES: [&'static str; 5] = ["view_y", "view_x", "row", "col", "rgb"];

    /// Makes a light field of a geometry and its radiance.
    ///
    /// # Errors
    /// If the geometry is invalid, or the values have another shape than the geometry.
    pub fn new(geometry: FieldGeometry, radiance: Tensor<5>) -> Result<Self, GridError> {
        geometry.check()?;
        let expected = Self::shape_of(&geometry);
        if radiance.shape() != expected {
            return Err(GridError {
                what: "shape [view_y][view_x][row][col][rgb] of the light field",
                expected: "the shape that the geometry has",
                found: format!("{:?} instead of {expected:?}", radiance.shape()),
            });
        }
        Ok(Self { geometry, radiance, depth: None })
    }

    /// Makes a black light field.
    ///
    /// # Errors
    /// If the geometry is invalid.
    pub fn black(geometry: FieldGeometry) -> Result<Self, GridError> {
        geometry.check()?;
        let radiance = Tensor::zeros(Self::AXES, Self::shape_of(&geometry));
        Ok(Self { geometry, radiance, depth: None })
    }

    /// Returns the depth in the middle view, [view rows / 2, view columns / 2]; `None` if it is
    /// unknown.
    pub fn depth(&self) -> Option<&SeenDepth> {
        self.depth.as_ref()
    }

    /// Returns this light field with `depth` as the depth of its middle view.
    #[must_use]
    pub fn with_depth(self, depth: Option<SeenDepth>) -> Self {
        Self { depth, ..self }
    }

    /// Returns the shape of [`radiance`](Self::radiance) for a geometry.
    pub fn shape_of(geometry: &FieldGeometry) -> [usize; 5] {
        let [view_rows, view_cols] = geometry.grid.views();
        [view_rows, view_cols, geometry.rows, geometry.cols, 3]
    }

    /// Returns the pixels and views of the light field.
    pub fn geometry(&self) -> &FieldGeometry {
        &self.geometry
    }

    /// Returns the values of all views.
    pub fn radiance(&self) -> &Tensor<5> {
        &self.radiance
    }

    /// Returns the values of all views, writable.
    pub fn radiance_mut(&mut self) -> &mut Tensor<5> {
        &mut self.radiance
    }

    /// Returns the values `[row][col][rgb]` of the view `view` = [view_y, view_x].
    pub fn view(&self, view: [usize; 2]) -> &[f32] {
        self.radiance.block(view)
    }

    /// Returns the values `[row][col][rgb]` of the view `view` = [view_y, view_x], writable.
    pub fn view_mut(&mut self, view: [usize; 2]) -> &mut [f32] {
        self.radiance.block_mut(view)
    }
}
