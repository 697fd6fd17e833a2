//! Measures rays per second of the tree alone, and of Embree on the same rays and threads. Beams
//! and Embree's packets consist of rays through neighbouring pixels (`primary`), or of rays through
//! one pixel (`pixels`), as in the path tracer.

use std::path::Path;
use std::time::Instant;

use glam::{DVec3, Vec3};
use lumistack_core::seed::Stream;
use lumistack_display::Projection;
use lumistack_pathtracer::rays::{BEAM_RAYS, Tree};
use rayon::prelude::*;

use crate::case::{Case, Outcome};
#[cfg(unix)]
use crate::embree::Embree;

/// Number of rays per unit of work.
const CHUNK: usize = 4096;
/// Distance of a ray's origin from the surface that it leaves, as a fraction of the scene's size.
const OFFSET: f32 = 1e-5;

/// Origins, directions and largest t.
type Rays = Vec<(Vec3, Vec3, f32)>;

/// Rays that are timed together.
struct Batch {
    name: &'static str,
    kind: Kind,
    rays: Rays,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// Successive rays are neighbours; they are traced one by one, as beams and as packets.
    Coherent,
    /// The nearest hits of rays in all directions.
    Scattered,
    /// Any hit on a segment.
    Shadow,
}

/// Prints millions of rays per second for primary rays, two bounces and shadow rays. Each value is
/// the fastest of several rounds, since other programs only make a round slower.
pub fn measure(case: &Case, embree: Option<&Path>, rounds: usize) -> Outcome {
    // build our tree, and Embree's if its library was given
    let triangles = world_triangles(case);
    let start = Instant::now();
    let tree = Tree::new(&triangles);
    let seconds = start.elapsed().as_secs_f64();
    println!(
        "\n{}: {} triangles in one tree, built in {seconds:.2} s, {:.0} bytes per triangle",
        case.name,
        triangles.len(),
        tree.bytes() as f64 / triangles.len() as f64
    );
    #[cfg(unix)]
    let peer = match embree.map(|library| Embree::new(library, &triangles)) {
        Some(Ok(peer)) => Some(peer),
        Some(Err(error)) => {
            println!("Embree is left out: {error}");
            None
        }
        None => None,
    };
    #[cfg(not(unix))]
    let _ = embree;
    // prepare the batches of rays, and a list of rates for each
    let batches = batches(case, &tree, &triangles);
    println!(
        "Mrays/s                    {}",
        batches.iter().map(|batch| format!("{:>10}", batch.name)).collect::<String>()
    );
    let mut ours = vec![Vec::new(); batches.len()];
    let mut single = vec![Vec::new(); batches.len()];
    let coherent = batches.iter().filter(|batch| batch.kind == Kind::Coherent).count();
    let mut beams = vec![Vec::new(); coherent];
    let mut packets = vec![Vec::new(); coherent];
    let mut differing = 0usize;
    // alternate between both libraries, so that other programs slow both equally
    for _ in 0..rounds {
        for (index, Batch { kind, rays, .. }) in batches.iter().enumerate() {
            let (shadow, coherent) = (*kind == Kind::Shadow, *kind == Kind::Coherent);
            let (seconds, own_hits) = timed(rays, |chunk| {
                let mut scratch = tree.scratch();
                let hits = |&(o, d, t): &(Vec3, Vec3, f32)| {
                    if shadow {
                        !tree.is_open(o, d, t, &mut scratch)
                    } else {
                        tree.nearest(o, d, t, &mut scratch).is_some()
                    }
                };
                chunk.iter().map(hits).filter(|&hit| hit).count()
            });
            ours[index].push(rays.len() as f64 / seconds * 1e-6);
            if coherent {
                let (seconds, hits) = timed(rays, |chunk| {
                    let mut scratch = tree.scratch();
                    let beam = |rays: &[(Vec3, Vec3, f32)]| {
                        tree.hits_of_beam(rays.iter().map(|&(o, d, _)| (o, d)), &mut scratch)
                    };
                    chunk.chunks(BEAM_RAYS).map(beam).sum()
                });
                beams[index].push(rays.len() as f64 / seconds * 1e-6);
                differing = differing.max(hits.abs_diff(own_hits));
            }
            #[cfg(unix)]
            if let Some(peer) = &peer {
                let (seconds, hits) = timed(rays, |chunk| {
                    let hits = |&(o, d, t): &(Vec3, Vec3, f32)| {
                        if shadow { !peer.is_open(o, d, t) } else { peer.nearest(o, d, t).is_some() }
                    };
                    chunk.iter().map(hits).filter(|&hit| hit).count()
                });
                single[index].push(rays.len() as f64 / seconds * 1e-6);
                differing = differing.max(hits.abs_diff(own_hits));
                if coherent {
                    let (seconds, _) = timed(rays, |chunk| chunk.chunks(8).map(|rays| peer.nearest8(rays)).sum());
                    packets[index].push(rays.len() as f64 / seconds * 1e-6);
                }
            }
        }
    }
    // print the fastest rate of every batch
    let row = |name: &str, values: &mut [Vec<f64>]| {
        let fastest = |values: &mut Vec<f64>| {
            let fastest = values.iter().copied().fold(f64::NAN, f64::max);
            format!("{fastest:10.1}")
        };
        println!("{name:<27}{}", values.iter_mut().map(fastest).collect::<String>());
    };
    row("Lumistack, single rays", &mut ours);
    row(&format!("Lumistack, beams of {BEAM_RAYS}"), &mut beams);
    if packets.iter().any(|packets| !packets.is_empty()) {
        row("Embree, single rays", &mut single);
        row("Embree, 8 coherent rays", &mut packets);
        println!("largest difference in the number of hits: {differing} of {}", batches[0].rays.len());
    }
    Ok(())
}

