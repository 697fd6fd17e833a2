//! Measures time and memory of many views of a million splats: rendered together, one by one, and
//! by a naive renderer.
//!
//! ```text
//! cargo bench -p lumistack-splats --bench splats --
//!     [SPLATS] [VIEWS per axis] [DEGREE]
//! ```

use std::sync::Arc;
use std::time::Instant;

use glam::{Affine3A, DQuat, DVec3, Quat, Vec3};
use lumistack_core::{Cancel, Cancelled, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_scene::{Cloud, PlacedCloud, Scene, SceneParts, Similarity, Window};
use lumistack_splats::{Renderer, SplatView, Wanted};
use rayon::prelude::*;

/// Number of views that are rendered one by one; the times of all views are extrapolated from them.
const SAMPLED: usize = 5;

fn main() {
    // cargo adds `--bench`
    let words = std::env::args().skip(1).filter(|word| word != "--bench");
    let arguments: Vec<usize> = words.map(|a| a.parse().expect("a number")).collect();
    let [count, views, degree] = [(0, 1_000_000), (1, 13), (2, 3)].map(|(i, d)| arguments.get(i).copied().unwrap_or(d));
    let scene = scene(count, degree);
    let grid = ViewGrid::uniform(Projection::Oblique, [views, views], [20.0, 20.0]).expect("a grid");
    let geometry = FieldGeometry { rows: 262, cols: 420, pitch_mm: 1.128, grid };
    let map = Similarity { rotation: DQuat::IDENTITY, scale: 0.007, translation: DVec3::ZERO };
    let window = Window { scene_from_display: map, size_mm: geometry.size_mm(), near_mm: None };
    let slopes: Vec<[f64; 2]> =
        geometry.grid.iter().map(|[y, x]| [geometry.grid.slope_x[x], geometry.grid.slope_y[y]]).collect();
    println!(
        "{count} splats of degree {degree}, {} views of {} × {}, {} threads",
        slopes.len(),
        geometry.cols,
        geometry.rows,
        rayon::current_num_threads()
    );
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let renderer = Renderer::new(scene.clone()).expect("splats");
    let render = |slopes: &[[f64; 2]], wanted: Wanted| {
        let mut sum = 0.0;
        let (start, used) = (Instant::now(), processor_s());
        let none = |_: usize| Ok::<_, Cancelled>(None);
        let done = |_: usize, view: SplatView| {
            sum += f64::from(view.light.data()[4 * 55_000]);
            Ok(())
        };
        renderer.render(&window, &geometry, slopes, &none, wanted, task, done).expect("views");
        (start.elapsed().as_secs_f64(), processor_s() - used, sum)
    };
    // Render once to warm up, then all views together. Then render some views one by one, and the
    // same views with the naive renderer.
    render(&slopes[..1], Wanted::Light);
    let (together, of_together, _) = render(&slopes, Wanted::Light);
    let (depth, of_depth, _) = render(&slopes, Wanted::Depth);
    let peak = peak_mb();
    let chosen: Vec<[f64; 2]> = (0..SAMPLED).map(|i| slopes[i * (slopes.len() - 1) / (SAMPLED - 1)]).collect();
    let one_by_one: Vec<_> = chosen.iter().map(|slope| render(&[*slope], Wanted::Light)).collect();
    let alone = one_by_one.iter().map(|one| one.0).sum::<f64>() / SAMPLED as f64;
    let of_alone = one_by_one.iter().map(|one| one.1).sum::<f64>() / SAMPLED as f64;
    let (start, used) = (Instant::now(), processor_s());
    let mut differences = Vec::new();
    for slope in &chosen {
        let picture = naive(&scene, &window, &geometry, *slope);
        differences.push(picture);
    }
    let plain = start.elapsed().as_secs_f64() / SAMPLED as f64;
    let of_plain = (processor_s() - used) / SAMPLED as f64;
    let mut error = 0.0f64;
    let none = |_: usize| Ok::<_, Cancelled>(None);
    let compare = |number: usize, view: SplatView| {
        let pixels = view.light.data().chunks_exact(4).zip(&differences[number]);
        let squares = pixels.map(|(a, b)| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>());
        error += squares.sum::<f64>() / (3 * geometry.rows * geometry.cols * SAMPLED) as f64;
        Ok(())
    };
    renderer.render(&window, &geometry, &chosen, &none, Wanted::Light, task, compare).expect("views");
    let all = slopes.len() as f64;
    let row = |name: &str, time: f64, processor: f64| {
        println!(
            "{name:24} {time:8.2} s {processor:8.2} s of processor time, {:7.1} ms of it per view",
            1e3 * processor / all
        );
    };
    row("all together", together, of_together);
    row("depth alone", depth, of_depth);
    row("one view, times all", alone * all, of_alone * all);
    row("naive, view by view", plain * all, of_plain * all);
    let (by_clock, by_processors) = (plain * all / together, of_plain * all / of_together);
    println!("naive / together: {by_clock:.2} by the clock, {by_processors:.2} by processor time");
    println!("peak memory {peak:.0} MB, agreement {:.1} dB", -10.0 * error.log10());
}

/// Makes splats on bumpy closed surfaces, similar to captures. The splats are flat and about as
/// large as the distance to their neighbours, and some of them are faint.
fn scene(count: usize, degree: usize) -> Arc<Scene> {
    let mut state = 7u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    };
    let spacing = (30.0 / count as f32).sqrt();
    let mut cloud = Cloud { degree, ..Cloud::default() };
    for i in 0..count {
        let (turn, z) = (std::f32::consts::TAU * next(), 2.0 * next() - 1.0);
        let flat = (1.0 - z * z).sqrt();
        let normal = Vec3::new(flat * turn.cos(), flat * turn.sin(), z);
        let shell = (i % 3) as f32;
        let bump = 0.04 * (9.0 * normal.x).sin() * (11.0 * normal.y).cos();
        let radius = 0.25 + 0.33 * shell + bump + 0.004 * (next() - 0.5);
        cloud.positions.push(radius * normal * Vec3::new(1.4, 1.0, 0.7));
        cloud.rotations.push(Quat::from_rotation_arc(Vec3::Z, normal));
        let size = spacing * (-1.0 + 2.0 * next()).exp();
        cloud.scales.push(Vec3::new(size, size * (0.4 + next()), 0.1 * size));
        cloud.opacities.push(if next() < 0.3 { 0.1 * next() } else { 0.4 + 0.6 * next() });
        let base = [normal.x, normal.y, shell - 1.0];
        cloud.harmonics.extend(base.map(|value| 1.2 * value));
        cloud.harmonics.extend((0..3 * ((degree + 1).pow(2) - 1)).map(|_| 0.2 * (next() - 0.5)));
    }
    let placed_clouds = vec![PlacedCloud { cloud: 0, scene_from_cloud: Affine3A::IDENTITY }];
    let parts = SceneParts { clouds: vec![cloud], placed_clouds, ..SceneParts::default() };
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).expect("a scene"))
}

