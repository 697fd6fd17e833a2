//! Unbiased path tracer: Scene, Window and view grid to radiance.
