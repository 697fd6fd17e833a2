//! Tests scenes whose radiance is known exactly.

use crate::common::{
    self, Builder, cube, diffuse, glowing, long_paths, mean_of, one_view, render, sphere, window, window_at,
};
use glam::{DVec3, Vec3, Vec4};
use lumistack_pathtracer::Settings;
use lumistack_scene::{Anisotropy, Clearcoat, Material};
use lumistack_testkit::statistics::FALSE_ALARM_RATE;

/// Relative rounding error of f32 sums over long paths.
const ROUNDING: f64 = 2e-4;
/// Energy that microfacet surfaces may lose: the interpolation error of the albedo table.
const ALBEDO_TABLE: f64 = 5e-3;
/// Energy that a sphere of triangles may lose: its shading normals lean away from the surface, and
/// light from below the surface is lost.
const TRIANGLES: f64 = 1e-2;

/// Inside a closed room whose diffuse walls of albedo ρ all emit L, every point radiates L + ρL +
/// ρ²L + ... = L/(1 − ρ).
#[test]
fn a_closed_room_radiates_the_geometric_series() {
    for albedo in [0.0, 0.5, 0.8] {
        let mut scene = Builder::default();
        for wall in cube(Vec3::ZERO, 1.0) {
            scene.add(wall, Material { emission: Vec3::new(1.0, 0.5, 0.25), ..diffuse(albedo) });
        }
        // the near wall must not hide the room, so back faces are invisible
        for material in &mut scene.parts.materials {
            material.double_sided = false;
        }
        for mesh in &mut scene.parts.meshes {
            mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
            mesh.normals.iter_mut().for_each(|n| *n = -*n);
        }
        let radiance =
            render(&scene.renderer(), &window_at(DVec3::ZERO, 1.0), &one_view(32, [0.1, 0.2]), &long_paths(32));
        for (channel, emitted) in [1.0, 0.5, 0.25].into_iter().enumerate() {
            let expected = emitted / (1.0 - f64::from(albedo));
            mean_of(&radiance, channel).assert_is(expected, ROUNDING * expected, FALSE_ALARM_RATE);
        }
    }
}

/// If n bounces are allowed, the series L + ρL + ρ²L + … has n + 1 terms. Russian roulette does not
/// change that.
#[test]
fn the_limit_on_bounces_cuts_the_series() {
    let mut scene = Builder::default();
    scene.add(sphere(Vec3::ZERO, 1.5, 24), Material { emission: Vec3::ONE, ..diffuse(0.5) });
    scene.parts.materials[0].double_sided = false;
    scene.parts.meshes[0].triangles.iter_mut().for_each(|t| t.swap(1, 2));
    scene.parts.meshes[0].normals.iter_mut().for_each(|n| *n = -*n);
    let renderer = scene.renderer();
    for (max_bounces, expected) in [(0, 1.0), (1, 1.5), (2, 1.75), (3, 1.875)] {
        for roulette_start in [0, 100] {
            let settings = Settings { samples: 16, max_bounces, roulette_start, ..Settings::default() };
            let radiance = render(&renderer, &window(), &one_view(32, [0.0, 0.0]), &settings);
            mean_of(&radiance, 0).assert_is(expected, ROUNDING, FALSE_ALARM_RATE);
        }
    }
}

/// If all light is the same and nothing is absorbed, every surface looks like the background.
#[test]
fn lossless_spheres_are_invisible_in_a_uniform_environment() {
    let white = Material { base_color: Vec4::ONE, ..diffuse(1.0) };
    let metal = |roughness| Material { metallic: 1.0, roughness, ..white.clone() };
    let cases = [
        ("diffuse", white.clone(), ROUNDING),
        ("white plastic", Material { ior: 1.5, roughness: 0.3, ..white.clone() }, TRIANGLES),
        ("mirror", metal(0.0), ROUNDING),
        ("metal 0.2", metal(0.2), TRIANGLES),
        ("metal 0.5", metal(0.5), TRIANGLES),
        ("metal 1", metal(1.0), TRIANGLES),
        ("thin glass", Material { transmission: 1.0, ior: 1.5, roughness: 0.0, ..white.clone() }, ROUNDING),
        ("glass", Material { transmission: 1.0, ior: 1.5, roughness: 0.0, solid: true, ..white.clone() }, ROUNDING),
    ];
    for (name, material, tolerance) in cases {
        let mut scene = Builder::default();
        scene.add(sphere(Vec3::ZERO, 0.9, 64), material).sky(&[0.7]);
        let radiance = render(&scene.renderer(), &window(), &one_view(48, [0.0, 0.1]), &long_paths(32));
        let mean = mean_of(&radiance, 1);
        println!("{name}: {mean:?}");
        mean.assert_is(0.7, 0.7 * tolerance, FALSE_ALARM_RATE);
    }
}

