//! Tests that every baseline computes the result of its method, and refuses displays that its
//! method does not support.

mod directional_sequence;
mod integral_imaging;
mod log_tomography;
mod parallax_barrier;
mod two_layer_nmf;
