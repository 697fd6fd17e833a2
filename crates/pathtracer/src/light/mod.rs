//! All light sources: triangles, the environment, punctual lights. A sample first chooses either
//! the local lights together, or one of the lights from infinity. The chances mostly follow the
//! lights' power. A tree then chooses one of the local lights, by a bound of the light that each
//! may send to the receiver ([`tree`]).

mod environment;
mod punctual;
mod sample;
mod tree;

use std::f32::consts::PI;
use std::sync::Arc;

use glam::Vec3;
use lumistack_scene::Scene;

use self::environment::EnvironmentLight;
use self::punctual::PunctualLight;
pub(crate) use self::sample::LightSample;
use self::sample::magnitude;
pub(crate) use self::tree::Receiver;
use self::tree::{Emitter, LightTree, Parts};
use crate::distribution::Distribution;
use crate::geometry::{Geometry, SurfacePoint};
use crate::shading::Materials;

/// Fraction of the chances that is divided equally among the kinds of light that exist. It raises
/// the chance of a weak kind of light that shines from close by.
const EQUAL_SHARE: f64 = 0.3;
/// Number of points per edge of a triangle at which a textured emission is evaluated to estimate
/// its power.
const POWER_POINTS: usize = 6;
/// Step between two successive values of the 24-bit random numbers that choose a light.
const DIGIT: f32 = 1.0 / (1u32 << 24) as f32;
/// Two triangles are taken as a parallelogram if the fourth corner deviates by at most this
/// fraction of a diagonal. Such a deviation comes from the rounding of corners.
const PARALLELOGRAM_TOLERANCE: f32 = 1e-6;
/// Number of distributions by which a light is chosen. Distribution k is used for 2ᵏ to 2ᵏ⁺¹ − 1
/// [`Parts`]. The last one is also used for all larger numbers, and the first one for 0.
const PART_POWERS: u32 = 13;
/// Marks a triangle that is no light.
const NONE: u32 = u32::MAX;

/// All lights of a scene.
pub(crate) struct Lights {
    triangles: Vec<TriangleLight>,
    /// For each triangle of the scene, the index of its light; [`NONE`] for most triangles. Empty
    /// if no triangle emits.
    light_of_triangle: Vec<u32>,
    environment: Option<EnvironmentLight>,
    /// Point lights and spotlights.
    points: Vec<PunctualLight>,
    directional: Vec<PunctualLight>,
    /// Tree over the triangles, followed by the point lights and spotlights.
    tree: Option<LightTree>,
    /// Distributions that choose among the tree ([`LOCAL`]), each directional light, and the
    /// environment, in this order. Distribution k rounds the chances to multiples of 1/2ᵏ. The list
    /// is empty if no light can be sampled.
    choices: Vec<Distribution>,
}

/// Index of the tree in a choice.
const LOCAL: usize = 0;

/// A triangle, or two triangles that make a parallelogram of one radiance. Most lamps are such
/// parallelograms, and one light is quicker to choose and better stratified than two.
struct TriangleLight {
    triangle: u32,
    /// The other triangle of a parallelogram.
    partner: Option<u32>,
    area: f32,
    double_sided: bool,
    /// Corners of the triangle. For a parallelogram, one corner and the two corners next to it.
    corners: [Vec3; 3],
    normal: Vec3,
    offset: f32,
    /// Radiance, if it is the same everywhere on the triangle.
    uniform: Option<Vec3>,
}

