//! Tests where things appear in the views: parallax, orientation, occlusion, both projections,
//! filters. Also tests that the number of threads changes no byte.

use crate::common::{self, Builder, WINDOW_MM, diffuse, glowing, one_view, rectangle, render, render_view, window};
use glam::{Affine3A, DVec3, Quat, Vec3, Vec4};
use lumistack_core::{Cancel, Collector, Task, Tensor};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::{AngularFilter, PixelSet, RenderError, Renderer, Settings};
use lumistack_scene::{AlphaMode, Filter, Image, Material, Pixels, Texture, TextureUse, Window, Wrap};

/// Settings with few samples. They suffice, since all samples of a pixel inside a card hit this
/// card.
const SAMPLES: Settings = Settings {
    hide_environment: false,
    samples: 4,
    further_rays: 0,
    sparse_paths: false,
    further_paths: false,
    max_bounces: 2,
    roulette_start: 3,
    seed: 0,
    angular_filter: AngularFilter::Point,
    clamp: None,
    pixels: PixelSet::All,
};
/// Number of pixels per edge of the test views: the pitch is 1/50 of the window.
const SIZE: usize = 50;
const PITCH: f64 = WINDOW_MM / SIZE as f64;
/// Tolerance for the centroid of a card, in pixels, since samples at the card's edges are jittered.
const CENTROID_TOLERANCE: f64 = 0.1;

/// Returns the centre of brightness of a channel, as (x, y) on z = 0.
fn centroid(image: &Tensor<3>, channel: usize) -> (f64, f64) {
    let [rows, cols, _] = image.shape();
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for row in 0..rows {
        for col in 0..cols {
            let value = f64::from(image.get([row, col, channel]));
            sum += value;
            x += value * (col as f64 - (cols as f64 - 1.0) / 2.0) * PITCH;
            y += value * ((rows as f64 - 1.0) / 2.0 - row as f64) * PITCH;
        }
    }
    (x / sum, y / sum)
}

fn assert_centroid(image: &Tensor<3>, channel: usize, expected: (f64, f64)) {
    let (x, y) = centroid(image, channel);
    let limit = CENTROID_TOLERANCE * PITCH;
    assert!((x - expected.0).abs() < limit && (y - expected.1).abs() < limit, "({x}, {y}) is not {expected:?}");
}

fn card(centre: Vec3, half: f32, radiance: Vec3) -> Builder {
    let mut scene = Builder::default();
    scene.add(rectangle(centre, half * Vec3::X, half * Vec3::Y), glowing(radiance));
    scene
}

/// The ray of slope s through (x, y) of the display comes from x + z s at depth z. So a card at z
/// appears at x_card − z s, on either side of the display. Rows are counted from the top.
#[test]
fn a_card_appears_where_its_rays_cross_the_display() {
    for (x, y, z) in [(0.2, 0.3, 0.5), (-0.2, 0.1, -0.6), (0.1, -0.3, 0.0)] {
        let renderer = card(Vec3::new(x, y, z), 0.1, Vec3::ONE).renderer();
        for slope in [[0.0, 0.0], [0.3, 0.0], [0.0, 0.3], [-0.3, 0.2]] {
            let image = render(&renderer, &window(), &one_view(SIZE, slope), &SAMPLES);
            let expected = |position: f32, slope: f64| f64::from(position) - f64::from(z) * slope;
            assert_centroid(&image, 0, (expected(x, slope[0]), expected(y, slope[1])));
        }
    }
}

/// In perspective, a view of slope s has its eye at e = D s, at the distance D from the display.
/// The card's rays to the eye cross z = 0 at x_card + (x_card − e) z/(D − z).
#[test]
fn perspective_views_meet_at_the_eye() {
    let distance = 3.0;
    let (x, y, z) = (0.2f32, -0.1f32, 0.5f32);
    let renderer = card(Vec3::new(x, y, z), 0.1, Vec3::ONE).renderer();
    let grid = ViewGrid {
        projection: Projection::Perspective { distance_mm: distance },
        slope_x: vec![-0.1, 0.15],
        slope_y: vec![0.2, 0.0],
    };
    let geometry = one_view(SIZE, [0.0, 0.0]).with_grid(grid.clone());
    for view in grid.iter() {
        let (image, _) = render_view(&renderer, &window(), &geometry, view, &SAMPLES);
        let crossing = |card: f32, slope: f64| {
            let (card, z) = (f64::from(card), f64::from(z));
            card + (card - distance * slope) * z / (distance - z)
        };
        assert_centroid(&image, 0, (crossing(x, grid.slope_x[view[1]]), crossing(y, grid.slope_y[view[0]])));
    }
}

