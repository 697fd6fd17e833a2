//! Subdivision schemes.

/// The subdivision scheme.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Scheme {
    /// Any polygons; each becomes quadrilaterals.
    #[default]
    CatmullClark,
    /// Triangles. Other polygons are cut into fans first.
    Loop,
    /// Any polygons, cut into quadrilaterals and not smoothed.
    Bilinear,
}
