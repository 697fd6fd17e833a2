//! Tests things that views leave out: all that is in front of a near plane, unseen lamps, and the
//! environment behind a backdrop. These things light the scene as if the viewer saw them.

use crate::common::{Builder, WINDOW_MM, diffuse, glowing, long_paths, mean_of, one_view, rectangle, render, window};
use glam::{Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::{AngularFilter, Settings};
use lumistack_scene::{AlphaMode, Lamp, Material, Window};
use lumistack_testkit::statistics::FALSE_ALARM_RATE;

const SIZE: usize = 40;
/// Half width of a lamp at a distance of 1 from a wall. The lamp fills the half space in front of
/// the wall except for less than the fraction `MISSING`.
const HALF_WIDTH: f32 = 300.0;
const MISSING: f64 = 2e-5;

/// A red card is in front of the window, and a green card behind it, both larger than every view. A
/// view shows the first card that is not in front of the near plane.
#[test]
fn nothing_before_the_near_plane_is_seen() {
    let mut scene = Builder::default();
    for (z, radiance) in [(1.0, Vec3::X), (-1.0, Vec3::Y)] {
        scene.add(rectangle(Vec3::new(0.0, 0.0, z), 9.0 * Vec3::X, 9.0 * Vec3::Y), glowing(radiance));
    }
    let renderer = scene.renderer();
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 5.0 }] {
        for (slope, filter) in [([0.0, 0.0], AngularFilter::Point), ([0.3, -0.2], AngularFilter::Lens(0.2))] {
            let geometry = FieldGeometry { grid: ViewGrid::single(projection, slope), ..one_view(SIZE, slope) };
            let settings = Settings { angular_filter: filter, ..long_paths(4) };
            // pairs of a near plane and the channel of the card that is then seen
            let seen = [
                (None, Some(0)),
                (Some(1.5), Some(0)),
                (Some(0.5), Some(1)),
                (Some(-0.5), Some(1)),
                (Some(-1.5), None),
            ];
            for (near_mm, channel) in seen {
                let window = Window { near_mm, ..window() };
                let image = render(&renderer, &window, &geometry, &settings);
                let expected = channel.map_or(Vec3::ZERO, |channel| Vec3::AXES[channel]).to_array();
                assert!(image.data().chunks_exact(3).all(|rgb| rgb == expected), "{projection:?} {near_mm:?}");
                let depth = renderer.depth(&window, &geometry, [0, 0], task).unwrap();
                let z = channel.map(|channel| [1.0, -1.0][channel]);
                assert!(depth.data().iter().all(|&found| match z {
                    Some(z) => (found - z as f32).abs() < 1e-4,
                    None => found.is_nan(),
                }));
                let coverage = renderer.coverage(&window, &geometry, [0, 0], task).unwrap();
                assert_eq!(coverage, if channel.is_some() { 1.0 } else { 0.0 });
            }
        }
    }
}