/// With scaled slopes all parallax is scaled too, as if each object were at the scaled depth. The
/// view from straight ahead has the same bytes.
#[test]
fn scaled_slopes_scale_parallax_and_leave_the_middle_alone() {
    let factor = 0.4;
    for projection in [Projection::Oblique, Projection::Perspective { distance_mm: 3.0 }] {
        for z in [0.6f32, -0.8] {
            let renderer = card(Vec3::new(0.1, 0.0, z), 0.1, Vec3::ONE).renderer();
            let grid = ViewGrid { projection, slope_x: vec![-0.2, 0.0, 0.3], slope_y: vec![0.0] };
            let geometry = one_view(SIZE, [0.0, 0.0]).with_grid(grid.clone());
            let scaled = geometry.with_grid(grid.scaled(factor));
            let images = |geometry: &FieldGeometry| {
                [0, 1, 2].map(|x| render_view(&renderer, &window(), geometry, [0, x], &SAMPLES).0)
            };
            let (all, less) = (images(&geometry), images(&scaled));
            assert_eq!(all[1].data(), less[1].data(), "{projection:?}: the middle view");
            let moved = |images: &[Tensor<3>; 3], x: usize| centroid(&images[x], 0).0 - centroid(&images[1], 0).0;
            for x in [0, 2] {
                let (whole, part) = (moved(&all, x), moved(&less, x));
                assert!(whole.abs() > 3.0 * PITCH, "the test needs a shift");
                assert!(
                    (part - factor * whole).abs() < 2.0 * CENTROID_TOLERANCE * PITCH,
                    "{projection:?} {whole} {part}"
                );
                // a card at the scaled depth moves by the same distance
                let shown = geometry.disparity_px(projection.scaled_depth(z.into(), factor), grid.slope_x[x]);
                assert!((part / PITCH + shown).abs() < 2.0 * CENTROID_TOLERANCE, "{projection:?} {part} {shown}");
            }
        }
    }
}

/// Perspective views do not show objects behind the eye. Oblique views have no eye and show them.
#[test]
fn perspective_views_do_not_see_behind_the_eye() {
    let renderer = card(Vec3::new(0.0, 0.0, 2.0), 0.5, Vec3::ONE).renderer();
    let perspective = ViewGrid::single(Projection::Perspective { distance_mm: 1.0 }, [0.0, 0.0]);
    let from_eye = render(&renderer, &window(), &one_view(SIZE, [0.0, 0.0]).with_grid(perspective), &SAMPLES);
    assert!(from_eye.data().iter().all(|&v| v == 0.0));
    assert!(render(&renderer, &window(), &one_view(SIZE, [0.0, 0.0]), &SAMPLES).data().contains(&1.0));
}

#[test]
fn the_window_maps_display_to_scene() {
    // the window is turned by a quarter around y, moved far away and scaled; a card is 100 units in
    // front of the window
    let centre = DVec3::new(1e4, -2e3, 5e3);
    let scale = 250.0;
    let window = Window::given(centre, DVec3::NEG_X, DVec3::Y, scale * WINDOW_MM, [WINDOW_MM, WINDOW_MM]).unwrap();
    let on_card = window.scene_from_display.point(DVec3::new(0.3, 0.2, 0.4)).as_vec3();
    let half = 0.1 * scale as f32;
    let mut scene = Builder::default();
    scene.add(rectangle(on_card, half * Vec3::NEG_Z, half * Vec3::Y), glowing(Vec3::ONE));
    let image = render(&scene.renderer(), &window, &one_view(SIZE, [0.5, -0.25]), &SAMPLES);
    assert_centroid(&image, 0, (0.3 - 0.4 * 0.5, 0.2 + 0.4 * 0.25));
}

