//! Decoders of pictures, packed meshes and captures, readers of light fields, and the writer of zip
//! files. The page that computes patterns in the browser needs these functions only for some files.
//!
//! In the page this crate is two WebAssembly modules, each of which is loaded at its first use. The
//! small module, with the feature `pictures`, decodes only the pictures that most scenes have. If a
//! decoder stops on damaged content, only its module stops. Outside of the browser,
//! `lumistack-web-solver` calls this crate directly.

use std::io::{Cursor, Write};
use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{Display, LightField};
use lumistack_field_io::{FieldError, GeometryDefaults, GeometryFlags, geometry_of, open};
pub use lumistack_gltf::unpack::{answer, unpack};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

#[cfg(all(target_arch = "wasm32", not(feature = "pictures")))]
mod shell;
#[cfg(all(target_arch = "wasm32", feature = "pictures"))]
mod small;

/// Geometry for light fields whose files state none, and the largest width of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Width of the light field's rectangle on the display plane, mm.
    pub width_mm: f64,
    /// [horizontal, vertical] full angle that the views cover, degrees.
    pub fov_deg: [f64; 2],
    /// Largest number of pixel columns of a view; views with more columns are reduced to this
    /// number.
    pub cols: usize,
}

/// Reads a light field of any kind that the program `lumistack` reads.
///
/// # Errors
/// The errors of the program `lumistack` for damaged or missing files.
pub fn field(path: &str, wanted: &Wanted, task: Task<'_>) -> Result<LightField, FieldError> {
    let path = Path::new(path);
    let defaults = GeometryDefaults { width_mm: Some(wanted.width_mm), fov_deg: Some(wanted.fov_deg) };
    let own = geometry_of(path, &GeometryFlags::default(), &defaults, task)?;
    let reduced = (own.cols > wanted.cols).then(|| {
        let rows = (wanted.cols * own.rows) as f64 / own.cols as f64;
        [wanted.cols, (rows.round() as usize).max(1)]
    });
    open(path, &GeometryFlags { resolution: reduced, ..GeometryFlags::default() }, &defaults, task)
}

/// Packs `display.toml` and files, in this order, as a zip. `display` is the display as JSON.
///
/// # Errors
/// If the JSON does not describe a display, or the zip becomes too large.
pub fn pack<'a>(display: &str, files: impl IntoIterator<Item = (&'a str, &'a [u8])>) -> Result<Vec<u8>, String> {
    let display: Display = serde_json::from_str(display).map_err(|error| format!("display: {error}"))?;
    let toml = display.to_toml();
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, bytes: &[u8]| -> Result<(), String> {
        let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        let failed = |error: &dyn std::fmt::Display| format!("zip: {name}: {error}");
        zip.start_file(name, options).map_err(|error| failed(&error))?;
        zip.write_all(bytes).map_err(|error| failed(&error))
    };
    add("display.toml", toml.as_bytes())?;
    for (name, bytes) in files {
        add(name, bytes)?;
    }
    zip.finish().map(Cursor::into_inner).map_err(|error| format!("zip: {error}"))
}
