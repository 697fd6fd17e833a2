//! Compares every kind of light with its closed form. The lit surface is a diffuse plane of albedo
//! ρ at z = 0, seen from the front. At the irradiance E its radiance is L = ρ E / π.

use std::f64::consts::PI;

use crate::common::{
    self, Builder, diffuse, glowing, long_paths, mean_of, one_view, rectangle, render, window, window_at,
};
use glam::{DVec3, Vec3};
use lumistack_core::Tensor;
use lumistack_pathtracer::Settings;
use lumistack_scene::{Light, LightKind, Material};
use lumistack_testkit::statistics::{FALSE_ALARM_RATE, Mean};

const ALBEDO: f32 = 0.6;
/// Relative rounding of f32 arithmetic.
const ROUNDING: f64 = 2e-5;

fn plane() -> Builder {
    let mut scene = Builder::default();
    scene.add(rectangle(Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::Y), diffuse(ALBEDO));
    scene
}

fn point_light(position: Vec3, kind: LightKind, direction: Vec3) -> Light {
    Light { position, direction, intensity: Vec3::new(5.0, 2.0, 1.0), kind }
}

/// Returns the irradiance at a point of z = 0 from a small light at `position`, whose intensity is
/// 1 in all directions.
fn inverse_square(position: DVec3, at: DVec3) -> f64 {
    let to_light = position - at;
    to_light.z / to_light.length().powi(3)
}

/// Returns the mean of a function over each pixel of the window, from a fine grid of points.
fn over_window(size: usize, f: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let fine = 8;
    let at = |i: usize, k: usize| ((i as f64 + (k as f64 + 0.5) / fine as f64) / size as f64 - 0.5) * 2.0;
    (0..size * size)
        .map(|i| {
            let sum: f64 = (0..fine * fine).map(|k| f(at(i % size, k % fine), -at(i / size, k / fine))).sum();
            sum / (fine * fine) as f64
        })
        .collect()
}

/// Asserts that every pixel has the expected value up to a relative tolerance. This function is for
/// light whose only variance comes from the area of the pixel.
fn assert_pixels(radiance: &Tensor<3>, expected: &[f64], relative: f64) {
    for (pixel, expected) in radiance.data().chunks(3).zip(expected) {
        let found = f64::from(pixel[0]);
        assert!((found - expected).abs() <= relative * expected.abs() + 1e-6, "{found} is not {expected}");
    }
}

/// Relative tolerance for a pixel with 64 stratified samples. It is needed since the light varies
/// within the pixel.
const PIXEL_AREA: f64 = 1e-2;

#[test]
fn a_point_light_falls_off_with_the_square_of_distance() {
    let mut scene = plane();
    scene.parts.lights.push(point_light(Vec3::new(0.3, -0.2, 1.0), LightKind::Point, Vec3::NEG_Z));
    let radiance = render(&scene.renderer(), &window(), &one_view(16, [0.0, 0.0]), &long_paths(64));
    let light = DVec3::new(0.3, -0.2, 1.0);
    let scale = f64::from(ALBEDO) / PI * 5.0;
    let expected = over_window(16, |x, y| scale * inverse_square(light, DVec3::new(x, y, 0.0)));
    assert_pixels(&radiance, &expected, PIXEL_AREA);
    let total = Mean::of(expected.iter().copied()).value;
    assert!((mean_of(&radiance, 0).value / total - 1.0).abs() < 2e-3);
    assert!((mean_of(&radiance, 1).value / total - 0.4).abs() < 2e-3, "green is 2/5 of red");
}

