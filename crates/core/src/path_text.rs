//! Paths in TOML and JSON, which hold Unicode only, while names on disk may be any bytes.
//!
//! A path that is UTF-8 is a text. Any other path is a table `{ percent = "m%F6bel.glb" }`, in
//! which `%` and two hexadecimal digits stand for a byte. So a path in a job still names the same
//! file after the job is written and read back. In paths that are only shown, U+FFFD replaces bytes
//! that are not UTF-8.
//!
//! On Windows names are UTF-16, which may contain unpaired surrogates. An unpaired surrogate is
//! written as the three bytes that UTF-8 would have for its number, as in the format WTF-8
//! (<https://simonsapin.github.io/wtf-8/>).

use std::path::{Path, PathBuf};

use percent_encoding::{AsciiSet, CONTROLS};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

const ENCODED: &AsciiSet = &CONTROLS.add(b'%');

/// The only key of the table for a path that is not UTF-8.
const KEY: &str = "percent";

/// Stores an optional path that a later run opens. Usage: `#[serde(with =
/// "lumistack_core::path_text::optional")]`.
pub mod optional {
    use super::*;

    /// Writes the path. `None` is written as null in JSON, and is left out in TOML.
    pub fn serialize<S: Serializer>(path: &Option<PathBuf>, serializer: S) -> Result<S::Ok, S::Error> {
        path.as_deref().map(Text).serialize(serializer)
    }

    /// Reads a path, or `None`.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<PathBuf>, D::Error> {
        Ok(Option::<Read>::deserialize(deserializer)?.map(|Read(path)| path))
    }
}

/// Stores paths that a later run opens, each with a hash of the file's content. Usage:
/// `#[serde(with = "lumistack_core::path_text::hashed")]`.
pub mod hashed {
    use super::*;

    /// Writes every path with its hash.
    pub fn serialize<S: Serializer>(files: &[(PathBuf, String)], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(files.iter().map(|(path, hash)| (Text(path), hash)))
    }

    /// Reads paths with their hashes.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(PathBuf, String)>, D::Error> {
        let files = Vec::<(Read, String)>::deserialize(deserializer)?;
        Ok(files.into_iter().map(|(Read(path), hash)| (path, hash)).collect())
    }
}

/// Stores a path that is only shown to the user. Usage: `#[serde(serialize_with =
/// "lumistack_core::path_text::told")]`.
pub fn told<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// Stores an optional path as [`told`] does.
pub fn told_optional<S: Serializer>(path: &Option<PathBuf>, serializer: S) -> Result<S::Ok, S::Error> {
    path.as_deref().map(Path::to_string_lossy).serialize(serializer)
}

/// Stores several paths as [`told`] does.
pub fn told_each<S: Serializer>(paths: &[PathBuf], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(paths.iter().map(|path| path.to_string_lossy()))
}

struct Text<'a>(&'a Path);

impl Serialize for Text<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.to_str() {
            Some(text) => serializer.serialize_str(text),
            None => {
                let bytes = self.0.as_os_str().as_encoded_bytes();
                let text = percent_encoding::percent_encode(bytes, ENCODED).to_string();
                serializer.collect_map([(KEY, text)])
            }
        }
    }
}

struct Read(PathBuf);

impl<'de> Deserialize<'de> for Read {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Visitor).map(Self)
    }
}

struct Visitor;

impl<'de> de::Visitor<'de> for Visitor {
    type Value = PathBuf;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a string that is a path, or { percent = \"...\" }")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<PathBuf, E> {
        Ok(text.into())
    }

    fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<PathBuf, A::Error> {
        let Some((key, text)) = map.next_entry::<String, String>()? else {
            return Err(de::Error::missing_field(KEY));
        };
        if key != KEY {
            return Err(de::Error::unknown_field(&key, &[KEY]));
        }
        if let Some((key, _)) = map.next_entry::<String, String>()? {
            return Err(de::Error::unknown_field(&key, &[KEY]));
        }
        Ok(from_bytes(percent_encoding::percent_decode_str(&text).collect()))
    }
}

