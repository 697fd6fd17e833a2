//! Reads USD into a [`Scene`] with the user's Python, and Blender's files with the user's Blender.
//!
//! ```text
//! .usd file ─▶ child: pxr stage ─▶ walker (python/) ─▶ package ─▶ meshes, materials ─▶ Scene
//! ```
//!
//! OpenUSD itself composes and evaluates the stage, so every file that it can open is read. The
//! walker is plain Python code that uses `pxr`; its source is part of this crate. It returns a
//! package: a JSON header and raw arrays. A caller that has Python in its own process runs
//! [`MODULES`] there, and calls [`scene_from_package`]. `docs/USD.md` lists the supported schemas.

mod blend;
mod camera;
mod child;
mod curves;
mod error;
mod geometry;
mod implicit;
mod lights;
mod material;
mod mesh;
mod package;
mod picture;
mod placing;
mod polygons;
mod preview;
mod python;
mod refine;
mod scene;
mod setup;
mod shapes;
mod slots;
mod spacing;
mod splats;
mod subdivide;
mod texture;
mod there;
mod uber;

use std::path::{Path, PathBuf};

use lumistack_core::Task;
use lumistack_scene::Scene;

pub use blend::{
    BlendAccount, BlendContents, BlendViews, BlendWindow, EXTENSION as BLEND_EXTENSION, HandedOver, blend_contents,
    blend_surroundings, file_stamp, hand_over, render_views,
};
pub use child::MODULES;
pub use error::UsdError;
pub use package::{Array, Contents, Failure, Header, Note, Package, TimeRange, VariantSet};
pub use scene::scene_from_package;
pub use setup::Setup;
pub use there::{There, blender, openusd};

/// Hash of this crate's sources, made at build. It is part of the key of every cached result to
/// which this code contributes.
pub const FINGERPRINT: &str = env!("LUMISTACK_FINGERPRINT");

/// Extensions of USD files.
pub const EXTENSIONS: [&str; 4] = ["usd", "usda", "usdc", "usdz"];

/// The part of a file to load: a time, and variants.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadOptions {
    /// Time in seconds after the stage's first time code, or after time code 0 if the stage has
    /// none. `None` stands for the first time code. In a stage without time codes, `None` stands
    /// for the first time sample of every attribute.
    pub time_s: Option<f64>,
    /// Variants: `set=variant` selects the variant on every prim that has the set,
    /// `/prim{set=variant}` on one prim only.
    pub variants: Vec<String>,
}

/// A scene, and the files from which it was read.
#[derive(Debug)]
pub struct Loaded {
    /// The scene.
    pub scene: Scene,
    /// The scene's own file, and every other layer and texture on disk that was read.
    pub files: Vec<PathBuf>,
}

/// Returns the Pythons that are tried, in this order, each with the source of its path.
pub fn pythons() -> Vec<(PathBuf, &'static str)> {
    let candidates = python::Surroundings::of_system().candidates().into_iter();
    candidates.map(|candidate| (candidate.program, candidate.from)).collect()
}

/// Loads a USD file.
///
/// # Errors
/// [`UsdError`] if the file cannot be opened, if its path is not UTF-8, if no Python has OpenUSD,
/// or if OpenUSD or the walker fails. Also if nothing in the file can be rendered, or if the task
/// is cancelled.
pub fn load(path: &Path, options: &LoadOptions, task: Task<'_>) -> Result<Loaded, UsdError> {
    let name = file_name(path)?;
    let LoadOptions { time_s, variants } = options;
    let request = child::Request { path: name, time_s: *time_s, variants, contents_only: false };
    let answer = child::ask(&request, task.cancel)?;
    let package = answer.package(name)?;
    let mut files: Vec<PathBuf> = package.header.files.iter().map(PathBuf::from).collect();
    // The walker can miss the file itself, for example if OpenUSD resolves its name to another
    // path. The keys of cached results must contain the file.
    let own = |file: &Path| std::fs::canonicalize(file).unwrap_or_else(|_| file.to_owned());
    if !files.iter().any(|file| own(file) == own(path)) {
        files.push(own(path));
    }
    Ok(Loaded { scene: scene_from_package(name, &package, task)?, files })
}

/// Reads the variant sets, cameras and time range of a USD file, and its numbers of prims, meshes
/// and points.
///
/// # Errors
/// The errors of [`load`], except that a file may have nothing that can be rendered.
pub fn contents(path: &Path, task: Task<'_>) -> Result<Contents, UsdError> {
    let name = file_name(path)?;
    let request = child::Request { path: name, time_s: None, variants: &[], contents_only: true };
    let answer = child::ask(&request, task.cancel)?;
    Ok(answer.package(name)?.header.contents)
}

/// Checks that the file can be opened, and returns its path as text.
fn file_name(path: &Path) -> Result<&str, UsdError> {
    lumistack_files::open(path).map_err(|source| UsdError::Io { place: path.display().to_string(), source })?;
    path.to_str().ok_or_else(|| {
        let source =
            std::io::Error::new(std::io::ErrorKind::InvalidInput, "expected a path in UTF-8, found another encoding");
        UsdError::Io { place: path.display().to_string(), source }
    })
}