#[test]
fn a_spot_light_fades_between_its_cones() {
    let (inner, outer) = (0.2f64, 0.6f64);
    let kind = LightKind::Spot { inner_cone_rad: inner as f32, outer_cone_rad: outer as f32 };
    let mut scene = plane();
    scene.parts.lights.push(point_light(Vec3::new(0.0, 0.0, 1.5), kind, Vec3::NEG_Z));
    let radiance = render(&scene.renderer(), &window(), &one_view(16, [0.0, 0.0]), &long_paths(64));
    let light = DVec3::new(0.0, 0.0, 1.5);
    let expected = over_window(16, |x, y| {
        let at = DVec3::new(x, y, 0.0);
        let cosine = 1.5 / (light - at).length();
        let falloff = ((cosine - outer.cos()) / (inner.cos() - outer.cos())).clamp(0.0, 1.0).powi(2);
        f64::from(ALBEDO) / PI * 5.0 * falloff * inverse_square(light, at)
    });
    assert!(expected[0] == 0.0 && radiance.data()[0] == 0.0, "outside the cone");
    // the cone's edge is steep, so the tolerance is relative to the brightest value
    let brightest = expected.iter().copied().fold(0.0, f64::max);
    for (pixel, expected) in radiance.data().chunks(3).zip(&expected) {
        assert!((f64::from(pixel[0]) - expected).abs() < PIXEL_AREA * brightest, "{} is not {expected}", pixel[0]);
    }
}

#[test]
fn a_directional_light_gives_its_irradiance_times_the_cosine() {
    let direction = Vec3::new(0.6, 0.0, -0.8);
    let mut scene = plane();
    scene.parts.lights.push(point_light(Vec3::ZERO, LightKind::Directional, direction));
    let radiance = render(&scene.renderer(), &window(), &one_view(8, [0.0, 0.0]), &long_paths(4));
    assert_pixels(&radiance, &[f64::from(ALBEDO) / PI * 5.0 * 0.8; 64], ROUNDING);
    // light from behind the plane does not arrive
    scene.parts.lights[0].direction = Vec3::Z;
    let radiance = render(&scene.renderer(), &window(), &one_view(8, [0.0, 0.0]), &long_paths(4));
    assert!(radiance.data().iter().all(|&v| v == 0.0));
}

/// A disc of the sky around the plane's normal gives the plane the irradiance that the light
/// states, at any width. A tilted disc that is wholly above the plane gives that irradiance times
/// the cosine between its axis and the normal. The reason: a cone's projected solid angle is π
/// sin²θ times this cosine.
#[test]
fn a_distant_light_gives_its_irradiance_times_the_cosine_of_its_centre() {
    for (half_angle_rad, direction) in
        [(0.005, Vec3::new(0.6, 0.0, -0.8)), (0.5, Vec3::new(0.6, 0.0, -0.8)), (1.5, Vec3::NEG_Z)]
    {
        let mut scene = plane();
        scene.parts.lights.push(point_light(Vec3::ZERO, LightKind::Distant { half_angle_rad }, direction));
        let radiance = render(&scene.renderer(), &window(), &one_view(16, [0.0, 0.0]), &long_paths(256));
        let expected = f64::from(ALBEDO) / PI * 5.0 * f64::from(-direction.z);
        mean_of(&radiance, 0).assert_is(expected, 1e-4 * expected, FALSE_ALARM_RATE);
    }
}

/// Returns the irradiance at the origin of the plane z = 0, from a square of radiance L and half
/// width w. The square is parallel to the plane, at height h, and centred above the origin:
///
/// ```text
/// E = 4 L s atan s,   s = w/√(w² + h²)
/// ```
///
/// This is π L times four form factors of a corner (Siegel, Howell, "Thermal Radiation Heat
/// Transfer").
fn irradiance_below_square(radiance: f64, half_width: f64, height: f64) -> f64 {
    let s = half_width / half_width.hypot(height);
    4.0 * radiance * s * s.atan()
}

