//! `cargo xtask bench render`: the path tracer compared with Embree, Mitsuba 3 and Cycles.

use std::path::{Path, PathBuf};

use crate::tools::{self, Outcome, absolute, bench, command, output_of, text};

/// Programs with which the path tracer is compared, called peers. Each entry has the package for
/// pip and the Python module. Mitsuba and Cycles also have a script that renders with them.
const MITSUBA: [&str; 3] = ["mitsuba==3.*", "mitsuba", "render_mitsuba.py"];
const CYCLES: [&str; 3] = ["bpy==5.0.1", "bpy", "render_cycles.py"];
const EMBREE: [&str; 2] = ["embreex==4.*", "embreex"];
/// Scenes of other projects, in LUMISTACK_ASSETS.
const FLIGHT_HELMET: &str = "gltf/FlightHelmet/FlightHelmet.gltf";
const CHESS_SET: &str = "usd/OpenChessSet/chess_set.usda";
/// Numbers of copies of a scene. With FlightHelmet the scenes have 1.4 and 100 million triangles.
const COPIES: &str = "15";
const MANY_COPIES: &str = "1100";

/// Runs the benchmarks of rays and of views; `None` if the options are wrong.
pub fn render(options: &[&str]) -> Option<Outcome> {
    let (mut full, mut with_peers, mut scenes) = (false, true, Vec::new());
    for &word in options {
        match word {
            "--full" => full = true,
            "--no-peers" => with_peers = false,
            word if word.starts_with("--") => return None,
            scene => scenes.push(absolute(scene)),
        }
    }
    if scenes.is_empty() {
        scenes = default_scenes();
    }
    let quick = if full { Vec::new() } else { vec!["--quick".to_owned()] };
    let python = if with_peers { python() } else { None };
    let embree = python.as_deref().filter(|python| has(python, &EMBREE)).and_then(embree_library);
    let peers = python.as_deref().map(peers).unwrap_or_default();
    // Measure rays first, then whole views with the peers.
    let run = || -> Outcome {
        for scene in &scenes {
            for copies in ["1", COPIES] {
                let mut words = vec!["rays".to_owned(), scene.clone(), "--copies".to_owned(), copies.to_owned()];
                words.extend(embree.iter().flat_map(|library| ["--embree".to_owned(), text(library)]));
                bench("lumistack-pathtracer", "render", &words)?;
            }
            let folder = ["--folder".to_owned(), text(&tools::root().join("target/bench-render"))];
            let words = [vec!["view".to_owned(), scene.clone()], quick.clone(), folder.to_vec(), peers.clone()];
            bench("lumistack-pathtracer", "render", &words.concat())?;
        }
        Ok(())
    };
    Some(run())
}

/// Compares converged pictures of FlightHelmet and OpenChessSet with pictures by Mitsuba and
/// Cycles. All surfaces are diffuse, with the textures of the files.
pub fn agree(samples: &str) -> Outcome {
    let scenes: Vec<String> = [FLIGHT_HELMET, CHESS_SET].into_iter().filter_map(asset).collect();
    if scenes.is_empty() {
        return Ok(());
    }
    let Some(python) = python() else { return Ok(()) };
    let peers = peers(&python);
    let folder = text(&tools::root().join("target/agreement-views"));
    for scene in &scenes {
        let words = ["agree", scene, "--size", "280x175", "--reference", samples, "--folder", &folder];
        bench("lumistack-pathtracer", "render", &[words.map(str::to_owned).to_vec(), peers.clone()].concat())?;
    }
    Ok(())
}

/// Runs the benchmark of a scene with many copies; `None` if the options are wrong.
pub fn big(options: &[&str]) -> Option<Outcome> {
    let scene = match options {
        [] => default_scenes().swap_remove(0),
        [scene] if !scene.starts_with("--") => absolute(scene),
        _ => return None,
    };
    let words = ["big", &scene, "--copies", MANY_COPIES].map(str::to_owned);
    Some(bench("lumistack-pathtracer", "render", &words))
}

/// The measured light fields: number of views, viewing zone in degrees, and samples per pixel. The
/// first has the views of the paper's prototypes. The second has the views that a display chooses.
/// The third has the views of a quilt.
const FIELDS: [[&str; 3]; 3] = [["5x5", "20", "16"], ["13x13", "20", "2"], ["1x45", "35", "4"]];

/// Samples per pixel of the converged pictures. The means of the views are compared with the means
/// of these pictures.
const CONVERGED: &str = "4096";

