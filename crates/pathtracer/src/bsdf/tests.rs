//! Tests that sampling follows the density, that the density integrates to at most one, and that
//! energy is conserved.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;

use super::coat::Coating;
use super::lobes::LOBES;
use super::sheen::Fabric;
use super::*;
use crate::lambert::Lambert;
use crate::normals::Normals;
use lumistack_core::seed::Stream;
use lumistack_testkit::statistics::{FALSE_ALARM_RATE, Mean, assert_counts, z_limit};

/// Largest deviation from 1 of the fraction of light that white metals and dielectrics return. The
/// albedo table is interpolated, so the fraction is not exactly 1.
const ENERGY_TOLERANCE: f64 = 4e-3;
/// Like [`ENERGY_TOLERANCE`], for clear rough glass, whose table is coarser.
const GLASS_TOLERANCE: f64 = 1e-2;
/// A white surface may return up to this fraction more light than it receives, since tables and the
/// albedos of stretched lobes are approximate.
const ENERGY_GAIN: f64 = 0.02;
/// Numbers of cells of the chi-square tests, over cos θ and φ of the whole sphere.
const CELLS: [usize; 2] = [16, 16];
/// Number of midpoints per edge of a cell, over which the density is integrated.
const CELL_POINTS: usize = 40;

fn appearance() -> Appearance {
    Appearance {
        base: Vec3::ONE,
        metallic: 0.0,
        roughness: 0.5,
        ior: 1.5,
        transmission: 0.0,
        solid: false,
        compensated: true,
        extras: None,
    }
}

fn viewer(cosine: f32) -> Vec3 {
    Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine)
}

fn bsdf(appearance: &Appearance, cosine: f32) -> Bsdf {
    Bsdf::new(appearance, viewer(cosine), &Frame::flat(Vec3::Z, Vec3::Z), true)
}

fn pair(stream: &mut Stream) -> [f32; 2] {
    [stream.next_f32(), stream.next_f32()]
}

/// Returns the mean weight of sampled directions: the albedo.
fn sampled_albedo(bsdf: &Bsdf, count: usize, seed: u64) -> Mean {
    sampled_channel(bsdf, count, seed, 0)
}

fn sampled_channel(bsdf: &Bsdf, count: usize, seed: u64, channel: usize) -> Mean {
    let mut stream = Stream::new(seed);
    Mean::of((0..count).map(|_| {
        let u_fresnel = stream.next_f32();
        bsdf.sample(pair(&mut stream), u_fresnel).map_or(0.0, |scatter| f64::from(scatter.weight[channel]))
    }))
}

#[test]
fn white_surfaces_return_all_light() {
    for (metallic, ior) in [(0.0, 1.5), (0.0, 1.1), (0.0, 2.4), (0.4, 1.5), (1.0, 1.5)] {
        for roughness in [0.0, 0.1, 0.3, 0.6, 1.0] {
            for cosine in [0.1, 0.5, 0.95] {
                let surface = Appearance { metallic, roughness, ior, ..appearance() };
                let albedo = sampled_albedo(&bsdf(&surface, cosine), 40_000, 1);
                albedo.assert_is(1.0, ENERGY_TOLERANCE, FALSE_ALARM_RATE);
            }
        }
    }
}

#[test]
fn an_index_of_one_is_a_lambertian() {
    let surface = Appearance { ior: 1.0, roughness: 1.0, base: Vec3::splat(0.3), ..appearance() };
    let bsdf = bsdf(&surface, 0.4);
    let i = Vec3::new(0.5, 0.5, 0.5f32.sqrt());
    let (value, pdf) = bsdf.evaluate(i);
    assert!((value.x - 0.3 * i.z * FRAC_1_PI).abs() < 1e-6, "{value}");
    assert!((pdf - i.z * FRAC_1_PI).abs() < 1e-6);
}

