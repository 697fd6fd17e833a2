//! Light fields and layer stacks on disk.
//!
//! ```text
//! lightfield.json + EXR ─┐
//! .npy + .json ──────────┤
//! camera folders ────────┼─▶ open() ─▶ LightField ─▶ write_field() ─▶ lightfield.json,
//! quilts, tiles ─────────┘                                            view_YY_XX.exr
//!                                     LayerStack ─▶ write_stack() ─▶ stack.json, layer_L.npy,
//!                                                                    emission.npy
//! ```
//!
//! All sources have one order of views: view (0, 0) is the leftmost and topmost viewpoint. Values
//! are linear light. Every file is written under another name in the target's folder and then
//! renamed, so a file with a final name is complete.

mod array;
mod assemble;
pub mod atomic;
mod cameras;
mod describe;
mod detect;
mod disparity;
mod error;
mod folder;
mod geometry;
mod hci;
mod index;
#[cfg(all(test, target_pointer_width = "64", target_endian = "little"))]
mod lent;
mod mapped;
pub mod npy;
pub mod npz;
mod open;
mod paged;
pub mod picture;
mod prefilter;
mod quilt;
mod resample;
mod source;
mod stack;
mod stack_writer;

pub use assemble::{LeftOut, Paging, Reading};
pub use describe::{Description, describe};
pub use error::FieldError;
pub use folder::{
    read_field_folder, read_field_region, round_to_half, view_file_name, write_field, write_index, write_view,
    write_views,
};
pub use geometry::{GeometryDefaults, GeometryFlags};
pub use lumistack_display::{BacklightEntry, LayerEntry, StackIndex};
pub use open::{geometry_of, open, open_for, picture_bytes};
pub use paged::{FieldWriter, Paged, storage};
pub use prefilter::Footprint;
pub use source::Kind;
pub use stack::{read_stack, read_stack_index, write_stack};
pub use stack_writer::StackWriter;

/// Hash of this crate's sources, computed at build. It belongs in the key of every cached result
/// that this code affects.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");
