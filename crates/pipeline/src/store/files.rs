//! Files of a run folder, written atomically.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{PipelineError, field_error};

/// Removes the reports of older patterns.
pub(crate) fn remove_reports(dir: &Path) -> Result<(), PipelineError> {
    for name in ["report.html", "report.json"] {
        let path = dir.join(name);
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(PipelineError::Write { path, source });
            }
            _ => {}
        }
    }
    Ok(())
}

/// Writes `report.json`, then `report.html`.
pub(crate) fn write_report(dir: &Path, html: &str, json: &serde_json::Value) -> Result<(), PipelineError> {
    write(&dir.join("report.json"), &serde_json::to_vec_pretty(json).expect("reports serialize"))?;
    write(&dir.join("report.html"), html.as_bytes())
}

pub(crate) fn check_folder(path: &Path) -> Result<(), PipelineError> {
    if path.is_file() { Err(PipelineError::NotAFolder { path: path.to_owned() }) } else { Ok(()) }
}

/// Text before and after the hash in a cached value: `{"blake3":"HASH","value":VALUE}`.
const SEAL: [&str; 2] = ["{\"blake3\":\"", "\",\"value\":"];

/// Reads a cached value; `None` if the file is missing, damaged or of another type.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Option<T> {
    let text = std::fs::read_to_string(path).ok()?;
    let (hash, value) = text.strip_prefix(SEAL[0])?.strip_suffix('}')?.split_once(SEAL[1])?;
    (blake3::hash(value.as_bytes()).to_hex().as_str() == hash).then(|| serde_json::from_str(value).ok()).flatten()
}

/// Writes a cached value with its hash.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), PipelineError> {
    let value = serde_json::to_string(value).expect("cached values serialize");
    let hash = blake3::hash(value.as_bytes()).to_hex();
    write(path, format!("{}{hash}{}{value}}}", SEAL[0], SEAL[1]).as_bytes())
}

pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), PipelineError> {
    lumistack_field_io::atomic::write_bytes(path, bytes).map_err(field_error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changed_cached_values_are_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        write_json(&path, &(1.5, "a")).unwrap();
        assert_eq!(read_json::<(f64, String)>(&path), Some((1.5, "a".into())));
        let text = std::fs::read_to_string(&path).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).expect("it is JSON");
        std::fs::write(&path, text.replace("1.5", "2.5")).unwrap();
        assert_eq!(read_json::<(f64, String)>(&path), None);
        assert_eq!(read_json::<(f64, String)>(&folder.path().join("b.json")), None);
    }
}