/// Black plastic as smooth as a mirror reflects by Fresnel's equations, which are written with
/// angles here. The mean over all directions is 9.18 % at index 1.5.
#[test]
fn dielectrics_reflect_by_fresnels_equations() {
    let reflected = |ior: f32, cosine: f32| {
        let black = Appearance { base: Vec3::ZERO, roughness: 0.0, ior, compensated: false, ..appearance() };
        bsdf(&black, cosine).sample([0.5; 2], 0.5).map_or(0.0, |scatter| f64::from(scatter.weight.x))
    };
    for ior in [1.2f32, 1.5, 2.4] {
        for cosine in [0.02f32, 0.2, 0.5, 0.9] {
            let (here, there) = (f64::from(cosine).acos(), (f64::from(cosine).acos().sin() / f64::from(ior)).asin());
            let across = ((here - there).sin() / (here + there).sin()).powi(2);
            let along = ((here - there).tan() / (here + there).tan()).powi(2);
            let (found, expected) = (reflected(ior, cosine), 0.5 * (across + along));
            assert!((found - expected).abs() < 1e-5, "{ior} {cosine}: {found} {expected}");
        }
    }
    let count = 1000;
    let mean: f64 =
        (0..count).map(|i| reflected(1.5, ((i as f32 + 0.5) / count as f32).sqrt())).sum::<f64>() / f64::from(count);
    assert!((mean - 0.0918).abs() < 1e-4, "{mean}");
}

#[test]
fn transmission_conserves_energy() {
    // a white thin wall reflects or passes all light, and so does a smooth solid, from both sides
    let thin = Appearance { transmission: 1.0, roughness: 0.4, ..appearance() };
    sampled_albedo(&bsdf(&thin, 0.7), 40_000, 2).assert_is(1.0, ENERGY_TOLERANCE, FALSE_ALARM_RATE);
    let smooth = Appearance { transmission: 1.0, roughness: 0.0, solid: true, ..appearance() };
    for front in [true, false] {
        let bsdf = Bsdf::new(&smooth, viewer(0.6), &Frame::flat(Vec3::Z, Vec3::Z), front);
        sampled_albedo(&bsdf, 40_000, 3).assert_is(1.0, 1e-5, FALSE_ALARM_RATE);
    }
}

/// Compensated clear glass is lossless from both sides, up to the interpolation of its table.
/// Without compensation it may lose light, but never gains any.
#[test]
fn rough_glass_returns_all_light() {
    for ior in [1.1, 1.33, 1.5, 2.4] {
        for roughness in [0.1, 0.4, 0.7, 1.0] {
            for (cosine, front) in [(0.1, true), (0.6, true), (1.0, true), (0.3, false), (0.8, false)] {
                let glass = Appearance { transmission: 1.0, roughness, solid: true, ior, ..appearance() };
                let frame = Frame::flat(Vec3::Z, Vec3::Z);
                let full = sampled_albedo(&Bsdf::new(&glass, viewer(cosine), &frame, front), 20_000, 4);
                full.assert_is(1.0, GLASS_TOLERANCE, FALSE_ALARM_RATE);
                let single = Appearance { compensated: false, ..glass };
                let single = sampled_albedo(&Bsdf::new(&single, viewer(cosine), &frame, front), 20_000, 4);
                assert!(
                    single.value < 1.0 + 1e-6 + 5.0 * single.standard_error,
                    "{ior} {roughness} {cosine}: {single:?}"
                );
            }
        }
    }
}

#[test]
fn refraction_bends_by_snells_law() {
    let glass = Appearance { transmission: 1.0, roughness: 0.0, solid: true, ..appearance() };
    let bsdf = Bsdf::new(&glass, viewer(0.5), &Frame::flat(Vec3::Z, Vec3::Z), true);
    let scatter = bsdf.sample([0.5; 2], 0.99).unwrap();
    assert!(scatter.crossed && scatter.refracted);
    // The sine of the refracted direction is sin θ / 1.5. The direction points away from the
    // viewer, so its x is negative.
    assert!((scatter.direction.x + 0.75f32.sqrt() / 1.5).abs() < 1e-5, "{}", scatter.direction);
    let inside = Bsdf::new(&glass, viewer(0.5), &Frame::flat(Vec3::Z, Vec3::Z), false);
    let reflected = inside.sample([0.5; 2], 0.99).unwrap();
    assert!(!reflected.crossed, "total internal reflection");
}

