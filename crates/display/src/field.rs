//! The light field that a viewer should see.

use lumistack_core::Tensor;

use crate::{FieldGeometry, GridError};

/// Display-referred linear radiance of every view: `radiance[view_y][view_x][row][col][rgb]`, 0..1 after exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct LightField {
    geometry: FieldGeometry,
    radiance: Tensor<5>,
}

impl LightField {
    /// Axis names of [`radiance`](Self::radiance).
    pub const AXES: [&'static str; 5] = ["view_y", "view_x", "row", "col", "rgb"];

    /// Joins geometry and values.
    ///
    /// # Errors
    /// If the geometry is wrong or its shape is not that of the values.
    pub fn new(geometry: FieldGeometry, radiance: Tensor<5>) -> Result<Self, GridError> {
        geometry.check()?;
        let expected = Self::shape_of(&geometry);
        if radiance.shape() != expected {
            return Err(GridError {
                what: "light field shape [view_y][view_x][row][col][rgb]",
                expected: "the shape of its geometry",
                found: format!("{:?} where the geometry has {expected:?}", radiance.shape()),
            });
        }
        Ok(Self { geometry, radiance })
    }

    /// A black light field.
    ///
    /// # Errors
    /// If the geometry is wrong.
    pub fn black(geometry: FieldGeometry) -> Result<Self, GridError> {
        geometry.check()?;
        let radiance = Tensor::zeros(Self::AXES, Self::shape_of(&geometry));
        Ok(Self { geometry, radiance })
    }

    /// Shape of the values of a geometry.
    pub fn shape_of(geometry: &FieldGeometry) -> [usize; 5] {
        let [view_rows, view_cols] = geometry.grid.views();
        [view_rows, view_cols, geometry.rows, geometry.cols, 3]
    }

    /// Where its rays are.
    pub fn geometry(&self) -> &FieldGeometry {
        &self.geometry
    }

    /// All values.
    pub fn radiance(&self) -> &Tensor<5> {
        &self.radiance
    }

    /// All values, writable.
    pub fn radiance_mut(&mut self) -> &mut Tensor<5> {
        &mut self.radiance
    }

    /// One view, `[row][col][rgb]`; `view` = [view_y, view_x].
    pub fn view(&self, view: [usize; 2]) -> &[f32] {
        self.radiance.block(view)
    }

    /// One view, writable.
    pub fn view_mut(&mut self, view: [usize; 2]) -> &mut [f32] {
        self.radiance.block_mut(view)
    }
}
