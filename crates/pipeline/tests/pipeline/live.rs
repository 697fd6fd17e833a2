//! Light fields of a job whose files and settings change.

use std::path::Path;

use lumistack_core::Task;
use lumistack_display::LightField;
use lumistack_pipeline::{Job, LiveFields, Registry};

use crate::compose::with_task;

/// Two light fields are regarded as equally bright if the ratio of their means differs from 1 by
/// less than this value.
const SAME: f64 = 0.02;

/// Writes `triangle.gltf`: a triangle that emits this radiance, 0..1.
fn write_glowing(folder: &Path, radiance: f64) {
    let corners: Vec<u8> =
        [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    std::fs::write(folder.join("triangle.bin"), corners).unwrap();
    let text = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "materials": [{{"emissiveFactor": [{radiance}, {radiance}, {radiance}], "pbrMetallicRoughness": {{"baseColorFactor": [0, 0, 0, 1]}}}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "material": 0}}]}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 36}}], "buffers": [{{"byteLength": 36, "uri": "triangle.bin"}}]}}"#
    );
    std::fs::write(folder.join("triangle.gltf"), text).unwrap();
}

fn job(folder: &Path) -> Job {
    let path = folder.join("job.toml");
    let text = "scene = \"triangle.gltf\"\n[display]\npreset = \"fig7-uniform\"\nresolution = [24, 16]\nviews = [3, 3]\n\
        [render]\nsamples = 1\n[light]\nautomatic = false\n";
    std::fs::write(&path, text).unwrap();
    Job::load(&path).unwrap()
}

/// Returns the next light field.
fn shown(live_fields: &mut LiveFields, registry: &Registry, task: Task<'_>) -> LightField {
    live_fields.pass(registry, task).unwrap().expect("the content is new").field
}

fn mean(field: &LightField) -> f64 {
    let values = field.radiance().data();
    values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64
}

#[test]
fn a_scene_that_is_saved_again_is_exposed_again() {
    let (registry, folder) = (Registry::built_in().unwrap(), tempfile::tempdir().unwrap());
    let folder = folder.path();
    write_glowing(folder, 0.1);
    let job = job(folder);
    let new_live_fields = || LiveFields::new(job.clone(), &folder.join("cache")).unwrap();
    let mut live_fields = new_live_fields();
    with_task(|task| {
        let before = shown(&mut live_fields, &registry, task);
        assert!(mean(&before) > 0.01, "the triangle is seen");
        // With eight times the radiance, automatic exposure gives the same light field.
        write_glowing(folder, 0.8);
        live_fields.reload();
        let reloaded = shown(&mut live_fields, &registry, task);
        assert_eq!(reloaded, shown(&mut new_live_fields(), &registry, task));
        let change = mean(&reloaded) / mean(&before);
        assert!((change - 1.0).abs() < SAME, "brighter by {change}");
        // If files and settings are unchanged, there is no new light field.
        assert!(live_fields.pass(&registry, task).unwrap().is_none());
    });
}