#[test]
fn near_hides_far() {
    let mut scene = card(Vec3::new(0.0, 0.0, -0.5), 0.4, Vec3::X);
    scene.add(rectangle(Vec3::new(0.0, 0.0, 0.5), 0.2 * Vec3::X, 0.2 * Vec3::Y), glowing(Vec3::Y));
    let image = render(&scene.renderer(), &window(), &one_view(SIZE, [0.0, 0.0]), &SAMPLES);
    assert_eq!(image.block([SIZE / 2, SIZE / 2]), [0.0, 1.0, 0.0]);
    assert_eq!(image.block([SIZE / 2, SIZE / 2 + 8]), [1.0, 0.0, 0.0]);
}

/// Adds a picture of 2 × 2 texels: red and green above blue and white.
fn quadrants(builder: &mut Builder) -> TextureUse {
    let texels = vec![[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 0], [255, 255, 255, 100]];
    builder.parts.images.push(Image { name: "quadrants".into(), width: 2, height: 2, pixels: Pixels::Rgba8(texels) });
    builder.parts.textures.push(Texture {
        image: builder.parts.images.len() - 1,
        wrap_u: Wrap::ClampToEdge,
        wrap_v: Wrap::ClampToEdge,
        filter: Filter::Nearest,
    });
    TextureUse { texture: builder.parts.textures.len() - 1, uv_set: 0, texture_from_mesh: glam::Affine2::IDENTITY }
}

#[test]
fn textures_are_neither_mirrored_nor_flipped() {
    let mut scene = Builder::default();
    let picture = quadrants(&mut scene);
    let material = Material { unlit: true, base_color_texture: Some(picture), base_color: Vec4::ONE, ..diffuse(1.0) };
    scene.add(rectangle(Vec3::ZERO, Vec3::X, Vec3::Y), material);
    let image = render(&scene.renderer(), &window(), &one_view(8, [0.0, 0.0]), &SAMPLES);
    assert_eq!(image.block([1, 1]), [1.0, 0.0, 0.0], "top left is red");
    assert_eq!(image.block([1, 6]), [0.0, 1.0, 0.0], "top right is green");
    assert_eq!(image.block([6, 1]), [0.0, 0.0, 1.0], "bottom left is blue");
    assert_eq!(image.block([6, 6]), [1.0, 1.0, 1.0], "bottom right is white");
}

#[test]
fn masked_and_blended_surfaces_let_light_through() {
    let mut scene = card(Vec3::new(0.0, 0.0, -0.5), 2.0, Vec3::splat(0.5));
    let picture = quadrants(&mut scene);
    let material = Material {
        unlit: true,
        base_color_texture: Some(picture),
        alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
        ..diffuse(1.0)
    };
    scene.add(rectangle(Vec3::ZERO, Vec3::X, Vec3::Y), material);
    let geometry = one_view(8, [0.0, 0.0]);
    let image = render(&scene.renderer(), &window(), &geometry, &SAMPLES);
    assert_eq!(image.block([1, 1]), [1.0, 0.0, 0.0], "alpha 1 is there");
    assert_eq!(image.block([6, 1]), [0.5; 3], "alpha 0 is not");
    assert_eq!(image.block([6, 6]), [0.5; 3], "alpha 100/255 is below the cutoff");
    scene.parts.materials[1].alpha_mode = AlphaMode::Blend;
    let many = Settings { samples: 256, ..SAMPLES };
    let image = render(&scene.renderer(), &window(), &geometry, &many);
    let alpha = 100.0 / 255.0;
    // stratified samples: the fraction of samples that hit the surface is exact to one of 256
    assert!((image.get([6, 6, 0]) - (alpha + (1.0 - alpha) * 0.5)).abs() < 1.0 / 256.0, "{}", image.get([6, 6, 0]));
}

/// At each blended surface, a ray draws an independent random number, which decides whether the ray
/// hits the surface. Therefore a pixel's mean converges to the alpha-composited colour.
#[test]
fn layers_of_blended_surfaces_converge() {
    let mut scene = card(Vec3::new(0.0, 0.0, -0.5), 2.0, Vec3::Z);
    for (z, color, alpha) in [(0.0, Vec3::Y, 0.5), (0.3, Vec3::X, 0.4)] {
        let material =
            Material { base_color: color.extend(alpha), unlit: true, alpha_mode: AlphaMode::Blend, ..diffuse(1.0) };
        scene.add(rectangle(Vec3::new(0.0, 0.0, z), 2.0 * Vec3::X, 2.0 * Vec3::Y), material);
    }
    let many = Settings { samples: 4096, ..SAMPLES };
    let image = render(&scene.renderer(), &window(), &one_view(8, [0.0, 0.0]), &many);
    for pixel in image.data().chunks(3) {
        for (value, expected) in pixel.iter().zip([0.4, 0.6 * 0.5, 0.6 * 0.5]) {
            // The bound is five standard errors of independent samples: 5 √(0.3 · 0.7 / 4096) =
            // 0.036.
            assert!((value - expected).abs() < 0.036, "{pixel:?}");
        }
    }
}

