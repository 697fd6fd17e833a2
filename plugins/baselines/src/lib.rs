//! Node plugins with older methods, to which tensor displays are compared. Each module is a plugin.

pub mod directional_sequence;
pub mod integral_imaging;
pub mod log_tomography;
pub mod parallax_barrier;
pub mod two_layer_nmf;

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
