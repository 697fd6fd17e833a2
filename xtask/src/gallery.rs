//! Makes the gallery: a page with Lumistack's renders of glTF and USD files next to Blender's, with
//! the same camera and light.

use std::path::{Path, PathBuf};

use crate::tools::{self, Outcome, cargo, command, output_of, run};

/// Help of `cargo xtask gallery --help`.
pub const USAGE: &str = "\
cargo xtask gallery [folder] [options]

  Renders every glTF and USD file in the folder and its subfolders (default: gltf in the folder that LUMISTACK_ASSETS names, or
  ../shared/scenes/gltf) with Lumistack's path tracer and with Blender's Cycles, and writes target/gallery/index.html. Its notes about each
  file come from xtask/gallery/notes.toml. Blender's pictures are kept while its input stays the same.

  --out FOLDER     another folder for the page
  --size COLSxROWS default 420x262
  --samples N      paths per pixel; default 128
  --turn DEG       rotation of the viewer to the right
  --threads N      number of threads of each renderer; default all

The package bpy (Blender as a Python module, some 400 MB, for Python 3.11) is fetched into target/python-gallery at the first run; without bpy
the page shows Lumistack's renders alone. LUMISTACK_BENCH_PYTHON names a Python that already has bpy.
";

/// The packages of Blender's module. The texts in `notes.toml` describe renders of this version.
const BLENDER: [&str; 2] = ["bpy==5.0.1", "numpy"];

/// Runs the task with the words after `gallery`; `None` if they are wrong.
pub fn gallery(arguments: &[&str]) -> Option<Outcome> {
    let root = tools::root();
    let (mut scenes, mut out) = (tools::assets().join("gltf"), root.join("target/gallery"));
    let (mut passed, mut threads) = (Vec::new(), "0");
    let mut words = arguments.iter();
    while let Some(&word) = words.next() {
        match word {
            "--help" | "-h" => {
                print!("{USAGE}");
                return Some(Ok(()));
            }
            "--out" => out = std::path::absolute(words.next()?).ok()?,
            "--size" | "--samples" | "--turn" => passed.extend([word, words.next()?]),
            "--threads" => threads = words.next()?,
            _ if word.starts_with('-') => return None,
            _ => scenes = std::path::absolute(word).ok()?,
        }
    }
    Some(build(&scenes, &out, &passed, threads))
}

fn build(scenes: &Path, out: &Path, options: &[&str], threads: &str) -> Outcome {
    let (scenes, folder) = (scenes.to_string_lossy(), out.to_string_lossy());
    cargo(&["build", "--release", "--package", "lumistack-pipeline", "--example", "gallery"])?;
    let example = |words: &[&str]| {
        let mut cargo = command("cargo");
        cargo.args(["run", "--quiet", "--release", "--package", "lumistack-pipeline", "--example", "gallery", "--"]);
        cargo.env("RAYON_NUM_THREADS", threads);
        run(cargo.args(words))
    };
    // Make Lumistack's renders, then Blender's renders, then the page.
    example(&[&["render", &scenes, &folder], options].concat())?;
    match blender() {
        Ok(python) => {
            let script = tools::root().join("xtask/gallery/blender.py");
            let mut entries: Vec<PathBuf> = std::fs::read_dir(out)
                .map_err(|error| error.to_string())?
                .flatten()
                .map(|entry| entry.path())
                .collect();
            entries.retain(|entry| entry.join("ours.json").is_file());
            entries.sort();
            for entry in entries {
                let mut blender = command(&python);
                blender.arg(&script).arg(entry.join("ours.json")).arg(threads);
                // a file that crashes Blender must not prevent the renders of other files
                if !blender.output().is_ok_and(|output| output.status.success()) {
                    println!("gallery: Blender ended before it had rendered {}", entry.display());
                } else {
                    println!("Blender: {}", entry.file_name().unwrap_or_default().to_string_lossy());
                }
            }
        }
        Err(message) => println!("gallery: the pictures of Blender are left out: {message}"),
    }
    let notes = tools::root().join("xtask/gallery/notes.toml");
    example(&["page", &folder, &notes.to_string_lossy()])
}

/// Finds or makes a Python with bpy.
fn blender() -> Outcome<PathBuf> {
    let given = std::env::var_os("LUMISTACK_BENCH_PYTHON").map(PathBuf::from);
    let folder = tools::root().join("target/python-gallery");
    let python = given.clone().unwrap_or_else(|| folder.join("bin/python"));
    let there = || output_of(command(&python).args(["-c", "import bpy, numpy"])).is_some();
    if !there() && given.is_none() {
        tools::make_python(&folder, "to render with Blender beside our own renderer")?;
        println!("fetching: {}, in target/python-gallery (used only for the gallery)", BLENDER.join(", "));
        tools::install(&python, &[&["--no-cache-dir", "--only-binary=:all:"], &BLENDER[..]].concat())?;
    }
    if there() {
        Ok(python)
    } else {
        Err(format!("{}: expected the modules bpy and numpy, found at most one of them", python.display()))
    }
}
