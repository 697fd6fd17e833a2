//! Paths in OBJ and MTL files.

use std::path::Path;

/// A path of an OBJ or MTL file, with forward slashes; Windows programs write backslashes.
pub(crate) fn forward(path: &Path) -> String {
    path.to_string_lossy().replace('\\', "/").trim_start_matches("./").to_string()
}
