//! Light from infinity: an equirectangular map, bilinear, sampled by its magnitude (the length of
//! its colour).
//!
//! The map is covered by a grid of cells with constant density in (u, v). A cell's weight is the
//! integral of bilinear magnitude times sin θ over the cell. In large maps a cell holds several
//! texels, in small maps a texel holds several cells. So the grid is never huge, and sin θ varies
//! little inside a cell.
//!
//! Only radiance above the mean is sampled ("MIS compensation", Karlík et al. 2019). Scattered rays
//! find darker light as well or better, and the power heuristic would give most samples of darker
//! light little weight. A sky of one radiance is thus never sampled here.

use std::f32::consts::PI;
use std::sync::Arc;

use glam::{Quat, Vec3};
use lumistack_scene::{Pixels, Scene};

use super::sample::magnitude;
use crate::distribution::Distribution;
use crate::math::{angle_turns, sin_cos_turns};

/// Largest number of cells along an axis of the map.
const MOST_CELLS: usize = 1024;
/// Smallest number of cells along an axis of the map.
const FEWEST_CELLS: usize = 64;

pub(crate) struct EnvironmentLight {
    scene: Arc<Scene>,
    environment_from_scene: Quat,
    scene_from_environment: Quat,
    width: usize,
    height: usize,
    columns: Cells,
    rows: Cells,
    row_choice: Distribution,
    column_choices: Vec<Option<Distribution>>,
    /// Magnitude of radiance that is subtracted before sampling.
    floor: f32,
    /// Magnitude above the floor, averaged over the sphere.
    sampled_magnitude: f32,
    /// Radiance, if it is the same from all directions.
    constant: Option<Vec3>,
}

/// Division of one axis of the map into cells. A cell covers one or more texels, or a texel is
/// split into several cells.
#[derive(Clone, Copy)]
struct Cells {
    texels: usize,
    /// Number of texels per cell; 1 if texels are not joined.
    joined: usize,
    /// Number of cells per texel. It is 1 if texels are not split. Otherwise it is even, so that
    /// the kinks of bilinear interpolation are on the edges of cells.
    split: usize,
}

impl EnvironmentLight {
    /// Prepares the environment of a scene. `None` without an environment, or when the environment
    /// is black.
    pub(crate) fn new(scene: &Arc<Scene>) -> Option<Self> {
        // first prepare sampling of all the light, which gives its mean
        let whole = Self::above(scene, 0.0)?;
        let mean = whole.sampled_magnitude;
        if whole.constant.is_some() { Some(whole) } else { Self::above(scene, mean).or(Some(whole)) }
    }

    /// Prepares sampling of the radiance above a magnitude.
    fn above(scene: &Arc<Scene>, floor: f32) -> Option<Self> {
        let environment = scene.environment?;
        let image = &scene.images[environment.image];
        let (columns, rows) = (Cells::new(image.width), Cells::new(image.height));
        let mut this = Self {
            scene: scene.clone(),
            environment_from_scene: environment.scene_from_environment.inverse(),
            scene_from_environment: environment.scene_from_environment,
            width: image.width,
            height: image.height,
            columns,
            rows,
            row_choice: Distribution::new(&[1.0])?,
            column_choices: Vec::new(),
            floor,
            sampled_magnitude: 0.0,
            constant: None,
        };
        // a sky of one radiance is found by scattering, and needs no sampling
        let Pixels::RgbF32(texels) = &image.pixels else { return None };
        if texels.iter().all(|texel| texel == &texels[0]) {
            this.constant = Some(environment.strength * Vec3::from_array(texels[0]));
            return (this.constant != Some(Vec3::ZERO)).then_some(this);
        }
        // a sample first chooses a row of cells by the row's sum, then a cell of that row
        let mut row_weights = Vec::with_capacity(rows.count());
        for row in 0..rows.count() {
            let weights: Vec<f64> = (0..columns.count()).map(|column| this.cell_weight(row, column)).collect();
            row_weights.push(weights.iter().sum());
            this.column_choices.push(Distribution::new(&weights));
        }
        this.row_choice = Distribution::new(&row_weights)?;
        // the mean over the sphere is ∫ L sin θ du dv times 2π² / 4π
        this.sampled_magnitude = (row_weights.iter().sum::<f64>() * std::f64::consts::FRAC_PI_2) as f32;
        Some(this)
    }