impl Lights {
    pub(crate) fn new(scene: &Arc<Scene>, geometry: &Geometry, materials: &Materials) -> Self {
        // find the emitting triangles, and keep for each triangle of the scene the index of its
        // light
        let (triangles, mut emitters) = emitting_triangles(geometry, materials);
        let mut light_of_triangle = Vec::new();
        if !triangles.is_empty() {
            light_of_triangle = vec![NONE; geometry.triangle_count()];
            for (index, light) in triangles.iter().enumerate() {
                for triangle in [Some(light.triangle), light.partner].into_iter().flatten() {
                    light_of_triangle[triangle as usize] = index as u32;
                }
            }
        }
        // Local punctual lights join the tree. Each directional or distant light is chosen
        // separately.
        let radius = geometry.space.radius;
        let mut local_power: f64 = emitters.iter().map(|light| f64::from(light.strength * light.sides() * PI)).sum();
        let (mut points, mut directional, mut directional_powers) = (Vec::new(), Vec::new(), Vec::new());
        for light in scene.lights.iter().map(|light| PunctualLight::new(light, geometry.space)) {
            let power = light.power(radius);
            match light.emitter() {
                None => {
                    directional.push(light);
                    directional_powers.push(power);
                }
                Some(emitter) if power > 0.0 => {
                    points.push(light);
                    emitters.push(emitter);
                    local_power += power;
                }
                Some(_) => {}
            }
        }
        // Compute the chances from the powers. One chance is for all local lights together, one for
        // each directional or distant light, and one for the environment.
        let tree = LightTree::new(&emitters);
        let environment = EnvironmentLight::new(scene);
        let environment_power =
            environment.as_ref().map(|light| f64::from(light.sampled_magnitude() * PI * PI * radius * radius));
        let weights = share(&[vec![local_power], directional_powers, environment_power.into_iter().collect()]);
        let choices =
            (0..PART_POWERS).filter_map(|power| Distribution::new(&in_whole_parts(&weights, 1 << power))).collect();
        Self { triangles, light_of_triangle, environment, points, directional, tree, choices }
    }

    /// Returns true if nothing emits.
    pub(crate) fn is_dark(&self) -> bool {
        self.choices.is_empty() && self.environment.is_none()
    }

    /// Returns true if [`sample`](Self::sample) can return a light.
    pub(crate) fn can_be_sampled(&self) -> bool {
        !self.choices.is_empty()
    }

    /// Returns the radiance that arrives from infinity along `direction`, and the density with
    /// which [`sample`](Self::sample) finds `direction`.
    pub(crate) fn infinite(&self, direction: Vec3, parts: Parts) -> (Vec3, f32) {
        let Some(environment) = &self.environment else { return (Vec3::ZERO, 0.0) };
        let chance = self.chance(1 + self.directional.len(), parts);
        let (radiance, pdf) = environment.evaluate(direction);
        (radiance, chance * pdf)
    }

    /// Returns true if there are point lights or spotlights. For these lights the tilt of receivers
    /// matters.
    #[inline]
    pub(crate) fn has_horizon(&self) -> bool {
        !self.points.is_empty()
    }

    /// Returns the density per solid angle with which [`sample`](Self::sample) for this receiver
    /// finds a point of a triangle. The point is `distance` away, and the direction has this cosine
    /// to the light's normal.
    pub(crate) fn triangle_pdf(
        &self,
        triangle: u32,
        receiver: &Receiver,
        distance: f32,
        cosine: f32,
        parts: Parts,
    ) -> f32 {
        match (self.light_of_triangle.get(triangle as usize), &self.tree) {
            (None | Some(&NONE), _) | (_, None) => 0.0,
            (Some(&light), Some(tree)) => {
                let area = self.triangles[light as usize].area;
                let local = self.chance(LOCAL, parts);
                let chance = local * tree.chance(light as usize, receiver, parts_of(local, parts));
                chance * distance * distance / (area * cosine.abs()).max(f32::MIN_POSITIVE)
            }
        }
    }