fn timed(rays: &Rays, trace: impl Fn(&[(Vec3, Vec3, f32)]) -> usize + Sync + Send) -> (f64, usize) {
    let start = Instant::now();
    let hits: usize = rays.par_chunks(CHUNK).map(trace).sum();
    (start.elapsed().as_secs_f64(), hits)
}

fn world_triangles(case: &Case) -> Vec<[Vec3; 3]> {
    let mut triangles = Vec::with_capacity(case.scene.triangle_count());
    for instance in &case.scene.instances {
        let mesh = &case.scene.meshes[instance.mesh];
        let place = |i: u32| instance.scene_from_mesh.transform_point3(mesh.positions[i as usize]);
        triangles.extend(mesh.triangles.iter().map(|corners| corners.map(place)));
    }
    triangles
}

/// Returns rays as in a path tracer: a ray through every pixel, and many samples of some pixels.
/// Also returns rays that are scattered by Lambert's law, and rays from the first hits to the
/// light.
fn batches(case: &Case, tree: &Tree, triangles: &[[Vec3; 3]]) -> Vec<Batch> {
    let mut stream = Stream::new(1);
    let geometry = &case.geometry;
    let map = &case.window.scene_from_display;
    let Projection::Perspective { distance_mm } = geometry.grid.projection else { return Vec::new() };
    let eye = map.point(DVec3::new(0.0, 0.0, distance_mm));
    let mut through = |row: usize, col: usize| {
        let x = geometry.x_mm(0) + geometry.pitch_mm * (col as f64 + f64::from(stream.next_f32()) - 0.5);
        let y = geometry.y_mm(0) - geometry.pitch_mm * (row as f64 + f64::from(stream.next_f32()) - 0.5);
        let direction = (map.point(DVec3::new(x, y, 0.0)) - eye).normalize();
        (eye.as_vec3(), direction.as_vec3(), f32::INFINITY)
    };
    let (mut primary, mut pixels) = (Vec::new(), Vec::new());
    // the pixels are ordered in tiles of 4 × 2, so that a packet of eight rays is one tile
    for tile_row in 0..geometry.rows.div_ceil(2) {
        for tile_col in 0..geometry.cols.div_ceil(4) {
            primary.extend((0..8).map(|at| through(2 * tile_row + at / 4, 4 * tile_col + at % 4)));
        }
    }
    // many samples for every fourth pixel of every fourth row
    for row in (0..geometry.rows).step_by(4) {
        for col in (0..geometry.cols).step_by(4) {
            pixels.extend((0..BEAM_RAYS).map(|_| through(row, col)));
        }
    }
    let mut scratch = tree.scratch();
    let mut scatter = |rays: &Rays| -> (Rays, Rays) {
        let (mut scattered, mut shadow) = (Vec::new(), Vec::new());
        for &(origin, direction, t_max) in rays {
            let Some((t, triangle)) = tree.nearest(origin, direction, t_max, &mut scratch) else { continue };
            let [a, b, c] = triangles[triangle as usize];
            let normal = (b - a).cross(c - a).normalize();
            let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
            let from = origin + t * direction + OFFSET * case.size() * normal;
            let (z, turns) = (2.0 * stream.next_f32() - 1.0, stream.next_f32());
            let (sin, cos) = (turns * std::f32::consts::TAU).sin_cos();
            let ring = (1.0 - z * z).max(0.0).sqrt();
            scattered.push((from, (normal + Vec3::new(ring * cos, ring * sin, z)).normalize_or(normal), f32::INFINITY));
            shadow.push((from, case.point_of_light([stream.next_f32(), stream.next_f32()]) - from, 0.999));
        }
        (scattered, shadow)
    };
    let (first, shadow) = scatter(&primary);
    let (second, _) = scatter(&first);
    let batch = |name, kind, rays| Batch { name, kind, rays };
    vec![
        batch("primary", Kind::Coherent, primary),
        batch("pixels", Kind::Coherent, pixels),
        batch("bounce 1", Kind::Scattered, first),
        batch("bounce 2", Kind::Scattered, second),
        batch("shadow", Kind::Shadow, shadow),
    ]
}