#[test]
fn a_square_light_has_its_form_factor() {
    // test a small light far above the plane, a larger light, and a light that fills almost the
    // whole half space above the plane
    for (half_width, height) in [(0.1, 2.0), (0.5, 1.0), (1.0, 0.1)] {
        let mut scene = plane();
        let light = rectangle(Vec3::new(0.0, 0.0, height), -half_width * Vec3::X, half_width * Vec3::Y);
        scene.add(light, Material { double_sided: false, ..glowing(Vec3::splat(3.0)) });
        let renderer = scene.renderer();
        // the light's back is invisible, so the view sees the plane through it; the window is tiny
        // and below the light's centre
        let window = window_at(DVec3::ZERO, 1e-3);
        let radiance = render(&renderer, &window, &one_view(32, [0.0, 0.0]), &long_paths(64));
        let irradiance = irradiance_below_square(3.0, f64::from(half_width), f64::from(height));
        let expected = f64::from(ALBEDO) / PI * irradiance;
        mean_of(&radiance, 0).assert_is(expected, ROUNDING * expected, FALSE_ALARM_RATE);
    }
}

#[test]
fn an_emission_texture_shines_where_it_is_bright() {
    use lumistack_scene::{Filter, Image, Pixels, Texture, TextureUse, Wrap};
    // only the left half of the light shines; the whole window is under the light
    let mut scene = plane();
    let texels = [[255, 255, 255, 255], [0, 0, 0, 255]];
    scene.parts.images.push(Image { name: "half".into(), width: 2, height: 1, pixels: Pixels::Rgba8(texels.to_vec()) });
    scene.parts.textures.push(Texture {
        image: 0,
        wrap_u: Wrap::ClampToEdge,
        wrap_v: Wrap::ClampToEdge,
        filter: Filter::Nearest,
    });
    let textured = Material {
        emission_texture: Some(TextureUse { texture: 0, uv_set: 0, texture_from_mesh: glam::Affine2::IDENTITY }),
        double_sided: false,
        ..glowing(Vec3::splat(3.0))
    };
    let light = rectangle(Vec3::new(0.0, 0.0, 1.0), -0.5 * Vec3::X, 0.5 * Vec3::Y);
    scene.add(light, textured);
    let radiance = render(&scene.renderer(), &window_at(DVec3::ZERO, 1e-3), &one_view(32, [0.0, 0.0]), &long_paths(64));
    let expected = 0.5 * f64::from(ALBEDO) / PI * irradiance_below_square(3.0, 0.5, 1.0);
    mean_of(&radiance, 0).assert_is(expected, 1e-3 * expected, FALSE_ALARM_RATE);
}

/// A diffuse plane under a sky that changes with height: the irradiance is the integral of L cos θ
/// over the hemisphere.
#[test]
fn environment_light_agrees_with_its_integral() {
    // the plane faces +z; the sky is 1 above the horizon y = 0 and 0 below it, so half of the
    // plane's hemisphere shines
    let mut scene = plane();
    let rows: Vec<f32> = (0..512).map(|row| if row < 256 { 1.0 } else { 0.0 }).collect();
    scene.sky(&rows);
    let radiance = render(&scene.renderer(), &window(), &one_view(32, [0.0, 0.0]), &long_paths(64));
    let expected = 0.5 * f64::from(ALBEDO);
    mean_of(&radiance, 0).assert_is(expected, 2e-3 * expected, FALSE_ALARM_RATE);
}

/// A glossy plane looks the same in an environment and between glowing walls of the same radiance.
/// The weights of light sampling and of scattering are quite different in these two scenes.
#[test]
fn sampling_lights_and_sampling_the_surface_agree() {
    let metal = Material { metallic: 1.0, roughness: 0.4, ..diffuse(0.8) };
    let mut by_environment = Builder::default();
    by_environment.add(rectangle(Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::Y), metal.clone()).sky(&[2.0, 2.0]);
    let mut by_triangles = Builder::default();
    by_triangles.add(rectangle(Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::Y), metal);
    for wall in common::cube(Vec3::ZERO, 8.0) {
        let mut inward = wall;
        inward.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        by_triangles.add(inward, Material { double_sided: false, ..glowing(Vec3::splat(2.0)) });
    }
    let settings = Settings { samples: 64, ..Settings::default() };
    let geometry = one_view(32, [0.7, 0.2]);
    let environment = mean_of(&render(&by_environment.renderer(), &window(), &geometry, &settings), 0);
    let triangles = mean_of(&render(&by_triangles.renderer(), &window(), &geometry, &settings), 0);
    environment.assert_same(triangles, 1e-3, FALSE_ALARM_RATE);
    assert!(environment.value > 1.0);
}