#[cfg(unix)]
fn from_bytes(bytes: Vec<u8>) -> PathBuf {
    use std::os::unix::ffi::OsStringExt;
    std::ffi::OsString::from_vec(bytes).into()
}

#[cfg(windows)]
fn from_bytes(bytes: Vec<u8>) -> PathBuf {
    use std::os::windows::ffi::OsStringExt;
    std::ffi::OsString::from_wide(&wide(&bytes)).into()
}

#[cfg(not(any(unix, windows)))]
fn from_bytes(bytes: Vec<u8>) -> PathBuf {
    String::from_utf8_lossy(&bytes).into_owned().into()
}

/// Decodes WTF-8 to UTF-16, which may contain unpaired surrogates. U+FFFD replaces other bytes that
/// are not UTF-8.
#[cfg(any(windows, test))]
fn wide(bytes: &[u8]) -> Vec<u16> {
    // 0xED begins a character of three bytes, so it is never the second or third byte of another
    // character
    let is_surrogate = |bytes: &[u8]| matches!(bytes, [0xED, 0xA0..=0xBF, 0x80..=0xBF]);
    let mut units = Vec::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let (text, other) = rest.split_at(rest.windows(3).position(is_surrogate).unwrap_or(rest.len()));
        units.extend(String::from_utf8_lossy(text).encode_utf16());
        rest = match other {
            [_, upper, lower, rest @ ..] => {
                units.push(0xD000 | u16::from(upper & 0x3F) << 6 | u16::from(lower & 0x3F));
                rest
            }
            _ => &[],
        };
    }
    units
}

/// Either form of a path, for schemas.
#[derive(JsonSchema)]
#[serde(untagged, deny_unknown_fields)]
#[allow(dead_code, reason = "describes what `Text` writes and `Read` reads")]
pub enum PathText {
    /// A path, relative to the file that names it.
    Text(String),
    /// A path that is not UTF-8.
    Bytes {
        /// The path, in which `%` and two hexadecimal digits stand for a byte.
        percent: String,
    },
}

/// Returns true for a default value, which need not be written.
pub fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct File {
        #[serde(with = "optional")]
        path: Option<PathBuf>,
    }

    fn read_back(path: PathBuf) {
        let file = File { path: Some(path) };
        let text = toml::to_string(&file).unwrap();
        assert_eq!(toml::from_str::<File>(&text).unwrap(), file, "{text}");
    }

    #[test]
    fn paths_are_read_as_they_were_written() {
        read_back("Größe 日本 🗻/100 %.glb".into());
        #[cfg(unix)]
        read_back(from_bytes(b"m\xF6bel 100 %.glb".to_vec()));
        // the second surrogate of a pair, the first surrogate, and both in the wrong order
        #[cfg(windows)]
        for units in [&[0xDDFB, 0x61][..], &[0x65E5, 0x25, 0xD83D], &[0xDDFB, 0xD83D]] {
            read_back(<std::ffi::OsString as std::os::windows::ffi::OsStringExt>::from_wide(units).into());
        }
    }

    #[test]
    fn surrogates_without_their_pair_are_decoded() {
        assert_eq!(wide("a日🗻".as_bytes()), "a日🗻".encode_utf16().collect::<Vec<_>>());
        assert_eq!(wide(b"a\xED\xB7\xBBb"), [0x61, 0xDDFB, 0x62]);
        assert_eq!(wide(b"\xE6\x97\xA5\xED\xA0\xBD"), [0x65E5, 0xD83D]);
        assert_eq!(wide(b"\xED\xB7\xBB\xED\xA0\xBD"), [0xDDFB, 0xD83D]);
        // U+D7FF is the last character before the surrogates
        assert_eq!(wide(b"\xED\x9F\xBF"), [0xD7FF]);
        // bytes of a name on Linux, and a surrogate that is cut off
        assert_eq!(wide(b"m\xF6b"), [0x6D, 0xFFFD, 0x62]);
        assert!(wide(b"a\xED\xA0").starts_with(&[0x61, 0xFFFD]));
    }
}
