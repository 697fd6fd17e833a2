//! Times the path tracer, and compares it with the renderers that the arguments name.
//!
//! ```text
//! render view SCENE [--quick] [--rounds N] [--samples N] [--reference N] [--size COLSxROWS]
//!        [--folder FOLDER] [--peer PYTHON SCRIPT]...
//! render rays SCENE [--copies N] [--rounds N] [--size COLSxROWS] [--embree LIBRARY]
//! render agree SCENE [--reference N] [--size COLSxROWS] [--folder FOLDER]
//!        [--peer PYTHON SCRIPT]...
//! render big SCENE [--copies N]
//! render field SCENE [--copies N] [--own-materials] [--views ROWSxCOLS] [--fov DEGREES]
//!        [--samples N] [--size COLSxROWS] [--converged N] [--folder FOLDER]
//!        [--peer PYTHON SCRIPT]...
//! render filters SCENE [--copies N] [--own-materials] [--views ROWSxCOLS] [--fov DEGREES]
//!        [--size COLSxROWS]
//! ```
//!
//! * `rays` counts rays per second of the tree alone.
//! * `big` renders a scene of many copies and prints its memory.
//! * `view` renders one view of a diffuse scene (see [`case`]) with each renderer in turn. It
//!   prints a line per renderer and sampler: median time, samples per second, mean squared error
//!   against the renderer's own converged picture, and error × seconds per megapixel.
//! * `agree` compares converged pictures of the same view, and fails if they differ too much.
//! * `field` renders many views in three ways: one by one, with light that the views share, and
//!   with shared light and further paths. It prints a row per way: processor seconds,
//!   squared error, error of the worst view, bias, change of the mean, variance of the mean view,
//!   and speed-up at equal error. With `--converged` it also compares the means of three views with
//!   pictures of N samples. With peers the views are perspective, and a row per peer follows.
//! * `filters` renders the views in the same three ways, and with the guided filter, with 4, 16 and
//!   64 samples each. It also renders views one by one with 256 samples. The last column is the
//!   error of views one by one in the same time, divided by the error of the row's way.

mod case;
#[cfg(unix)]
mod embree;
mod field;
mod peer;
mod rays;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use lumistack_core::{Cancel, Collector, NoProgress, Task};
use lumistack_pathtracer::{Memory, Renderer, Settings};

use crate::case::{Case, Outcome};
use crate::peer::Peer;

/// Largest number of scattering events of a path: one at the first hit, and 4 after it.
const BOUNCES: u32 = 5;
/// Largest difference of the mean radiances, and largest relative RMSE, of two renderers that
/// agree.
const AGREE: [f64; 2] = [0.003, 0.03];
/// A pixel's error is divided by the larger of two values: the pixel's radiance, and this fraction
/// of the mean radiance.
const DARKEST_SHARE: f64 = 0.05;

struct Options {
    scene: PathBuf,
    rounds: usize,
    samples: Vec<u32>,
    reference: u32,
    size: [usize; 2],
    folder: PathBuf,
    peers: Vec<[PathBuf; 2]>,
    copies: usize,
    embree: Option<PathBuf>,
    /// For `field` and `filters`: numbers of rows and columns of views.
    views: [usize; 2],
    /// For `field` and `filters`: field of view of an axis with several views, in degrees.
    fov_deg: f64,
    /// For `field` and `filters`: true if surfaces keep the materials of the file.
    own_materials: bool,
    /// For `field`: number of samples of the pictures with which means are compared.
    converged: Option<u32>,
}

fn main() -> ExitCode {
    // cargo adds `--bench`
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let done = match words.first().map(String::as_str) {
        Some("view") => options(&words[1..]).and_then(|options| view(&options)),
        Some("rays") => options(&words[1..]).and_then(|options| {
            let (warnings, cancel) = (Collector::default(), Cancel::default());
            let case =
                Case::load(&options.scene, options.copies, options.size, false, Task::quiet(&warnings, &cancel))?;
            rays::measure(&case, options.embree.as_deref(), options.rounds)
        }),
        Some("agree") => options(&words[1..]).and_then(|options| agree(&options)),
        Some("field") => options(&words[1..]).and_then(|options| field::measure(&options)),
        Some("filters") => options(&words[1..]).and_then(|options| field::filters(&options)),
        Some("big") => options(&words[1..]).and_then(|options| big(&options)),
        _ => Err("expected view, rays, agree, big, field or filters, followed by SCENE".into()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("render: {error}");
            ExitCode::FAILURE
        }
    }
}