    /// Chooses a light and a point of it, as seen by the receiver. The first number of `u` also
    /// chooses the light. This number is then rescaled from the light's interval to [0, 1), so that
    /// each light's samples stay stratified. `u_fine` adds the digits that rescaling loses. `parts`
    /// is a number of equal parts of [0, 1). Each part holds the first number of `u` of one of the
    /// pixel's samples.
    pub(crate) fn sample(
        &self,
        geometry: &Geometry,
        materials: &Materials,
        receiver: &Receiver,
        u: [f32; 2],
        u_fine: f32,
        parts: Parts,
    ) -> Option<LightSample> {
        // choose between the local lights and each light from infinity
        let choice = self.choice(parts)?;
        // if all lights are local, the choice needs no search
        let only_local = choice.probability(LOCAL) == 1.0;
        let (index, inside) = if only_local { (LOCAL, u[0]) } else { choice.sample(u[0]) };
        let chance = choice.probability(index);
        let inside = f64::from(inside) + f64::from(u_fine * DIGIT / chance);
        let single = |inside: f64| (inside as f32).min(1.0 - f32::EPSILON);
        // choose a local light by the tree, and a point of that light
        if index == LOCAL {
            let inside = inside.min(1.0 - f64::EPSILON);
            let (light, tree_chance, inside) = self.tree.as_ref()?.sample(receiver, inside, parts_of(chance, parts))?;
            let chance = chance * tree_chance;
            return match self.triangles.get(light) {
                Some(triangle) => {
                    triangle.sample(geometry, materials, receiver.position, chance, [single(inside), u[1]])
                }
                None => {
                    let point = self.points.get(light - self.triangles.len())?;
                    point.light_sample(receiver.position, chance, [single(inside), u[1]])
                }
            };
        }
        if let Some(light) = self.directional.get(index - 1) {
            return light.light_sample(receiver.position, chance, [single(inside), u[1]]);
        }
        let environment = self.environment.as_ref()?;
        let (direction, radiance, density) = environment.sample([single(inside), u[1]])?;
        let inverse_pdf = 1.0 / (chance * density);
        Some(LightSample { direction, end: None, weight: radiance * inverse_pdf, inverse_pdf })
    }

    fn chance(&self, index: usize, parts: Parts) -> f32 {
        self.choice(parts).map_or(0.0, |choice| choice.probability(index))
    }

    #[inline]
    fn choice(&self, parts: Parts) -> Option<&Distribution> {
        self.choices.get(parts.max(1).ilog2().min(PART_POWERS - 1) as usize)
    }
}

impl TriangleLight {
    fn sample(
        &self,
        geometry: &Geometry,
        materials: &Materials,
        from: Vec3,
        chance: f32,
        u: [f32; 2],
    ) -> Option<LightSample> {
        let barycentric = match self.partner {
            Some(_) => [1.0 - u[0] - u[1], u[0], u[1]],
            None => uniform_barycentric(u),
        };
        let [a, b, c] = self.corners;
        let position = barycentric[0] * a + barycentric[1] * b + barycentric[2] * c;
        let to_light = position - from;
        let inverse_distance = to_light.length_recip();
        let direction = to_light * inverse_distance;
        let cosine = -direction.dot(self.normal);
        // The inverse of the density is area · |cos θ'| / d², divided by the chance. Here θ' is the
        // angle to the light's normal, and d the distance. The divisions are independent, so they
        // run in parallel.
        let inverse_pdf = self.area * cosine.abs() * (inverse_distance * inverse_distance) * chance.recip();
        // no light arrives at distance 0, edge-on, from a side that does not shine, or where the
        // numbers overflow
        let is_seen = inverse_pdf > 0.0 && inverse_pdf.is_finite() && (cosine > 0.0 || self.double_sided);
        if !is_seen {
            return None;
        }
        let radiance = self.uniform.unwrap_or_else(|| {
            let point = geometry.point(self.triangle, barycentric);
            emitted(materials, geometry.material_index(self.triangle), &point, cosine)
        });
        let end = Some(position + cosine.signum() * self.offset * self.normal);
        (radiance != Vec3::ZERO).then_some(LightSample { direction, end, weight: radiance * inverse_pdf, inverse_pdf })
    }
}

impl TriangleLight {
    /// Joins this triangle and the triangle `before` to one light. `None` if they are not the
    /// halves of a parallelogram of one radiance.
    fn joined(&self, before: &Self, geometry: &Geometry) -> Option<Self> {
        let alike = before.partner.is_none()
            && before.triangle + 1 == self.triangle
            && geometry.material_index(before.triangle) == geometry.material_index(self.triangle)
            && self.uniform.is_some()
            && before.uniform == self.uniform
            && before.normal.dot(self.normal) > 1.0 - PARALLELOGRAM_TOLERANCE;
        let alone = |[a, b, c]: [Vec3; 3], other: [Vec3; 3]| {
            let shared = |corner: Vec3| other.contains(&corner);
            match [shared(a), shared(b), shared(c)] {
                [false, true, true] => Some([a, b, c]),
                [true, false, true] => Some([b, c, a]),
                [true, true, false] => Some([c, a, b]),
                _ => None,
            }
        };
        let corners @ [tip, next, last] = alone(before.corners, self.corners).filter(|_| alike)?;
        let [other_tip, ..] = alone(self.corners, before.corners)?;
        let gap = (next - tip) + (last - tip) - (other_tip - tip);
        (gap.length() <= PARALLELOGRAM_TOLERANCE * (next - last).length()).then(|| Self {
            partner: Some(self.triangle),
            area: before.area + self.area,
            corners,
            offset: before.offset.max(self.offset),
            ..*before
        })
    }
}