fn extras() -> Extras {
    Extras {
        specular: 1.0,
        specular_color: Vec3::ONE,
        anisotropy: 0.0,
        film: None,
        layers: Layers::default(),
        dispersion: 0.0,
        wave_weight: Vec3::ONE,
    }
}

/// Returns surfaces of every kind whose base is white, with their names.
fn surfaces() -> Vec<(&'static str, Appearance)> {
    let with = |base: Appearance, extras: Extras| Appearance { extras: Some(extras), ..base };
    let plain = appearance();
    let metal = Appearance { metallic: 1.0, roughness: 0.35, ..plain };
    let glass = Appearance { transmission: 1.0, roughness: 0.6, solid: true, ..plain };
    let coat = Some(Coating { factor: 1.0, roughness: 0.3 });
    let coated = Layers { coat, ..Layers::default() };
    let sheen = Some(Fabric { color: Vec3::new(1.0, 0.7, 0.4), roughness: 0.4 });
    let film = Some(Film { factor: 1.0, ior: 1.5, thickness_nm: 420.0 });
    vec![
        ("diffuse", Appearance { ior: 1.0, roughness: 1.0, ..plain }),
        ("plastic", plain),
        ("metal", metal),
        ("roughest metal", Appearance { roughness: 1.0, ..metal }),
        ("half metal", Appearance { metallic: 0.3, roughness: 0.6, ..plain }),
        ("thin wall", Appearance { transmission: 0.7, roughness: 0.6, ..plain }),
        ("glass", glass),
        ("half glass", Appearance { transmission: 0.5, roughness: 0.8, ior: 1.2, ..glass }),
        ("half strength", with(plain, Extras { specular: 0.5, specular_color: Vec3::new(1.0, 0.2, 2.0), ..extras() })),
        (
            "gloss colour",
            with(Appearance { ior: 0.0, ..plain }, Extras { specular_color: Vec3::splat(0.4), ..extras() }),
        ),
        ("weak glass", with(glass, Extras { specular: 0.5, ..extras() })),
        ("stretched metal", with(metal, Extras { anisotropy: 0.8, ..extras() })),
        ("stretched plastic", with(plain, Extras { anisotropy: 0.5, ..extras() })),
        ("stretched glass", with(glass, Extras { anisotropy: 0.6, ..extras() })),
        ("film on metal", with(metal, Extras { film, ..extras() })),
        ("film on plastic", with(plain, Extras { film, ..extras() })),
        ("film on glass", with(glass, Extras { film, ..extras() })),
        ("velvet", with(plain, Extras { layers: Layers { sheen, ..Layers::default() }, ..extras() })),
        (
            "fine velvet",
            with(
                plain,
                Extras {
                    layers: Layers { sheen: Some(Fabric { color: Vec3::ONE, roughness: 0.15 }), ..Layers::default() },
                    ..extras()
                },
            ),
        ),
        ("coated diffuse", with(Appearance { ior: 1.0, ..plain }, Extras { layers: coated, ..extras() })),
        ("coated metal", with(metal, Extras { layers: coated, ..extras() })),
        (
            "mirror coat",
            with(
                plain,
                Extras {
                    layers: Layers { coat: Some(Coating { factor: 0.8, roughness: 0.0 }), ..Layers::default() },
                    ..extras()
                },
            ),
        ),
        ("coated glass", with(glass, Extras { layers: coated, ..extras() })),
        ("everything", with(metal, Extras { layers: Layers { sheen, ..coated }, film, anisotropy: 0.4, ..extras() })),
    ]
}

/// Returns frames whose direction of stretch is off the axes. The first has one normal. The second
/// has a tilted shading normal and a coat that leans the opposite way. The third is the second with
/// the diffuse normals of a steep normal map.
fn frames() -> [Frame; 3] {
    let tangent = Some(Vec3::new(0.8, 0.6, 0.0));
    let straight = Frame { tangent, ..Frame::flat(Vec3::Z, Vec3::Z) };
    let coat = Vec3::new(-0.2, 0.3, 0.9).normalize();
    let tilted = Frame { tangent, coat, ..Frame::flat(Vec3::Z, Vec3::new(0.25, 0.1, 0.95).normalize()) };
    [straight, tilted, Frame { diffuse: steep(), ..tilted }]
}

