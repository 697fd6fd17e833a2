//! The filter's input: noisy views, and the size of its windows.

use lumistack_core::Tensor;

use crate::Features;

/// Sizes of the filter's windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Number of pixels on either side of a pixel, in the view itself. Default 5.
    pub radius: usize,
    /// Number of views on either side, along both axes of the grid. With 0 every view is filtered
    /// by itself. Default 2.
    pub views: usize,
    /// Number of pixels on either side of the corresponding pixel in the neighbouring views.
    /// Default 1.
    pub radius_in_views: usize,
}

impl Default for Window {
    fn default() -> Self {
        Self { radius: 5, views: 2, radius_in_views: 1 }
    }
}

/// One rendered view.
#[derive(Clone, Debug)]
pub struct NoisyView {
    /// Radiance `[row][col][rgb]` of two renders, each with half of the samples and its own seeds.
    pub halves: [Tensor<3>; 2],
    /// Guides of the view's first surfaces.
    pub features: Features,
}

impl NoisyView {
    /// Returns the unbiased picture: the mean of the halves.
    pub fn mean(&self) -> Tensor<3> {
        let mut mean = self.halves[0].clone();
        for (value, other) in mean.data_mut().iter_mut().zip(self.halves[1].data()) {
            *value = 0.5 * (*value + other);
        }
        mean
    }
}
