//! Names of files that plugins write.

use lumistack_plugin::PluginError;

/// Most bytes of a part, which every usual file system takes.
const LONGEST_PART: usize = 255;
/// Most bytes of a path.
const LONGEST_PATH: usize = 1024;

/// The parts of a file's path, if it stays inside the output's folder and is a file on every system: relative, `/` between parts, no part that
/// is empty, longer than 255 bytes, starts with a dot (`..`, and names that the host keeps for itself), ends with a dot or a space, is the name
/// of a device (`nul`, `com1.txt`) or holds a control character or one of `\\ : * ? " < > |`; at most 1024 bytes in all.
///
/// # Errors
/// If it does not.
pub fn path_parts(path: &str) -> Result<Vec<&str>, PluginError> {
    let parts: Vec<&str> = path.split('/').collect();
    let sound = |part: &&str| {
        !part.is_empty()
            && part.len() <= LONGEST_PART
            && !part.starts_with('.')
            && !part.ends_with(['.', ' '])
            && !part.contains(|c: char| "\\:*?\"<>|".contains(c) || c.is_control())
            && !is_device(part)
    };
    if path.len() <= LONGEST_PATH && parts.iter().all(sound) {
        Ok(parts)
    } else {
        let (shown, rest) = path.split_at(path.floor_char_boundary(80));
        Err(PluginError::Refused(format!(
            "file `{}{}`: expected a path inside the output's folder, without `..`, a leading `/`, names that start with a dot, and \
             characters or lengths that some system does not take",
            shown.escape_debug(),
            if rest.is_empty() { "" } else { "…" }
        )))
    }
}

/// Whether some system takes a name for a device, with or without an extension.
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