/// The light that a blended surface passes reaches the surfaces behind it.
#[test]
fn blended_surfaces_cast_partial_shadows() {
    use lumistack_scene::{Light, LightKind};
    let lit = |alpha: Option<f32>| {
        let mut scene = Builder::default();
        scene.add(rectangle(Vec3::new(0.0, 0.0, -0.5), 2.0 * Vec3::X, 2.0 * Vec3::Y), diffuse(0.5));
        if let Some(alpha) = alpha {
            // the veil is above the plane and outside of the view, where it blocks the slanted
            // light
            let mut veil = diffuse(0.0);
            veil.base_color.w = alpha;
            veil.alpha_mode = AlphaMode::Blend;
            scene.add(rectangle(Vec3::new(3.0, 0.0, 0.5), 1.5 * Vec3::X, 3.0 * Vec3::Y), veil);
        }
        scene.parts.lights.push(Light {
            position: Vec3::ZERO,
            direction: Vec3::new(-3.0, 0.0, -1.0).normalize(),
            intensity: Vec3::ONE,
            kind: LightKind::Directional,
        });
        let settings = Settings { max_bounces: 1, ..SAMPLES };
        render(&scene.renderer(), &window(), &one_view(8, [0.0, 0.0]), &settings).get([4, 4, 0])
    };
    let open = lit(None);
    assert!((lit(Some(0.25)) / open - 0.75).abs() < 1e-5 && lit(Some(1.0)) == 0.0);
}

/// A normal map shows the same relief on every placement: mirrored, stretched, turned. The test
/// surface leans towards the right of the map's picture.
#[test]
fn normal_maps_keep_their_relief() {
    use lumistack_scene::{Light, LightKind};
    for (name, placement) in [
        ("as it is", Affine3A::IDENTITY),
        ("mirrored", Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0))),
        ("stretched", Affine3A::from_scale(Vec3::new(1.0, 3.0, 2.0))),
        ("turned", Affine3A::from_rotation_z(std::f32::consts::PI)),
    ] {
        // the whole surface leans 45° towards the picture's right (u), and not along v
        let texel = [217, 128, 217, 255];
        let mut scene = Builder::default();
        scene.parts.images.push(Image { name: "n".into(), width: 1, height: 1, pixels: Pixels::Rgba8(vec![texel]) });
        scene.parts.textures.push(Texture {
            image: 0,
            wrap_u: Wrap::Repeat,
            wrap_v: Wrap::Repeat,
            filter: Filter::Linear,
        });
        let map = TextureUse { texture: 0, uv_set: 0, texture_from_mesh: glam::Affine2::IDENTITY };
        scene.add(rectangle(Vec3::ZERO, Vec3::X, Vec3::Y), Material { normal_texture: Some(map), ..diffuse(1.0) });
        scene.parts.instances[0].scene_from_mesh = placement;
        let picture_right = placement.transform_vector3(Vec3::X).normalize();
        let mut lit_from = |direction: Vec3| {
            scene.parts.lights = vec![Light {
                position: Vec3::ZERO,
                direction: -direction.normalize(),
                intensity: Vec3::splat(std::f32::consts::PI),
                kind: LightKind::Directional,
            }];
            render(&scene.renderer(), &window(), &one_view(4, [0.0, 0.0]), &SAMPLES).get([1, 1, 0])
        };
        let from_right = lit_from(picture_right + Vec3::Z);
        // the bumps of 45° keep the fraction 2 / (1 + √(9/8)) of light at 45°
        assert!((from_right - 0.971).abs() < 0.01, "{name}: the relief faces this light, {from_right}");
        let from_left = lit_from(-picture_right + Vec3::Z);
        assert!(from_left < 0.01, "{name}: the relief is edge-on to this light, {from_left}");
    }
}