/// Renders light fields view by view, and with light that all views share. The scenes have diffuse
/// surfaces, the materials of their files, or many copies. The function also compares filtered with
/// unfiltered views at equal rendering time. With `--peers` it compares only the first light field,
/// with views that Mitsuba and Cycles render. `None` if the options are wrong.
pub fn field(options: &[&str]) -> Option<Outcome> {
    let (flags, scenes): (Vec<&str>, Vec<&str>) = options.iter().partition(|word| word.starts_with("--"));
    let with_peers = match flags.as_slice() {
        [] => false,
        ["--peers"] => true,
        _ => return None,
    };
    let mut scenes: Vec<String> = scenes.into_iter().map(absolute).collect();
    if scenes.is_empty() {
        scenes = default_scenes();
    }
    let words_of = |scene: &str, [views, fov, samples]: [&str; 3], more: &[&str]| {
        let words = ["field", scene, "--views", views, "--fov", fov, "--samples", samples, "--size", "210x131"];
        [&words[..], more].concat().iter().map(|&word| word.to_owned()).collect::<Vec<_>>()
    };
    let run_with_peers = || -> Outcome {
        let peers = python().as_deref().map(peers).unwrap_or_default();
        let folder = ["--folder".to_owned(), text(&tools::root().join("target/bench-render"))];
        head("times less time");
        for scene in &scenes {
            let words = words_of(scene, FIELDS[0], &[]);
            bench("lumistack-pathtracer", "render", &[words, folder.to_vec(), peers.clone()].concat())?;
        }
        Ok(())
    };
    let run = || -> Outcome {
        head("times less time");
        for scene in &scenes {
            for (number, field) in FIELDS.into_iter().enumerate() {
                // compare means only for the first light field, which has the most samples per view
                let means = if number == 0 { &["--converged", CONVERGED][..] } else { &[] };
                for more in [&[][..], &["--own-materials"], &["--copies", COPIES]] {
                    bench("lumistack-pathtracer", "render", &words_of(scene, field, &[more, means].concat()))?;
                }
            }
        }
        head("times less error in equal time");
        for scene in &scenes {
            for materials in [&[][..], &["--own-materials".to_owned()]] {
                let words = ["filters", scene, "--views", "5x5", "--fov", "20", "--size", "140x88"].map(str::to_owned);
                bench("lumistack-pathtracer", "render", &[&words, materials].concat())?;
            }
        }
        Ok(())
    };
    Some(if with_peers { run_with_peers() } else { run() })
}

/// Prints the head of the table of light fields; `last` is the name of its last column.
fn head(last: &str) {
    println!(
        "\n| scene | views, zone | samples | light | CPU s | squared error | worst view | bias | mean | mean view's variance | {last} |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
}

fn default_scenes() -> Vec<String> {
    let mut scenes = vec![text(&tools::root().join("scenes/still-life/still-life.gltf"))];
    if let Some(helmet) = asset(FLIGHT_HELMET) {
        scenes.insert(0, helmet);
    }
    scenes
}

/// Returns the path of a file of another project; prints a message if it is missing.
pub fn asset(file: &str) -> Option<String> {
    let path = tools::assets().join(file);
    if !path.is_file() {
        println!(
            "bench: {} is missing, so the scene is skipped; LUMISTACK_ASSETS sets the folder of scenes",
            path.display()
        );
        return None;
    }
    Some(text(&path))
}

/// Returns a Python for the peers. The first call makes its environment.
fn python() -> Option<PathBuf> {
    if let Some(given) = std::env::var_os("LUMISTACK_BENCH_PYTHON") {
        return Some(given.into());
    }
    let folder = tools::root().join("target/python-render-bench");
    let python = folder.join("bin/python");
    let made = if imports(&python, "numpy") {
        Ok(())
    } else {
        tools::make_python(&folder, "for comparing speed").and_then(|()| tools::install(&python, &["numpy==1.26.*"]))
    };
    made.map_err(|error| println!("bench: no other renderer is compared: {error}")).ok().map(|()| python)
}

/// Returns the options that name the peers which this Python has.
fn peers(python: &Path) -> Vec<String> {
    let mut peers = Vec::new();
    for [package, module, script] in [MITSUBA, CYCLES] {
        if has(python, &[package, module]) {
            let script = tools::root().join("xtask/bench").join(script);
            peers.extend(["--peer".to_owned(), text(python), text(&script)]);
        }
    }
    peers
}

fn imports(python: &Path, module: &str) -> bool {
    output_of(command(python).args(["-c", &format!("import {module}")])).is_some()
}

/// Returns true if a peer can be imported. If the peer is missing and LUMISTACK_BENCH_PYTHON is not
/// set, the function first tries to install the peer.
fn has(python: &Path, [package, module]: &[&str; 2]) -> bool {
    if !imports(python, module) && std::env::var_os("LUMISTACK_BENCH_PYTHON").is_none() {
        println!("\nfetching: {package}, in target/python-render-bench (used only for comparing speed)");
        if let Err(error) = tools::install(python, &["--only-binary=:all:", package]) {
            println!("bench: {error}");
        }
    }
    let there = imports(python, module);
    if !there {
        println!("bench: {module} is not compared, since {} cannot import the module", python.display());
    }
    there
}

/// Returns the path of Embree's library in its wheel.
fn embree_library(python: &Path) -> Option<PathBuf> {
    let code = "import embreex, glob, os; f = os.path.dirname(os.path.dirname(embreex.__file__)); print(glob.glob(f + '/embreex.libs/libembree4*')[0])";
    let path = output_of(command(python).args(["-c", code]))?;
    Some(PathBuf::from(path.trim()))
}
