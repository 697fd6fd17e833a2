//! Dense arrays as planes of the boundary.

use lumistack_plugin_abi::{Plane, dtype};

/// Lends values that lie `[row][col][channel]`; valid as long as they are.
pub fn dense(values: &[f32], [rows, cols, channels]: [usize; 3]) -> Plane {
    let element = size_of::<f32>() as isize;
    Plane {
        data: values.as_ptr().cast(),
        dtype: dtype::F32,
        ndim: 3,
        shape: [rows, cols, channels, 1],
        strides: [(cols * channels) as isize * element, channels as isize * element, element, 0],
        ..Plane::empty()
    }
}
