//! Plugin registry and the host's side of the boundary.
