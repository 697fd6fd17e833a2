//! Which surfaces a cage stands for.

/// The family of surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Scheme {
    /// Any polygons; each becomes quadrilaterals.
    #[default]
    CatmullClark,
    /// Triangles. Other polygons are cut into fans first.
    Loop,
    /// Only cut into quadrilaterals, not smoothed.
    Bilinear,
}