/// Returns barycentrics that are uniform over a triangle, with little distortion (Heitz 2019, "A
/// low-distortion map between triangle and square").
fn uniform_barycentric([mut x, mut y]: [f32; 2]) -> [f32; 3] {
    if y > x {
        x *= 0.5;
        y -= x;
    } else {
        y *= 0.5;
        x -= y;
    }
    [x, y, 1.0 - x - y]
}

/// Returns the radiance that leaves a point in a direction with this cosine to the normal, times
/// the opaque fraction of the surface.
fn emitted(materials: &Materials, material: usize, point: &SurfacePoint<'_>, cosine: f32) -> Vec3 {
    materials.emission(material, point, 0.0, true, cosine) * materials.coverage(material, point)
}

/// Returns the emitting triangles, as lights and as entries of the tree.
fn emitting_triangles(geometry: &Geometry, materials: &Materials) -> (Vec<TriangleLight>, Vec<Emitter>) {
    let mut lights: Vec<TriangleLight> = Vec::new();
    let mut emitters: Vec<Emitter> = Vec::new();
    for triangle in 0..geometry.triangle_count() as u32 {
        let material = geometry.material(triangle);
        if !material.is_emissive() {
            continue;
        }
        let index = geometry.material_index(triangle);
        let at = |k: usize| (k as f32 + 0.5) / POWER_POINTS as f32;
        let centre = geometry.point(triangle, [1.0 / 3.0; 3]);
        // mean radiance of the triangle; if it varies, it is averaged over points of the triangle
        let varies = material.textures().next().is_some() || material.clearcoat.is_some() || centre.is_colored();
        let uniform = (!varies).then(|| emitted(materials, index, &centre, 1.0));
        let mean = match uniform {
            Some(radiance) => radiance,
            None => {
                let points = (0..POWER_POINTS * POWER_POINTS).map(|i| {
                    let u = [at(i % POWER_POINTS), at(i / POWER_POINTS)];
                    emitted(materials, index, &geometry.point(triangle, uniform_barycentric(u)), 1.0)
                });
                points.sum::<Vec3>() / (POWER_POINTS * POWER_POINTS) as f32
            }
        };
        let area = geometry.area(triangle);
        let strength = area * magnitude(mean);
        // A triangle is left out here if its strength is not positive and finite, or if its area is
        // not a normal floating-point number. Scattered rays still find its light.
        if strength > 0.0 && strength.is_finite() && area.is_normal() {
            // two halves of a parallelogram become one light
            let corners @ [a, b, c] = geometry.corners(triangle);
            let light = TriangleLight {
                triangle,
                partner: None,
                area,
                double_sided: material.double_sided,
                corners,
                normal: centre.geometric_normal,
                offset: centre.offset,
                uniform,
            };
            if let (Some(first), Some(emitter)) = (lights.last_mut(), emitters.last_mut())
                && let Some(both) = light.joined(first, geometry)
            {
                *first = both;
                emitter.min = emitter.min.min(a).min(b).min(c);
                emitter.max = emitter.max.max(a).max(b).max(c);
                emitter.strength += strength;
                continue;
            }
            emitters.push(Emitter {
                min: a.min(b).min(c),
                max: a.max(b).max(c),
                strength,
                axis: centre.geometric_normal,
                normal_angle: 0.0,
                falloff_angle: 0.5 * PI,
                two_sided: material.double_sided,
            });
            lights.push(light);
        }
    }
    (lights, emitters)
}

