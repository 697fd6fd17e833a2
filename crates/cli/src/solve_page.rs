//! `lumistack preview --solve`: the page that solves light fields. The program contains the page's
//! files, and writes them to a folder that the server serves.

use std::fs;
use std::path::Path;

use lumistack_pipeline::PipelineError;
use tempfile::TempDir;

macro_rules! files {
    ($($path:literal),* $(,)?) => {
        /// Paths in the page's folder, and contents of the files.
        const FILES: &[(&str, &[u8])] = &[$(($path, include_bytes!(concat!("../dist/", $path)))),*];
    };
}

files!(
    "solve.html",
    "solve.js",
    "solve-gpu.js",
    "viewer.js",
    "bridge.js",
    "headset.js",
    "lenticular.js",
    "lumistack_web_bg.wasm",
    "lumistack_web_decoders_bg.wasm",
    "lumistack_web_pictures_bg.wasm",
    "lumistack_web_solver_bg.wasm",
    "lumistack_web_solver_gpu_bg.wasm",
    "scenes/dandelion/dandelion.spz",
    "scenes/letters/charts.png",
    "scenes/letters/graph-paper.png",
    "scenes/letters/letters.bin",
    "scenes/letters/letters.gltf",
    "scenes/letters/sky.hdr",
    "scenes/still-life/brushed-metal.png",
    "scenes/still-life/checkerboard.jpg",
    "scenes/still-life/sky.hdr",
    "scenes/still-life/still-life.bin",
    "scenes/still-life/still-life.gltf",
    "scenes/still-life/striped-ball.png",
    "scenes/still-life/text-card.png",
    "scenes/still-life/wallpaper.jpg",
);

/// Writes the page into a new folder. The folder is removed when the returned value is dropped.
///
/// # Errors
/// When a file cannot be written.
pub(crate) fn write() -> Result<TempDir, PipelineError> {
    let folder = tempfile::tempdir().map_err(PipelineError::write(&std::env::temp_dir()))?;
    for (path, content) in FILES {
        // A server sends index.html if the address names no file, so the page also has this name.
        let names = if *path == "solve.html" { vec![*path, "index.html"] } else { vec![*path] };
        names.iter().try_for_each(|name| write_one(&folder.path().join(name), content))?;
    }
    Ok(folder)
}

fn write_one(path: &Path, content: &[u8]) -> Result<(), PipelineError> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(PipelineError::write(folder))?;
    }
    fs::write(path, content).map_err(PipelineError::write(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The program must contain every file that the build of the page writes.
    #[test]
    fn the_program_holds_all_of_the_page() {
        let dist = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../web/dist");
        let mut found = Vec::new();
        let mut folders = vec![dist.join("scenes")];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() { folders.push(path) } else { found.push(path) }
            }
        }
        let written = write().unwrap();
        for path in found.iter().map(|path| path.strip_prefix(&dist).unwrap()) {
            assert!(written.path().join(path).is_file(), "{}", path.display());
        }
        let page = fs::read_to_string(written.path().join("index.html")).unwrap();
        for link in page.split("src=\"").skip(1).filter_map(|rest| rest.split('"').next()) {
            assert!(written.path().join(link).is_file(), "{link}");
        }
    }
}
