//! USD scenes: shapes that are not triangles yet.

#![warn(missing_docs)]

mod curves;
mod geometry;
mod implicit;
mod subdivide;