/// Returns the normals of a point where a steep normal map turns the smooth normal.
fn steep() -> Normals {
    Normals::new(Vec3::new(-0.8, 0.3, 0.5).normalize(), Vec3::new(0.1, 0.0, 1.0).normalize())
}

/// Views of the sampling tests: cosine of the viewer's direction, and true for the front face.
const VIEWS: [(f32, bool); 3] = [(0.9, true), (0.3, true), (0.6, false)];

#[test]
fn sampled_directions_follow_the_density() {
    for (index, (name, surface)) in surfaces().iter().enumerate() {
        for (cosine, front) in VIEWS {
            for frame in frames() {
                println!("{name}, cosine {cosine}, front {front}, shading {}", frame.shading);
                check_density(&Bsdf::new(surface, viewer(cosine), &frame, front), 40_000, index as u64);
            }
        }
    }
}

/// Every lobe alone follows its density. The chances of all other lobes are 0, since a mixture may
/// hide a fault of a lobe that is rarely chosen.
#[test]
fn every_lobe_follows_its_density() {
    for (index, (name, surface)) in surfaces().iter().enumerate() {
        for (cosine, front) in VIEWS {
            for lobe in 0..LOBES {
                let bsdf = Bsdf::new(surface, viewer(cosine), &frames()[2], front);
                let Some(alone) = bsdf.alone(lobe) else { continue };
                println!("{name}, lobe {lobe}, cosine {cosine}, front {front}");
                check_density(&alone, 40_000, (1000 + index) as u64);
            }
        }
    }
}

/// No surface sends out more light than arrives, at any roughness and angle, in any channel.
#[test]
fn no_surface_gains_energy() {
    for (name, surface) in surfaces() {
        for roughness in [0.0, 0.15, 0.4, 0.7, 1.0] {
            for cosine in [0.03, 0.2, 0.5, 0.8, 1.0] {
                for frame in [frames()[0], Frame { tangent: Some(Vec3::Y), ..frames()[0] }] {
                    let bsdf = Bsdf::new(&Appearance { roughness, ..surface }, viewer(cosine), &frame, true);
                    for channel in 0..3 {
                        let albedo = sampled_channel(&bsdf, 4_000, 7, channel);
                        let most = 1.0 + ENERGY_GAIN + z_limit(FALSE_ALARM_RATE) * albedo.standard_error;
                        assert!(
                            albedo.value.is_finite() && albedo.value <= most,
                            "{name}, roughness {roughness}, cosine {cosine}, channel {channel}: {albedo:?}"
                        );
                    }
                }
            }
        }
    }
}

/// Surfaces on which nothing is absorbed return all light, up to the interpolation of the tables.
#[test]
fn lossless_layers_return_all_light() {
    let tolerances = [
        ("stretched metal", 0.02),
        ("stretched plastic", 0.01),
        ("coated diffuse", ENERGY_TOLERANCE),
        ("coated metal", ENERGY_TOLERANCE),
        ("mirror coat", ENERGY_TOLERANCE),
        ("coated glass", GLASS_TOLERANCE),
        ("gloss colour", ENERGY_TOLERANCE),
    ];
    for (name, tolerance) in tolerances {
        let (_, surface) = surfaces().into_iter().find(|(known, _)| *known == name).unwrap();
        for cosine in [0.15, 0.5, 0.9] {
            for tangent in [Vec3::X, Vec3::Y] {
                let frame = Frame { tangent: Some(tangent), ..Frame::flat(Vec3::Z, Vec3::Z) };
                let albedo = sampled_albedo(&Bsdf::new(&surface, viewer(cosine), &frame, true), 20_000, 3);
                println!("{name}, cosine {cosine}, tangent {tangent}: {albedo:?}");
                albedo.assert_is(1.0, tolerance, FALSE_ALARM_RATE);
            }
        }
    }
}

