//! Paths in TOML and JSON, which hold Unicode only, while names on disk may be any bytes.
//!
//! A path that is UTF-8 is a text. Any other is a table `{ percent = "m%F6bel.glb" }`, in which `%` and two hexadecimal digits stand for a byte, so
//! that a job that was written leads to the same file when it is read back. Paths that are only told are written with U+FFFD for what is no text.

use std::path::{Path, PathBuf};

use percent_encoding::{AsciiSet, CONTROLS};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

const ENCODED: &AsciiSet = &CONTROLS.add(b'%');

/// The one key of the table.
const KEY: &str = "percent";

/// `#[serde(with = "crate::path_text::optional")]` of a path that is opened again.
pub(crate) mod optional {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(path: &Option<PathBuf>, serializer: S) -> Result<S::Ok, S::Error> {
        path.as_deref().map(Text).serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<PathBuf>, D::Error> {
        Ok(Option::<Read>::deserialize(deserializer)?.map(|Read(path)| path))
    }
}

/// `#[serde(with = "crate::path_text::hashed")]` of paths that are opened again, each with a hash of its content.
pub(crate) mod hashed {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(files: &[(PathBuf, String)], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(files.iter().map(|(path, hash)| (Text(path), hash)))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(PathBuf, String)>, D::Error> {
        let files = Vec::<(Read, String)>::deserialize(deserializer)?;
        Ok(files.into_iter().map(|(Read(path), hash)| (path, hash)).collect())
    }
}

/// `#[serde(serialize_with = "crate::path_text::told")]` of a path that is only told.
pub(crate) fn told<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// [`told`] of an optional path.
pub(crate) fn told_optional<S: Serializer>(path: &Option<PathBuf>, serializer: S) -> Result<S::Ok, S::Error> {
    path.as_deref().map(Path::to_string_lossy).serialize(serializer)
}

/// [`told`] of several paths.
pub(crate) fn told_each<S: Serializer>(paths: &[PathBuf], serializer: S) -> Result<S::Ok, S::Error> {
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

#[cfg(not(unix))]
fn from_bytes(bytes: Vec<u8>) -> PathBuf {
    String::from_utf8_lossy(&bytes).into_owned().into()
}

/// Either form of a path, for schemas.
#[derive(JsonSchema)]
#[serde(untagged, deny_unknown_fields)]
#[allow(dead_code, reason = "describes what `Text` writes and `Read` reads")]
pub(crate) enum PathText {
    /// A path, relative to the file that names it.
    Text(String),
    /// A path that is not UTF-8.
    Bytes {
        /// The path, in which `%` and two hexadecimal digits stand for a byte.
        percent: String,
    },
}

/// Whether a value is the default, so that it needs not be written.
pub(crate) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DisplayJob, Job};

    #[cfg(unix)]
    #[test]
    fn a_job_with_any_name_reads_back_the_same() {
        use std::os::unix::ffi::OsStrExt;

        let path = |bytes: &[u8]| Some(PathBuf::from(std::ffi::OsStr::from_bytes(bytes)));
        let mut job = Job::new(DisplayJob::by_name_or_path("paper-three-layer"));
        job.scene = path(b"/tmp/100%/m\xF6bel.glb");
        job.light.environment = path(b"sky%20.hdr");
        job.factorize.weights = path(b"\xFF");
        let text = job.to_toml();
        assert!(text.contains("percent = \"/tmp/100%25/m%F6bel.glb\""), "{text}");
        assert!(text.contains("environment = \"sky%20.hdr\""), "{text}");
        assert_eq!(lumistack_core::config::parse::<Job>(&text).unwrap(), job);
        assert!(job.to_json()["scene"]["percent"].is_string());
    }

    #[test]
    fn a_path_of_another_kind_is_refused() {
        let parse = |scene: &str| {
            let text = format!("scene = {scene}\n[display]\npreset = \"paper-three-layer\"\n");
            lumistack_core::config::parse::<Job>(&text).unwrap_err().message
        };
        assert!(parse("5").contains("a string that is a path"), "{}", parse("5"));
        assert!(parse("{ bytes = \"a\" }").contains("percent"), "{}", parse("{ bytes = \"a\" }"));
    }
}