/// Returns the chance of every light, a sum of two parts. One part is in proportion to the light's
/// power. The other part, [`EQUAL_SHARE`], is divided equally among the kinds of lights that exist,
/// and within a kind by power.
fn share(kinds: &[Vec<f64>; 3]) -> Vec<f64> {
    let sums = kinds.each_ref().map(|powers| powers.iter().sum::<f64>());
    let total: f64 = sums.iter().sum();
    let present = sums.iter().filter(|&&sum| sum > 0.0).count().max(1) as f64;
    let weight = |power: f64, sum: f64| {
        if sum > 0.0 { (1.0 - EQUAL_SHARE) * power / total + EQUAL_SHARE / present * power / sum } else { 0.0 }
    };
    kinds.iter().zip(sums).flat_map(|(powers, sum)| powers.iter().map(move |&power| weight(power, sum))).collect()
}

/// Returns the rounded number of parts in an interval of length `chance`, if [0, 1) is divided into
/// `parts` equal parts.
#[inline]
fn parts_of(chance: f32, parts: Parts) -> Parts {
    (chance * parts as f32 + 0.5) as Parts
}

/// Returns the chances in proportion to weights, rounded to whole parts of [0, 1). A chance of less
/// than half a part is not rounded. The greatest chance is 1 minus the sum of all others. If this
/// remainder is less than half of the greatest chance before rounding, no chance is rounded.
fn in_whole_parts(weights: &[f64], parts: Parts) -> Vec<f64> {
    let (sum, parts) = (weights.iter().sum::<f64>(), f64::from(parts));
    if !(sum > 0.0 && sum.is_finite()) {
        return weights.to_vec();
    }
    let mut chances: Vec<f64> = weights.iter().map(|weight| weight / sum).collect();
    let Some(greatest) = (0..weights.len()).max_by(|&a, &b| weights[a].total_cmp(&weights[b])) else { return chances };
    let rounded = |chance: f64| if chance * parts < 0.5 { chance } else { (chance * parts).round() / parts };
    let others: f64 = (0..weights.len()).filter(|&index| index != greatest).map(|index| rounded(chances[index])).sum();
    if 1.0 - others < 0.5 * chances[greatest] {
        return chances;
    }
    chances = chances.into_iter().map(rounded).collect();
    chances[greatest] = 1.0 - others;
    chances
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Affine3A;
    use lumistack_core::seed::Stream;
    use lumistack_core::{Cancel, Collector, Task};
    use lumistack_scene::{Instance, Light, LightKind, Material, Mesh, SceneParts};
    use lumistack_testkit::statistics::{FALSE_ALARM_RATE, assert_counts};

    use crate::geometry::Sharing;

    /// Returns a scene of emitting meshes: a one-sided rectangle, a triangle, a two-sided kite, a
    /// sheared parallelogram.
    fn lit_scene() -> Arc<Scene> {
        let mesh = |corners: &[[f32; 3]], triangles: &[[u32; 3]], material: usize| Mesh {
            positions: corners.iter().map(|&corner| Vec3::from_array(corner)).collect(),
            triangles: triangles.to_vec(),
            material,
            ..Mesh::default()
        };
        let halves = [[0, 1, 2], [0, 2, 3]];
        let meshes = vec![
            mesh(&[[-1.0, 2.0, -1.0], [1.0, 2.0, -1.0], [1.0, 2.0, 1.0], [-1.0, 2.0, 1.0]], &halves, 0),
            mesh(&[[3.0, 0.5, 0.0], [3.0, 1.5, 0.3], [2.5, 0.8, 1.0]], &[[0, 1, 2]], 1),
            mesh(&[[-3.0, 0.0, 0.0], [-2.0, 0.2, -0.5], [-1.5, 1.0, 0.0], [-2.0, 0.2, 0.5]], &halves, 1),
            mesh(&[[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [1.5, 1.0, 3.0], [0.5, 1.0, 3.0]], &[[0, 1, 2], [2, 3, 0]], 1),
        ];
        let shining = |emission: f32, double_sided| Material {
            emission: Vec3::splat(emission),
            double_sided,
            ..Material::default()
        };
        let parts = SceneParts {
            instances: (0..meshes.len()).map(|mesh| Instance { mesh, scene_from_mesh: Affine3A::IDENTITY }).collect(),
            meshes,
            materials: vec![shining(3.0, false), shining(1.0, true)],
            ..SceneParts::default()
        };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).unwrap())
    }

    /// Number of intervals of each barycentric coordinate. They divide a triangle into PARTS²
    /// congruent cells.
    const PARTS: usize = 4;

    /// Points sampled on lights follow their density (chi-square over the PARTS² cells of each
    /// triangle). Scattered rays that hit a light are weighted by the same density. There are four
    /// receivers, each tested with the false-alarm rate [`FALSE_ALARM_RATE`].
    #[test]
    fn points_of_lights_follow_their_density() {
        let scene = lit_scene();
        let geometry = Geometry::new(scene.clone(), Sharing::Auto);
        let materials = Materials::new(scene.clone());
        let lights = Lights::new(&scene, &geometry, &materials);
        assert_eq!(lights.triangles.iter().filter(|light| light.partner.is_some()).count(), 2, "parallelograms");
        assert_eq!(lights.triangles.len(), 5);
        let at = |x, y, z, normal| Receiver {
            position: geometry.space.point(Vec3::new(x, y, z).as_dvec3()).as_vec3(),
            normal,
            tilt: Receiver::UPRIGHT,
        };
        let receivers = [
            at(0.0, 0.0, 0.0, Some(Vec3::Y)),
            at(0.3, 1.9, 0.2, None),
            at(2.0, 0.4, 0.5, Some(Vec3::X)),
            at(0.5, 0.5, 2.0, Some(Vec3::Z)),
        ];
        let cells = PARTS * PARTS * PARTS;
        for (seed, (receiver, parts)) in receivers.iter().zip([0, 4, 16, 64]).enumerate() {
            let draws = 60_000;
            let mut expected = vec![0.0f64; geometry.triangle_count() * cells + 1];
            for triangle in 0..geometry.triangle_count() {
                let [a, b, c] = geometry.corners(triangle as u32);
                let area = 0.5 * (b - a).cross(c - a).length();
                let normal = (b - a).cross(c - a).normalize();
                // the density per area is the same all over a light, so any point serves
                let to_light = (a + b + c) / 3.0 - receiver.position;
                let (distance, cosine) = (to_light.length(), -to_light.normalize().dot(normal));
                let per_area = lights.triangle_pdf(triangle as u32, receiver, distance, cosine, parts) * cosine.abs()
                    / (distance * distance);
                // seen from a side that does not shine, a light returns no samples
                let shines = cosine > 0.0 || geometry.material(triangle as u32).double_sided;
                for i in 0..PARTS {
                    for j in 0..PARTS {
                        for k in 0..PARTS {
                            if (PARTS - 2..PARTS).contains(&(i + j + k)) && shines {
                                let share = f64::from(per_area * area) / (PARTS * PARTS) as f64;
                                expected[triangle * cells + (i * PARTS + j) * PARTS + k] = share * f64::from(draws);
                            }
                        }
                    }
                }
            }
            *expected.last_mut().unwrap() = f64::from(draws) - expected.iter().sum::<f64>();
            let mut counts = vec![0u64; expected.len()];
            let mut stream = Stream::new(70 + seed as u64);
            for _ in 0..draws {
                let [u0, u1, fine] = [stream.next_f32(), stream.next_f32(), stream.next_f32()];
                let cell = lights.sample(&geometry, &materials, receiver, [u0, u1], fine, parts);
                let cell = cell.and_then(|sample| {
                    (0..geometry.triangle_count()).find_map(|triangle| {
                        let [a, b, c] = geometry.corners(triangle as u32);
                        let normal = (b - a).cross(c - a);
                        // the shadow ray ends just in front of the light
                        let end = sample.end? - a;
                        let away = normal.normalize().dot(end);
                        if away.abs() > 1e-4 {
                            return None;
                        }
                        let t = normal.dot(a - receiver.position) / normal.dot(sample.direction);
                        let point = receiver.position + t * sample.direction;
                        let weight =
                            |p: Vec3, q: Vec3| (p - point).cross(q - point).dot(normal) / normal.length_squared();
                        let weights = [weight(b, c), weight(c, a), weight(a, b)];
                        let whole = weights.map(|weight| (weight * PARTS as f32).floor());
                        weights.iter().all(|&weight| weight > 0.0).then(|| {
                            whole.iter().fold(0, |cell, &part| cell * PARTS + (part as usize).min(PARTS - 1))
                                + triangle * cells
                        })
                    })
                });
                counts[cell.unwrap_or(expected.len() - 1)] += 1;
            }
            assert_counts(&counts, &expected, FALSE_ALARM_RATE);
        }
    }

    /// Red, green and blue light of one strength have the same chance. White light has a greater
    /// chance, by the length of its colour.
    #[test]
    fn no_colour_is_starved() {
        let mut parts = Arc::try_unwrap(lit_scene()).ok().unwrap().into_parts();
        parts.materials.iter_mut().for_each(|material| material.emission = Vec3::ZERO);
        let light = |intensity: Vec3| Light {
            position: Vec3::ZERO,
            direction: Vec3::NEG_Y,
            intensity,
            kind: LightKind::Directional,
        };
        parts.lights = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE].map(light).to_vec();
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let scene = Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).unwrap());
        let lights = Lights::new(&scene, &Geometry::new(scene.clone(), Sharing::Auto), &Materials::new(scene.clone()));
        let [red, green, blue, white] = [1, 2, 3, 4].map(|index| lights.chance(index, 0));
        assert!((red / blue - 1.0).abs() < 1e-5 && (green / blue - 1.0).abs() < 1e-5, "{red} {green} {blue}");
        assert!((white / blue - 3.0f32.sqrt()).abs() < 1e-4, "{white} {blue}");
    }

    #[test]
    fn weak_kinds_keep_their_share() {
        let weights = share(&[vec![1.0, 3.0], vec![], vec![996.0]]);
        let sum: f64 = weights.iter().sum();
        assert!((sum - 1.0).abs() < 1e-12);
        assert!((weights[0] + weights[1] - (0.7 * 0.004 + 0.15)).abs() < 1e-12);
        assert!((weights[1] / weights[0] - 3.0).abs() < 1e-12);
        assert_eq!(share(&[vec![0.0], vec![], vec![]]), [0.0]);
    }

    #[test]
    fn chances_become_whole_parts() {
        let close = |chances: Vec<f64>, expected: &[f64]| {
            assert!(chances.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{chances:?} {expected:?}");
        };
        close(in_whole_parts(&[3.3, 6.7], 16), &[5.0 / 16.0, 11.0 / 16.0]);
        // a chance of less than half a part is not rounded, and a chance of 0 stays 0
        close(in_whole_parts(&[0.0, 1e-6, 1.0], 64), &[0.0, 1e-6 / (1.0 + 1e-6), 1.0 / (1.0 + 1e-6)]);
        // two chances of 0.5 parts would be rounded up to 1 part each, which would leave nothing
        // for the third chance
        close(in_whole_parts(&[1.0, 1.0, 2.0], 2), &[0.25, 0.25, 0.5]);
        close(in_whole_parts(&[5.0], 8), &[1.0]);
        assert!(Distribution::new(&in_whole_parts(&[], 4)).is_none());
        assert!(Distribution::new(&in_whole_parts(&[0.0, 0.0], 4)).is_none());
        assert!(Distribution::new(&in_whole_parts(&[0.0], 4)).is_none());
    }

    #[test]
    fn barycentric_points_are_uniform() {
        // the mean of each barycentric weight over a triangle is 1/3, and the mean of its square is
        // 1/6
        let n = 300;
        let (mut first, mut second) = ([0.0f64; 3], [0.0f64; 3]);
        for i in 0..n * n {
            let b = uniform_barycentric([((i % n) as f32 + 0.5) / n as f32, ((i / n) as f32 + 0.5) / n as f32]);
            for k in 0..3 {
                assert!(b[k] >= 0.0);
                first[k] += f64::from(b[k]) / f64::from(n * n);
                second[k] += f64::from(b[k] * b[k]) / f64::from(n * n);
            }
        }
        for k in 0..3 {
            assert!(
                (first[k] - 1.0 / 3.0).abs() < 1e-3 && (second[k] - 1.0 / 6.0).abs() < 1e-3,
                "{first:?} {second:?}"
            );
        }
    }
}