fn options(words: &[String]) -> Outcome<Options> {
    let mut options = Options {
        scene: PathBuf::new(),
        rounds: 3,
        samples: vec![16, 64],
        reference: 2048,
        size: [840, 525],
        folder: std::env::temp_dir().join("lumistack-bench-render"),
        peers: Vec::new(),
        copies: 1,
        embree: None,
        views: [5, 5],
        fov_deg: 20.0,
        own_materials: false,
        converged: None,
    };
    let mut words = words.iter();
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--quick" => (options.size, options.reference, options.rounds) = ([420, 262], 1024, 3),
            "--rounds" => options.rounds = value()?.parse()?,
            "--samples" => options.samples = vec![value()?.parse()?],
            "--reference" => options.reference = value()?.parse()?,
            "--copies" => options.copies = value()?.parse()?,
            "--embree" => options.embree = Some(value()?.into()),
            "--folder" => options.folder = value()?.into(),
            "--peer" => options.peers.push([value()?.into(), value()?.into()]),
            "--size" => options.size = pair(value()?)?,
            "--views" => options.views = pair(value()?)?,
            "--fov" => options.fov_deg = value()?.parse()?,
            "--converged" => options.converged = Some(value()?.parse()?),
            "--own-materials" => options.own_materials = true,
            _ => options.scene = word.into(),
        }
    }
    Ok(options)
}

/// Parses two numbers, such as 420x262.
fn pair(word: &str) -> Outcome<[usize; 2]> {
    let (a, b) = word.split_once('x').ok_or(format!("{word}: expected two numbers, such as 420x262"))?;
    Ok([a.parse()?, b.parse()?])
}

/// One of the renderers that render the view: Lumistack, or a peer with one of its samplers.
struct Entry {
    name: String,
    /// Index of the peer among the started peers, and its sampler; `None` for Lumistack.
    peer: Option<(usize, String)>,
    reference: Vec<f32>,
    /// Per number of samples: (seconds, mean squared error) of every round.
    runs: Vec<Vec<(f64, f64)>>,
}

