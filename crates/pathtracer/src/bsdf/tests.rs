//! Sampling follows the density, the density integrates to one, energy is conserved.

use std::f32::consts::TAU;

use super::*;
use lumistack_core::seed::Stream;
use lumistack_testkit::statistics::{FALSE_ALARM_RATE, Mean, assert_counts};

/// White metals and dielectrics return all light up to the interpolation error of the albedo table.
const ENERGY_TOLERANCE: f64 = 4e-3;
/// Cells of the chi-square tests, over cos θ and φ of the whole sphere.
const CELLS: [usize; 2] = [24, 24];
/// Midpoints per edge of a cell over which its density is integrated.
const CELL_POINTS: usize = 48;

fn appearance() -> Appearance {
    Appearance { base: Vec3::ONE, metallic: 0.0, roughness: 0.5, ior: 1.5, transmission: 0.0, solid: false }
}

fn viewer(cosine: f32) -> Vec3 {
    Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine)
}

fn bsdf(appearance: &Appearance, cosine: f32) -> Bsdf {
    Bsdf::new(appearance, viewer(cosine), Vec3::Z, Vec3::Z, true)
}

fn pair(stream: &mut Stream) -> [f32; 2] {
    [stream.next_f32(), stream.next_f32()]
}

/// Mean weight of sampled directions: the albedo.
fn sampled_albedo(bsdf: &Bsdf, count: usize, seed: u64) -> Mean {
    let mut stream = Stream::new(seed);
    Mean::of((0..count).map(|_| {
        let u_fresnel = stream.next_f32();
        bsdf.sample(pair(&mut stream), u_fresnel).map_or(0.0, |scatter| f64::from(scatter.weight.x))
    }))
}

#[test]
fn white_surfaces_return_all_light() {
    for metallic in [0.0, 0.4, 1.0] {
        for roughness in [0.0, 0.1, 0.3, 0.6, 1.0] {
            for cosine in [0.1, 0.5, 0.95] {
                let surface = Appearance { metallic, roughness, ..appearance() };
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

#[test]
fn transmission_conserves_energy() {
    // thin: all of a white wall's light is reflected or passed; solid and smooth: likewise, from both sides
    let thin = Appearance { transmission: 1.0, roughness: 0.4, ..appearance() };
    sampled_albedo(&bsdf(&thin, 0.7), 40_000, 2).assert_is(1.0, ENERGY_TOLERANCE, FALSE_ALARM_RATE);
    let smooth = Appearance { transmission: 1.0, roughness: 0.0, solid: true, ..appearance() };
    for front in [true, false] {
        let bsdf = Bsdf::new(&smooth, viewer(0.6), Vec3::Z, Vec3::Z, front);
        sampled_albedo(&bsdf, 40_000, 3).assert_is(1.0, 1e-5, FALSE_ALARM_RATE);
    }
    // rough glass scatters once only: it may lose, never gain
    let rough = Appearance { roughness: 0.7, ..smooth };
    let albedo = sampled_albedo(&bsdf(&rough, 0.6), 40_000, 4);
    assert!(albedo.value < 1.0 + ENERGY_TOLERANCE && albedo.value > 0.85, "{albedo:?}");
}

#[test]
fn refraction_bends_by_snells_law() {
    let glass = Appearance { transmission: 1.0, roughness: 0.0, solid: true, ..appearance() };
    let bsdf = Bsdf::new(&glass, viewer(0.5), Vec3::Z, Vec3::Z, true);
    let scatter = bsdf.sample([0.5; 2], 0.99).unwrap();
    assert!(scatter.crossed && scatter.refracted);
    // sin θ / 1.5 on the far side, away from the viewer
    assert!((scatter.direction.x + 0.75f32.sqrt() / 1.5).abs() < 1e-5, "{}", scatter.direction);
    let inside = Bsdf::new(&glass, viewer(0.5), Vec3::Z, Vec3::Z, false);
    let reflected = inside.sample([0.5; 2], 0.99).unwrap();
    assert!(!reflected.crossed, "total internal reflection");
}

#[test]
fn sampled_directions_follow_the_density() {
    let surfaces = [
        Appearance { metallic: 1.0, roughness: 0.35, ..appearance() },
        Appearance { metallic: 1.0, roughness: 1.0, ..appearance() },
        Appearance { metallic: 0.3, roughness: 0.6, ..appearance() },
        Appearance { transmission: 0.7, roughness: 0.6, ..appearance() },
        Appearance { transmission: 1.0, roughness: 0.6, solid: true, ..appearance() },
        Appearance { transmission: 0.5, roughness: 0.8, solid: true, ior: 1.2, ..appearance() },
    ];
    for (index, surface) in surfaces.iter().enumerate() {
        for (cosine, front) in [(0.9, true), (0.3, true), (0.6, false)] {
            let bsdf = Bsdf::new(surface, viewer(cosine), Vec3::Z, Vec3::Z, front);
            check_density(&bsdf, 60_000, index as u64);
        }
    }
}

/// Chi-square test of [`Bsdf::sample`] against the density of [`Bsdf::evaluate`]; samples that are absorbed are one more cell.
fn check_density(bsdf: &Bsdf, count: u64, seed: u64) {
    let [rows, cols] = CELLS;
    let local = |z: f32, phi: f32| {
        let sine = (1.0 - z * z).max(0.0).sqrt();
        bsdf.scene_from_local * Vec3::new(sine * phi.cos(), sine * phi.sin(), z)
    };
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
    let mut observed = vec![0u64; rows * cols + 1];
    let mut stream = Stream::new(seed);
    for _ in 0..count {
        let u_fresnel = stream.next_f32();
        let cell = match bsdf.sample(pair(&mut stream), u_fresnel) {
            Some(scatter) => {
                let d = bsdf.scene_from_local.transpose() * scatter.direction;
                let row = ((0.5 * (d.z + 1.0) * rows as f32) as usize).min(rows - 1);
                let col = ((d.y.atan2(d.x).rem_euclid(TAU) / TAU * cols as f32) as usize).min(cols - 1);
                row * cols + col
            }
            None => rows * cols,
        };
        observed[cell] += 1;
    }
    assert_counts(&observed, &expected, FALSE_ALARM_RATE);
}

#[test]
fn light_does_not_leak_around_a_tilted_shading_normal() {
    let tilted = Vec3::new(0.8, 0.0, 0.6);
    let bsdf = Bsdf::new(&appearance(), Vec3::new(0.6, 0.0, 0.8), Vec3::Z, tilted, true);
    // above the shading normal's horizon, below the surface
    assert_eq!(bsdf.evaluate(Vec3::new(0.95, 0.0, -0.3).normalize()).0, Vec3::ZERO);
    let mut stream = Stream::new(5);
    for _ in 0..5000 {
        let u_fresnel = stream.next_f32();
        if let Some(scatter) = bsdf.sample(pair(&mut stream), u_fresnel) {
            assert!(scatter.direction.z > 0.0 && !scatter.crossed);
        }
    }
}