/// A flat white metal returns all light of the environment at every roughness. Its shading normals
/// equal its geometric normal, so only the albedo table can be wrong.
#[test]
fn a_flat_white_metal_is_invisible_at_every_roughness() {
    for roughness in [0.05, 0.2, 0.4, 0.6, 0.8, 1.0] {
        for slope in [0.0, 1.0, 3.0] {
            let mut scene = Builder::default();
            let metal = Material { metallic: 1.0, roughness, ..diffuse(1.0) };
            scene.add(common::rectangle(Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::Y), metal).sky(&[1.0]);
            let radiance = render(&scene.renderer(), &window(), &one_view(32, [slope, 0.0]), &long_paths(64));
            mean_of(&radiance, 0).assert_is(1.0, ALBEDO_TABLE, FALSE_ALARM_RATE);
        }
    }
}

/// A sphere that absorbs light is darker than a lossless one. So the tests above would notice
/// absorption.
#[test]
fn an_absorbing_sphere_is_visible() {
    let mut scene = Builder::default();
    scene.add(sphere(Vec3::ZERO, 0.9, 32), diffuse(0.9)).sky(&[0.7]);
    let mean = mean_of(&render(&scene.renderer(), &window(), &one_view(32, [0.0, 0.0]), &long_paths(16)), 1);
    assert!(mean.z(0.7, 0.7 * TRIANGLES) > 20.0, "{mean:?}");
    scene.parts.materials[0] = glowing(Vec3::ZERO);
    let black = mean_of(&render(&scene.renderer(), &window(), &one_view(32, [0.0, 0.0]), &long_paths(16)), 1);
    // the disc of radius 0.9 covers π 0.9²/4 of the window
    black.assert_is(0.7 * (1.0 - std::f64::consts::PI * 0.81 / 4.0), 5e-3, 0.5);
}

/// Layers that absorb nothing are as invisible as the surface below them: coats with and without
/// roughness, stretched metal, rough glass, and glass that disperses.
#[test]
fn lossless_layers_are_invisible_in_a_uniform_environment() {
    let white = Material { base_color: Vec4::ONE, ..diffuse(1.0) };
    let coat = |roughness| Some(Clearcoat { factor: 1.0, roughness, ..Clearcoat::default() });
    let glass = Material { transmission: 1.0, ior: 1.5, roughness: 0.0, solid: true, ..white.clone() };
    let stretched = Some(Anisotropy { strength: 0.7, ..Anisotropy::default() });
    let cases = [
        ("coat", Material { clearcoat: coat(0.0), ..white.clone() }, TRIANGLES),
        ("rough coat", Material { clearcoat: coat(0.5), ..white.clone() }, TRIANGLES),
        (
            "stretched",
            Material { metallic: 1.0, roughness: 0.3, anisotropy: stretched, ..white.clone() },
            2.0 * TRIANGLES,
        ),
        ("rough glass", Material { roughness: 0.4, ..glass.clone() }, 2.0 * TRIANGLES),
        ("dispersion", Material { dispersion: 1.0, ..glass }, TRIANGLES),
    ];
    for (name, material, tolerance) in cases {
        let mut scene = Builder::default();
        scene.add(sphere(Vec3::ZERO, 0.9, 64), material).sky(&[0.7]);
        let radiance = render(&scene.renderer(), &window(), &one_view(48, [0.0, 0.1]), &long_paths(32));
        for channel in 0..3 {
            let mean = mean_of(&radiance, channel);
            println!("{name}: {mean:?}");
            mean.assert_is(0.7, 0.7 * tolerance, FALSE_ALARM_RATE);
        }
    }
}

/// A coat dims the emission below it: a clear coat of index 1.5 passes 1 − 0.04 of the emission
/// along its normal.
#[test]
fn a_coat_dims_emission() {
    let mut scene = Builder::default();
    let coat = Some(Clearcoat { factor: 1.0, ..Clearcoat::default() });
    let lamp = Material { clearcoat: coat, ..glowing(Vec3::ONE) };
    scene.add(common::rectangle(Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::Y), lamp);
    let settings = Settings { samples: 4, max_bounces: 4, ..Settings::default() };
    let radiance = render(&scene.renderer(), &window(), &one_view(8, [0.0, 0.0]), &settings);
    mean_of(&radiance, 0).assert_is(0.96, 2e-3, FALSE_ALARM_RATE);
}