fn view(options: &Options) -> Outcome {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task { progress: &NoProgress, warnings: &warnings, cancel: &cancel };
    let case = Case::load(&options.scene, options.copies, options.size, false, task)?;
    let folder = options.folder.join(&case.name);
    case.export(&case.geometry, &folder, false)?;
    let start = Instant::now();
    let renderer = Renderer::new(case.scene.clone(), task)?;
    let [cols, rows] = options.size;
    println!("\n{}, {cols}×{rows}, prepared in {:.2} s", case.name, start.elapsed().as_secs_f64());
    print_memory(&renderer.memory());
    let own = |samples: u32, seed: u32| -> Outcome<(f64, Vec<f32>)> {
        let settings = Settings {
            samples,
            seed: seed.into(),
            max_bounces: BOUNCES,
            roulette_start: BOUNCES,
            ..Settings::default()
        };
        let start = Instant::now();
        let picture = renderer.render_view(&case.window, &case.geometry, [0, 0], &settings, task)?;
        Ok((start.elapsed().as_secs_f64(), picture.data().to_vec()))
    };

    // start the peers; each sampler of a peer is one entry
    let mut peers = Vec::new();
    let mut entries = vec![Entry { name: "Lumistack".into(), peer: None, reference: Vec::new(), runs: Vec::new() }];
    for [python, script] in &options.peers {
        match Peer::start(python, script, &folder) {
            Ok(peer) => {
                for sampler in &peer.samplers {
                    entries.push(Entry {
                        name: format!("{}, {sampler}", peer.name),
                        peer: Some((peers.len(), sampler.clone())),
                        reference: Vec::new(),
                        runs: Vec::new(),
                    });
                }
                peers.push(peer);
            }
            Err(error) => println!("{} is left out: {error}", script.display()),
        }
    }
    let file = folder.join("view.npy");
    let mut render = |peer: &Option<(usize, String)>, samples: u32, seed: u32| match peer {
        None => own(samples, seed),
        Some((index, sampler)) => peers[*index].render(sampler, samples, seed, &file),
    };
    // render the references first, so that every timed picture can be compared at once
    for index in 0..entries.len() {
        // one reference per renderer serves all its samplers
        let same = entries[..index]
            .iter()
            .position(|e| e.peer.as_ref().map(|p| p.0) == entries[index].peer.as_ref().map(|p| p.0));
        entries[index].reference = match same {
            Some(same) => entries[same].reference.clone(),
            None => render(&entries[index].peer, options.reference, 4711)?.1,
        };
        entries[index].runs = vec![Vec::new(); options.samples.len()];
    }
    // alternate between the entries, so that other programs slow all of them equally
    for round in 0..options.rounds {
        for (at, &samples) in options.samples.iter().enumerate() {
            for entry in &mut entries {
                let (seconds, picture) = render(&entry.peer, samples, 1 + round as u32)?;
                entry.runs[at].push((seconds, mean_square(&picture, &entry.reference)));
            }
        }
    }
    for (at, &samples) in options.samples.iter().enumerate() {
        println!("\n{samples:>4} samples per pixel                     seconds  Msamples/s     MSE   MSE × s/Mpixel");
        for entry in &entries {
            let mut seconds: Vec<f64> = entry.runs[at].iter().map(|run| run.0).collect();
            seconds.sort_by(f64::total_cmp);
            let median = seconds[seconds.len() / 2];
            let error = entry.runs[at].iter().map(|run| run.1).sum::<f64>() / entry.runs[at].len() as f64;
            let paths = case.pixels() * f64::from(samples);
            println!(
                "{:<42} {median:8.2} {:10.2}  {error:9.2e}  {:9.2e}",
                entry.name,
                paths / median * 1e-6,
                error * median / (case.pixels() * 1e-6)
            );
        }
    }
    // compare the references of the renderers with each other
    println!("\nconverged pictures, {} samples per pixel, against ours:", options.reference);
    for entry in &entries[1..] {
        let (mean, relative) = agreement(&entries[0].reference, &entry.reference);
        println!("{:<42} mean radiance {:+.3} %, relative RMSE {:.2} %", entry.name, 100.0 * mean, 100.0 * relative);
    }
    for warning in warnings.take() {
        println!("warning: {warning}");
    }
    for (name, entry) in ["ours", "first peer"].iter().zip([entries.first(), entries.get(1)]) {
        if let Some(entry) = entry {
            write_png(&folder.join(format!("{}.png", name.replace(' ', "_"))), &entry.reference, options.size)?;
        }
    }
    Ok(())
}

/// Compares converged pictures of a diffuse scene with the peers' pictures.
fn agree(options: &Options) -> Outcome {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task { progress: &NoProgress, warnings: &warnings, cancel: &cancel };
    let case = Case::load(&options.scene, options.copies, options.size, false, task)?;
    let folder = options.folder.join(&case.name);
    case.export(&case.geometry, &folder, true)?;
    let renderer = Renderer::new(case.scene.clone(), task)?;
    let samples = options.reference;
    let settings =
        Settings { samples, seed: 4711, max_bounces: BOUNCES, roulette_start: BOUNCES, ..Settings::default() };
    let picture = renderer.render_view(&case.window, &case.geometry, [0, 0], &settings, task)?;
    write_png(&folder.join("ours.png"), picture.data(), options.size)?;
    // render the same view with every peer, and keep the largest differences
    let mut worst = [0.0f64; 2];
    println!("\n{}, {samples} samples per pixel, against ours:", case.name);
    for (number, [python, script]) in options.peers.iter().enumerate() {
        let mut peer = Peer::start(python, script, &folder)?;
        let sampler = peer.samplers.first().cloned().ok_or("the renderer: expected a sampler's name, found none")?;
        let (_, theirs) = peer.render(&sampler, samples, 4711, &folder.join("view.npy"))?;
        let (mean, relative) = agreement(picture.data(), &theirs);
        println!("{:<42} mean radiance {:+.3} %, relative RMSE {:.2} %", peer.name, 100.0 * mean, 100.0 * relative);
        write_png(&folder.join(format!("peer-{number}.png")), &theirs, options.size)?;
        worst = [worst[0].max(mean.abs()), worst[1].max(relative)];
    }
    if worst[0] > AGREE[0] || worst[1] > AGREE[1] {
        let [mean, rmse, worst_mean, worst_rmse] = [AGREE[0], AGREE[1], worst[0], worst[1]].map(|part| 100.0 * part);
        return Err(format!(
            "{}: expected a difference of the mean radiance of at most {mean:.1} % and a relative RMSE of at most {rmse:.1} %, \
             found {worst_mean:.2} % and {worst_rmse:.2} %",
            case.name
        )
        .into());
    }
    Ok(())
}