/// A diffuse surface with a normal map is equally bright from all sides, since only specular
/// normals are bent towards the viewer. Its bumps shade one another: the cosine of the light is
/// multiplied by `2 cos θ / (cos θ + √(cos² θ + α² sin² θ))`. θ is the angle between the light and
/// the geometric normal. The map tilts normals by 45°, so α² = tan² 45° / 8.
#[test]
fn diffuse_normal_maps_do_not_depend_on_the_viewer() {
    use lumistack_scene::{Light, LightKind};
    let mut scene = Builder::default();
    scene.parts.images.push(Image {
        name: "n".into(),
        width: 1,
        height: 1,
        pixels: Pixels::Rgba8(vec![[217, 128, 217, 255]]),
    });
    scene.parts.textures.push(Texture { image: 0, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, filter: Filter::Linear });
    let map = TextureUse { texture: 0, uv_set: 0, texture_from_mesh: glam::Affine2::IDENTITY };
    scene.add(rectangle(Vec3::ZERO, Vec3::X, Vec3::Y), Material { normal_texture: Some(map), ..diffuse(1.0) });
    for (light, expected) in [(Vec3::Z, 0.707), (Vec3::new(-0.5, 0.0, 1.0), 0.314), (Vec3::new(2.0, 0.0, 1.0), 0.853)] {
        scene.parts.lights = vec![Light {
            position: Vec3::ZERO,
            direction: -light.normalize(),
            intensity: Vec3::splat(std::f32::consts::PI),
            kind: LightKind::Directional,
        }];
        let renderer = scene.renderer();
        for slope in [-3.0, 0.0, 3.0] {
            let seen = render(&renderer, &window(), &one_view(4, [slope, 0.0]), &SAMPLES).get([1, 1, 0]);
            assert!((seen - expected).abs() < 0.01, "light from {light}, slope {slope}: {seen}, not {expected}");
        }
    }
}

#[test]
fn single_sided_backs_are_invisible_and_mirrored_copies_keep_their_front() {
    let mut scene = Builder::default();
    let front_only = Material { double_sided: false, ..glowing(Vec3::ONE) };
    scene.add(rectangle(Vec3::ZERO, Vec3::X, Vec3::Y), front_only);
    let seen =
        |scene: &Builder| render(&scene.renderer(), &window(), &one_view(2, [0.0, 0.0]), &SAMPLES).get([0, 0, 0]);
    assert_eq!(seen(&scene), 1.0);
    scene.parts.instances[0].scene_from_mesh = Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    assert_eq!(seen(&scene), 1.0, "a mirrored copy still faces the viewer");
    scene.parts.instances[0].scene_from_mesh = Affine3A::from_rotation_y(std::f32::consts::PI);
    assert_eq!(seen(&scene), 0.0, "turned away");
}

#[test]
fn a_fine_texture_is_filtered_to_its_mean() {
    // Each of the 4 × 4 pixels shows 128 × 128 texels of a checkerboard. So its value is near the
    // mean even with one sample.
    let mut scene = Builder::default();
    let size = 512;
    let texels =
        (0..size * size).map(|i| if (i % size + i / size) % 2 == 0 { [255; 4] } else { [0, 0, 0, 255] }).collect();
    scene.parts.images.push(Image { name: "c".into(), width: size, height: size, pixels: Pixels::Rgba8(texels) });
    scene.parts.textures.push(Texture { image: 0, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, filter: Filter::Linear });
    let picture = TextureUse { texture: 0, uv_set: 0, texture_from_mesh: glam::Affine2::IDENTITY };
    scene.add(
        rectangle(Vec3::ZERO, Vec3::X, Vec3::Y),
        Material { unlit: true, base_color_texture: Some(picture), ..diffuse(1.0) },
    );
    for slope in [[0.0, 0.0], [0.8, -0.3]] {
        let one = Settings { samples: 1, ..SAMPLES };
        let image = render(&scene.renderer(), &window(), &one_view(4, slope), &one);
        // levels of the pyramid have 8 bits; near 0.5, half of a code is a difference of 0.003
        assert!(image.data().iter().all(|v| (v - 0.5).abs() < 5e-3), "{:?}", &image.data()[..6]);
    }
}

