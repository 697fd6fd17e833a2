//! Writes clouds and views for `xtask/bench/splats_mitsuba.py`. That script traces the same rays
//! through the same Gaussians with Mitsuba 3.
//!
//! ```text
//! cargo bench -p lumistack-splats --bench agreement -- FOLDER
//! ```
//!
//! Lengths are in millimetres of display space. `apart` has few wide splats behind one another:
//! every way to measure their distance gives the same order, and no splat is narrower than a pixel.
//! `capture` has thousands of overlapping splats, as captures do.

use std::path::Path;
use std::sync::Arc;

use glam::{Affine3A, DQuat, DVec3, Quat, Vec3};
use lumistack_core::{Cancel, Cancelled, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_scene::{Cloud, PlacedCloud, SceneParts, Similarity, Window};
use lumistack_splats::{Renderer, SplatView, Wanted};
use serde_json::{Value, json};

const EYE_MM: f64 = 300.0;
const SLOPES: [[f64; 2]; 3] = [[0.0, 0.0], [0.12, -0.08], [-0.15, 0.1]];

fn main() {
    let folder = std::env::args().nth(1).expect("a folder");
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder).expect("a folder");
    let mut cases = Vec::new();
    for (name, cloud) in [("apart", apart()), ("capture", capture(20_000))] {
        for (kind, projection) in
            [("parallel", Projection::Oblique), ("from an eye", Projection::Perspective { distance_mm: EYE_MM })]
        {
            cases.push(write(folder, &format!("{name}, {kind}"), &cloud, projection));
        }
    }
    std::fs::write(folder.join("cases.json"), Value::from(cases).to_string()).expect("a file");
}

/// Renders the views of a cloud, and writes cloud and views to files.
fn write(folder: &Path, name: &str, cloud: &Cloud, projection: Projection) -> Value {
    let geometry = FieldGeometry { rows: 100, cols: 150, pitch_mm: 1.0, grid: ViewGrid::single(projection, [0.0; 2]) };
    let map = Similarity { rotation: DQuat::IDENTITY, scale: 1.0, translation: DVec3::ZERO };
    let window = Window { scene_from_display: map, size_mm: geometry.size_mm(), near_mm: None };
    let placed_clouds = vec![PlacedCloud { cloud: 0, scene_from_cloud: Affine3A::IDENTITY }];
    let parts = SceneParts { clouds: vec![cloud.clone()], placed_clouds, ..SceneParts::default() };
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let scene = Arc::new(parts.validate(task).expect("a scene"));
    let file = |part: &str, values: &[f32]| -> String {
        let name = format!("{}-{part}.f32", name.replace([' ', ','], "-"));
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        std::fs::write(folder.join(&name), bytes).expect("a file");
        name
    };
    // Put the attributes of each splat into one row, as the script reads them.
    let cloud = &scene.clouds[0];
    let mut rows = Vec::new();
    for i in 0..cloud.len() {
        rows.extend(cloud.positions[i].to_array());
        rows.extend(cloud.scales[i].to_array());
        rows.extend(cloud.rotations[i].to_array());
        rows.push(cloud.opacities[i]);
        rows.extend(&cloud.harmonics[3 * cloud.coefficients() * i..][..3 * cloud.coefficients()]);
    }
    let mut views = Vec::new();
    let renderer = Renderer::new(scene.clone()).expect("splats");
    let none = |_: usize| Ok::<_, Cancelled>(None);
    let done = |number: usize, view: SplatView| {
        views.push(json!({"slope": SLOPES[number], "ours": file(&number.to_string(), view.light.data())}));
        Ok(())
    };
    renderer.render(&window, &geometry, &SLOPES, &none, Wanted::Light, task, done).expect("views");
    let eye_mm = matches!(projection, Projection::Perspective { .. }).then_some(EYE_MM);
    json!({
        "name": name, "rows": geometry.rows, "cols": geometry.cols, "pitch_mm": geometry.pitch_mm, "eye_mm": eye_mm,
        "count": cloud.len(), "splats": file("splats", &rows), "views": views,
    })
}

/// Returns a function that returns random numbers from 0 to 1.
fn random(mut state: u64) -> impl FnMut() -> f32 {
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    }
}

fn push(cloud: &mut Cloud, at: Vec3, turn: Quat, scale: Vec3, opacity: f32, harmonics: [f32; 12]) {
    cloud.positions.push(at);
    cloud.rotations.push(turn);
    cloud.scales.push(scale);
    cloud.opacities.push(opacity);
    cloud.harmonics.extend(harmonics);
}

/// Makes discs that face the viewer, 6 mm behind one another.
fn apart() -> Cloud {
    let mut next = random(3);
    let mut cloud = Cloud { degree: 1, ..Cloud::default() };
    for i in 0..24 {
        let at = Vec3::new(30.0 * next() - 15.0, 30.0 * next() - 15.0, 6.0 * i as f32 - 72.0);
        let scale = Vec3::new(4.0 + 8.0 * next(), 4.0 + 8.0 * next(), 0.3);
        let turn = Quat::from_rotation_z(std::f32::consts::TAU * next());
        let opacity = 0.1 + 0.2 * next();
        push(&mut cloud, at, turn, scale, opacity, std::array::from_fn(|_| next() - 0.5));
    }
    cloud
}

/// Makes flat splats on three bumpy shells. Splats are about as large as the distance to their
/// neighbours.
fn capture(count: usize) -> Cloud {
    let mut next = random(7);
    let mut cloud = Cloud { degree: 1, ..Cloud::default() };
    for i in 0..count {
        let (turn, z) = (std::f32::consts::TAU * next(), 2.0 * next() - 1.0);
        let flat = (1.0 - z * z).sqrt();
        let normal = Vec3::new(flat * turn.cos(), flat * turn.sin(), z);
        let bump = 2.0 * (9.0 * normal.x).sin() * (11.0 * normal.y).cos();
        let at = (15.0 + 15.0 * (i % 3) as f32 + bump) * normal;
        let size = 0.4 + 1.2 * next();
        let scale = Vec3::new(size, size * (0.4 + next()), 0.1 * size);
        let opacity = if next() < 0.3 { 0.1 * next() } else { 0.4 + 0.6 * next() };
        let mut harmonics: [f32; 12] = std::array::from_fn(|_| 0.2 * (next() - 0.5));
        harmonics[..3].copy_from_slice(&[normal.x, normal.y, (i % 3) as f32 - 1.0].map(|value| 1.2 * value));
        push(&mut cloud, at, Quat::from_rotation_arc(Vec3::Z, normal), scale, opacity, harmonics);
    }
    cloud
}
