//! Reads files of splats into [`Cloud`](lumistack_scene::Cloud)s, from bytes. Before memory is
//! allocated for splats, their count is compared with the amount of data in the file.
//!
//! | file | written by | axes |
//! |---|---|---|
//! | `.ply` | the reference trainers; PlayCanvas, in a compressed form | right, down, front |
//! | `.spz` | Niantic, versions 1 to 4 | right, up, back |
//! | SOG | PlayCanvas: `meta.json` with WebP pictures beside it, or all in one zip (`.sog`) | those of the `.ply` that it was made from |

mod found;
mod ply;
mod sog;
mod spz;

pub use found::{Axes, Found, MAX_BYTES, ReadError};
pub use spz::read_spz;

/// Reads a file of splats. The file's first bytes, and not its name, decide the format.
///
/// `beside` returns the content of a file that a SOG's `meta.json` names.
///
/// # Errors
/// If the format of the bytes is unknown, or a value in the file is not valid.
pub fn read(bytes: &[u8], beside: &dyn Fn(&str) -> Result<Vec<u8>, String>) -> Result<Found, ReadError> {
    match bytes {
        [b'p', b'l', b'y', b'\n' | b'\r', ..] => ply::read(bytes),
        [b'N', b'G', b'S', b'P', ..] | [0x1f, 0x8b, ..] => read_spz(bytes, MAX_BYTES),
        [b'P', b'K', ..] => sog::read_bundle(bytes),
        [b'{' | b' ' | b'\n' | b'\r' | b'\t', ..] => sog::read(bytes, beside),
        _ => {
            let start = &bytes[..bytes.len().min(4)];
            Err(ReadError::new(
                "byte 0",
                "a .ply, .spz or .sog file, or the file meta.json of a SOG",
                format!("a file that starts \"{}\"", start.escape_ascii()),
            ))
        }
    }
}