/// The estimate has the same mean for any number of samples.
#[test]
fn the_mean_does_not_depend_on_the_number_of_samples() {
    let mut scene = plane();
    scene.sky(&[0.2, 1.0, 3.0]);
    scene.add(common::sphere(Vec3::new(0.3, 0.0, 0.5), 0.4, 16), Material { ior: 1.5, roughness: 0.3, ..diffuse(0.7) });
    scene.parts.lights.push(point_light(Vec3::new(-0.5, 0.5, 1.0), LightKind::Point, Vec3::NEG_Z));
    let renderer = scene.renderer();
    // compare each pixel with the reference at the same pixel, since radiance varies between pixels
    let render_with = |samples: u32, seed: u64| {
        render(&renderer, &window(), &one_view(48, [0.0, 0.0]), &Settings { samples, seed, ..Settings::default() })
    };
    let reference = render_with(512, 1);
    for samples in [1, 3, 16, 24] {
        let image = render_with(samples, 2);
        let differences = image.data().iter().zip(reference.data()).step_by(3).map(|(a, b)| f64::from(a - b));
        Mean::of(differences).assert_is(0.0, 0.0, FALSE_ALARM_RATE);
    }
}

/// Hundreds of point lights and panels are above a plane. The test compares every pixel with the
/// sum over all lights.
#[test]
fn hundreds_of_lights_add_up() {
    let mut scene = plane();
    let mut stream = lumistack_core::seed::Stream::new(6);
    let mut unit = || stream.next_f32();
    let (mut places, mut panels) = (Vec::new(), Vec::new());
    for k in 0..300 {
        let position = Vec3::new(3.0 * unit() - 1.5, 3.0 * unit() - 1.5, 0.1 + 0.4 * unit());
        let strength = 0.01 * (0.2 + unit());
        if k % 3 == 0 {
            // a panel so small that it acts as a point with a cosine; half of the panels face away
            let half = 0.002;
            let up = if unit() < 0.5 { -half } else { half };
            let radiance = strength / (4.0 * half * half);
            let panel = rectangle(position, half * Vec3::X, up * Vec3::Y);
            panels.push(position);
            scene.add(panel, Material { double_sided: false, ..glowing(Vec3::splat(radiance)) });
            if up < 0.0 {
                places.push((position.as_dvec3(), f64::from(strength), true));
            }
        } else {
            let light =
                Light { position, direction: Vec3::NEG_Z, intensity: Vec3::splat(strength), kind: LightKind::Point };
            scene.parts.lights.push(light);
            places.push((position.as_dvec3(), f64::from(strength), false));
        }
    }
    let size = 24;
    let radiance = render(
        &scene.renderer(),
        &window(),
        &one_view(size, [0.0, 0.0]),
        &Settings { samples: 256, max_bounces: 1, ..Settings::default() },
    );
    let expected = over_window(size, |x, y| {
        let at = DVec3::new(x, y, 0.0);
        let arrives = |&(place, strength, panel): &(DVec3, f64, bool)| {
            let cosine = if panel { place.z / (place - at).length() } else { 1.0 };
            strength * cosine * inverse_square(place, at)
        };
        f64::from(ALBEDO) / PI * places.iter().map(arrives).sum::<f64>()
    });
    // a panel hides a tiny area of the plane from the view, so pixels with a panel are left out
    let hidden = |pixel: usize| {
        let (col, row) = (pixel % size, pixel / size);
        panels.iter().any(|place| {
            let at = |x: f32| ((0.5 * x + 0.5) * size as f32).floor();
            (at(place.x) - col as f32).abs() <= 1.0 && (at(-place.y) - row as f32).abs() <= 1.0
        })
    };
    let pixels = radiance.data().chunks(3).zip(&expected).enumerate();
    let relative: Vec<f64> = pixels
        .filter(|(pixel, _)| !hidden(*pixel))
        .map(|(_, (rgb, expected))| f64::from(rgb[0]) / expected - 1.0)
        .collect();
    let mean = Mean::of(relative.iter().copied());
    println!("{} pixels: {mean:?}", relative.len());
    assert!(relative.len() > 30);
    // the tolerance is needed since the radiance varies within a pixel
    mean.assert_is(0.0, 2e-3, FALSE_ALARM_RATE);
    assert!(relative.iter().all(|error| error.abs() < 0.25), "one light of 300 per path: {relative:?}");
}

