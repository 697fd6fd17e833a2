//! Parts of the page that solves that most scenes do not need, or that are needed once. They decode
//! pictures, packed meshes and captures, read light fields, and write the zip that is saved.
//!
//! In the page they are a module of their own, which is loaded at its first use. A decoder that
//! stops on broken content stops this module alone; the page starts it again. Natively the crate of
//! the page that solves calls them directly.

use std::io::{Cursor, Write};
use std::path::Path;

use lumistack_core::Task;
use lumistack_display::{Display, LightField};
use lumistack_field_io::{FieldError, GeometryDefaults, GeometryFlags, geometry_of, open};
pub use lumistack_gltf::unpack::{answer, unpack};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

#[cfg(target_arch = "wasm32")]
mod shell;

/// A light field's values that its files do not state, and its largest width in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Width on the plane of zero parallax, mm.
    pub width_mm: f64,
    /// [horizontal, vertical] full angle of its views, degrees.
    pub fov_deg: [f64; 2],
    /// Most columns of a view; views with more are reduced.
    pub cols: usize,
}

/// Reads a light field of any kind that the command reads.
///
/// # Errors
/// Those of the command.
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

/// Packs files as a zip, after `display.toml` with the display that is given as JSON.
///
/// # Errors
/// When the JSON is no display, or the zip becomes too large.
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
