//! Imports captures of Gaussian splats through the plugin's C function, reads the result with the
//! glTF reader, and compares renders.

use std::sync::Arc;

use glam::{DVec3, Quat, Vec3};
use lumistack_core::{Cancel, Cancelled, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_gltf::AssetResolver;
use lumistack_plugin::PluginError;
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin_splats::PLUGIN;
use lumistack_plugin_testkit::serve::{Plugin, import, resolved};
use lumistack_plugin_testkit::{MemoryHost, conformance, import_conformance};
use lumistack_scene::{Cloud, Scene, Window};
use lumistack_splats::{Renderer, SplatView, Wanted, glb, write};

struct NoFiles;

impl AssetResolver for NoFiles {
    fn read(&self, uri: &str, _max_bytes: u64) -> Result<Vec<u8>, String> {
        Err(format!("no file {uri}"))
    }
}

/// Returns a bumpy ball of flat splats, whose colours depend on the viewing direction. y is up.
fn ball() -> Cloud {
    let mut cloud = Cloud { degree: 1, ..Cloud::default() };
    for i in 0..2000 {
        let z = 1.0 - 2.0 * (i as f32 + 0.5) / 2000.0;
        let turn = 2.399_963 * i as f32;
        let normal = Vec3::new((1.0 - z * z).sqrt() * turn.cos(), z, (1.0 - z * z).sqrt() * turn.sin());
        cloud.positions.push((1.0 + 0.1 * (5.0 * turn).sin() + 0.3 * normal.y) * normal);
        cloud.rotations.push(Quat::from_rotation_arc(Vec3::Z, normal));
        cloud.scales.push(Vec3::new(0.06, 0.04, 0.01));
        cloud.opacities.push(0.5 + 0.4 * normal.x.abs());
        cloud.harmonics.extend([1.5 * normal.y, normal.x, -normal.z]);
        cloud.harmonics.extend([0.2, 0.0, 0.1, -0.3, 0.2, 0.0, 0.1, 0.1, -0.2]);
    }
    cloud
}

/// Converts a cloud to the axes of training programs, where y points down and z away from the
/// viewer. Positions, rotations and harmonics are turned by half a turn about x.
fn as_trained(cloud: &Cloud) -> Cloud {
    let mut turned = cloud.clone();
    let turn = Quat::from_xyzw(1.0, 0.0, 0.0, 0.0);
    turned.positions.iter_mut().for_each(|at| *at = turn * *at);
    turned.rotations.iter_mut().for_each(|rotation| *rotation = turn * *rotation);
    for splat in turned.harmonics.chunks_exact_mut(12) {
        // The harmonics of degree 1 and orders −1 and 0 are proportional to y and z. So their
        // coefficients change sign.
        splat[3..9].iter_mut().for_each(|value| *value = -*value);
    }
    turned
}

fn document(file: &str, bytes: &[u8], params: &Value) -> Result<Vec<u8>, PluginError> {
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    let read = |path: &str| match path == file {
        true => Ok(bytes.to_vec()),
        false => Err(PluginError::Failed(format!("no file {path}"))),
    };
    import(&plugin, &MemoryHost::new(), &resolved(&plugin, params)?, file, &read)
}

fn loaded(document: &[u8]) -> Arc<Scene> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let scene = lumistack_gltf::load("a.glb", document, &NoFiles, Task::quiet(&warnings, &cancel)).unwrap();
    assert!(warnings.take().is_empty());
    Arc::new(scene)
}

fn scene(file: &str, bytes: &[u8], params: &Value) -> Arc<Scene> {
    loaded(&document(file, bytes, params).unwrap())
}

/// Renders views of a scene from the side.
fn pictures(scene: &Arc<Scene>) -> Vec<f32> {
    let grid = ViewGrid::uniform(Projection::Perspective { distance_mm: 500.0 }, [2, 2], [20.0, 20.0]).unwrap();
    let geometry = FieldGeometry { rows: 60, cols: 80, pitch_mm: 3.0, grid };
    let forward = DVec3::new(-0.4, -0.3, -1.0);
    let window = Window::given(DVec3::ZERO, forward, DVec3::Y, 4.0, geometry.size_mm()).unwrap();
    let slopes: Vec<[f64; 2]> =
        geometry.grid.iter().map(|[y, x]| [geometry.grid.slope_x[x], geometry.grid.slope_y[y]]).collect();
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let mut all = Vec::new();
    let none = |_: usize| Ok::<_, Cancelled>(None);
    let done = |_: usize, view: SplatView| {
        all.extend_from_slice(view.light.data());
        Ok(())
    };
    let renderer = Renderer::new(scene.clone()).unwrap();
    let task = Task::quiet(&warnings, &cancel);
    renderer.render(&window, &geometry, &slopes, &none, Wanted::Light, task, done).unwrap();
    all
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    -10.0 * (squares / a.len() as f64).log10()
}

#[test]
fn conforms() {
    conformance(&PLUGIN).unwrap();
    let plugin = Plugin::compiled_in(&PLUGIN).unwrap();
    import_conformance(&plugin, "a.ply", &[("a.ply", &write::ply(&ball()))]).unwrap();
}

#[test]
fn one_cloud_looks_the_same_from_every_file() {
    let ball = ball();
    let original = pictures(&loaded(&glb(&ball, [0.0, 0.0, 0.0, 1.0], 1.0).unwrap()));
    assert!(original.chunks_exact(4).filter(|pixel| pixel[3] < 0.5).count() > 3000, "the ball is visible");
    let from_ply = pictures(&scene("a.ply", &write::ply(&as_trained(&ball)), &json!({})));
    let quality = psnr(&original, &from_ply);
    assert!(quality > 70.0, "{quality} dB");
    // .spz stores colours and logarithms of scales in eight bits, so its pictures differ a little.
    let from_spz = pictures(&scene("a.spz", &write::spz(&ball).unwrap(), &json!({})));
    let quality = psnr(&original, &from_spz);
    assert!(quality > 42.0, "{quality} dB");
    // With the wrong upward axis the pictures must differ much.
    let other = pictures(&scene("a.spz", &write::spz(&ball).unwrap(), &json!({"up": "-y"})));
    assert!(psnr(&original, &other) < 25.0);
}

#[test]
fn up_and_scale_place_the_splats() {
    let ply = write::ply(&ball());
    let bounds = |params: Value| scene("a.ply", &ply, &params).bounds();
    let upright = bounds(json!({"up": "y"}));
    assert!(upright.max.y > 1.2 && upright.min.y > -0.95, "{upright:?}");
    assert!(bounds(json!({})).min.y < -1.2, "the default axis of .ply is -y, so the import turns the ball upside down");
    let on_its_back = bounds(json!({"up": "z", "scale": 10.0}));
    assert!(on_its_back.min.z < -12.0, "{on_its_back:?}");
    assert!(bounds(json!({"up": "-z"})).max.z > 1.2);
    let error = document("a.ply", &ply[..500], &json!({})).unwrap_err().to_string();
    assert!(error.contains("a.ply: header"), "{error}");
}
