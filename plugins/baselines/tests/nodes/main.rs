//! Every baseline produces its method's result, and refuses other displays.

mod directional_sequence;
mod integral_imaging;
mod log_tomography;
mod parallax_barrier;
mod two_layer_nmf;