/// A card off the display plane is blurred by its parallax over the bin: a box of width z·Δs. A
/// card on the plane stays sharp.
#[test]
fn the_angular_filter_blurs_what_is_off_the_plane() {
    let grid = ViewGrid { projection: Projection::Oblique, slope_x: vec![-0.4, 0.0, 0.4], slope_y: vec![0.0] };
    let geometry = one_view(SIZE, [0.0, 0.0]).with_grid(grid);
    let settings = |angular_filter| Settings { samples: 256, angular_filter, ..SAMPLES };
    for (z, width) in [(0.0f32, 0.0), (0.5, 0.5 * 0.4)] {
        let renderer = card(Vec3::new(0.0, 0.0, z), 0.3, Vec3::ONE).renderer();
        let (image, _) = render_view(&renderer, &window(), &geometry, [0, 1], &settings(AngularFilter::Bin));
        let (sharp, _) = render_view(&renderer, &window(), &geometry, [0, 1], &settings(AngularFilter::Point));
        let row: Vec<f32> = (0..SIZE).map(|col| image.get([SIZE / 2, col, 0])).collect();
        // count the columns on both edges of the card that are neither dark nor full
        let partial = row.iter().filter(|&&v| v > 0.02 && v < 0.98).count() as f64;
        assert!((partial * PITCH - 2.0 * width).abs() < 4.5 * PITCH, "{z}: {partial} columns");
        assert_centroid(&image, 0, (0.0, 0.0));
        let total = |image: &Tensor<3>| image.data().iter().map(|&v| f64::from(v)).sum::<f64>();
        assert!((total(&image) / total(&sharp) - 1.0).abs() < 5e-3, "blur keeps the light");
    }
}

/// A lens focused on the display plane blurs the edge of a card at depth z over a disc. The disc's
/// diameter is |z| times the lens's diameter. The profile is the fraction of a disc on one side of
/// a chord. If the chord is u radii from the middle, this fraction is 1/2 + (u√(1 − u²) + asin
/// u)/π.
#[test]
fn a_lens_blurs_with_a_disc() {
    let geometry = one_view(SIZE, [0.0, 0.0]);
    let settings = Settings { samples: 256, angular_filter: AngularFilter::Lens(0.8), ..SAMPLES };
    for z in [0.0f32, 0.5, -0.5] {
        let half = 0.5f32;
        let renderer = card(Vec3::new(0.0, 0.0, z), half, Vec3::ONE).renderer();
        let (image, _) = render_view(&renderer, &window(), &geometry, [0, 0], &settings);
        let radius = (0.5 * 0.8 * z.abs()) as f64;
        for col in 0..SIZE {
            // x is the distance from the card's left edge; the mean over a pixel is estimated from
            // its ends and its middle
            let profile = |x: f64| {
                let u = if radius > 0.0 { (x / radius).clamp(-1.0, 1.0) } else { x.signum() };
                0.5 + (u * (1.0 - u * u).sqrt() + u.asin()) / std::f64::consts::PI
            };
            let x = geometry.x_mm(col) + f64::from(half);
            if x > f64::from(half) || x.abs() < 0.51 * PITCH && radius == 0.0 {
                continue;
            }
            let expected = (profile(x - 0.5 * PITCH) + 4.0 * profile(x) + profile(x + 0.5 * PITCH)) / 6.0;
            let found = f64::from(image.get([SIZE / 2, col, 0]));
            // The tolerance 0.03 is one standard deviation of 256 independent samples. Stratified
            // samples have far smaller errors.
            assert!((found - expected).abs() < 0.03, "z {z}, {x} from the rim: {found} instead of {expected}");
        }
    }
}

fn busy_scene() -> Renderer {
    let mut scene = Builder::default();
    let picture = quadrants(&mut scene);
    let floor = Material { base_color_texture: Some(picture), ..diffuse(0.8) };
    scene.add(rectangle(Vec3::new(0.0, -0.6, 0.0), 2.0 * Vec3::X, 2.0 * Vec3::NEG_Z), floor);
    scene
        .add(common::sphere(Vec3::new(-0.3, 0.0, 0.2), 0.5, 20), Material { ior: 1.5, roughness: 0.2, ..diffuse(0.5) });
    scene.add(
        common::sphere(Vec3::new(0.6, 0.0, -0.3), 0.4, 20),
        Material { metallic: 1.0, roughness: 0.1, ..diffuse(0.9) },
    );
    scene.add(rectangle(Vec3::new(0.0, 2.0, 0.0), 0.5 * Vec3::X, 0.5 * Vec3::Z), glowing(Vec3::splat(4.0)));
    scene.sky(&[0.5, 0.2]).renderer()
}

