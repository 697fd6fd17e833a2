//! Names of files that plugins write.

use crate::PluginError;

/// The parts of a file's path, if it stays inside the output's folder on every system: relative, `/` between parts, no part that is
/// empty, starts with a dot (`..`, and names that the host keeps for itself) or holds a backslash, a colon or a control character.
///
/// # Errors
/// If it does not.
pub fn path_parts(path: &str) -> Result<Vec<&str>, PluginError> {
    let parts: Vec<&str> = path.split('/').collect();
    let sound = |part: &&str| {
        !part.is_empty() && !part.starts_with('.') && !part.contains(|c: char| c == '\\' || c == ':' || c.is_control())
    };
    if parts.iter().all(sound) {
        Ok(parts)
    } else {
        Err(PluginError::Refused(format!(
            "file `{}`: expected a path inside the output's folder, without `..`, a leading `/` or names that start with a dot",
            path.escape_debug()
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_inside() {
        assert_eq!(path_parts("a.png").unwrap(), ["a.png"]);
        assert_eq!(path_parts("t0001/view 00_é.png").unwrap(), ["t0001", "view 00_é.png"]);
        for path in ["", "/a", "..", "a/../b", "./a", "a//b", "a/", "C:\\a", "C:a", "..\\a", ".hidden", "a\0b", "a\nb"]
        {
            assert!(path_parts(path).is_err(), "{path:?}");
        }
    }
}
