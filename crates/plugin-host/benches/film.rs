//! Makes the PDF of a printed display whose patterns are larger than the allowed memory.
//!
//! One process writes the patterns tile by tile. Another process makes a PDF of these patterns with
//! the plugin `transparencies`. The memory of each process is limited to less than a gigabyte,
//! cached pages of files included, if the system permits the limit.
//!
//! `cargo bench -p lumistack-plugin-host --bench film -- [COLUMNS ROWS [FOLDER]]`

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{Display, Layer, LayerStack, Region, Tiling};
use lumistack_field_io::{StackWriter, read_stack};
use lumistack_plugin_host::{OutputContext, OutputData, Registry, Time, run_output};
use serde_json::json;

type Outcome = Result<(), Box<dyn Error>>;

/// Limit on a process's memory, cached pages of files included, bytes. The limit is below a
/// gigabyte, since the system may charge shared pages, such as libraries, to another process.
const LIMIT: u64 = 900 << 20;
/// Pixels per side of a tile.
const TILE: usize = 2048;
const PITCH_MM: f64 = 25.4 / 1200.0;

fn main() -> Outcome {
    // cargo adds `--bench`
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["patterns", size @ .., folder] => patterns(&display(size)?, Path::new(folder)),
        ["film", size @ .., folder] => film(&display(size)?, Path::new(folder)),
        [cols, rows, folder] => bench([cols, rows], Path::new(folder)),
        [cols, rows] => bench([cols, rows], tempfile::tempdir()?.path()),
        _ => bench(["30000", "54000"], tempfile::tempdir()?.path()),
    }
}

/// Makes a display of two films (layers printed on transparent foil). The front film has few
/// pixels, since one large film is enough for the measurement.
fn display(size: &[&str]) -> Result<Display, Box<dyn Error>> {
    let [cols, rows] = size else { return Err("expected columns and rows".into()) };
    let resolution = [cols.parse()?, rows.parse()?];
    let mut display = Display::uniform(resolution, PITCH_MM, [5, 5], [20.0, 20.0], &[-1.0], 1);
    let front = Layer::new(1.0, resolution.map(|count: usize| count.div_ceil(16)), 16.0 * PITCH_MM);
    display.layers.push(front);
    display.name = "film".into();
    Ok(display)
}

/// Returns a pixel's value: stripes with noise. The direction of the stripes changes slowly from
/// row to row, so that no two tiles are equal. Such content compresses badly.
fn value(row: usize, col: usize, channel: usize) -> f32 {
    let noise = lumistack_core::seed::unit_f32(lumistack_core::seed::mix((row * 131_071 + col * 3 + channel) as u64));
    let stripe = ((row * row / 9973 + 7 * col) % 512) as f32 / 512.0;
    (0.9 * stripe + 0.1 * noise).clamp(0.02, 1.0)
}

fn patterns(display: &Display, folder: &Path) -> Outcome {
    let geometry = display.geometry()?;
    let tiles = [geometry.cols, geometry.rows].map(|pixels| pixels.div_ceil(TILE));
    let tiling = Tiling::new(display, &geometry, tiles);
    let mut writer = StackWriter::begin(&folder.join("layers"), display)?;
    for number in 0..tiling.count() {
        let own: Vec<Region> = tiling.tile(number).parts.into_iter().map(|part| part.own).collect();
        let mut of_tile = display.clone();
        for (layer, own) in of_tile.layers.iter_mut().zip(&own) {
            layer.resolution = [own.cols.len(), own.rows.len()];
        }
        let mut stack = LayerStack::filled(&of_tile, 0.0);
        for (layer, Region { rows, cols }) in stack.layers.iter_mut().zip(&own) {
            let pixels = rows.clone().flat_map(|row| cols.clone().map(move |col| (row, col)));
            for (pixel, (row, col)) in layer.data_mut().chunks_exact_mut(3).zip(pixels) {
                pixel.iter_mut().enumerate().for_each(|(channel, to)| *to = value(row, col, channel));
            }
        }
        writer.write(&own, &stack)?;
    }
    Ok(writer.finish()?)
}

fn film(display: &Display, folder: &Path) -> Outcome {
    let stack = read_stack(&folder.join("layers"))?;
    let (registry, warnings, cancel) = (Registry::built_in()?, Collector::default(), Cancel::default());
    let (task, out_dir) = (Task::quiet(&warnings, &cancel), folder.join("films"));
    let data = OutputData::LayerStack(&stack, None);
    let context = OutputContext { display, data, time: Time::default(), out_dir: &out_dir, task };
    let params = json!({ "paper": "tight" });
    run_output(&registry, "transparencies", &params, context)?;
    Ok(())
}

fn bench(size: [&str; 2], folder: &Path) -> Outcome {
    println!("a film of {} × {} pixels, {} dots per inch", size[0], size[1], (25.4 / PITCH_MM).round());
    let group = Group::new();
    if group.is_none() {
        println!("cached pages of files are not limited: this system permits no control group for memory");
    }
    for step in ["patterns", "film"] {
        let begun = Instant::now();
        let mut child = Command::new(std::env::current_exe()?).arg(step).args(size).arg(folder).spawn()?;
        if let Some(group) = &group {
            group.take(&child)?;
        }
        let (status, own) = watch(&mut child)?;
        let seconds = begun.elapsed().as_secs_f64();
        println!(
            "{step:9} {seconds:6.0} s, at most {:4} MiB of anonymous memory{}",
            own >> 20,
            if group.is_some() { ", limit 900 MiB with cached pages of files" } else { "" }
        );
        if !status {
            return Err(format!("`{step}` failed").into());
        }
        if own > LIMIT {
            return Err(format!("`{step}` used more than {} MiB of anonymous memory", LIMIT >> 20).into());
        }
    }
    for file in ["layers/layer_0.npy", "films/transparencies.pdf"] {
        println!("{file:24} {:7.2} GB", std::fs::metadata(folder.join(file))?.len() as f64 * 1e-9);
    }
    Ok(())
}

/// Waits for a process. Returns two values: true if the process succeeded, and the peak of its
/// anonymous memory in bytes. This memory excludes pages of files.
fn watch(child: &mut Child) -> Result<(bool, u64), Box<dyn Error>> {
    let path = format!("/proc/{}/status", child.id());
    let mut most = 0;
    loop {
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        let own = text.lines().find_map(|line| line.strip_prefix("RssAnon:"));
        let kib = own.and_then(|own| own.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
        most = most.max(kib.unwrap_or(0) << 10);
        if let Some(status) = child.try_wait()? {
            return Ok((status.success(), most));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A control group whose processes share [`LIMIT`], cached pages of files included.
struct Group(PathBuf);

impl Group {
    fn new() -> Option<Self> {
        let name = format!("lumistack-film-{}", std::process::id());
        // Version 2 and version 1 of control groups differ in the root folder and in the file of
        // the limit.
        let kinds = [("/sys/fs/cgroup", "memory.max"), ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")];
        kinds.into_iter().find_map(|(root, limit)| {
            let group = Self(Path::new(root).join(&name));
            std::fs::create_dir(&group.0).ok()?;
            // opening the file fails if the new folder is no control group
            let file = std::fs::OpenOptions::new().write(true).open(group.0.join(limit));
            std::io::Write::write_all(&mut file.ok()?, LIMIT.to_string().as_bytes()).ok()?;
            Some(group)
        })
    }

    fn take(&self, child: &Child) -> std::io::Result<()> {
        std::fs::write(self.0.join("cgroup.procs"), child.id().to_string())
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.0);
    }
}
