//! Lends dense arrays as planes of the C interface.

use lumistack_plugin_abi::{Plane, dtype};

/// Makes a plane that points to dense values `[row][col][channel]`. The plane is valid as long as
/// the values are.
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
