//! Real spherical harmonics up to degree 3, with the Condon-Shortley phase.
//!
//! Source: KHR_gaussian_splatting, appendix A.

/// Number of basis functions up to degree 3.
pub(crate) const MOST: usize = 16;

/// Returns Y_lm of a unit direction, in the order of degree l, then of order m.
#[inline]
pub(crate) fn basis([x, y, z]: [f32; 3]) -> [f32; MOST] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_8,
        -0.488_602_5 * y,
        0.488_602_5 * z,
        -0.488_602_5 * x,
        1.092_548_4 * x * y,
        -1.092_548_4 * y * z,
        0.315_391_57 * (2.0 * zz - xx - yy),
        -1.092_548_4 * x * z,
        0.546_274_2 * (xx - yy),
        -0.590_043_6 * y * (3.0 * xx - yy),
        2.890_611_4 * x * y * z,
        -0.457_045_8 * y * (4.0 * zz - xx - yy),
        0.373_176_34 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_8 * x * (4.0 * zz - xx - yy),
        1.445_305_7 * z * (xx - yy),
        -0.590_043_6 * x * (xx - 3.0 * yy),
    ]
}
