//! Compares the renderer with its equations in f64, pixel by pixel and splat by splat.

use std::sync::Arc;

use glam::{Affine3A, DMat2, DMat3, DQuat, DVec2, DVec3, Quat, Vec3};
use lumistack_core::{Cancel, Cancelled, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_scene::{Cloud, PlacedCloud, Scene, SceneParts, Similarity, Window};
use lumistack_splats::{Renderer, SplatView, Surfaces, Wanted};

/// PSNR in dB. The PSNR of every view against the equations must exceed this value by 20 dB.
const LEAST_PSNR: f64 = 40.0;
const PERSPECTIVE: Projection = Projection::Perspective { distance_mm: 300.0 };

/// Random numbers from 0 to 1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }

    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next())
    }
}

/// Makes splats in and around the cube −1..1: from needles to spheres, and from thinner than a
/// pixel to wider than a tile.
fn cloud(count: usize, degree: usize, seed: u64) -> Cloud {
    let mut random = Random(seed);
    let mut cloud = Cloud { degree, ..Cloud::default() };
    for _ in 0..count {
        cloud.positions.push(2.4 * random.vector() - Vec3::splat(1.2));
        let turn = random.vector() - Vec3::splat(0.5);
        cloud.rotations.push(Quat::from_xyzw(turn.x, turn.y, turn.z, random.next() - 0.5));
        cloud.scales.push(Vec3::from((random.vector() * 4.5 - Vec3::splat(6.0)).to_array().map(f32::exp)));
        cloud.opacities.push(random.next());
        cloud
            .harmonics
            .extend((0..3 * (degree + 1).pow(2)).map(|i| (random.next() - 0.5) * if i < 3 { 3.0 } else { 0.5 }));
    }
    cloud
}

fn scene(clouds: Vec<(Cloud, Affine3A)>) -> Arc<Scene> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let (clouds, places): (Vec<_>, Vec<_>) = clouds.into_iter().unzip();
    let place = |(cloud, scene_from_cloud)| PlacedCloud { cloud, scene_from_cloud };
    let placed_clouds = places.into_iter().enumerate().map(place).collect();
    let parts = SceneParts { clouds, placed_clouds, ..SceneParts::default() };
    Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).unwrap())
}

/// Returns two clouds, one of them rotated, scaled unevenly and moved.
fn two_clouds() -> Arc<Scene> {
    let turned = Affine3A::from_scale_rotation_translation(
        Vec3::new(0.8, 0.5, 0.6),
        Quat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 0.7),
        Vec3::new(0.3, -0.2, 0.4),
    );
    scene(vec![(cloud(400, 3, 1), Affine3A::IDENTITY), (cloud(300, 1, 2), turned)])
}

fn geometry(projection: Projection, views: usize) -> FieldGeometry {
    let grid = ViewGrid::uniform(projection, [views, views], [24.0, 20.0]).unwrap();
    FieldGeometry { rows: 34, cols: 50, pitch_mm: 3.0, grid }
}

fn window(geometry: &FieldGeometry) -> Window {
    let rotation = DQuat::from_euler(glam::EulerRot::YXZ, 0.4, -0.2, 0.1);
    let scene_from_display = Similarity { rotation, scale: 0.02, translation: DVec3::new(0.1, 0.05, -0.1) };
    Window { scene_from_display, size_mm: geometry.size_mm(), near_mm: None }
}

fn slopes(geometry: &FieldGeometry) -> Vec<[f64; 2]> {
    geometry.grid.iter().map(|[y, x]| [geometry.grid.slope_x[x], geometry.grid.slope_y[y]]).collect()
}

fn render(
    scene: &Arc<Scene>,
    geometry: &FieldGeometry,
    slopes: &[[f64; 2]],
    surfaces: Option<&Surfaces>,
) -> Vec<SplatView> {
    let (warnings, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&warnings, &cancel);
    let mut views = Vec::new();
    let surfaces = |_: usize| Ok::<_, Cancelled>(surfaces.cloned());
    let renderer = Renderer::new(scene.clone()).unwrap();
    renderer
        .render(&window(geometry), geometry, slopes, &surfaces, Wanted::Light, task, |number, view| {
            assert_eq!(number, views.len());
            views.push(view);
            Ok(())
        })
        .unwrap();
    views
}

