//! Names of the files that work writes in a run folder, and a test whether Lumistack made a folder.

use std::ffi::OsStr;
use std::path::Path;

use serde::Deserialize;

use super::settings::is_written_by_us;

/// Name of the lock file, in the folder `cache`.
pub(crate) const LOCK: &str = "lumistack.lock";

/// Kinds of work in a folder. The names of the written files depend on the kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// A run, with nodes or without.
    Run,
    /// A sequence. Each of its time steps has a folder.
    Sequence,
    /// Rendering of views, without patterns.
    Views,
    /// A sweep over designs.
    Sweep,
}

impl Work {
    /// Returns true if the work writes a file or folder of this name directly into the run folder.
    pub(crate) fn writes(self, name: &OsStr) -> bool {
        let Some(name) = name.to_str() else { return false };
        if name == "cache" {
            return true;
        }
        match self {
            Self::Run => matches!(
                name,
                "job.toml"
                    | "display.toml"
                    | "target"
                    | "held-out"
                    | "outside"
                    | "layers"
                    | "outputs"
                    | "nodes"
                    | "report.html"
                    | "report.json"
            ),
            Self::Sequence => matches!(name, "job.toml" | "report.html" | "report.json") || is_time(name),
            Self::Views => {
                let is_view = name.starts_with("view_") || name.starts_with("layers_");
                name == "lightfield.json" || (is_view && name.ends_with(".exr"))
            }
            Self::Sweep => matches!(
                name,
                "job.toml" | "designs" | "fields" | "plots" | "proposed.toml" | "sweep.csv" | "sweep.json"
            ),
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Run => "a run",
            Self::Sequence => "a sequence",
            Self::Views => "`render`",
            Self::Sweep => "a sweep",
        }
    }
}

/// Returns true for names of time steps, such as t0001.
pub(crate) fn is_time(name: &str) -> bool {
    name.strip_prefix('t').is_some_and(|digits| digits.len() >= 4 && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// Returns true if Lumistack certainly made a folder. The evidence is a lock file in the folder, a
/// job file by Lumistack, or cached files of versions that had no locks.
pub(crate) fn is_ours(dir: &Path) -> bool {
    let cache = dir.join("cache");
    if cache.join(LOCK).is_file() || is_written_by_us(&dir.join("job.toml"), false) {
        return true;
    }
    // Versions without locks left stamps in the cache, and files with keys in their names.
    let kept = |name: &str| {
        let stem = name.split('.').next().unwrap_or_default();
        let is_keyed = |kinds: &[&str]| {
            let keyed = stem.rsplit_once('-');
            keyed.is_some_and(|(kind, key)| {
                kinds.contains(&kind) && key.len() == 16 && key.bytes().all(|b| b.is_ascii_hexdigit())
            })
        };
        match name.rsplit_once('.') {
            Some((_, "json")) => is_keyed(&["window", "fit", "blend"]) || is_stamp(&cache.join(name)),
            Some(_) => false,
            None => is_keyed(&["target", "held-out", "outside"]) && cache.join(name).is_dir(),
        }
    };
    let any = |folder: &Path| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().into_string().ok()).any(|name| kept(&name))
    };
    // Older versions of Lumistack, which had no locks, wrote each row of a sweep into a file.
    let is_row = |name: &str| {
        name.strip_suffix(".json").is_some_and(|key| key.len() == 24 && key.bytes().all(|b| b.is_ascii_hexdigit()))
    };
    let rows = std::fs::read_dir(dir.join("designs")).into_iter().flatten().flatten();
    any(&cache)
        || cache.join("views").is_dir()
        || rows.filter_map(|row| row.file_name().into_string().ok()).any(|name| is_row(&name))
}

/// Returns true if the file is a stamp of any version.
fn is_stamp(path: &Path) -> bool {
    #[derive(Deserialize)]
    struct AnyStamp {
        key: String,
        #[serde(rename = "files")]
        _files: Vec<serde_json::Value>,
    }
    let read = std::fs::read(path).ok().and_then(|text| serde_json::from_slice::<AnyStamp>(&text).ok());
    read.is_some_and(|stamp| stamp.key.len() == 64)
}
