//! `KHR_gaussian_splatting`, by the text of the extension, and its SPZ compression.

use crate::support::{self, Builder, U8, load, scene};
use glam::{Quat, Vec3};
use lumistack_scene::{Cloud, Encoding};
use serde_json::{Value, json};

const COUNT: usize = 3;

fn own(name: &str) -> String {
    format!("KHR_gaussian_splatting:{name}")
}

/// Returns three splats with spherical harmonics of the given degree, on a node that is moved and
/// rotated.
fn splats(degree: usize) -> Builder {
    let mut b = Builder::new();
    let mut attributes = json!({
        "POSITION": b.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0]),
    });
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let rotations = [0.0, 0.0, 0.0, 1.0, half, 0.0, 0.0, half, 0.0, 1.0, 0.0, 0.0];
    attributes[own("ROTATION")] = b.floats("VEC4", &rotations).into();
    attributes[own("SCALE")] = b.floats("VEC3", &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.0]).into();
    attributes[own("OPACITY")] = b.accessor(U8, "SCALAR", COUNT, &[255, 51, 0]).into();
    let opacities = attributes[own("OPACITY")].as_u64().unwrap();
    b.set(&format!("/accessors/{opacities}/normalized"), true.into());
    for l in 0..=degree {
        for m in 0..2 * l + 1 {
            let values: Vec<f32> = (0..3 * COUNT).map(|i| (100 * l + 10 * m + i) as f32 / 1000.0).collect();
            attributes[own(&format!("SH_DEGREE_{l}_COEF_{m}"))] = b.floats("VEC3", &values).into();
        }
    }
    let extension = json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display"});
    let primitive = json!({"mode": 0, "attributes": attributes, "extensions": {"KHR_gaussian_splatting": extension}});
    b.push("meshes", json!({"primitives": [primitive]}));
    b.push("nodes", json!({"mesh": 0, "translation": [0, 0, 5], "rotation": [0, half, 0, half]}));
    b.push("scenes", json!({"nodes": [0]}));
    b.set("/extensionsUsed", json!(["KHR_gaussian_splatting"]));
    b.set("/extensionsRequired", json!(["KHR_gaussian_splatting"]));
    b
}

const PRIMITIVE: &str = "/meshes/0/primitives/0";

fn extension(key: &str) -> String {
    format!("{PRIMITIVE}/extensions/KHR_gaussian_splatting/{key}")
}

#[test]
fn accessors_become_a_cloud() {
    for degree in 0..=3 {
        let scene = scene(&splats(degree));
        assert_eq!((scene.splat_count(), scene.triangle_count()), (COUNT, 0));
        let cloud = &scene.clouds[0];
        assert_eq!((cloud.degree, cloud.encoding, cloud.place.as_str()), (degree, Encoding::Srgb, PRIMITIVE));
        assert_eq!(cloud.scales[1], Vec3::new(0.4, 0.5, 0.6));
        assert_eq!(cloud.opacities, [1.0, 0.2, 0.0]);
        assert!((cloud.rotations[1] * Vec3::Y - Vec3::Z).length() < 1e-6);
        // the harmonics of a cloud are `[splat][coefficient][rgb]`
        let coefficients = (degree + 1).pow(2);
        for (i, rgb) in cloud.harmonics.chunks_exact(3).enumerate() {
            let (splat, coefficient) = (i / coefficients, i % coefficients);
            let l = (coefficient as f64).sqrt() as usize;
            let first = (100 * l + 10 * (coefficient - l * l) + 3 * splat) as f32;
            for (c, value) in rgb.iter().enumerate() {
                assert!((value - (first + c as f32) / 1000.0).abs() < 1e-6, "{degree} {i} {rgb:?}");
            }
        }
        let at: Vec<Vec3> = scene.splat_positions().collect();
        assert!((at[1] - Vec3::new(0.0, 0.0, 4.0)).length() < 1e-6, "{at:?}");
    }
}

#[test]
fn splats_stand_beside_meshes_and_are_placed_often() {
    let mut b = splats(0);
    let positions = b.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    b.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(json!({"attributes": {"POSITION": positions}}));
    b.push("nodes", json!({"mesh": 0, "scale": [2, 2, 2]}));
    b.set("/scenes/0/nodes", json!([0, 1]));
    let scene = scene(&b);
    assert_eq!((scene.splat_count(), scene.clouds.len(), scene.triangle_count()), (2 * COUNT, 1, 2));
    assert_eq!(scene.splat_positions().last(), Some(Vec3::new(0.0, 4.0, 0.0)));
}

