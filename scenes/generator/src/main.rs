//! Writes Lumistack's sample scenes: glTF 2.0 with textures, a camera and an environment, and a
//! scene of Gaussian splats.
//!
//! `cargo run -p lumistack-scene-generator [FOLDER]` rewrites `still-life/`, `letters/`, `glass/`
//! and `dandelion/` in FOLDER (default: the repository's `scenes/`). The same source gives the same
//! bytes on every run. The tests compare the committed files with the generator's output.
//!
//! The glTF scenes are modelled at true size, with 1 unit = 1 metre. They stand around a window of
//! 475.02 mm x 296.89 mm (840 x 525 pixels of 0.5655 mm), whose centre is the origin. Each camera
//! looks at the window's centre, and its frustum at the focus distance is the window.

mod bitmap_font;
mod dandelion;
mod encode;
mod glass;
mod glass_meshes;
mod gltf_document;
mod lettering;
mod letters;
mod mesh;
mod paint;
mod sky;
mod still_life;
mod teapot;
mod teapot_data;
mod textures;
mod window;

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

fn main() -> ExitCode {
    let folder =
        std::env::args_os().nth(1).map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join(".."), PathBuf::from);
    match write_scenes(&folder) {
        Ok(bytes) => {
            println!("wrote {bytes} bytes to {}", folder.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// A file of a scene: its name inside the scene's folder, and its bytes.
pub(crate) type SceneFile = (String, Vec<u8>);

/// Builds every scene in memory. Returns the name and the files of each scene's folder.
fn build_scenes() -> Result<Vec<(&'static str, Vec<SceneFile>)>, GeneratorError> {
    Ok(vec![
        ("still-life", still_life::build()?),
        ("letters", letters::build()?),
        ("glass", glass::build()?),
        ("dandelion", dandelion::build()?),
    ])
}

/// Writes every scene into `folder` and returns the number of bytes written.
fn write_scenes(folder: &Path) -> Result<usize, GeneratorError> {
    let mut bytes = 0;
    for (name, files) in build_scenes()? {
        let scene_folder = folder.join(name);
        std::fs::create_dir_all(&scene_folder)
            .map_err(|source| GeneratorError::Write { path: scene_folder.clone(), source })?;
        for (file, data) in files {
            let path = scene_folder.join(file);
            bytes += data.len();
            std::fs::write(&path, data).map_err(|source| GeneratorError::Write { path: path.clone(), source })?;
        }
    }
    Ok(bytes)
}

/// Errors while the scenes are built and written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum GeneratorError {
    /// A texture or the sky could not be encoded.
    #[error("cannot encode {file}: {source}")]
    Encode {
        /// The file that was being made.
        file: String,
        /// The encoder's reason.
        source: image::ImageError,
    },
    /// The glTF document could not be serialized.
    #[error("cannot serialize {file}: {source}")]
    Serialize {
        /// The file that was being made.
        file: String,
        /// The serializer's reason.
        source: serde_json::Error,
    },
    /// A file or folder could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
}