    /// Returns the magnitude of the radiance that [`sample`](Self::sample) draws, averaged over the
    /// sphere; 0 for a sky of one radiance.
    pub(crate) fn sampled_magnitude(&self) -> f32 {
        self.sampled_magnitude
    }

    /// Returns the radiance from a direction, and the density per solid angle with which
    /// [`sample`](Self::sample) finds this direction.
    pub(crate) fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        if let Some(radiance) = self.constant {
            return (radiance, 0.0);
        }
        let (u, v, sine) = self.map_coordinates(direction);
        let density =
            self.map_density(self.rows.at(v), self.columns.at(u)) / (2.0 * PI * PI * sine).max(f32::MIN_POSITIVE);
        (self.bilinear(u, v), density)
    }

    /// Returns a random direction, the radiance from it, and the density per solid angle of the
    /// direction.
    pub(crate) fn sample(&self, u: [f32; 2]) -> Option<(Vec3, Vec3, f32)> {
        let (row, inside_row) = self.row_choice.sample(u[1]);
        let (column, inside_column) = self.column_choices[row].as_ref()?.sample(u[0]);
        let ((u0, u1), (v0, v1)) = (self.columns.range(column), self.rows.range(row));
        let (u, v) = (u0 + (u1 - u0) * inside_column, v0 + (v1 - v0) * inside_row);
        let (sin_phi, cos_phi) = sin_cos_turns(u - 0.5);
        let (sine, cosine) = sin_cos_turns(0.5 * v);
        let direction = Vec3::new(sine * sin_phi, cosine, -sine * cos_phi);
        let density = self.map_density(row, column) / (2.0 * PI * PI * sine);
        (sine > 0.0 && density.is_finite())
            .then(|| (self.scene_from_environment * direction, self.bilinear(u, v), density))
    }

    /// Returns u, v and sin θ of a direction.
    fn map_coordinates(&self, direction: Vec3) -> (f32, f32, f32) {
        let d = self.environment_from_scene * direction;
        let sine = (d.x * d.x + d.z * d.z).sqrt();
        (0.5 + angle_turns(d.x, -d.z), 2.0 * angle_turns(sine, d.y), sine)
    }

    fn map_density(&self, row: usize, column: usize) -> f32 {
        let Some(columns) = &self.column_choices[row] else { return 0.0 };
        let ((u0, u1), (v0, v1)) = (self.columns.range(column), self.rows.range(row));
        self.row_choice.probability(row) * columns.probability(column) / ((u1 - u0) * (v1 - v0))
    }

    /// Returns the integral of (magnitude above `floor`) · sin θ du dv over a cell.
    fn cell_weight(&self, row: usize, column: usize) -> f64 {
        let mut sum = 0.0;
        let ((u0, u1), (v0, v1)) = (self.columns.range(column), self.rows.range(row));
        let (across, down) = (self.columns.joined, self.rows.joined);
        // Add up the values at the corners of squares of half a texel, or of half a cell if cells
        // are smaller than texels. The outermost corners have half the weight, since neighbouring
        // cells share them.
        for j in 0..=2 * down {
            let v = v0 + (v1 - v0) * j as f32 / (2 * down) as f32;
            let mut line = 0.0;
            for i in 0..=2 * across {
                let u = u0 + (u1 - u0) * i as f32 / (2 * across) as f32;
                let share = if i == 0 || i == 2 * across { 0.5 } else { 1.0 };
                line += share * f64::from((magnitude(self.bilinear(u, v)) - self.floor).max(0.0));
            }
            let share = if j == 0 || j == 2 * down { 0.5 } else { 1.0 };
            // sin θ is 0 where v is at a pole, but a cell that touches the pole must have some
            // weight
            sum += share * line * f64::from((PI * v).sin()).max(1e-6);
        }
        sum / (4 * across * down) as f64 * f64::from((u1 - u0) * (v1 - v0))
    }

    fn bilinear(&self, u: f32, v: f32) -> Vec3 {
        let environment = &self.scene.environment;
        let Some(environment) = environment else { return Vec3::ZERO };
        let Pixels::RgbF32(texels) = &self.scene.images[environment.image].pixels else { return Vec3::ZERO };
        let (x, y) = (u * self.width as f32 - 0.5, v * self.height as f32 - 0.5);
        // x and y are at least −0.5, so truncation of x + 1 and y + 1 equals the floor
        let (x0, y0) = ((x + 1.0) as usize, (y + 1.0) as usize);
        let (fx, fy) = (x + 1.0 - x0 as f32, y + 1.0 - y0 as f32);
        // the index x0 = 0 or y0 = 0 stands for texel −1, which is outside of the map
        let left = if x0 == 0 { self.width - 1 } else { (x0 - 1).min(self.width - 1) };
        let right = if x0 >= self.width { 0 } else { x0 };
        let (top, bottom) = (y0.saturating_sub(1) * self.width, y0.min(self.height - 1) * self.width);
        let at = |index: usize| Vec3::from_array(texels[index]);
        environment.strength
            * at(top + left).lerp(at(top + right), fx).lerp(at(bottom + left).lerp(at(bottom + right), fx), fy)
    }
}

