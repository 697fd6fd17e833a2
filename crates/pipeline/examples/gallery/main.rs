//! Renders every glTF and USD file of a folder, and writes a page that compares our renders with
//! Blender's.
//!
//! ```text
//! gallery render SCENES OUT [--size COLSxROWS] [--samples N] [--turn DEG]
//! gallery page OUT NOTES
//! ```
//!
//! `cargo xtask gallery` calls `render`, then Blender, then `page`. A file's folder in OUT contains
//! `ours.json`, `covered-ours.npy` and, if the scene has an environment, `environment.exr`. The
//! folder's renders `ours-a.exr` and `ours-b.exr` have half of the samples each, and different
//! seeds, so their noise is independent.

mod compare;
mod page;
mod render;

use std::path::PathBuf;
use std::process::ExitCode;

/// A result whose error is one sentence.
type Outcome<T = ()> = Result<T, String>;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let result = match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["render", scenes, out, options @ ..] => render::Options::parse(options)
            .and_then(|options| render::all(&PathBuf::from(scenes), &PathBuf::from(out), &options)),
        ["page", out, notes] => page::write(&PathBuf::from(out), &PathBuf::from(notes)),
        _ => Err("expected `render SCENES OUT` or `page OUT NOTES`".into()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("gallery: {message}");
            ExitCode::FAILURE
        }
    }
}

/// Converts an error to its message.
fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}