/// Returns the real spherical harmonics of KHR_gaussian_splatting's appendix A.
fn harmonics(d: DVec3) -> [f64; 16] {
    let (x, y, z) = (d.x, d.y, d.z);
    let pi = std::f64::consts::PI;
    let (a, b, c) = ((3.0 / (4.0 * pi)).sqrt(), 0.5 * (15.0 / pi).sqrt(), 0.25 * (35.0 / (2.0 * pi)).sqrt());
    [
        0.5 / pi.sqrt(),
        -a * y,
        a * z,
        -a * x,
        b * x * y,
        -b * y * z,
        0.25 * (5.0 / pi).sqrt() * (3.0 * z * z - 1.0),
        -b * x * z,
        0.5 * b * (x * x - y * y),
        -c * y * (3.0 * x * x - y * y),
        0.5 * (105.0 / pi).sqrt() * x * y * z,
        -0.25 * (21.0 / (2.0 * pi)).sqrt() * y * (5.0 * z * z - 1.0),
        0.25 * (7.0 / pi).sqrt() * z * (5.0 * z * z - 3.0),
        -0.25 * (21.0 / (2.0 * pi)).sqrt() * x * (5.0 * z * z - 1.0),
        0.25 * (105.0 / pi).sqrt() * z * (x * x - y * y),
        -c * x * (x * x - 3.0 * y * y),
    ]
}

/// A splat in one view: distance from the eye, centre and covariance on the plane z = 0 in
/// millimetres, opacity, colour, depth in millimetres.
type Projected = (f64, DVec2, DMat2, f64, DVec3, f64);

