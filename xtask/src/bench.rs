//! Measures release builds. Compares their parts, such as the factorizer and the path tracer, with
//! other programs.

use std::path::{Path, PathBuf};

use crate::bench_render;
use crate::bench_zone;
use crate::fuzz;
use crate::python;
use crate::tools::{self, Outcome, absolute, bench, cargo, command, example, output_of, text};
use crate::web;

/// Help of `cargo xtask bench --help`.
pub const USAGE: &str = "\
cargo xtask bench [what]

  (nothing)     `factorize --no-peers`, then `render --no-peers`
  factorize     the paper's main case, 840×525 pixels, 5×5 views, 3 layers, 6 frames: time per update of every
                solver, time to the quality of 50 iterations of the paper's rule, and the reached fractions of the machine's
                limits; compared with the same update in NumPy and PyTorch, run in turn on the same data (some minutes)
      --quick        a quarter of the resolution
      --no-peers     without NumPy and PyTorch
      --rounds N     number of times that every case is timed, at least 3; default 9
      --json FILE    also write every measured time, as JSON
  convergence   PSNR after 1 to 500 iterations of every solver, start and number of coarser levels, next to
                reference values
      --quick        50 iterations at most
      --json FILE    also as JSON
  gpu           the paper's case with 12 frames on a graphics processor, or on an adapter in software if there is none: updates per
                second compared with the processor; transferred bytes and arithmetic compared with the adapter's limits
      --quick        a sixteenth of the pixels
      NAME           an adapter whose name contains NAME
  stream        a display whose target does not fit into memory: 3840×2160 pixels, 9×9 views, 3 layers, 12 frames
  outputs       memory of the outputs `images` and `web_simulator` with 4 and with 12 frames of three 4K layers
  render [scene.gltf]   the path tracer: rays per second of the tree compared with Embree, and one view of diffuse
                scenes compared with Mitsuba 3 and Blender's Cycles at equal scene, camera, light and bounces: time, samples per
                second, mean squared error × time; memory. Scenes: the given ones; by default still-life, and FlightHelmet if
                LUMISTACK_ASSETS has it (about 3 minutes each with the other renderers)
      --full         twice the resolution, more samples in the references (25 minutes each)
      --no-peers     only our own measurements
  big [scene.gltf]      1,100 copies of a scene, which share its memory; with FlightHelmet they are 100 million triangles
  field [scene.gltf]    light fields whose views share light, without and with further paths, compared with the same views rendered one by
                one: processor time at equal squared error, including bias. Cases: 5×5 and 13×13 views over 20°, the 45 views of a quilt,
                many copies. Then all filters compared with unfiltered views in equal time, with 4, 16 and 64 samples. Scenes as for
                `render` (some twenty minutes)
      --peers        only 5×5 views, beside the same views that Mitsuba and Cycles render one by one (some ten minutes)
  splats        13×13 views of a million Gaussian splats: rendered all together, one by one, and by a naive renderer (some minutes).
                Then views are compared with Mitsuba's, which traces rays through the same Gaussians
      --agreement    only the comparison with Mitsuba
  agreement     the path tracer compared with Mitsuba 3 on scenes that both can represent exactly: a test of every pixel of
                converged renders, a table, and an error if they differ (some minutes). Then FlightHelmet and OpenChessSet, as diffuse
                scenes with their textures, compared with Mitsuba and Cycles: means within 0.3 %, relative RMSE below 3 %
      --quick        a quarter of the samples
  design        predicted quality of 40 random designs compared with their solved quality. Then a sweep of 100 small designs, which is killed and
                continued repeatedly, must end with the same bytes as one that ran without a break (a minute or two)
  farm          a sequence of 48 time steps on one and on two workers: time compared with the prediction. Then with twenty kills of workers, one
                kill of the client, and for root a full disk; the bytes must equal those of one machine (some ten minutes)
      --quick        12 small time steps (two minutes)
      --times N, --samples N     numbers of time steps and of samples per pixel; default 48 and 32
      --json FILE    also as JSON
  film          patterns of 30,000 × 54,000 pixels, written tile by tile, and a film of them by `transparencies`, each in a process with a gigabyte of
                memory (some ten minutes, 25 GB of disk in the folder for temporary files)
      COLUMNS ROWS   a film of another size
  zone [scene.gltf]     quality over the whole zone of displays that choose their views, compared with displays of 5×5 views, in whole runs:
                quality, wall and processor time. Scenes: the given ones; by default still-life, glass, letters (directional) and, if
                LUMISTACK_ASSETS has them, FlightHelmet and 2CylinderEngine (about 4 minutes each)
      --rounds N     number of runs of each; default 1
      --large        a zone of 50° × 20°, 840×525 pixels, the directional prototype
      --views        one scene with different numbers of views and equal samples
      --iterations   one scene with different numbers of iterations
  live          `lumistack live` with 1,000 random edits in five minutes: two pages must receive complete states with rising numbers, memory
                must not grow, and Ctrl-C must freeze the display immediately. Needs Linux
      --quick        100 edits in half a minute
  web           the simulator's page in headless Chromium and Firefox, with the preview of still-life: time to the poster, to the first
                movement and to the picture, the longest task, and all bytes, also on an emulated connection and a slow processor; time
                per frame through WebGL2 and on the processor; screenshots of the first five seconds. A missed limit is an error
      --solve        the page that computes patterns, with FlightHelmet, which LUMISTACK_ASSETS must have: time to the first picture, zone score over
                time compared with the final score, animation frames per second, memory; then the page's own scenes, and the
                command's result for one of them
  fuzz          random changes to files of every kind that is read, and to compressed streams in them, from our own corpora and
                those of other projects. A reader must return a value or an error message; a crash or a hang is a failure. Needs a C++ compiler, uses a
                nightly Rust if there is one, and fetches cargo-fuzz
      --minutes N    time for each target; default 10
      --target NAME  only this target: load (glTF and its pictures), light_field, quilt, npy, picture, obj, splats, display, job, stack, calibration