#[test]
fn what_is_not_known_is_taken_for_what_is() {
    let mut b = splats(0);
    b.set(&extension("colorSpace"), "lin_rec709_display".into());
    assert_eq!(scene(&b).clouds[0].encoding, Encoding::Linear);
    b.set(&extension("colorSpace"), "other".into()).set(&extension("kernel"), "box".into());
    b.set(&extension("sortingMethod"), "depth".into());
    let (scene, warnings) = load(&b.glb());
    assert_eq!(scene.unwrap().splat_count(), COUNT);
    for part in [
        "found `other`; srgb_rec709_display is used",
        "found `box`; `ellipse` is used",
        "found `depth`; `cameraDistance` is used",
    ] {
        assert!(warnings.iter().any(|warning| warning.contains(part)), "{part}: {warnings:?}");
    }
}

#[test]
fn broken_splats_are_refused_or_left_out() {
    let refused = |change: &dyn Fn(&mut Builder), part: &str| {
        let mut b = splats(1);
        change(&mut b);
        let error = support::error(&b);
        assert!(error.contains(part), "{error:?} lacks {part:?}");
    };
    let attribute = |name: &str| format!("{PRIMITIVE}/attributes/{}", own(name));
    refused(
        &|b| {
            b.set(&format!("{PRIMITIVE}/mode"), 4.into());
        },
        "0 (POINTS)",
    );
    for name in ["ROTATION", "SCALE", "OPACITY"] {
        refused(
            &|b| {
                b.remove(&attribute(name));
            },
            "an attribute that splats need",
        );
        refused(
            &|b| {
                b.set(&attribute(name), 99.into());
            },
            "an index below",
        );
        refused(
            &|b| {
                b.set(&attribute(name), (-1).into());
            },
            "found integer `-1`",
        );
    }
    refused(
        &|b| {
            b.remove(&attribute("SH_DEGREE_1_COEF_2"));
        },
        "every coefficient of degree 1 (3 in all)",
    );
    refused(
        &|b| {
            b.remove(&attribute("SH_DEGREE_0_COEF_0"));
        },
        "every coefficient of degree 0 (1 in all)",
    );
    let fewer = |b: &mut Builder| {
        let scales = b.floats("VEC3", &[1.0; 6]);
        b.set(&attribute("SCALE"), scales.into());
    };
    refused(&fewer, "3 elements, as POSITION has");
    // a splat with an impossible value is left out, and the other splats stay
    for (name, kind, values) in [
        ("SCALE", "VEC3", [0.1, f32::NAN, 0.1, 1.0, 1.0, 1.0, -1.0, 1.0, 1.0].as_slice()),
        ("ROTATION", "VEC4", &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, f32::INFINITY, 0.0, 0.0, 1.0]),
        ("OPACITY", "SCALAR", &[1.5, 0.5, f32::NAN]),
        ("SH_DEGREE_1_COEF_0", "VEC3", &[f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, f32::INFINITY, 0.0]),
    ] {
        let mut b = splats(1);
        let accessor: Value = b.floats(kind, values).into();
        b.set(&attribute(name), accessor);
        let (scene, warnings) = load(&b.glb());
        let scene = scene.unwrap();
        assert_eq!((scene.splat_count(), scene.clouds[0].harmonics.len()), (1, 12), "{name}");
        assert!(warnings.iter().any(|w| w.contains("splats left out: 2 of 3")), "{name}: {warnings:?}");
        assert!(scene.clouds[0].rotations[0].is_normalized());
    }
    let mut b = splats(0);
    let opacities = b.floats("SCALAR", &[-1.0, 2.0, f32::NAN]);
    b.set(&attribute("OPACITY"), opacities.into());
    assert!(support::error(&b).contains("expected at least one splat that is a Gaussian"), "{}", support::error(&b));
}

#[test]
fn an_spz_stream_goes_before_accessors() {
    let cloud = Cloud {
        positions: vec![Vec3::new(1.0, 2.0, 3.0), Vec3::ZERO],
        rotations: vec![Quat::from_rotation_x(0.5), Quat::IDENTITY],
        scales: vec![Vec3::splat(0.1), Vec3::splat(0.2)],
        opacities: vec![1.0, 0.2],
        harmonics: vec![0.5; 6],
        ..Cloud::default()
    };
    let mut b = splats(2);
    let view = b.view(&lumistack_splats::write::spz(&cloud).unwrap());
    b.set(&extension("extensions"), json!({"KHR_gaussian_splatting_compression_spz_2": {"bufferView": view}}));
    b.set("/extensionsRequired", json!(["KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"]));
    b.set("/nodes/0", json!({"mesh": 0}));
    let scene = scene(&b);
    assert_eq!((scene.splat_count(), scene.clouds[0].degree), (2, 0));
    // SPZ has x right, y up and z back; glTF has x left, y up and z front, so x and z change their
    // signs
    let first = scene.splat_positions().next().unwrap();
    assert!((first - Vec3::new(-1.0, 2.0, -3.0)).length() < 1e-3, "{first}");
    let broken = b.view(&[0; 100]);
    b.set(&extension("extensions/KHR_gaussian_splatting_compression_spz_2/bufferView"), broken.into());
    assert!(support::error(&b).contains("NGSP"), "{}", support::error(&b));
}
