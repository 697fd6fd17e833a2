//! Reads pictures of tiles, such as quilts. The first three bytes of the input are the number of
//! columns, the number of rows and the kind of picture; the picture follows.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lumistack_field_io::{GeometryDefaults, GeometryFlags, open};
use lumistack_fuzz::{folder, reads};

fuzz_target!(|data: &[u8]| {
    let [columns, rows, kind, picture @ ..] = data else { return };
    let (columns, rows) = (usize::from(*columns), usize::from(*rows));
    let extension = ["png", "exr", "hdr", "jpg", "webp"][usize::from(kind >> 2) % 5];
    let (name, mut flags) = match kind & 3 {
        0 => (format!("a_qs{columns}x{rows}a0.75.{extension}"), GeometryFlags::default()),
        1 => (format!("a.{extension}"), GeometryFlags { quilt: Some([columns, rows]), ..GeometryFlags::default() }),
        _ => (format!("a.{extension}"), GeometryFlags { tiles: Some([columns, rows]), ..GeometryFlags::default() }),
    };
    (flags.fov_deg, flags.pitch_mm) = (Some([20.0, 20.0]), Some(0.5));
    let path = folder(&[(&name, picture)]).join(name);
    reads(|task| open(&path, &flags, &GeometryDefaults::default(), task));
});
