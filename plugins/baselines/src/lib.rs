//! Node plugins: the displays that tensor displays are compared with, a module each.

pub mod directional_sequence;
pub mod integral_imaging;
pub mod log_tomography;
pub mod parallax_barrier;
pub mod two_layer_nmf;

/// Hash of this crate's sources, made at build. It belongs into the keys of all kept results that this code has a part in.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