/// On a sphere of few triangles, the edge between light and dark is the edge of the smooth sphere.
/// It does not follow the triangles. A point P of a triangle has the interpolated normal P/|P|. Its
/// radiance is L = ρ E max(P·d, 0) / (π |P|), with the albedo ρ, the irradiance E and the direction
/// d to the light. The sphere's centre is the origin. So |P| is at most the radius, and at least
/// the distance from the origin to the middle of the largest triangle.
#[test]
fn hard_light_ends_where_the_smooth_surface_turns_away() {
    let (radius, divisions, irradiance) = (0.9f64, 12usize, 2.0f64);
    let towards = DVec3::new(1.0, 0.35, 0.1).normalize();
    let far = 4000.0;
    let at = |scale: f64| Light {
        position: (far * towards).as_vec3(),
        direction: Vec3::NEG_Z,
        intensity: Vec3::splat((scale * irradiance * far * far) as f32),
        kind: LightKind::Point,
    };
    let sun = Light {
        position: Vec3::ZERO,
        direction: -towards.as_vec3(),
        intensity: Vec3::splat(irradiance as f32),
        kind: LightKind::Directional,
    };
    for lights in [vec![sun], vec![at(0.25), at(0.75)]] {
        let mut scene = Builder::default();
        scene.add(common::sphere(Vec3::ZERO, radius as f32, divisions), diffuse(ALBEDO));
        scene.parts.lights = lights;
        let size = 96;
        let radiance = render(&scene.renderer(), &window(), &one_view(size, [0.0, 0.0]), &long_paths(64));
        let flattest = (PI / divisions as f64 / 2.0).cos().powi(2);
        let mut at_edge = 0;
        for (index, pixel) in radiance.data().chunks(3).enumerate() {
            let place = |i: usize| ((i as f64 + 0.5) / size as f64 - 0.5) * 2.0;
            let (x, y) = (place(index % size), -place(index / size));
            if x.hypot(y) > 0.85 * radius {
                continue;
            }
            let on = |radius: f64| DVec3::new(x, y, (radius * radius - x * x - y * y).sqrt()).dot(towards) / radius;
            // tolerance: about the change of the cosine over a pixel
            let pixel_wide = 2.0 / (size as f64 * radius);
            let (low, high) = (on(radius).min(on(radius * flattest)), on(radius).max(on(radius * flattest)));
            let cosine = f64::from(pixel[0]) * PI / (f64::from(ALBEDO) * irradiance);
            assert!(
                cosine >= (low - pixel_wide).max(0.0) && cosine <= (high + pixel_wide).max(0.0),
                "{cosine} is not in {low}..{high} at {x} {y}"
            );
            at_edge += usize::from((0.0..0.2).contains(&low));
        }
        assert!(at_edge > 200, "{at_edge}");
    }
}