/// A lamp of radiance L fills the half space in front of a wall, and the viewer looks through the
/// lamp. The wall's radiance is ρ L with the albedo ρ, or L if the wall is a mirror.
#[test]
fn a_lamp_that_is_not_seen_lights_as_ever() {
    let (albedo, radiance) = (0.8, 2.5);
    let mirror = Material { base_color: Vec4::ONE, metallic: 1.0, roughness: 0.0, ..diffuse(1.0) };
    for (wall, expected) in [(diffuse(albedo), f64::from(albedo * radiance)), (mirror, f64::from(radiance))] {
        for lamp in [Lamp::Unseen, Lamp::Seen, Lamp::No] {
            let mut scene = Builder::default();
            scene.add(rectangle(Vec3::ZERO, 2.0 * Vec3::X, 2.0 * Vec3::Y), wall.clone());
            let shining = Material { lamp, ..glowing(Vec3::splat(radiance)) };
            scene.add(rectangle(Vec3::Z, HALF_WIDTH * Vec3::X, HALF_WIDTH * Vec3::Y), shining);
            let renderer = scene.renderer();
            let geometry = one_view(SIZE, [0.1, 0.0]);
            let image = render(&renderer, &window(), &geometry, &long_paths(16));
            let (collector, cancel) = (Collector::default(), Cancel::default());
            let depth = renderer.depth(&window(), &geometry, [0, 0], Task::quiet(&collector, &cancel)).unwrap();
            if lamp == Lamp::Unseen {
                mean_of(&image, 1).assert_is(expected, MISSING * expected, FALSE_ALARM_RATE);
                assert!(depth.data().iter().all(|z| z.abs() < 1e-3));
            } else {
                assert!(image.data().iter().all(|&value| value == radiance), "the lamp covers the scene");
                assert!(depth.data().iter().all(|z| (z - 1.0).abs() < 1e-3));
            }
        }
    }
    let seen = |lamp| {
        let mut scene = Builder::default();
        scene.add(rectangle(Vec3::ZERO, Vec3::X, Vec3::Y), diffuse(0.5));
        scene.add(rectangle(Vec3::Z, 50.0 * Vec3::X, 50.0 * Vec3::Y), Material { lamp, ..glowing(Vec3::ONE) });
        let (collector, cancel) = (Collector::default(), Cancel::default());
        scene.parts.validate(Task::quiet(&collector, &cancel)).unwrap()
    };
    // framing uses the bounds of visible surfaces
    assert_eq!(seen(Lamp::Unseen).seen_bounds().max, Vec3::new(1.0, 1.0, 0.0));
    assert_eq!(seen(Lamp::Seen).seen_bounds(), seen(Lamp::Seen).bounds());
    assert_eq!(seen(Lamp::Unseen).bounds().max, Vec3::new(50.0, 50.0, 1.0));
}

/// A sky of radiance 1 and a backdrop of 1/4: surfaces, mirrors and refracted rays see the sky. The
/// viewer sees the backdrop, also through panes.
#[test]
fn a_backdrop_is_seen_and_lights_nothing() {
    let backdrop = 0.25;
    let half = 0.5 * WINDOW_MM as f32;
    let render_of = |material: Material, ground: Option<f32>| {
        let mut scene = Builder::default();
        // the material covers the left half of the window
        scene.add(rectangle(Vec3::new(-half, 0.0, 0.0), half * Vec3::X, 2.0 * half * Vec3::Y), material);
        scene.sky(&[1.0]).parts.backdrop = ground.map(Vec3::splat);
        render(&scene.renderer(), &window(), &one_view(SIZE, [0.0; 2]), &long_paths(64))
    };
    let mean = |image: &lumistack_core::Tensor<3>, cols: std::ops::Range<usize>| {
        let cells = (0..SIZE).flat_map(|row| cols.clone().map(move |col| (row, col)));
        let values: Vec<f64> = cells.map(|(row, col)| f64::from(image.get([row, col, 0]))).collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    let mirror = Material { base_color: Vec4::ONE, metallic: 1.0, roughness: 0.0, ..diffuse(1.0) };
    let veil = Material { base_color: Vec4::new(0.0, 0.0, 0.0, 0.4), alpha_mode: AlphaMode::Blend, ..diffuse(0.0) };
    // a veil of alpha 0.4 passes the fraction 0.6 of light
    let cases = [(diffuse(0.6), 0.6, 0.6), (mirror, 1.0, 1.0), (veil, 0.6, 0.6 * backdrop)];
    for (material, before_sky, before_ground) in cases {
        for (ground, right, left) in [(None, 1.0, before_sky), (Some(backdrop), backdrop, before_ground)] {
            let image = render_of(material.clone(), ground);
            let found = [mean(&image, 0..SIZE / 2), mean(&image, SIZE / 2..SIZE)];
            assert!((found[0] - f64::from(left)).abs() < 1e-2, "{found:?}, expected {left} on the left");
            assert!((found[1] - f64::from(right)).abs() < 1e-6, "{found:?}, expected {right} on the right");
        }
    }
    // glass as thin as a pane shows the backdrop through it, and reflects the sky
    let pane =
        Material { base_color: Vec4::ONE, metallic: 0.0, roughness: 0.0, transmission: 1.0, ior: 1.5, ..diffuse(1.0) };
    let through = mean(&render_of(pane, Some(backdrop)), 0..SIZE / 2);
    // one interface reflects R = 0.04, so a pane reflects at most 2 R / (1 + R)
    assert!(through > f64::from(backdrop) && through < 0.35, "{through}");
}
