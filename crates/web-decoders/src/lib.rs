//! Parts of the page that solves that most scenes do not need, or that are needed once: decoders of
//! pictures, packed meshes and captures, and the zip that is saved.
//!
//! In the page they are a module of their own, which is loaded at its first use. A decoder that
//! stops on broken content stops this module alone; the page starts it again. Natively the crate of
//! the page that solves calls them directly.

use std::io::{Cursor, Write};

use lumistack_display::Display;
pub use lumistack_gltf::unpack::{answer, unpack};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

#[cfg(target_arch = "wasm32")]
mod shell;

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