impl Cells {
    fn new(texels: usize) -> Self {
        let joined = texels.div_ceil(MOST_CELLS);
        let split = if texels < FEWEST_CELLS { FEWEST_CELLS.div_ceil(texels).next_multiple_of(2) } else { 1 };
        Self { texels, joined, split }
    }

    fn count(self) -> usize {
        (self.texels * self.split).div_ceil(self.joined)
    }

    /// Returns the range of map coordinates of a cell.
    fn range(self, cell: usize) -> (f32, f32) {
        let parts = self.texels * self.split;
        let edge = |cell: usize| (cell * self.joined).min(parts) as f32 / parts as f32;
        (edge(cell), edge(cell + 1))
    }

    /// Returns the cell that holds a map coordinate.
    fn at(self, coordinate: f32) -> usize {
        let parts = self.texels * self.split;
        ((coordinate * parts as f32) as usize).min(parts - 1) / self.joined
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Affine3A;
    use lumistack_core::seed::Stream;
    use lumistack_core::{Cancel, Collector, Task};
    use lumistack_scene::{Environment, Image, Instance, Material, Mesh, SceneParts};
    use lumistack_testkit::statistics::{FALSE_ALARM_RATE, Mean, assert_counts};

    fn light(width: usize, height: usize, rotation: Quat, texel: impl Fn(usize, usize) -> f32) -> EnvironmentLight {
        let texels = (0..width * height).map(|i| [texel(i % width, i / width); 3]).collect();
        let parts = SceneParts {
            meshes: vec![Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            }],
            instances: vec![Instance { mesh: 0, scene_from_mesh: Affine3A::IDENTITY }],
            materials: vec![Material::default()],
            images: vec![Image { name: "sky".into(), width, height, pixels: Pixels::RgbF32(texels) }],
            environment: Some(Environment { image: 0, strength: Vec3::ONE, scene_from_environment: rotation }),
            ..SceneParts::default()
        };
        let (collector, cancel) = (Collector::default(), Cancel::default());
        EnvironmentLight::new(&Arc::new(parts.validate(Task::quiet(&collector, &cancel)).unwrap())).unwrap()
    }

    fn uneven(x: usize, y: usize) -> f32 {
        if (x * 7 + y * 5 + 3) % 11 < 3 { 0.0 } else { 0.2 + ((x * 13 + y * 29) % 17) as f32 }
    }

    #[test]
    fn the_picture_stands_as_documented() {
        // 4 × 2 texels with different values; the directions point to the centres of four texels
        let sky = light(4, 2, Quat::IDENTITY, |x, y| (4 * y + x) as f32);
        let direction = |yaw_right: f32, up: f32| {
            let (yaw, pitch) = (yaw_right.to_radians(), up.to_radians());
            Vec3::new(pitch.cos() * yaw.sin(), pitch.sin(), -pitch.cos() * yaw.cos())
        };
        for (yaw, up, expected) in [(45.0, 45.0, 2.0), (-45.0, 45.0, 1.0), (135.0, 45.0, 3.0), (45.0, -45.0, 6.0)] {
            assert!((sky.evaluate(direction(yaw, up)).0.x - expected).abs() < 1e-4, "{yaw} {up}");
        }
        // the map is turned a quarter to the left around y, so −z moves to −x
        let turned = light(4, 2, Quat::from_rotation_y(std::f32::consts::FRAC_PI_2), |x, y| (4 * y + x) as f32);
        assert!((turned.evaluate(direction(45.0 - 90.0, 45.0)).0.x - 2.0).abs() < 1e-4);
    }