#[test]
fn the_same_bytes_come_out_on_one_and_two_threads() {
    let renderer = busy_scene();
    let geometry = FieldGeometry { rows: 37, cols: 53, ..one_view(SIZE, [0.1, 0.1]) };
    let settings = Settings { samples: 7, ..Settings::default() };
    let on_threads = |count: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().unwrap();
        pool.install(|| render(&renderer, &window(), &geometry, &settings))
    };
    let (one, two) = (on_threads(1), on_threads(2));
    assert!(one.data().iter().zip(two.data()).all(|(a, b)| a.to_bits() == b.to_bits()));
    assert!(one.data().iter().all(|v| v.is_finite()) && one.data().iter().any(|&v| v > 0.0));
    // another renderer of the same scene gives equal bytes; another seed gives different bytes
    assert_eq!(one, render(&busy_scene(), &window(), &geometry, &settings));
    assert_ne!(one, render(&renderer, &window(), &geometry, &Settings { seed: 1, ..settings }));
}

#[test]
fn views_are_decorrelated() {
    // Two views of the same slope have the same expectation and different noise. The noise of this
    // diffuse scene has no heavy tails, so the bound below holds.
    let mut scene = Builder::default();
    scene.add(rectangle(Vec3::new(0.0, 0.0, -0.5), 3.0 * Vec3::X, 3.0 * Vec3::Y), diffuse(0.7)).sky(&[1.0, 0.2]);
    let renderer = scene.renderer();
    let size = 64;
    let grid = ViewGrid { projection: Projection::Oblique, slope_x: vec![0.1, 0.1], slope_y: vec![0.0] };
    let geometry = one_view(size, [0.0, 0.0]).with_grid(grid);
    let noise = |view: usize| -> Vec<f64> {
        let (image, _) = render_view(&renderer, &window(), &geometry, [0, view], &SAMPLES);
        let values: Vec<f64> = image.data().iter().step_by(3).map(|&v| f64::from(v)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|v| v - mean).collect()
    };
    let (a, b) = (noise(0), noise(1));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let correlation = dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt();
    // the bound is five standard errors of a correlation over all pixels
    assert!(dot(&a, &a) > 0.0 && correlation.abs() < 5.0 / size as f64, "{correlation}");
}

#[test]
fn one_pixel_and_one_view_are_enough() {
    let renderer = card(Vec3::ZERO, 5.0, Vec3::ONE).renderer();
    assert_eq!(render(&renderer, &window(), &one_view(1, [0.0, 0.0]), &SAMPLES).data(), [1.0; 3]);
}

#[test]
fn coverage_is_the_share_of_central_rays_that_hit() {
    let renderer = card(Vec3::new(0.0, 0.0, 0.3), 0.5, Vec3::ONE).renderer();
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let share = renderer.coverage(&window(), &one_view(100, [0.0, 0.0]), [0, 0], task).unwrap();
    assert!((share - 0.25).abs() < 1e-9, "{share}");
}

#[test]
fn wrong_requests_are_refused() {
    let renderer = card(Vec3::ZERO, 1.0, Vec3::ONE).renderer();
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let render = |geometry: &FieldGeometry, view, settings: &Settings| {
        renderer.render_view(&window(), geometry, view, settings, task).map(|_| ())
    };
    let good = one_view(4, [0.0, 0.0]);
    let none = Settings { samples: 0, ..SAMPLES };
    assert!(matches!(render(&good, [0, 0], &none), Err(RenderError::Settings(_))));
    assert!(matches!(render(&good, [1, 0], &SAMPLES), Err(RenderError::View { .. })));
    assert!(matches!(
        render(&FieldGeometry { rows: 0, ..good.clone() }, [0, 0], &SAMPLES),
        Err(RenderError::Geometry(_))
    ));
    cancel.cancel();
    assert!(matches!(render(&good, [0, 0], &SAMPLES), Err(RenderError::Cancelled(_))));
}

