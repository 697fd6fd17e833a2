//! Solves a display whose light field can exceed the memory: 3840×2160 pixels, 9×9 views, 3 layers,
//! 12 frames, one channel.
//!
//! ```text
//! cargo bench -p lumistack-factorizer --bench stream --
//!     FOLDER [COLUMNS ROWS ITERATIONS]
//! ```
//!
//! The program prints an estimate of the memory, and writes a target of several textured planes to
//! FOLDER. Then it factorizes the mapped target, and prints times, PSNR and anonymous memory.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "this program measures time and maps a file")]

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use lumistack_core::Cancel;
use lumistack_display::{Display, FieldGeometry};
use lumistack_factorizer::{ChannelRun, Estimate};

/// A mapped file of half floats.
struct Halves(memmap2::Mmap);

impl AsRef<[u16]> for Halves {
    fn as_ref(&self) -> &[u16] {
        // SAFETY: a map begins at a page and any bytes are valid integers
        unsafe { self.0.align_to::<u16>().1 }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // cargo adds `--bench`
    let args: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let folder = PathBuf::from(args.first().ok_or("expected the argument FOLDER, found none")?);
    let number = |i: usize, default: usize| args.get(i).map_or(Ok(default), |text| text.parse());
    let (cols, rows, iterations) = (number(1, 3840)?, number(2, 2160)?, number(3, 3)?);
    // a display of 55 inches
    let pitch_mm = 1210.0 / cols as f64;
    let display = Display {
        brightness: 0.2,
        ..Display::uniform([cols, rows], pitch_mm, [9, 9], [10.0, 10.0], &[-20.0, 0.0, 20.0], 12)
    };
    let geometry = display.geometry()?;
    let estimate = Estimate::of(&display, &geometry);
    let gib = |bytes: u64| bytes as f64 / f64::from(1u32 << 30);
    println!(
        "will take: target {:.2} GiB on disk, patterns {:.2} GiB and working space {:.2} GiB in memory",
        gib(estimate.target),
        gib(estimate.patterns),
        gib(estimate.working),
    );
    // write the target to a file, which is then mapped, so that memory never holds all of it
    std::fs::create_dir_all(&folder)?;
    let path = folder.join("target.f16");
    let begin = Instant::now();
    write_planes(&path, &geometry)?;
    println!("target written in {:.1} s", begin.elapsed().as_secs_f64());
    // SAFETY: no other process writes the file
    let map = unsafe { memmap2::Mmap::map(&File::open(&path)?)? };
    // Solve the target, and check that the process holds little memory.
    let begin = Instant::now();
    let mut run = ChannelRun::start(&display, &geometry, Arc::new(Halves(map)), 1)?;
    println!("started in {:.1} s, {:.0} million rays", begin.elapsed().as_secs_f64(), run.rays() as f64 / 1e6);
    for iteration in 1..=iterations {
        let begin = Instant::now();
        run.step(&Cancel::default())?;
        let step = begin.elapsed().as_secs_f64();
        let psnr = run.objective().psnr_view;
        println!(
            "iteration {iteration}: {step:.1} s, {psnr:.2} dB, {:.2} GiB anonymous memory",
            gib(anonymous_bytes())
        );
    }
    let held = gib(anonymous_bytes());
    assert!(held < 3.0 || cols > 3840, "expected less than 3 GiB of anonymous memory, found {held:.2} GiB");
    std::fs::remove_file(&path)?;
    Ok(())
}

/// Writes three textured planes: one behind the display, one on it, and one in front of it. The two
/// nearer planes have holes.
fn write_planes(path: &Path, geometry: &FieldGeometry) -> std::io::Result<()> {
    let mut file = BufWriter::with_capacity(1 << 20, File::create(path)?);
    let texture = |x: f64, y: f64, scale: f64| 0.5 + 0.25 * (x / scale).sin() + 0.25 * (y / scale * 1.3).cos();
    let mut row_bytes = Vec::with_capacity(2 * geometry.cols);
    for [view_y, view_x] in geometry.grid.iter() {
        let (sx, sy) = (geometry.grid.slope_x[view_x], geometry.grid.slope_y[view_y]);
        for row in 0..geometry.rows {
            row_bytes.clear();
            for col in 0..geometry.cols {
                let (x, y) = (geometry.x_mm(col), geometry.y_mm(row));
                let at = |z: f64| (x + z * sx, y + z * sy);
                let (front, middle, rear) = (at(30.0), at(0.0), at(-60.0));
                let value = if (front.0 / 90.0).sin() * (front.1 / 70.0).sin() > 0.6 {
                    texture(front.0, front.1, 3.0)
                } else if (middle.0 / 50.0).sin() > 0.3 {
                    0.8 * texture(middle.0, middle.1, 2.0)
                } else {
                    0.6 * texture(rear.0, rear.1, 9.0)
                };
                row_bytes.extend_from_slice(&half(value).to_le_bytes());
            }
            file.write_all(&row_bytes)?;
        }
    }
    file.flush()
}

/// Rounds a value in 0..1 down to a half float. Values below 2⁻¹⁴ become 0.
fn half(value: f64) -> u16 {
    let bits = (value as f32).to_bits();
    let exponent = (bits >> 23) as i32 - 112;
    if exponent <= 0 { 0 } else { (exponent as u16) << 10 | (bits >> 13 & 0x3ff) as u16 }
}

/// Returns the anonymous memory of this process, as the system reports it, bytes; 0 if it is
/// unknown.
fn anonymous_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"));
    line.and_then(|text| text.trim().trim_end_matches(" kB").trim().parse::<u64>().ok()).unwrap_or(0) * 1024
}