/// Each sample of a rough lobe has the weight and density that evaluation returns for its
/// direction.
#[test]
fn sampling_and_evaluation_agree() {
    for (name, surface) in surfaces() {
        for (cosine, front) in VIEWS {
            let bsdf = Bsdf::new(&surface, viewer(cosine), &frames()[2], front);
            let mut stream = Stream::new(11);
            for _ in 0..300 {
                let u_fresnel = stream.next_f32();
                let Some(scatter) = bsdf.sample(pair(&mut stream), u_fresnel) else { continue };
                if scatter.pdf.is_infinite() {
                    continue;
                }
                let (value, pdf) = bsdf.evaluate(scatter.direction);
                assert!((pdf / scatter.pdf - 1.0).abs() < 1e-3, "{name}: {pdf} {}", scatter.pdf);
                let error = (value / pdf - scatter.weight).abs().max_element();
                assert!(error <= 1e-3 * scatter.weight.max_element(), "{name}: {} {}", value / pdf, scatter.weight);
                assert_eq!(scatter.crossed, scatter.direction.z < 0.0, "{name}");
            }
        }
    }
}

/// Single-scattering microfacets are reciprocal: f(o, i) = f(i, o). `Bsdf` returns f for
/// basic radiance. So for glass, f divided by the squared index of the light's side is reciprocal.
#[test]
fn single_scattering_is_reciprocal() {
    let single = |surface: Appearance| Appearance { compensated: false, ..surface };
    let metal = Appearance { metallic: 1.0, roughness: 0.5, base: Vec3::new(0.9, 0.5, 0.2), ..appearance() };
    let stretched = Appearance { extras: Some(Extras { anisotropy: 0.7, ..extras() }), ..metal };
    let film = Some(Film { factor: 1.0, ior: 1.4, thickness_nm: 500.0 });
    let filmed = Appearance { extras: Some(Extras { film, ..extras() }), ..metal };
    let glass = Appearance { transmission: 1.0, solid: true, ..appearance() };
    let frame = frames()[0];
    let mut stream = Stream::new(3);
    let mut compared = 0;
    for surface in [metal, stretched, filmed, glass].map(single) {
        for _ in 0..300 {
            let mut direction =
                || Vec3::from_array([(); 3].map(|()| 2.0 * stream.next_f32() - 1.0)).normalize_or(Vec3::Z);
            let (o, i) = (direction(), direction());
            // Computes f for light from `to`, as seen from `from`. The shading normal is on the
            // side of `from`, since `Bsdf` expects it on the viewer's side.
            let seen = |from: Vec3, to: Vec3| {
                let side = from.z.signum();
                let frame = Frame { tangent: frame.tangent, ..Frame::flat(side * Vec3::Z, side * Vec3::Z) };
                let index = if to.z < 0.0 { surface.ior } else { 1.0 };
                Bsdf::new(&surface, from, &frame, from.z > 0.0).evaluate(to).0 / (to.z.abs() * index * index)
            };
            if o.z.abs() < 0.05 || i.z.abs() < 0.05 {
                continue;
            }
            let (there, back) = (seen(o, i), seen(i, o));
            // An opaque surface passes no light: for directions on different sides of it, the two
            // values are 0 and agree.
            let error = (there - back).abs().max_element();
            assert!(error <= 2e-3 * there.max_element().max(1e-3), "{o} {i}: {there} {back}");
            compared += usize::from(there != Vec3::ZERO);
        }
    }
    assert!(compared > 300, "{compared}");
}

/// A film with factor 0 changes nothing. A film with the index of its base adds no second
/// interface.
#[test]
fn films_have_their_limits() {
    let bare = Vec3::splat(0.3);
    for cosine in [0.1, 0.5, 1.0] {
        let same = Film { factor: 0.0, ior: 1.8, thickness_nm: 300.0 }.over(bare, Vec3::splat(0.04), cosine);
        assert_eq!(same, bare);
        // A film of index 1.5 on a base of index 1.5 has one interface, its upper side. The
        // tolerance is for a small rest of interference, since the code clamps the product of the
        // reflectances above 0.
        let one = Film { factor: 1.0, ior: 1.5, thickness_nm: 500.0 }.over(bare, Vec3::splat(0.04), cosine);
        let schlick = 0.04 + 0.96 * (1.0 - cosine).powi(5);
        assert!((one - schlick).abs().max_element() < 0.03, "{cosine}: {one} against {schlick}");
        // thick films have no colour: over the spectrum, interference averages out
        let thick = Film { factor: 1.0, ior: 1.5, thickness_nm: 20_000.0 }.over(bare, Vec3::splat(0.5), cosine);
        assert!(thick.max_element() - thick.min_element() < 1e-3, "{thick}");
    }
    // a film of a quarter wavelength of 550 nm on a denser base reflects little green light
    let quarter = Film { factor: 1.0, ior: 1.22, thickness_nm: 550.0 / 4.0 / 1.22 }.over(bare, Vec3::splat(0.04), 1.0);
    assert!(quarter.y < 0.01 && quarter.max_element() < 0.03, "{quarter}");
}

