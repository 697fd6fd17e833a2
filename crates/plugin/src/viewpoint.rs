//! Viewpoints from which a display is seen.

/// A viewpoint from which a display is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ViewPoint {
    /// A parallel projection of slope (s_x, s_y), which an eye at a large distance sees.
    Slope([f64; 2]),
    /// An eye at (x, y, z) millimetres in display space, z > 0.
    Eye([f64; 3]),
}