/// Projects all splats onto the plane z = 0 along the rays of one view, and sorts them, nearest
/// first. Near each centre, the projection is replaced by its linear part (the Jacobian).
fn project(scene: &Scene, window: &Window, projection: Projection, slope: [f64; 2]) -> Vec<Projected> {
    let map = window.scene_from_display;
    let mut all = Vec::new();
    for placed in &scene.placed_clouds {
        let cloud = &scene.clouds[placed.cloud];
        let axes = DMat3::from_cols_array(&placed.scene_from_cloud.matrix3.to_cols_array().map(f64::from));
        let unit = DMat3::from_cols(axes.x_axis.normalize(), axes.y_axis.normalize(), axes.z_axis.normalize());
        for i in 0..cloud.len() {
            let in_scene = axes * cloud.positions[i].as_dvec3() + placed.scene_from_cloud.translation.as_dvec3();
            let at = map.inverse_point(in_scene);
            let own =
                DMat3::from_quat(cloud.rotations[i].as_dquat()) * DMat3::from_diagonal(cloud.scales[i].as_dvec3());
            let spread = DMat3::from_quat(map.rotation.inverse()) * axes * own * (1.0 / map.scale);
            let covariance = spread * spread.transpose();
            let (direction, distance, slope, m) = match projection {
                Projection::Oblique => {
                    let to = DVec3::new(slope[0], slope[1], 1.0);
                    (-to, -to.dot(at), DVec2::from(slope), 1.0)
                }
                Projection::Perspective { distance_mm } => {
                    let eye = DVec3::new(slope[0] * distance_mm, slope[1] * distance_mm, distance_mm);
                    let to = at - eye;
                    (to, to.length(), -to.truncate() / (distance_mm - at.z), distance_mm / (distance_mm - at.z))
                }
            };
            // columns of J, the Jacobian of the projection onto z = 0
            let j = [DVec2::X * m, DVec2::Y * m, -slope * m];
            let mut flat = DMat2::ZERO;
            for (a, u) in j.iter().enumerate() {
                for (b, v) in j.iter().enumerate() {
                    flat += DMat2::from_cols(*u * v.x, *u * v.y) * covariance.col(b)[a];
                }
            }
            let basis = harmonics(unit.transpose() * (map.rotation * direction.normalize()));
            let count = cloud.coefficients();
            let mut colour = DVec3::splat(0.5);
            for (k, rgb) in cloud.harmonics[3 * count * i..][..3 * count].chunks_exact(3).enumerate() {
                colour += basis[k] * DVec3::new(f64::from(rgb[0]), f64::from(rgb[1]), f64::from(rgb[2]));
            }
            let centre = at.truncate() - at.z * slope;
            all.push((distance, centre, flat, f64::from(cloud.opacities[i]), colour.max(DVec3::ZERO), at.z));
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// Returns a pixel's colour and transmittance. A surface at depth `cut`, in millimetres, hides the
/// splats behind it.
fn pixel(splats: &[Projected], at: DVec2, pitch: f64, cut: f64) -> [f64; 4] {
    let (mut sum, mut through) = (DVec3::ZERO, 1.0);
    for (_, centre, covariance, opacity, colour, z) in splats {
        let filtered = *covariance + DMat2::IDENTITY * (pitch * pitch / 12.0);
        let d = at - *centre;
        let square = d.dot(filtered.inverse() * d);
        if square > 9.0 || *z < cut {
            continue;
        }
        let lowered = opacity * (covariance.determinant().max(0.0) / filtered.determinant()).sqrt();
        let alpha = lowered * (-0.5 * square).exp();
        sum += through * alpha * *colour;
        through *= 1.0 - alpha;
    }
    [sum.x, sum.y, sum.z, through]
}

fn psnr(found: &Tensor<3>, expected: impl Fn(usize, usize) -> [f64; 4]) -> f64 {
    let [rows, cols, _] = found.shape();
    let mut sum = 0.0;
    for row in 0..rows {
        for col in 0..cols {
            let values = &found.data()[4 * (row * cols + col)..][..4];
            let expected = expected(row, col);
            sum += values.iter().zip(expected).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>();
        }
    }
    -10.0 * (sum / (4 * rows * cols) as f64).log10()
}

#[test]
fn views_are_those_of_the_equations() {
    let scene = two_clouds();
    for projection in [Projection::Oblique, PERSPECTIVE] {
        let geometry = geometry(projection, 8);
        let slopes = slopes(&geometry);
        let views = render(&scene, &geometry, &slopes, None);
        assert_eq!(views.len(), 64);
        for (view, slope) in views.iter().zip(&slopes) {
            let splats = project(&scene, &window(&geometry), projection, *slope);
            let quality = psnr(&view.light, |row, col| {
                pixel(&splats, DVec2::new(geometry.x_mm(col), geometry.y_mm(row)), 3.0, f64::NEG_INFINITY)
            });
            // the views reached 90 dB and more when this limit was set
            assert!(quality > LEAST_PSNR + 20.0, "{projection:?} {slope:?}: {quality} dB");
        }
    }
}

/// Compares views with rays that need no projection of splats: a ray takes the largest value of
/// each Gaussian along it. The result is averaged over the pixel's area.
///
/// The splats are not thinner than a pixel. For thinner splats, the mean of the product of
/// transmittances would differ from the product of their means.
#[test]
fn views_are_means_of_rays_through_the_gaussians() {
    const RAYS: usize = 6;
    let mut wide = cloud(60, 0, 5);
    wide.scales.iter_mut().for_each(|scale| *scale = scale.max(Vec3::splat(0.1)));
    let scene = scene(vec![(wide, Affine3A::IDENTITY)]);
    for projection in [Projection::Oblique, PERSPECTIVE] {
        let mut geometry = geometry(projection, 2);
        (geometry.rows, geometry.cols) = (17, 25);
        let geometry = FieldGeometry { pitch_mm: 6.0, ..geometry };
        let slopes = slopes(&geometry);
        let views = render(&scene, &geometry, &slopes, None);
        let map = window(&geometry).scene_from_display;
        for (view, slope) in views.iter().zip(&slopes) {
            let splats = project(&scene, &window(&geometry), projection, *slope);
            let order: Vec<(DVec3, DMat3)> = splats
                .iter()
                .map(|(_, _, _, opacity, ..)| {
                    let i = scene.clouds[0].opacities.iter().position(|o| f64::from(*o) == *opacity).unwrap();
                    let cloud = &scene.clouds[0];
                    let own = DMat3::from_quat(cloud.rotations[i].as_dquat())
                        * DMat3::from_diagonal(cloud.scales[i].as_dvec3());
                    let spread = DMat3::from_quat(map.rotation.inverse()) * own * (1.0 / map.scale);
                    (map.inverse_point(cloud.positions[i].as_dvec3()), (spread * spread.transpose()).inverse())
                })
                .collect();
            let ray = |x: f64, y: f64| -> [f64; 4] {
                let grid = ViewGrid::single(projection, *slope);
                let [sx, sy] = grid.slope_at([0, 0], [x, y]);
                let direction = DVec3::new(sx, sy, 1.0);
                let (mut sum, mut through) = (DVec3::ZERO, 1.0);
                for ((_, _, _, opacity, colour, _), (at, inverse)) in splats.iter().zip(&order) {
                    let to = *at - DVec3::new(x, y, 0.0);
                    let along = to.dot(*inverse * direction).powi(2) / direction.dot(*inverse * direction);
                    let alpha = opacity * (-0.5 * (to.dot(*inverse * to) - along)).exp();
                    sum += through * alpha * *colour;
                    through *= 1.0 - alpha;
                }
                [sum.x, sum.y, sum.z, through]
            };
            let quality = psnr(&view.light, |row, col| {
                let mut mean = [0.0; 4];
                for (i, j) in (0..RAYS).flat_map(|i| (0..RAYS).map(move |j| (i, j))) {
                    let offset = |k: usize| ((k as f64 + 0.5) / RAYS as f64 - 0.5) * geometry.pitch_mm;
                    let value = ray(geometry.x_mm(col) + offset(j), geometry.y_mm(row) + offset(i));
                    (0..4).for_each(|c| mean[c] += value[c] / (RAYS * RAYS) as f64);
                }
                mean
            });
            assert!(quality > 38.0, "{projection:?} {slope:?}: {quality} dB");
        }
    }
}

#[test]
fn surfaces_hide_the_splats_behind_them() {
    let scene = two_clouds();
    let geometry = geometry(PERSPECTIVE, 1);
    let (rows, cols) = (geometry.rows, geometry.cols);
    // the surface tilts from left to right, and the right part of the picture has no surface
    let z = |col: usize| if col < 40 { col as f32 * 2.0 - 40.0 } else { f32::NAN };
    let values = (0..rows * cols).flat_map(|i| [z(i % cols); 2]).collect();
    let surfaces = Surfaces { z_mm: Tensor::from_vec(["row", "col", "sample"], [rows, cols, 2], values).unwrap() };
    let slopes = slopes(&geometry);
    let views = render(&scene, &geometry, &slopes, Some(&surfaces));
    let splats = project(&scene, &window(&geometry), PERSPECTIVE, slopes[0]);
    let quality = psnr(&views[0].light, |row, col| {
        let cut = if z(col).is_nan() { f64::NEG_INFINITY } else { f64::from(z(col)) };
        pixel(&splats, DVec2::new(geometry.x_mm(col), geometry.y_mm(row)), 3.0, cut)
    });
    assert!(quality > LEAST_PSNR + 20.0, "{quality} dB");
}

#[test]
fn the_same_bytes_come_out_of_any_block_of_views_and_any_number_of_threads() {
    let scene = two_clouds();
    for projection in [Projection::Oblique, PERSPECTIVE] {
        let geometry = geometry(projection, 6);
        let slopes = slopes(&geometry);
        let all = render(&scene, &geometry, &slopes, None);
        let same = |a: &SplatView, b: &SplatView| {
            let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(a.light.data()), bits(b.light.data()));
            assert_eq!(bits(a.z_mm.data()), bits(b.z_mm.data()));
        };
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let again = render(&scene, &geometry, &slopes, None);
                all.iter().zip(&again).for_each(|(a, b)| same(a, b));
            });
        }
        // rendering every fifth view in its own call, from the last to the first, gives the same
        // view
        for (slope, view) in slopes.iter().zip(&all).rev().step_by(5) {
            same(view, &render(&scene, &geometry, &[*slope], None)[0]);
        }
    }
}

