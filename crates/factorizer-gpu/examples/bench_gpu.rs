//! Measures the iterations per second of an adapter in two cases: the paper's main case, and a
//! display with the views of a whole viewing zone. Compares these rates with the processor's rates
//! and with the adapter's measured limits.
//!
//! The output calls an iteration an update. Operations and bytes per iteration and colour channel,
//! with F factors and M frames:
//!
//! ```text
//! multiply-adds per ray   block-exact      F (M (F−2) + 2M + M(M+1)/2)
//!                         multiplicative   F M (F+1)
//! bytes                   F times: the target and all factors are read, and one factor is written
//! ```
//!
//! The paper's two Quadro cards computed about 10 iterations per second.

#[path = "../../factorizer/benches/factorize/scene.rs"]
mod scene;

use std::error::Error;
use std::time::Instant;

use lumistack_core::Cancel;
use lumistack_display::{Display, LayerStack, Weights};
use lumistack_factorizer::{Problem, Solver, random_start, solver};
use lumistack_factorizer_gpu::{Device, Limits, adapters};

/// Width of the display, millimetres.
const WIDTH_MM: f64 = 473.76;
/// Number of untimed updates between the first update and the timed ones.
const WARM_UP: usize = 2;

/// A display, and the number of views of its light field.
struct Case {
    resolution: [usize; 2],
    views: usize,
    frames: usize,
}

const PAPER: Case = Case { resolution: [840, 525], views: 5, frames: 12 };
/// The main example of this repository, with the views that its display chooses.
const ZONE: Case = Case { resolution: [420, 262], views: 13, frames: 6 };
/// Smaller displays, for `--quick`.
const QUICK: [Case; 2] = [Case { resolution: [210, 131], ..PAPER }, Case { resolution: [105, 66], ..ZONE }];

/// Returns the seconds of the start and the first update together, and the seconds of a later
/// update.
fn time(
    solver: &dyn Solver,
    problem: &Problem,
    start: &LayerStack,
    updates: usize,
) -> Result<[f64; 2], Box<dyn Error>> {
    let begun = Instant::now();
    let mut run = solver.start(problem, start.clone())?;
    run.step(&Cancel::default())?;
    // the objective waits for the device
    run.objective();
    let first = begun.elapsed().as_secs_f64();
    (0..WARM_UP).try_for_each(|_| run.step(&Cancel::default()))?;
    run.objective();
    let begun = Instant::now();
    for _ in 0..updates {
        run.step(&Cancel::default())?;
    }
    run.objective();
    run.check()?;
    Ok([first, begun.elapsed().as_secs_f64() / updates as f64])
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let quick = arguments.iter().any(|argument| argument == "--quick");
    arguments.retain(|argument| argument != "--quick");
    let name = arguments.first().map(String::as_str);
    // list the adapters, and open one: the requested one, or, without a request, a graphics
    // processor if there is one
    for adapter in adapters() {
        println!("{} ({}, {}, {})", adapter.name, adapter.kind, adapter.backend, adapter.driver);
    }
    let device = match Device::open(name) {
        Err(error) if name.is_none() => {
            println!("{error}");
            Device::open(Some(""))?
        }
        device => device?,
    };
    let adapter = device.adapter();
    if !adapter.is_hardware {
        println!("no graphics processor: these results are those of the processor, through a software driver");
    }
    // measure the adapter's limits; no update can be faster than they allow
    let limits = device.measured_limits();
    println!(
        "on {}: copies {:.1} GB/s, {:.1} G multiply-adds/s",
        adapter.name,
        limits.bytes_per_s / 1e9,
        limits.multiply_adds_per_s / 1e9
    );
    let updates = if quick { 2 } else { 40 };
    for case in if quick { QUICK } else { [PAPER, ZONE] } {
        measure(&device, &limits, &case, updates)?;
    }
    Ok(())
}

/// Times the device and the processor on one case.
fn measure(device: &Device, limits: &Limits, case: &Case, updates: usize) -> Result<(), Box<dyn Error>> {
    let Case { resolution: [cols, rows], views, frames } = *case;
    let pitch_mm = WIDTH_MM / cols as f64;
    let display = Display::uniform([cols, rows], pitch_mm, [views; 2], [20.0; 2], &[-40.0, 0.0, 40.0], frames);
    let display = Display { brightness: 0.2, ..display };
    let target = scene::light_field(&display)?;
    let problem = Problem { display: &display, target: &target, weights: &Weights::Uniform };
    let start = random_start(&display, 1);
    // count values and rays; they give the bytes that an update must at least read and write (see
    // the top of this file)
    let (factors, m) = (3.0, frames as f64);
    let values = 3.0 * (rows * cols) as f64;
    let rays = (views * views) as f64 * values;
    println!("{cols}×{rows} pixels, {views}×{views} views, 3 layers, {frames} frames");
    let bytes = factors * (2.0 * rays + 4.0 * m * factors * values + 4.0 * m * values);
    // time the device and the processor on the same updates
    for (name, per_ray) in [
        ("multiplicative", factors * m * (factors + 1.0)),
        ("extrapolated", factors * (m * (factors - 2.0) + 2.0 * m + m * (m + 1.0) / 2.0)),
    ] {
        let [first, each] = time(&device.solver(name)?, &problem, &start, updates)?;
        let [cpu_first, cpu_each] = time(solver(name)?, &problem, &start, updates.min(10))?;
        let least = (bytes / limits.bytes_per_s).max(per_ray * rays / limits.multiply_adds_per_s);
        println!(
            "{name}: {:.2} updates/s, the first after {first:.2} s; at the device's limits {:.2}",
            1.0 / each,
            1.0 / least
        );
        println!(
            "  {:.0} MB and {:.2} G multiply-adds an update: {:.1} GB/s, {:.1} G/s, {:.0} % of the nearer limit",
            bytes / 1e6,
            per_ray * rays / 1e9,
            bytes / each / 1e9,
            per_ray * rays / each / 1e9,
            100.0 * least / each
        );
        println!("  processor: {:.2} updates/s, the first after {cpu_first:.2} s", 1.0 / cpu_each);
    }
    Ok(())
}
