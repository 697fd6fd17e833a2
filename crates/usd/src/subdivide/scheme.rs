//! Subdivision schemes.

/// The subdivision scheme.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Scheme {
    /// For any polygons, each of which becomes quadrilaterals.
    #[default]
    CatmullClark,
    /// For triangles. Other polygons are cut into fans of triangles first.
    Loop,
    /// For any polygons, which are cut into quadrilaterals and not smoothed.
    Bilinear,
}
