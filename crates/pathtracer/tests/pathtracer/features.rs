//! Tests the denoiser's guides on scenes whose first hits are known.

use crate::common::{Builder, diffuse, glowing, one_view, rectangle, window};
use glam::{Quat, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_pathtracer::{Feature, Features, PixelSet, Settings, SplitView};
use lumistack_scene::{AlphaMode, Material};

fn features(builder: &Builder, size: usize, slope: [f64; 2]) -> Features {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let geometry = one_view(size, slope);
    let settings = Settings { samples: 16, ..Settings::default() };
    builder.renderer().render_features(&window(), &geometry, [0, 0], &settings, task).unwrap()
}

#[test]
fn depth_normal_and_reflectance_are_those_of_the_first_surface() {
    let mut builder = Builder::default();
    let turn = Quat::from_rotation_y(0.4);
    let metal = Material { base_color: Vec4::new(0.9, 0.6, 0.3, 1.0), metallic: 1.0, roughness: 0.5, ..diffuse(0.5) };
    builder.add(rectangle(Vec3::new(0.0, 0.0, -0.2), turn * (4.0 * Vec3::X), 4.0 * Vec3::Y), metal);
    // the first surface hides this surface
    builder.add(rectangle(Vec3::new(0.0, 0.0, -3.0), 9.0 * Vec3::X, 9.0 * Vec3::Y), diffuse(0.1));
    let (size, slope) = (16, [0.25, -0.1]);
    let found = features(&builder, size, slope);
    let geometry = one_view(size, slope);
    let normal = turn * Vec3::Z;
    for row in 0..size {
        for col in 0..size {
            let Feature { covered, albedo, normal: seen, z_mm, gloss, alpha, central_z_mm } = found.at(row, col);
            assert_eq!((covered, gloss, alpha), (1.0, 1.0, 0.25));
            assert!((albedo - Vec3::new(0.9, 0.6, 0.3)).abs().max_element() < 1e-5, "{albedo}");
            assert!((seen - normal).length() < 1e-5, "{seen}");
            // (x + s z, y, z) is on the plane through (0, 0, −0.2) with the normal `normal`
            let [nx, nz] = [f64::from(normal.x), f64::from(normal.z)];
            let z = (-0.2 * nz - geometry.x_mm(col) * nx) / (nz + slope[0] * nx);
            // rays are spread over the pixel, so the mean of 16 stratified rays is off the pixel's
            // centre by a small fraction of its size
            assert!((f64::from(z_mm) - z).abs() < 0.2 * geometry.pitch_mm, "{z_mm} {z}");
            // one of 16 stratified samples is within a quarter of a pixel of the centre along each
            // axis
            let central = f64::from(central_z_mm.unwrap());
            assert!((central - z).abs() < 0.3 * geometry.pitch_mm, "{central} {z}");
        }
    }
}

#[test]
fn a_pixel_at_an_edge_tells_its_share() {
    let mut builder = Builder::default();
    // the rectangle covers the right half of the window, and a quarter of the column of pixels next
    // to it
    let size = 8;
    let pitch = 2.0 / size as f32;
    builder.add(
        rectangle(Vec3::new(0.5 - 0.125 * pitch, 0.0, 0.0), (0.5 + 0.125 * pitch) * Vec3::X, Vec3::Y),
        diffuse(0.3),
    );
    let found = features(&builder, size, [0.0; 2]);
    for row in 0..size {
        let share = |col| found.at(row, col).covered;
        assert_eq!((share(0), share(2), share(5)), (0.0, 0.0, 1.0));
        assert_eq!(share(3), 0.25, "16 samples are stratified into 16 columns");
        assert_eq!(
            found.at(row, 0),
            Feature {
                covered: 0.0,
                albedo: Vec3::ZERO,
                normal: Vec3::ZERO,
                z_mm: 0.0,
                gloss: 0.0,
                alpha: 0.0,
                central_z_mm: None,
            }
        );
    }
}

/// Returns a scene with surfaces of every kind: metal, plastic, diffuse, unlit, transparent,
/// glowing.
fn mixture() -> Builder {
    let mut builder = Builder::default();
    let metal = Material { base_color: Vec4::new(0.9, 0.6, 0.3, 1.0), metallic: 1.0, roughness: 0.2, ..diffuse(0.5) };
    let plastic = Material { base_color: Vec4::new(0.2, 0.4, 0.9, 1.0), roughness: 0.3, ior: 1.5, ..diffuse(0.5) };
    let unlit = Material { unlit: true, base_color: Vec4::new(0.3, 0.9, 0.5, 1.0), ..diffuse(0.5) };
    let veil = Material { base_color: Vec4::new(0.8, 0.2, 0.2, 0.5), alpha_mode: AlphaMode::Blend, ..diffuse(0.5) };
    let turned = |angle: f32| Quat::from_rotation_y(angle) * (0.3 * Vec3::X);
    for (number, material) in
        [metal, plastic, diffuse(0.7), unlit, veil, glowing(Vec3::splat(2.0))].into_iter().enumerate()
    {
        let x = 0.35 * number as f32 - 0.9;
        builder.add(rectangle(Vec3::new(x, 0.0, 0.1 * x), turned(0.3 * x), 0.7 * Vec3::Y), material);
    }
    builder.add(rectangle(Vec3::new(0.0, 0.0, -0.8), 3.0 * Vec3::X, 0.8 * Vec3::Y), diffuse(0.4));
    builder.sky(&[0.7, 0.2]);
    builder
}

/// Recording the first surfaces changes no bit of the light. The same surfaces are recorded if the
/// rays are traced to their first hits alone.
#[test]
fn surfaces_come_with_the_light_at_no_change_of_it() {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let (renderer, geometry) = (mixture().renderer(), one_view(24, [0.2, 0.1]));
    // compare bits, since NaN must equal NaN
    let same = |a: &Tensor<3>, b: &Tensor<3>| {
        a.shape() == b.shape() && a.data().iter().map(|v| v.to_bits()).eq(b.data().iter().map(|v| v.to_bits()))
    };
    for samples in [1, 5, 16, 40] {
        for (max_bounces, clamp) in [(8, None), (0, None), (4, Some(0.5))] {
            let settings = Settings { samples, max_bounces, clamp, seed: 7, ..Settings::default() };
            let plain = renderer.render_view(&window(), &geometry, [0, 0], &settings, task).unwrap();
            let guided = renderer.render_view_and_features(&window(), &geometry, [0, 0], &settings, task).unwrap();
            let alone = renderer.render_features(&window(), &geometry, [0, 0], &settings, task).unwrap();
            assert!(same(&guided.radiance, &plain), "{samples} {max_bounces}");
            assert!(same(guided.features.values(), alone.values()), "{samples} {max_bounces}");
            // Split views with and without guides must agree.
            let split = renderer.render_split(&window(), &geometry, [0, 0], &settings, task).unwrap();
            let parts = renderer.render_split_and_features(&window(), &geometry, [0, 0], &settings, task).unwrap();
            let features = &parts.features;
            assert!(same(split.values(), parts.split.values()) && same(&parts.variance, &guided.variance));
            assert!(same(features.values(), alone.values()));
            let missed = renderer.render_misses(&window(), &geometry, [0, 0], &settings, task).unwrap();
            let pixels = split.values().data().chunks(SplitView::VALUES).zip(plain.data().chunks(3));
            for (number, (pixel, rgb)) in pixels.enumerate() {
                let feature = features.at(number / 24, number % 24);
                assert!((feature.covered + missed.data()[number] - 1.0).abs() < 1e-6);
                assert_eq!(feature.covered > 0.0, pixel[9..12].iter().any(|normal| *normal != 0.0));
                for c in 0..3 {
                    assert!((pixel[c] + pixel[3 + c] - rgb[c]).abs() <= 1e-6 * rgb[c].max(1.0));
                    // neither diffuse nor other light is negative
                    assert!(pixel[c] >= 0.0 && pixel[3 + c] >= -1e-6 * rgb[c].max(1.0));
                }
            }
            assert!((0..24 * 24).any(|i| features.at(i / 24, i % 24).covered < 1.0));
        }
    }
}

/// The misses of a split view with further rays are those of all its rays.
#[test]
fn misses_include_further_rays() {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let (renderer, geometry) = (mixture().renderer(), one_view(24, [0.2, 0.1]));
    for (samples, further_rays) in [(1, 1), (2, 3), (1, 20)] {
        let settings = Settings { samples, further_rays, seed: 7, ..Settings::default() };
        let missed = renderer.render_misses(&window(), &geometry, [0, 0], &settings, task).unwrap();
        let parts = renderer.render_split_and_features(&window(), &geometry, [0, 0], &settings, task).unwrap();
        let mut partial = 0;
        for (number, missed) in missed.data().iter().enumerate() {
            let covered = parts.features.at(number / 24, number % 24).covered;
            assert!((covered + missed - 1.0).abs() < 1e-6, "{samples} {further_rays}, {number}: {covered} {missed}");
            partial += usize::from(*missed > 0.0 && *missed < 1.0);
        }
        assert!(partial > 0);
    }
}

/// The rendered pixels of a set have the bits of a whole view, and all other pixels are 0.
#[test]
fn sets_of_pixels_are_parts_of_the_view() {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let (renderer, geometry) = (mixture().renderer(), one_view(23, [0.2, 0.1]));
    // with few samples, several pixels share a beam
    for samples in [1, 5, 12, 40] {
        let whole = Settings { samples, seed: 7, ..Settings::default() };
        let light = |settings: &Settings| renderer.render_view(&window(), &geometry, [0, 0], settings, task).unwrap();
        let missed =
            |settings: &Settings| renderer.render_misses(&window(), &geometry, [0, 0], settings, task).unwrap();
        let (all, all_missed) = (light(&whole), missed(&whole));
        for number in 0..PixelSet::SIXTHS {
            let part = Settings { pixels: PixelSet::Sixth(number), ..whole };
            let (some, some_missed) = (light(&part), missed(&part));
            for at in 0..23 * 23 {
                let share = if part.pixels.contains([at / 23, at % 23]) { 1.0 } else { 0.0 };
                assert_eq!(some_missed.data()[at], share * all_missed.data()[at]);
                assert!((0..3).all(|c| some.data()[3 * at + c] == share * all.data()[3 * at + c]), "{samples} {at}");
            }
        }
    }
}

/// Two renders with half of the samples each give the guides of all samples.
#[test]
fn guides_of_halves_are_joined() {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let (renderer, geometry) = (mixture().renderer(), one_view(24, [0.2, 0.1]));
    let of = |seed| {
        let settings = Settings { samples: 4, seed, ..Settings::default() };
        renderer.render_features(&window(), &geometry, [0, 0], &settings, task).unwrap()
    };
    let [a, b] = [of(1), of(2)];
    let joined = a.clone().joined(&b);
    let mut mixed = 0;
    for (row, col) in (0..24).flat_map(|row| (0..24).map(move |col| (row, col))) {
        let [a, b, both] = [&a, &b, &joined].map(|features| features.at(row, col));
        assert_eq!(both.covered, 0.5 * (a.covered + b.covered));
        let sum = a.covered * a.z_mm + b.covered * b.z_mm;
        assert!((both.z_mm * 2.0 * both.covered - sum).abs() < 1e-5, "{both:?}");
        let sum = a.covered * a.albedo + b.covered * b.albedo;
        assert!((both.albedo * 2.0 * both.covered - sum).length() < 1e-5, "{both:?}");
        mixed += usize::from(a.covered != b.covered);
    }
    assert!(mixed > 10);
}
