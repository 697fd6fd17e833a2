//! Display model, view grids, ray-to-layer maps and the forward model.
