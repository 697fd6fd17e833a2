//! Helpers of the fuzz targets: they split an input into parts, and write the parts as files into a
//! folder in memory.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use lumistack_core::{Cancel, Collector, Task};

/// Separates the parts of an input.
pub const SEPARATOR: &[u8] = b"\n====\n";

/// Splits an input into its parts; missing parts are empty.
pub fn parts<const N: usize>(mut data: &[u8]) -> [&[u8]; N] {
    std::array::from_fn(|i| {
        let at = data.windows(SEPARATOR.len()).position(|window| window == SEPARATOR).filter(|_| i + 1 < N);
        let (part, rest) = at.map_or((data, &data[data.len()..]), |at| (&data[..at], &data[at + SEPARATOR.len()..]));
        data = rest;
        part
    })
}

/// Makes a folder that contains only these files. Every process has its own folder, which is in
/// memory if the system has `/dev/shm`.
pub fn folder(files: &[(&str, &[u8])]) -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let memory = Path::new("/dev/shm");
        let base = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        base.join(format!("lumistack-fuzz-{}", std::process::id()))
    });
    std::fs::create_dir_all(folder).expect("the folder can be made");
    for entry in std::fs::read_dir(folder).expect("the folder can be listed").flatten() {
        _ = std::fs::remove_file(entry.path());
    }
    for (name, bytes) in files {
        std::fs::write(folder.join(name), bytes).expect("the file can be written");
    }
    folder
}

/// Runs a reader without output of progress. Returns its value, or `None` after an error, whose
/// text must not be empty.
pub fn reads<T, E: std::fmt::Display>(work: impl FnOnce(Task<'_>) -> Result<T, E>) -> Option<T> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    match work(Task::quiet(&warnings, &cancel)) {
        Ok(value) => Some(value),
        Err(error) => {
            assert!(!error.to_string().is_empty());
            None
        }
    }
}