    #[test]
    fn sampled_directions_follow_the_density_and_the_density_is_the_one_reported() {
        for (width, height, seed) in [(1, 2, 1), (3, 2, 2), (70, 66, 3), (2100, 40, 4)] {
            let sky = light(width, height, Quat::from_euler(glam::EulerRot::XYZ, 0.3, 1.0, -0.4), uneven);
            let (rows, cols) = (16, 16);
            let mut stream = Stream::new(seed);
            let count = 100_000;
            let mut observed = vec![0u64; rows * cols];
            for _ in 0..count {
                let (direction, _, density) = sky.sample([stream.next_f32(), stream.next_f32()]).unwrap();
                // near a cell's edge, rounding may choose different cells in the two computations,
                // and one of these cells may have a density of 0
                let reported = sky.evaluate(direction).1;
                assert!(reported > 0.0 || density < 1e-3, "{direction}");
                let cell = |z: f32, n: usize| ((0.5 * (z + 1.0) * n as f32) as usize).min(n - 1);
                let phi = direction.y.atan2(direction.x) / PI;
                observed[cell(direction.z, rows) * cols + cell(phi, cols)] += 1;
            }
            // integrate the density over cells of equal solid angle
            let points = 64;
            let mut expected = vec![0.0f64; rows * cols];
            for i in 0..rows * points {
                for j in 0..cols * points {
                    let z = 2.0 * (i as f32 + 0.5) / (rows * points) as f32 - 1.0;
                    let phi = PI * (2.0 * (j as f32 + 0.5) / (cols * points) as f32 - 1.0);
                    let sine = (1.0 - z * z).sqrt();
                    let pdf = sky.evaluate(Vec3::new(sine * phi.cos(), sine * phi.sin(), z)).1;
                    expected[i / points * cols + j / points] += f64::from(pdf);
                }
            }
            let scale = f64::from(count) * 4.0 * std::f64::consts::PI / (rows * cols * points * points) as f64;
            expected.iter_mut().for_each(|e| *e *= scale);
            assert!((expected.iter().sum::<f64>() / f64::from(count) - 1.0).abs() < 5e-3);
            assert_counts(&observed, &expected, FALSE_ALARM_RATE);
        }
    }

    #[test]
    fn importance_sampling_gives_the_mean_of_uniform_sampling() {
        let sky = light(40, 20, Quat::IDENTITY, uneven);
        let mut stream = Stream::new(5);
        let above = |radiance: Vec3| f64::from((radiance.x - sky.floor).max(0.0));
        let important = Mean::of((0..20_000).map(|_| {
            let (direction, radiance, pdf) = sky.sample([stream.next_f32(), stream.next_f32()]).unwrap();
            assert!((radiance - sky.evaluate(direction).0).abs().max_element() < 1e-2, "{direction}");
            above(radiance) / f64::from(pdf)
        }));
        let uniform = Mean::of((0..200_000).map(|_| {
            let (z, phi) = (2.0 * stream.next_f32() - 1.0, 2.0 * PI * stream.next_f32());
            let sine = (1.0 - z * z).sqrt();
            above(sky.evaluate(Vec3::new(sine * phi.cos(), sine * phi.sin(), z)).0) * 4.0 * std::f64::consts::PI
        }));
        important.assert_same(uniform, 0.0, FALSE_ALARM_RATE);
        // `uniform` has ten times as many samples. With the number of samples of `important`, the
        // standard error of `uniform` would be 3.2 times as large. `important` must have less than
        // half of this error.
        assert!(important.standard_error < 0.5 * 3.2 * uniform.standard_error, "{important:?} {uniform:?}");
        // the integral over a cell is nearly exact unless the radiance crosses `floor` within it
        assert!((important.value / (4.0 * std::f64::consts::PI * f64::from(sky.sampled_magnitude)) - 1.0).abs() < 0.03);
    }

    #[test]
    fn a_sky_of_one_radiance_is_left_to_scattered_rays() {
        let sky = light(3, 2, Quat::IDENTITY, |_, _| 0.5);
        assert_eq!((sky.evaluate(Vec3::Y), sky.sampled_magnitude()), ((Vec3::splat(0.5), 0.0), 0.0));
    }
}
