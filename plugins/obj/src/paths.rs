//! Normalizes paths in OBJ and MTL files.

use std::path::Path;

/// Returns a path with forward slashes and without `./` at its start. Programs on Windows write
/// backslashes.
pub(crate) fn forward(path: &Path) -> String {
    path.to_string_lossy().replace('\\', "/").trim_start_matches("./").to_string()
}
