//! Subdivision schemes.

/// The subdivision scheme.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Scheme {
    /// The scheme for any polygons, each of which becomes quadrilaterals.
    #[default]
    CatmullClark,
    /// The scheme for triangles. Other polygons are cut into fans of triangles first.
    Loop,
    /// The scheme that cuts polygons into quadrilaterals without smoothing.
    Bilinear,
}