/// Renders a single picture in a simple way, on all threads.
///
/// The function projects, shades and sorts all splats. Then each tile blends the splats that
/// overlap it, until its pixels are opaque.
fn naive(scene: &Scene, window: &Window, geometry: &FieldGeometry, slope: [f64; 2]) -> Vec<[f32; 3]> {
    const TILE: usize = 16;
    struct Flat {
        distance: f32,
        at: [f32; 2],
        conic: [f32; 3],
        reach: [f32; 2],
        opacity: f32,
        colour: [f32; 3],
    }
    let cloud = &scene.clouds[0];
    let map = window.scene_from_display;
    let pixel = (map.scale * geometry.pitch_mm) as f32;
    let [sx, sy] = [slope[0] as f32, -slope[1] as f32];
    let direction = Vec3::new(-sx, sy, -1.0).normalize();
    // Project every splat onto the window, and compute its colour.
    let mut flat: Vec<Flat> = (0..cloud.len())
        .into_par_iter()
        .map(|i| {
            let at = cloud.positions[i] / pixel;
            let (x, y, z) =
                (at.x + 0.5 * (geometry.cols as f32 - 1.0), 0.5 * (geometry.rows as f32 - 1.0) - at.y, at.z);
            let turn = glam::Mat3::from_quat(cloud.rotations[i]) * glam::Mat3::from_diagonal(cloud.scales[i] / pixel);
            let turn = glam::Mat3::from_diagonal(Vec3::new(1.0, -1.0, 1.0)) * turn;
            let (u, v) = (turn.row(0) - sx * turn.row(2), turn.row(1) - sy * turn.row(2));
            let (a, b, c) = (u.dot(u), u.dot(v), v.dot(v));
            let (wide, high) = (a + 1.0 / 12.0, c + 1.0 / 12.0);
            let determinant = wide * high - b * b;
            let opacity = cloud.opacities[i] * ((a * c - b * b).max(0.0) / determinant).sqrt();
            let count = 3 * cloud.coefficients();
            let mut colour = [0.5f32; 3];
            for (rgb, y) in cloud.harmonics[i * count..][..count].chunks_exact(3).zip(basis(direction)) {
                (0..3).for_each(|c| colour[c] += rgb[c] * y);
            }
            Flat {
                distance: -(sx * x + sy * y + z),
                at: [x - z * sx, y - z * sy],
                conic: [0.5 * high / determinant, -b / determinant, 0.5 * wide / determinant],
                reach: [3.0 * wide.sqrt(), 3.0 * high.sqrt()],
                opacity,
                colour: colour.map(|value| value.max(0.0)),
            }
        })
        .collect();
    // Sort the splats by distance, list the splats of each tile, and blend each tile.
    flat.par_sort_unstable_by(|a, b| a.distance.total_cmp(&b.distance));
    let tiles = [geometry.cols.div_ceil(TILE), geometry.rows.div_ceil(TILE)];
    let mut lists = vec![Vec::new(); tiles[0] * tiles[1]];
    for (i, splat) in flat.iter().enumerate() {
        let range = |axis: usize| {
            let first = ((splat.at[axis] - splat.reach[axis]) / TILE as f32).floor().max(0.0) as usize;
            let end = ((splat.at[axis] + splat.reach[axis]) / TILE as f32).floor() + 1.0;
            first..(end.max(0.0) as usize).min(tiles[axis])
        };
        for row in range(1) {
            range(0).for_each(|col| lists[row * tiles[0] + col].push(i as u32));
        }
    }
    let rendered: Vec<Vec<([f32; 3], f32)>> = lists
        .par_iter()
        .enumerate()
        .map(|(tile, list)| {
            let mut pixels = vec![([0.0f32; 3], 1.0f32); TILE * TILE];
            let mut open = TILE * TILE;
            for splat in list.iter().map(|i| &flat[*i as usize]) {
                for row in 0..TILE {
                    let dy = (tile / tiles[0] * TILE + row) as f32 - splat.at[1];
                    if dy.abs() > splat.reach[1] {
                        continue;
                    }
                    for col in 0..TILE {
                        let dx = (tile % tiles[0] * TILE + col) as f32 - splat.at[0];
                        let (sum, through) = &mut pixels[row * TILE + col];
                        if dx.abs() > splat.reach[0] || *through < 1e-4 {
                            continue;
                        }
                        let [a, b, c] = splat.conic;
                        let power = a * dx * dx + b * dx * dy + c * dy * dy;
                        if power > 4.5 {
                            continue;
                        }
                        let weight = *through * splat.opacity * (-power).exp();
                        (0..3).for_each(|c| sum[c] += weight * splat.colour[c]);
                        *through -= weight;
                        if *through < 1e-4 {
                            open -= 1;
                        }
                    }
                }
                if open == 0 {
                    break;
                }
            }
            pixels
        })
        .collect();
    let place = |row: usize, col: usize| rendered[row / TILE * tiles[0] + col / TILE][row % TILE * TILE + col % TILE].0;
    (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| place(row, col)).collect::<Vec<_>>()).collect()
}

fn basis(d: Vec3) -> [f32; 16] {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_8,
        -0.488_602_5 * y,
        0.488_602_5 * z,
        -0.488_602_5 * x,
        1.092_548_4 * x * y,
        -1.092_548_4 * y * z,
        0.315_391_57 * (2.0 * zz - xx - yy),
        -1.092_548_4 * x * z,
        0.546_274_2 * (xx - yy),
        -0.590_043_6 * y * (3.0 * xx - yy),
        2.890_611_4 * x * y * z,
        -0.457_045_8 * y * (4.0 * zz - xx - yy),
        0.373_176_34 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_8 * x * (4.0 * zz - xx - yy),
        1.445_305_7 * z * (xx - yy),
        -0.590_043_6 * x * (xx - 3.0 * yy),
    ]
}

/// Returns the processor time of all threads since the start, in seconds. Other programs affect
/// this time less than they affect the elapsed time.
fn processor_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or("").split_whitespace().skip(11).take(2);
    // the numbers are in hundredths of a second
    fields.flat_map(str::parse::<f64>).sum::<f64>() / 100.0
}

/// Returns the peak resident memory since the start, in MB; 0 if the system does not report it.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    let kilobytes = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) / 1024.0
}
