//! Guides of the denoiser on scenes whose first hits are known.

use crate::common::{Builder, diffuse, one_view, rectangle, window};
use glam::{Quat, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task};
use lumistack_pathtracer::{AngularFilter, Feature, Features};
use lumistack_scene::Material;

fn features(builder: &Builder, size: usize, slope: [f64; 2]) -> Features {
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let geometry = one_view(size, slope);
    builder.renderer().render_features(&window(), &geometry, [0, 0], 16, AngularFilter::Point, task).unwrap()
}

#[test]
fn depth_normal_and_reflectance_are_those_of_the_first_surface() {
    let mut builder = Builder::default();
    let turn = Quat::from_rotation_y(0.4);
    let metal = Material { base_color: Vec4::new(0.9, 0.6, 0.3, 1.0), metallic: 1.0, roughness: 0.5, ..diffuse(0.5) };
    builder.add(rectangle(Vec3::new(0.0, 0.0, -0.2), turn * (4.0 * Vec3::X), 4.0 * Vec3::Y), metal);
    // never seen
    builder.add(rectangle(Vec3::new(0.0, 0.0, -3.0), 9.0 * Vec3::X, 9.0 * Vec3::Y), diffuse(0.1));
    let (size, slope) = (16, [0.25, -0.1]);
    let found = features(&builder, size, slope);
    let geometry = one_view(size, slope);
    let normal = turn * Vec3::Z;
    for row in 0..size {
        for col in 0..size {
            let Feature { covered, albedo, normal: seen, z_mm, gloss, alpha } = found.at(row, col);
            assert_eq!((covered, gloss, alpha), (1.0, 1.0, 0.25));
            assert!((albedo - Vec3::new(0.9, 0.6, 0.3)).abs().max_element() < 1e-5, "{albedo}");
            assert!((seen - normal).length() < 1e-5, "{seen}");
            // (x + s z, y, z) lies on the plane through (0, 0, −0.2) with that normal
            let [nx, nz] = [f64::from(normal.x), f64::from(normal.z)];
            let z = (-0.2 * nz - geometry.x_mm(col) * nx) / (nz + slope[0] * nx);
            // rays are spread over the pixel: the mean of 16 stratified ones stands off its centre
            // by a small part of it
            assert!((f64::from(z_mm) - z).abs() < 0.2 * geometry.pitch_mm, "{z_mm} {z}");
        }
    }
}

#[test]
fn a_pixel_at_an_edge_tells_its_share() {
    let mut builder = Builder::default();
    // the right half of the window, and a quarter of one more column of pixels
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
            Feature { covered: 0.0, albedo: Vec3::ZERO, normal: Vec3::ZERO, z_mm: 0.0, gloss: 0.0, alpha: 0.0 }
        );
    }
}