/// On white plastic, the largest channel of the film's reflectance dims all channels of the lobes
/// below (`KHR_materials_iridescence`). So the brightest channel returns all light. Each weaker
/// channel loses only its difference from the brightest channel.
#[test]
fn a_film_on_plastic_loses_light_in_weaker_channels_only() {
    for thickness_nm in [200.0, 350.0, 600.0] {
        for cosine in [0.3, 0.6, 1.0] {
            let film = Film { factor: 1.0, ior: 1.8, thickness_nm };
            let extras = Some(Extras { film: Some(film), ..extras() });
            let plastic = bsdf(&Appearance { roughness: 0.0, extras, ..appearance() }, cosine);
            let bare = (1.0 - cosine).powi(5);
            let film = film.over(Vec3::splat(0.04 + 0.96 * bare), Vec3::splat(0.04), cosine);
            for channel in 0..3 {
                let lost = f64::from(film.max_element() - film[channel]);
                let albedo = sampled_channel(&plastic, 20_000, 9, channel);
                albedo.assert_is(1.0 - lost, ENERGY_TOLERANCE, FALSE_ALARM_RATE);
            }
            assert!(film.max_element() - film.min_element() < 0.35, "{film}: more than a third would be lost");
        }
    }
}

/// A path's wavelength changes only the index of refraction and the tint of the transmitted light.
/// On average, the glass stays white.
#[test]
fn dispersion_keeps_white_white() {
    let glass = Appearance { transmission: 1.0, roughness: 0.0, solid: true, ior: 1.5, ..appearance() };
    let glass = Appearance { extras: Some(Extras { dispersion: 1.0, ..extras() }), ..glass };
    let mut stream = Stream::new(9);
    let mut samples: [Vec<f64>; 3] = Default::default();
    let mut indices = Vec::new();
    for _ in 0..40_000 {
        let mut here = glass;
        let nanometres = here.disperse(None, || stream.next_f32()).unwrap();
        indices.push((nanometres, here.ior));
        let bsdf = Bsdf::new(&here, viewer(0.6), &Frame::flat(Vec3::Z, Vec3::Z), true);
        let u_fresnel = stream.next_f32();
        let weight = bsdf.sample(pair(&mut stream), u_fresnel).unwrap().weight;
        (0..3).for_each(|channel| samples[channel].push(f64::from(weight[channel])));
        let mut again = glass;
        assert_eq!(again.disperse(Some(nanometres), || panic!("drawn twice")), Some(nanometres));
        assert_eq!((again.ior, again.extras.unwrap().wave_weight), (here.ior, Vec3::ONE));
    }
    // The tolerance is needed, since the reflectance differs by a few thousandths between channels.
    samples.into_iter().for_each(|samples| Mean::of(samples).assert_is(1.0, 5e-3, FALSE_ALARM_RATE));
    assert!(indices.iter().all(|&(nanometres, ior)| (ior > 1.5) == (nanometres < 587.57)));
    assert_eq!(appearance().disperse(None, || panic!("drawn for nothing")), None);
}