#[test]
fn a_scene_without_light_is_reported() {
    let mut scene = Builder::default();
    scene.add(rectangle(Vec3::ZERO, Vec3::X, Vec3::Y), diffuse(0.5));
    let (collector, cancel) = (Collector::default(), Cancel::default());
    let task = Task::quiet(&collector, &cancel);
    let scene = std::sync::Arc::new(scene.parts.clone().validate(task).unwrap());
    Renderer::new(scene, task).unwrap();
    assert!(collector.take().iter().any(|w| w.message.contains("nothing in the scene emits light")));
}

#[test]
fn samples_that_overflow_are_counted_and_left_out() {
    // the card is so bright that the sum of emitted and reflected light overflows f32, but directly
    // seen emission does not
    let mut scene = card(Vec3::new(0.0, 0.0, -0.5), 1.0, Vec3::splat(3e38));
    scene.parts.materials[0].base_color = Vec4::ONE;
    scene.add(rectangle(Vec3::new(0.0, -0.9, 0.0), Vec3::X, Vec3::NEG_Z), glowing(Vec3::splat(3e38)));
    let (image, warnings) =
        render_view(&scene.renderer(), &window(), &one_view(8, [0.0, 0.0]), [0, 0], &Settings::default());
    assert!(image.data().iter().all(|v| v.is_finite()));
    assert!(
        warnings.iter().any(|w| w.message.contains("samples are left out, since they are not finite numbers")),
        "{warnings:?}"
    );
}

#[test]
fn extreme_scenes_stay_finite() {
    // extreme scenes: tiny and huge scales, a position far from the origin, roughness 0
    for (scale, at) in [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)] {
        let mut scene = Builder::default();
        let place = |v: Vec3| (scale * v.as_dvec3() + DVec3::splat(at)).as_vec3();
        let unit = scale as f32;
        scene.add(
            common::sphere(place(Vec3::ZERO), 0.5 * unit, 12),
            Material { metallic: 1.0, roughness: 0.0, ..diffuse(1.0) },
        );
        scene.add(
            rectangle(place(Vec3::new(0.0, -0.5, 0.0)), 2.0 * unit * Vec3::X, 2.0 * unit * Vec3::NEG_Z),
            diffuse(1.0),
        );
        scene.sky(&[1.0]);
        scene.parts.environment.as_mut().unwrap().scene_from_environment = Quat::from_rotation_x(1.0);
        let window =
            Window::given(DVec3::splat(at), DVec3::NEG_Z, DVec3::Y, 2.0 * scale, [WINDOW_MM, WINDOW_MM]).unwrap();
        let (image, warnings) =
            render_view(&scene.renderer(), &window, &one_view(24, [0.1, 0.1]), [0, 0], &Settings::default());
        assert!(warnings.is_empty(), "{warnings:?}");
        // all surfaces are lossless and uniformly lit, so the mean radiance is 1
        let mean = image.data().iter().map(|&v| f64::from(v)).sum::<f64>() / image.data().len() as f64;
        assert!((mean - 1.0).abs() < 0.02, "scale {scale} at {at}: {mean}");
    }
}

/// A limit dims brighter samples, and the light that it removes is reported. Without a limit
/// nothing is dimmed.
#[test]
fn a_clamp_is_reported() {
    let mut scene = Builder::default();
    scene.add(rectangle(Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::Y), glowing(Vec3::new(4.0, 2.0, 1.0)));
    let renderer = scene.renderer();
    let settings = Settings { samples: 4, max_bounces: 0, ..Settings::default() };
    let (plain, warnings) = render_view(&renderer, &window(), &one_view(8, [0.0, 0.0]), [0, 0], &settings);
    assert!(warnings.is_empty() && (plain.data()[0] - 4.0).abs() < 1e-5);
    let clamped = Settings { clamp: Some(1.0), ..settings };
    let (dimmed, warnings) = render_view(&renderer, &window(), &one_view(8, [0.0, 0.0]), [0, 0], &clamped);
    assert!((dimmed.data()[0] - 1.0).abs() < 1e-5 && (dimmed.data()[2] - 0.25).abs() < 1e-5, "the colour stays");
    let [warning] = warnings.as_slice() else { panic!("{warnings:?}") };
    assert!(
        warning
            .to_string()
            .contains("the limit of clamp, 1, dims 256 of 256 samples, which removes 75.000 % of the light"),
        "{warning}"
    );
}