NumPy and PyTorch are fetched into target/python-bench at the first `factorize` (on x86-64 Linux 3 GB to fetch and
6 GB on disk, since PyTorch's package contains libraries for graphics processors). If they cannot be installed, the benchmark reports it
and continues without them. LUMISTACK_BENCH_PYTHON names a Python that has them already. `render` fetches Mitsuba, bpy 5.0.1 (which needs
Python 3.11) and Embree's wheel into target/python-render-bench in the same way (1 GB on disk), `agreement` Mitsuba (60 MB) into
target/python-bench; Mitsuba also needs an LLVM
library of the system (Debian: libllvm19).
";

/// Runs the benchmark that the arguments after `bench` select; `None` if they are wrong.
pub fn run(arguments: &[&str]) -> Option<Outcome> {
    Some(match arguments {
        [] => factorize(&["--no-peers"])?.and_then(|()| bench_render::render(&["--no-peers"]).unwrap_or(Ok(()))),
        ["factorize", options @ ..] => factorize(options)?,
        ["convergence", options @ ..] => convergence(options)?,
        ["gpu", options @ ..] => {
            let options: Vec<String> = options.iter().map(ToString::to_string).collect();
            example("lumistack-factorizer-gpu", "bench_gpu", &options)
        }
        ["stream"] => bench("lumistack-factorizer", "stream", &[text(&tools::root().join("target/stream"))]),
        ["agreement"] => agreement("64").and(bench_render::agree("4096")),
        ["agreement", "--quick"] => agreement("16").and(bench_render::agree("1024")),
        ["outputs"] => {
            let test = ["--package", "lumistack-plugin-host", "--test", "memory"];
            let chosen =
                ["--", "--ignored", "--exact", "memory_does_not_grow_with_the_number_of_frames", "--nocapture"];
            cargo(&[&["test", "--release"][..], &test, &chosen].concat())
        }
        ["render", options @ ..] => bench_render::render(options)?,
        ["big", options @ ..] => bench_render::big(options)?,
        ["field", options @ ..] => bench_render::field(options)?,
        ["splats"] => bench("lumistack-splats", "splats", &[]).and_then(|()| agreement_of_splats()),
        ["splats", "--agreement"] => agreement_of_splats(),
        ["design"] => bench("lumistack-pipeline", "design", &[]),
        ["farm", options @ ..] => farm(options)?,
        ["live"] => live(&[]),
        ["live", "--quick"] => live(&["--quick"]),
        ["film", size @ ..] if matches!(size.len(), 0 | 2) => {
            let size: Vec<String> = size.iter().map(|word| (*word).to_owned()).collect();
            bench("lumistack-plugin-host", "film", &size)
        }
        ["zone", options @ ..] => bench_zone::run(options)?,
        ["web"] => web::bench(),
        ["web", "--solve"] => web::bench_solve(),
        ["fuzz", options @ ..] => fuzzing(options)?,
        ["--help" | "-h"] => {
            print!("{USAGE}");
            Ok(())
        }
        _ => return None,
    })
}

fn farm(options: &[&str]) -> Option<Outcome> {
    let mut words = options.iter();
    let mut passed = Vec::new();
    while let Some(&word) = words.next() {
        match word {
            "--quick" => passed.push(word.to_owned()),
            "--json" => passed.extend([word.to_owned(), absolute(words.next()?)]),
            "--times" | "--samples" => passed.extend([word.to_owned(), (*words.next()?).to_owned()]),
            _ => return None,
        }
    }
    Some(
        python::release_environment().and_then(|python| {
            tools::run(command(&python).arg(tools::root().join("xtask/bench/farm.py")).args(&passed))
        }),
    )
}

fn live(options: &[&str]) -> Outcome {
    cargo(&["build", "--release", "--package", "lumistack-cli"])?;
    let program = web::target_folder()?.join("release").join(format!("lumistack{}", std::env::consts::EXE_SUFFIX));
    tools::run(command("python3").arg(tools::root().join("xtask/bench/live.py")).arg(program).args(options))
}

fn fuzzing(options: &[&str]) -> Option<Outcome> {
    let (mut minutes, mut only) = (10.0, None);
    let mut words = options.iter();
    while let Some(word) = words.next() {
        match *word {
            "--minutes" => minutes = words.next()?.parse().ok()?,
            "--target" => only = Some(*words.next()?),
            _ => return None,
        }
    }
    Some(fuzz::run(minutes, only))
}

fn factorize(options: &[&str]) -> Option<Outcome> {
    let mut words = options.iter();
    let (mut passed, mut with_peers) = (Vec::new(), true);
    while let Some(&word) = words.next() {
        match word {
            "--quick" => passed.push(word.to_owned()),
            "--no-peers" => with_peers = false,
            "--rounds" => passed.extend([word.to_owned(), (*words.next()?).to_owned()]),
            "--json" => passed.extend([word.to_owned(), absolute(words.next()?)]),
            _ => return None,
        }
    }
    let peers = if with_peers { peers() } else { Vec::new() };
    for [python, script] in &peers {
        passed.extend(["--peer".to_owned(), text(python), text(script)]);
    }
    if !peers.is_empty() {
        passed.extend(["--folder".to_owned(), text(&tools::root().join("target"))]);
    }
    Some(bench("lumistack-factorizer", "factorize", &passed))
}

fn convergence(options: &[&str]) -> Option<Outcome> {
    let mut words = options.iter();
    let mut passed = Vec::new();
    while let Some(&word) = words.next() {
        match word {
            "--quick" => passed.push(word.to_owned()),
            "--json" => passed.extend([word.to_owned(), absolute(words.next()?)]),
            _ => return None,
        }
    }
    Some(bench("lumistack-factorizer", "convergence", &passed))
}

/// Returns the Python that LUMISTACK_BENCH_PYTHON names. Without this variable, returns the Python
/// of an environment with Mitsuba, and makes the environment if it is missing.
fn mitsuba() -> Outcome<PathBuf> {
    let given = std::env::var_os("LUMISTACK_BENCH_PYTHON").map(PathBuf::from);
    let python = given.clone().unwrap_or_else(|| tools::root().join("target/python-bench/bin/python"));
    let there = || output_of(command(&python).args(["-c", "import mitsuba, numpy"])).is_some();
    if !there() && given.is_none() {
        tools::make_python(&tools::root().join("target/python-bench"), "to compare our renders with")?;
        tools::install(&python, &["numpy==2.*", "mitsuba==3.*"])?;
    }
    Ok(python)
}

fn agreement_of_splats() -> Outcome {
    let python = mitsuba()?;
    let folder = tools::root().join("target/agreement-splats");
    bench("lumistack-splats", "agreement", &[text(&folder)])?;
    tools::run(command(&python).arg(tools::root().join("xtask/bench/splats_mitsuba.py")).arg(&folder))
}

fn agreement(samples: &str) -> Outcome {
    let python = mitsuba()?;
    let folder = tools::root().join("target/agreement");
    let words = [text(&folder), "--samples".into(), samples.into()];
    bench("lumistack-pathtracer", "agreement", &words)?;
    tools::run(command(&python).arg(tools::root().join("xtask/bench/agreement.py")).arg(&folder))
}

/// Returns a Python and a script for each library that is compared with the factorizer (NumPy,
/// PyTorch). Libraries that cannot be imported are left out.
fn peers() -> Vec<[PathBuf; 2]> {
    let given = std::env::var_os("LUMISTACK_BENCH_PYTHON").map(PathBuf::from);
    let python = given.clone().unwrap_or_else(|| tools::root().join("target/python-bench/bin/python"));
    let mut peers = Vec::new();
    for (name, module, script) in [("NumPy", "numpy", "update_numpy.py"), ("PyTorch", "torch", "update_torch.py")] {
        let there = || output_of(command(&python).args(["-c", &format!("import {module}")])).is_some();
        let fetched = if there() || given.is_some() { Ok(()) } else { fetch(module, &python) };
        match fetched {
            Ok(()) if there() => peers.push([python.clone(), tools::root().join("xtask/bench").join(script)]),
            Ok(()) => println!("bench: {name} is not compared, since {} cannot import the package", python.display()),
            Err(error) => println!("bench: {name} is not compared: {error}"),
        }
    }
    peers
}

/// Installs a library into an environment that only benchmarks use, since PyTorch is large and no
/// test needs it.
fn fetch(module: &str, python: &Path) -> Outcome {
    if module == "numpy" {
        tools::make_python(&tools::root().join("target/python-bench"), "for comparing speed")?;
        return tools::install(python, &["numpy==2.*"]);
    }
    println!("\nfetching: {module}, in target/python-bench (3 GB on x86-64 Linux; used only for comparing speed)");
    tools::install(python, &["--no-cache-dir", "--only-binary=:all:", module])
}