/// Tests, by chi-square, that the directions of [`Bsdf::sample`] follow the density of
/// [`Bsdf::evaluate`]. Samples that are absorbed, or reflected by a mirror, are counted in one more
/// cell.
fn check_density(bsdf: &Bsdf, count: u64, seed: u64) {
    let [rows, cols] = CELLS;
    let local = |z: f32, phi: f32| {
        let sine = (1.0 - z * z).max(0.0).sqrt();
        bsdf.facet.scene_from_local * Vec3::new(sine * phi.cos(), sine * phi.sin(), z)
    };
    // integrate the density over every cell
    let mut expected = vec![0.0f64; rows * cols];
    for (cell, expected) in expected.iter_mut().enumerate() {
        for k in 0..CELL_POINTS * CELL_POINTS {
            let (row, col) = (cell / cols, cell % cols);
            let at = |cell: usize, k: usize, n: usize| (cell as f32 + (k as f32 + 0.5) / CELL_POINTS as f32) / n as f32;
            let z = 2.0 * at(row, k / CELL_POINTS, rows) - 1.0;
            let phi = TAU * at(col, k % CELL_POINTS, cols);
            *expected += f64::from(bsdf.evaluate(local(z, phi)).1);
        }
        let solid_angle = 2.0 * std::f64::consts::TAU / (rows * cols * CELL_POINTS * CELL_POINTS) as f64;
        *expected *= solid_angle * count as f64;
    }
    let inside: f64 = expected.iter().sum::<f64>();
    assert!(inside < 1.005 * count as f64, "the density integrates to {}", inside / count as f64);
    expected.push((count as f64 - inside).max(0.0));
    // count the sampled directions in the same cells
    let mut observed = vec![0u64; rows * cols + 1];
    let mut stream = Stream::new(seed);
    for _ in 0..count {
        let u_fresnel = stream.next_f32();
        let cell = match bsdf.sample(pair(&mut stream), u_fresnel) {
            Some(scatter) if scatter.pdf.is_finite() => {
                let d = bsdf.facet.scene_from_local.transpose() * scatter.direction;
                let row = ((0.5 * (d.z + 1.0) * rows as f32) as usize).min(rows - 1);
                let col = ((d.y.atan2(d.x).rem_euclid(TAU) / TAU * cols as f32) as usize).min(cols - 1);
                row * cols + col
            }
            _ => rows * cols,
        };
        observed[cell] += 1;
    }
    assert_counts(&observed, &expected, FALSE_ALARM_RATE);
}

/// Without gloss the model equals its diffuse special case, even if a steep normal map changes the
/// normal of specular reflection.
#[test]
fn diffuse_light_is_that_of_lambert_surfaces() {
    let surface = Appearance { ior: 1.0, roughness: 1.0, base: Vec3::new(0.9, 0.5, 0.2), ..appearance() };
    let general = Bsdf::new(&surface, viewer(0.2), &frames()[2], true);
    let lambert = Lambert::new(surface.base, Vec3::Z, steep());
    let (mut stream, mut lit) = (Stream::new(12), 0);
    for _ in 0..2000 {
        let direction = Vec3::from_array([(); 3].map(|()| 2.0 * stream.next_f32() - 1.0)).normalize_or(Vec3::Z);
        let ((value, pdf), (expected, expected_pdf)) = (general.evaluate(direction), lambert.evaluate(direction));
        assert!((value - expected).abs().max_element() < 1e-5, "{direction}: {value} {expected}");
        assert!((pdf - expected_pdf).abs() < 1e-5, "{direction}: {pdf} {expected_pdf}");
        lit += usize::from(value != Vec3::ZERO);
    }
    assert!((200..1000).contains(&lit), "{lit}");
}

#[test]
fn light_does_not_leak_around_a_tilted_shading_normal() {
    let tilted = Vec3::new(0.8, 0.0, 0.6);
    let bsdf = Bsdf::new(&appearance(), Vec3::new(0.6, 0.0, 0.8), &Frame::flat(Vec3::Z, tilted), true);
    // This direction is above the plane of the shading normal, but below the surface.
    assert_eq!(bsdf.evaluate(Vec3::new(0.95, 0.0, -0.3).normalize()).0, Vec3::ZERO);
    let mut stream = Stream::new(5);
    for _ in 0..5000 {
        let u_fresnel = stream.next_f32();
        if let Some(scatter) = bsdf.sample(pair(&mut stream), u_fresnel) {
            assert!(scatter.direction.z > 0.0 && !scatter.crossed);
        }
    }
}
