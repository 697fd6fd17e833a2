//! Checks the names of files that plugins write.

use lumistack_plugin::PluginError;

/// Longest part of a path between slashes, bytes. Common file systems allow this length.
const MAX_PART_BYTES: usize = 255;
/// Longest path, bytes.
const MAX_PATH_BYTES: usize = 1024;

/// Splits a file's path into its parts and checks that it stays inside the output's folder on every
/// system. The path is relative, with `/` between parts, and at most 1024 bytes long. A part
///
/// * is not empty and has at most 255 bytes,
/// * does not start with a dot (which excludes `..` and names that the host reserves), and does not
///   end with a dot or a space,
/// * is no device name (`nul`, `com1.txt`),
/// * contains no control character and none of `\ : * ? " < > |`.
///
/// # Errors
/// If a rule is violated.
pub fn path_parts(path: &str) -> Result<Vec<&str>, PluginError> {
    let parts: Vec<&str> = path.split('/').collect();
    let sound = |part: &&str| {
        !part.is_empty()
            && part.len() <= MAX_PART_BYTES
            && !part.starts_with('.')
            && !part.ends_with(['.', ' '])
            && !part.contains(|c: char| "\\:*?\"<>|".contains(c) || c.is_control())
            && !is_device(part)
    };
    if path.len() <= MAX_PATH_BYTES && parts.iter().all(sound) {
        Ok(parts)
    } else {
        let (shown, rest) = path.split_at(path.floor_char_boundary(80));
        Err(PluginError::Refused(format!(
            "file `{}{}`: expected a path inside the output's folder, found a path with `..`, a leading `/`, a name that starts with a dot, or \
                         a name, character or length that some system refuses",
            shown.escape_debug(),
            if rest.is_empty() { "" } else { "…" }
        )))
    }
}

/// Detects names of Windows' devices, with or without an extension. Such names are refused on every
/// system.
fn is_device(part: &str) -> bool {
    let stem = part.split('.').next().unwrap_or_default().trim_end().to_ascii_lowercase();
    let numbered =
        |name: &str| stem.strip_prefix(name).is_some_and(|n| n.len() == 1 && n.as_bytes()[0].is_ascii_digit());
    matches!(stem.as_str(), "con" | "prn" | "aux" | "nul") || numbered("com") || numbered("lpt")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_inside() {
        assert_eq!(path_parts("a.png").unwrap(), ["a.png"]);
        assert_eq!(path_parts("t0001/view 00_é.png").unwrap(), ["t0001", "view 00_é.png"]);
        assert_eq!(path_parts("comet/a_qs8x6a0.75.png").unwrap(), ["comet", "a_qs8x6a0.75.png"]);
        for path in ["", "/a", "..", "a/../b", "./a", "a//b", "a/", "C:\\a", "C:a", "..\\a", ".hidden", "a\0b", "a\nb"]
        {
            assert!(path_parts(path).is_err(), "{path:?}");
        }
        for path in ["a?", "a.", "a /b", "NUL", "sub/com1.txt", "Aux.png", "a|b", "\"a\""] {
            assert!(path_parts(path).is_err(), "{path:?}");
        }
        let long = "é".repeat(1 << 20);
        let error = path_parts(&long).unwrap_err().to_string();
        assert!(error.len() < 400, "{} bytes about a long name", error.len());
        assert!(path_parts(&"a".repeat(255)).is_ok() && path_parts(&"a".repeat(256)).is_err());
        assert!(path_parts(&vec!["a"; 600].join("/")).is_err());
    }
}