/// The depth of a pixel is the depth of the splat at which the pixel's transmittance falls below
/// one half.
#[test]
fn depth_is_where_half_of_the_light_is_gone() {
    let mut wall = Cloud::default();
    for (z, opacity) in [(1.0, 0.3), (0.5, 0.4), (-0.5, 0.9)] {
        wall.positions.push(Vec3::new(0.0, 0.0, z));
        wall.rotations.push(Quat::IDENTITY);
        wall.scales.push(Vec3::new(2.0, 2.0, 0.01));
        wall.opacities.push(opacity);
        wall.harmonics.extend([0.0; 3]);
    }
    let scene = scene(vec![(wall, Affine3A::IDENTITY)]);
    let grid = ViewGrid::single(Projection::Oblique, [0.0; 2]);
    let geometry = FieldGeometry { rows: 9, cols: 9, pitch_mm: 1.0, grid };
    let map = Similarity { rotation: DQuat::IDENTITY, scale: 0.1, translation: DVec3::ZERO };
    let window = Window { scene_from_display: map, size_mm: geometry.size_mm(), near_mm: None };
    let z_of = |window: &Window| {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let mut z = f32::NAN;
        let renderer = Renderer::new(scene.clone()).unwrap();
        let none = |_: usize| Ok::<_, Cancelled>(None);
        let done = |_: usize, view: SplatView| {
            assert!(view.light.data().chunks_exact(4).all(|pixel| pixel[..3] == [0.0; 3]));
            z = view.z_mm.get([4, 4]);
            Ok(())
        };
        renderer.render(window, &geometry, &[[0.0; 2]], &none, Wanted::Depth, task, done).unwrap();
        z
    };
    // the first two splats transmit 0.7 · 0.6 = 0.42, so the depth is the second splat's
    assert_eq!(z_of(&window), 5.0);
    // a near plane at 7 mm removes the first splat, and one at −7 mm removes all splats
    assert_eq!(z_of(&Window { near_mm: Some(7.0), ..window }), -5.0);
    assert!(z_of(&Window { near_mm: Some(-7.0), ..window }).is_nan());
}