/// Renders a scene whose copies would not fit into memory as separate triangles.
fn big(options: &Options) -> Outcome {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let case = Case::load(&options.scene, options.copies, options.size, false, task)?;
    let start = Instant::now();
    let renderer = Renderer::new(case.scene.clone(), task)?;
    println!("\n{}, prepared in {:.2} s", case.name, start.elapsed().as_secs_f64());
    print_memory(&renderer.memory());
    let samples = options.samples[0];
    let settings = Settings { samples, max_bounces: BOUNCES, roulette_start: BOUNCES, ..Settings::default() };
    let start = Instant::now();
    let picture = renderer.render_view(&case.window, &case.geometry, [0, 0], &settings, task)?;
    let seconds = start.elapsed().as_secs_f64();
    println!("{:.2} Msamples/s", case.pixels() * f64::from(samples) / seconds * 1e-6);
    write_png(&options.folder.join("big.png"), picture.data(), options.size)
}

fn print_memory(memory: &Memory) {
    let per = |bytes: usize, triangles: usize| bytes as f64 / triangles as f64;
    println!(
        "{} triangles, {} unique: tree {:.1} bytes per unique triangle, all {:.1} MB ({:.2} bytes per triangle)",
        memory.triangles,
        memory.unique_triangles,
        per(memory.tree_bytes, memory.unique_triangles),
        memory.bytes() as f64 * 1e-6,
        per(memory.bytes(), memory.triangles)
    );
    let images = memory.scene_bytes + memory.texture_bytes;
    println!(
        "meshes and images {:.1} MB, coarser levels of images {:.1} MB, together {:.2} times the meshes and images alone",
        memory.scene_bytes as f64 * 1e-6,
        memory.texture_bytes as f64 * 1e-6,
        images as f64 / memory.scene_bytes as f64
    );
}

fn write_png(path: &std::path::Path, radiance: &[f32], [cols, rows]: [usize; 2]) -> Outcome {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let codes = radiance.iter().map(|&v| lumistack_core::colour::srgb_code(v)).collect();
    Ok(image::RgbImage::from_raw(cols as u32, rows as u32, codes).ok_or("expected 3 bytes per pixel")?.save(path)?)
}

fn mean_square(picture: &[f32], reference: &[f32]) -> f64 {
    let sum: f64 = picture.iter().zip(reference).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    sum / picture.len() as f64
}

/// Returns the relative difference of the mean radiances of two pictures, and the root mean square
/// of the relative differences of their pixels.
fn agreement(ours: &[f32], theirs: &[f32]) -> (f64, f64) {
    let mean = |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64;
    let (own_mean, their_mean) = (mean(ours), mean(theirs));
    let relative = |(&a, &b): (&f32, &f32)| {
        let (a, b) = (f64::from(a), f64::from(b));
        ((b - a) / a.max(DARKEST_SHARE * own_mean)).powi(2)
    };
    let squares: f64 = ours.iter().zip(theirs).map(relative).sum();
    (their_mean / own_mean - 1.0, (squares / ours.len() as f64).sqrt())
}
