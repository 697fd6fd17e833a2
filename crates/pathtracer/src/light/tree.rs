//! Chooses one of many local lights, by a bound of the irradiance that each of them gives at a
//! point. The lights are leaves of a binary tree.
//!
//! A node bounds its lights' positions by a box and their directions by a cone, and sums their
//! strengths I (radiant intensity along the normal). The descent chooses one child of each node.
//! The chance is in proportion to a bound of the irradiance that the child gives (Conty Estevez,
//! Kulla 2018):
//!
//! ```text
//! I cos θ' max(cos θᵢ', 0) / d²,   θ' = max(0, θ_w − θ_o − θ_b),   θᵢ' = max(0, θ_i − θ_b)
//! ```
//!
//! The angles are:
//!
//! * θ_b: the half angle of the box seen from the point,
//! * θ_w: the angle between the cone's axis and the direction to the point,
//! * θ_o: the half angle of the cone that holds the normals,
//! * θ_i: the angle between the receiver's normal and the direction to the box, less the receiver's
//!   tilt.
//!
//! d is the distance to the box's centre, or the box's radius if that is greater. A bound of 0
//! means that no light can arrive, so the estimate stays unbiased.
//!
//! A pixel's samples choose a light by numbers in [0, 1), which is divided into equal parts with
//! one number each ([`Parts`]). The chances of two children are rounded to whole parts, if each
//! child keeps at least one part. Then every light gets exactly its fraction of the samples, and
//! the choice among a few point lights adds no noise. Rounded chances are valid chances too, so the
//! estimate stays unbiased.

use std::f32::consts::PI;

use glam::{Quat, Vec3};

/// Number of buckets into which a node's lights are sorted along each axis. The node is split at a
/// border of two buckets.
const BUCKETS: usize = 12;

/// A point that receives light, from one side of a surface or from all directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Receiver {
    pub(crate) position: Vec3,
    /// Unit normal of an opaque surface, which receives light only from the normal's side. `None`
    /// for surfaces that light passes through.
    pub(crate) normal: Option<Vec3>,
    /// Cosine and sine of the tilt: the angle by which light may come from below the plane of the
    /// surface. Only triangles that approximate a smooth surface have a tilt other than 0.
    pub(crate) tilt: [f32; 2],
}

impl Receiver {
    /// [`tilt`](Self::tilt) of surfaces that are as flat as their triangles.
    pub(crate) const UPRIGHT: [f32; 2] = [1.0, 0.0];
}

/// A light or a set of lights: its box, and the cone of its directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Emitter {
    pub(crate) min: Vec3,
    pub(crate) max: Vec3,
    /// Radiant intensity along the axis, by the measure [`magnitude`](super::sample::magnitude).
    pub(crate) strength: f32,
    pub(crate) axis: Vec3,
    /// Largest angle between the axis and a normal.
    pub(crate) normal_angle: f32,
    /// Largest angle between a normal and light that leaves.
    pub(crate) falloff_angle: f32,
    /// True if light also leaves around the direction opposite to the axis.
    pub(crate) two_sided: bool,
}

/// Number of equal parts of [0, 1). Each part holds one of the random numbers by which a pixel's
/// samples choose a light. 0 if nothing is known about these numbers.
pub(crate) type Parts = u32;

/// Rounds the chance of the first child to whole parts. The chance stays unrounded if the first
/// child would get no part or all parts. Also returns how many parts each child gets.
#[inline]
pub(super) fn whole_parts(chance: f32, parts: Parts) -> (f32, [Parts; 2]) {
    let first = (chance * parts as f32 + 0.5) as Parts;
    let chance = if first == 0 || first >= parts { chance } else { first as f32 / parts as f32 };
    (chance, [first.min(parts), parts.saturating_sub(first)])
}

/// The tree; leaves are single lights.
pub(crate) struct LightTree {
    nodes: Vec<Node>,
    /// For each light, the path from the root to its leaf: a bit per turn, 1 for the second child.
    /// The first turn is the lowest bit.
    trails: Vec<u64>,
}

struct Node {
    centre: Vec3,
    radius: f32,
    strength: f32,
    axis: Vec3,
    cos_normal: f32,
    sin_normal: f32,
    cos_falloff: f32,
    two_sided: bool,
    /// Index of the second child (the first child follows its parent); in a leaf, index of the
    /// light.
    next: u32,
    is_leaf: bool,
}

impl LightTree {
    /// Builds a tree of lights whose strengths are > 0; `None` without lights.
    pub(crate) fn new(lights: &[Emitter]) -> Option<Self> {
        if lights.is_empty() {
            return None;
        }
        let mut tree = Self { nodes: Vec::with_capacity(2 * lights.len() - 1), trails: vec![0; lights.len()] };
        let mut order: Vec<u32> = (0..lights.len() as u32).collect();
        tree.build(lights, &mut order, 0, 0);
        Some(tree)
    }

    /// Chooses a light by `u` in [0, 1). Returns its index, its chance, and `u` rescaled from the
    /// light's interval to [0, 1). `None` where no light can arrive.
    pub(crate) fn sample(&self, receiver: &Receiver, mut u: f64, mut parts: Parts) -> Option<(usize, f32, f64)> {
        let (mut index, mut chance) = (0, 1.0);
        loop {
            let node = &self.nodes[index];
            if node.is_leaf {
                return Some((node.next as usize, chance, u));
            }
            let (first, sides) = whole_parts(self.first_share(index, receiver)?, parts);
            let edge = f64::from(first);
            if u < edge {
                u /= edge;
                chance *= first;
                (index, parts) = (index + 1, sides[0]);
            } else {
                u = (u - edge) / (1.0 - edge);
                chance *= 1.0 - first;
                (index, parts) = (node.next as usize, sides[1]);
            }
            u = u.min(1.0 - f64::EPSILON);
        }
    }

    /// Returns the chance with which [`sample`](Self::sample) chooses a light.
    pub(crate) fn chance(&self, light: usize, receiver: &Receiver, mut parts: Parts) -> f32 {
        let (mut index, mut chance) = (0, 1.0);
        let mut trail = self.trails[light];
        while !self.nodes[index].is_leaf {
            let Some(first) = self.first_share(index, receiver) else { return 0.0 };
            let (first, sides) = whole_parts(first, parts);
            if trail & 1 == 0 {
                chance *= first;
                (index, parts) = (index + 1, sides[0]);
            } else {
                chance *= 1.0 - first;
                (index, parts) = (self.nodes[index].next as usize, sides[1]);
            }
            trail >>= 1;
        }
        chance
    }

    /// Returns the chance of the first child of an inner node; `None` if no light can arrive from
    /// either child.
    fn first_share(&self, index: usize, receiver: &Receiver) -> Option<f32> {
        let first = self.nodes[index + 1].importance(receiver);
        let second = self.nodes[self.nodes[index].next as usize].importance(receiver);
        let sum = first + second;
        (sum > 0.0).then(|| if sum.is_finite() { first / sum } else { 0.5 })
    }

    fn build(&mut self, lights: &[Emitter], order: &mut [u32], trail: u64, depth: u32) -> Emitter {
        let index = self.nodes.len();
        if let [light] = *order {
            let emitter = lights[light as usize];
            self.trails[light as usize] = trail;
            self.nodes.push(Node::new(&emitter, light, true));
            return emitter;
        }
        self.nodes.push(Node::new(&lights[order[0] as usize], 0, false));
        // A trail of 64 bits holds 64 turns. From depth 32 on the lights are halved, which takes at
        // most 32 more turns.
        let middle = if depth < 32 { split(lights, order) } else { order.len() / 2 };
        let (left, right) = order.split_at_mut(middle);
        let first = self.build(lights, left, trail, depth + 1);
        let next = self.nodes.len() as u32;
        let second = self.build(lights, right, trail | 1 << depth, depth + 1);
        let both = first.union(&second);
        self.nodes[index] = Node::new(&both, next, false);
        both
    }
}

impl Node {
    fn new(emitter: &Emitter, next: u32, is_leaf: bool) -> Self {
        Self {
            centre: 0.5 * (emitter.min + emitter.max),
            radius: 0.5 * (emitter.max - emitter.min).length(),
            strength: emitter.strength,
            axis: emitter.axis,
            cos_normal: emitter.normal_angle.cos(),
            sin_normal: emitter.normal_angle.sin(),
            cos_falloff: emitter.falloff_angle.cos(),
            two_sided: emitter.two_sided,
            next,
            is_leaf,
        }
    }

    /// Returns a bound of the irradiance at the receiver, up to a factor that is the same for all
    /// nodes.
    fn importance(&self, receiver: &Receiver) -> f32 {
        let to_receiver = receiver.position - self.centre;
        let distance2 = to_receiver.length_squared();
        let radius2 = self.radius * self.radius;
        let most = self.strength / distance2.max(radius2).max(f32::MIN_POSITIVE);
        if distance2 <= radius2 {
            // inside the sphere around the box, light may come from any direction, so no cosine
            // lowers the bound
            return most;
        }
        let direction = to_receiver / distance2.sqrt();
        let sin_box = (radius2 / distance2).min(1.0).sqrt();
        let cos_box = (1.0 - sin_box * sin_box).max(0.0).sqrt();
        let along = self.axis.dot(direction);
        let cos_axis = if self.two_sided { along.abs() } else { along };
        let sin_axis = (1.0 - cos_axis * cos_axis).max(0.0).sqrt();
        let (cos_left, sin_left) = subtract(cos_axis, sin_axis, self.cos_normal, self.sin_normal);
        let (cos_light, _) = subtract(cos_left, sin_left, cos_box, sin_box);
        if cos_light <= self.cos_falloff {
            return 0.0;
        }
        let cos_receiver = receiver.normal.map_or(1.0, |normal| {
            let cosine = -normal.dot(direction);
            let (cosine, sine) = subtract(cosine, (1.0 - cosine * cosine).max(0.0).sqrt(), cos_box, sin_box);
            subtract(cosine, sine, receiver.tilt[0], receiver.tilt[1]).0.max(0.0)
        });
        // falloff angles are at most a right angle, so cos_light is positive here
        most * cos_light * cos_receiver
    }
}

/// Returns the cosine and sine of max(0, a − b) for angles in 0..π.
#[inline]
fn subtract(cos_a: f32, sin_a: f32, cos_b: f32, sin_b: f32) -> (f32, f32) {
    if cos_a > cos_b { (1.0, 0.0) } else { (cos_a * cos_b + sin_a * sin_b, sin_a * cos_b - cos_a * sin_b) }
}

impl Emitter {
    /// Returns the number of sides that shine: a factor on the power.
    pub(crate) fn sides(&self) -> f32 {
        if self.two_sided { 2.0 } else { 1.0 }
    }

    fn centre(&self) -> Vec3 {
        0.5 * (self.min + self.max)
    }

    fn union(&self, other: &Self) -> Self {
        let (axis, normal_angle) = cone_union(self, other);
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
            strength: self.strength + other.strength,
            axis,
            normal_angle,
            falloff_angle: self.falloff_angle.max(other.falloff_angle),
            two_sided: self.two_sided || other.two_sided,
        }
    }

    /// Returns the cost of these lights as one node: strength × extent × solid angle (Conty
    /// Estevez, Kulla 2018, equation 1).
    fn cost(&self) -> f32 {
        let size = self.max - self.min;
        let area = size.x * size.y + size.y * size.z + size.z * size.x;
        let (inner, outer) = (self.normal_angle, (self.normal_angle + self.falloff_angle).min(PI));
        let sine = inner.sin();
        let directions = 2.0 * PI * (1.0 - inner.cos())
            + 0.5 * PI * (2.0 * outer * sine - (inner - 2.0 * outer).cos() - 2.0 * inner * sine + inner.cos());
        self.strength * directions * (area + f32::MIN_POSITIVE)
    }
}

/// Returns the axis and half angle of a cone that holds the cones of two emitters.
fn cone_union(a: &Emitter, b: &Emitter) -> (Vec3, f32) {
    // a two-sided light shines along both directions of its axis
    let other_axis = if (a.two_sided || b.two_sided) && a.axis.dot(b.axis) < 0.0 { -b.axis } else { b.axis };
    let between = a.axis.angle_between(other_axis);
    if (between + b.normal_angle).min(PI) <= a.normal_angle {
        return (a.axis, a.normal_angle);
    }
    if (between + a.normal_angle).min(PI) <= b.normal_angle {
        return (other_axis, b.normal_angle);
    }
    let angle = 0.5 * (a.normal_angle + between + b.normal_angle);
    let turn = a.axis.cross(other_axis).try_normalize();
    match turn {
        Some(turn) if angle < PI => (Quat::from_axis_angle(turn, angle - a.normal_angle) * a.axis, angle),
        _ => (a.axis, PI),
    }
}

/// Splits the lights of `order` in two parts: reorders them, and returns the index at which the
/// second part begins.
fn split(lights: &[Emitter], order: &mut [u32]) -> usize {
    let light = |index: u32| &lights[index as usize];
    let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &index in order.iter() {
        min = min.min(light(index).centre());
        max = max.max(light(index).centre());
    }
    let size = max - min;
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in 0..3 {
        if size[axis] <= 0.0 {
            continue;
        }
        // sort lights into buckets along the axis, and compute the cost of each cut between buckets
        let mut buckets: [Option<Emitter>; BUCKETS] = [None; BUCKETS];
        for &index in order.iter() {
            let bucket = &mut buckets[bucket_of(light(index), axis, min, size)];
            *bucket = Some(bucket.map_or(*light(index), |before| before.union(light(index))));
        }
        // prefer cuts across the longest axis: the cost of other cuts is raised
        let stretch = size.max_element() / size[axis];
        for cut in 1..BUCKETS {
            let joined = |side: &[Option<Emitter>]| {
                side.iter().flatten().copied().reduce(|a, b| a.union(&b)).map(|emitter| emitter.cost())
            };
            if let (Some(left), Some(right)) = (joined(&buckets[..cut]), joined(&buckets[cut..])) {
                let cost = stretch * (left + right);
                if best.is_none_or(|(least, _, _)| cost < least) {
                    best = Some((cost, axis, cut));
                }
            }
        }
    }
    // partition the lights by the cheapest cut, or into two halves if no cut separates them
    let Some((_, axis, cut)) = best else { return order.len() / 2 };
    let mut middle = 0;
    for k in 0..order.len() {
        if bucket_of(light(order[k]), axis, min, size) < cut {
            order.swap(k, middle);
            middle += 1;
        }
    }
    if middle == 0 || middle == order.len() { order.len() / 2 } else { middle }
}

fn bucket_of(light: &Emitter, axis: usize, min: Vec3, size: Vec3) -> usize {
    let x = (light.centre()[axis] - min[axis]) / size[axis];
    ((x * BUCKETS as f32) as usize).min(BUCKETS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumistack_core::seed::Stream;
    use lumistack_testkit::statistics::{FALSE_ALARM_RATE, assert_counts};

    /// Returns small one-sided and two-sided panels and point lights, scattered over a box of 10 ×
    /// 2 × 10.
    fn lights(count: usize, seed: u64) -> Vec<Emitter> {
        let mut stream = Stream::new(seed);
        let mut unit = || stream.next_f32();
        (0..count)
            .map(|k| {
                let place = Vec3::new(10.0 * unit(), 2.0 + 2.0 * unit(), 10.0 * unit());
                let axis = Vec3::new(unit() - 0.5, -unit(), unit() - 0.5).normalize();
                let point = k % 5 == 0;
                let half = if point { Vec3::ZERO } else { Vec3::splat(0.05) };
                Emitter {
                    min: place - half,
                    max: place + half,
                    strength: 0.1 + unit() * unit(),
                    axis,
                    normal_angle: if point { PI } else { 0.0 },
                    falloff_angle: 0.5 * PI,
                    two_sided: k % 7 == 0,
                }
            })
            .collect()
    }

    fn receivers() -> Vec<Receiver> {
        let at =
            |x: f32, y: f32, z: f32, normal| Receiver { position: Vec3::new(x, y, z), normal, tilt: Receiver::UPRIGHT };
        vec![
            at(1.0, 0.0, 1.0, Some(Vec3::Y)),
            at(5.0, 3.0, 5.0, Some(Vec3::X)),
            at(-30.0, 1.0, 4.0, None),
            at(9.0, 3.5, 2.0, None),
            at(5.0, 6.0, 5.0, Some(Vec3::NEG_Y)),
        ]
    }

    /// Returns the irradiance at a receiver without shadows; a panel is treated as a point at its
    /// centre.
    fn irradiance(light: &Emitter, receiver: &Receiver) -> f32 {
        let to_receiver = receiver.position - light.centre();
        let direction = to_receiver.normalize();
        let along = light.axis.dot(direction);
        let cosine = if light.normal_angle > 0.0 {
            1.0
        } else if light.two_sided {
            along.abs()
        } else {
            along.max(0.0)
        };
        let received = receiver.normal.map_or(1.0, |normal| (-normal.dot(direction)).max(0.0));
        light.strength * cosine * received / to_receiver.length_squared()
    }

    #[test]
    fn chosen_lights_follow_their_chance() {
        for (count, parts) in [(1, 16), (2, 0), (2, 4), (3, 16), (300, 0), (300, 64)] {
            let lights = lights(count, count as u64);
            let tree = LightTree::new(&lights).unwrap();
            for (seed, receiver) in receivers().iter().enumerate() {
                let chances: Vec<f64> =
                    (0..count).map(|light| f64::from(tree.chance(light, receiver, parts))).collect();
                let sum: f64 = chances.iter().sum();
                assert!(sum < 1.0 + 1e-4, "{sum}");
                let draws = 40_000;
                let mut stream = Stream::new(seed as u64);
                let mut counts = vec![0u64; count + 1];
                for _ in 0..draws {
                    let u = f64::from(stream.next_f32()) + f64::from(stream.next_f32()) * 2f64.powi(-24);
                    match tree.sample(receiver, u.min(1.0 - f64::EPSILON), parts) {
                        Some((light, chance, inside)) => {
                            assert!((f64::from(chance) - chances[light]).abs() < 1e-4 * chances[light].max(1e-3));
                            assert!((0.0..1.0).contains(&inside));
                            counts[light] += 1;
                        }
                        None => counts[count] += 1,
                    }
                }
                let mut expected: Vec<f64> = chances.iter().map(|chance| chance * f64::from(draws)).collect();
                // the rest of the chance belongs to nodes from which no light arrives
                expected.push((1.0 - sum).max(0.0) * f64::from(draws));
                // if one light has nearly all of the chance, there is nothing to test
                if expected.iter().filter(|&&expected| expected > 10.0).count() > 1 {
                    assert_counts(&counts, &expected, FALSE_ALARM_RATE);
                }
            }
        }
    }

    /// Every light from which the receiver gets irradiance has a chance above 0, in trees over
    /// random lights.
    #[test]
    fn whatever_arrives_can_be_chosen() {
        for seed in 0..20 {
            let lights = lights(60, seed);
            let tree = LightTree::new(&lights).unwrap();
            for receiver in receivers() {
                for (index, light) in lights.iter().enumerate() {
                    let arrives = irradiance(light, &receiver) > 1e-6;
                    assert!(!arrives || tree.chance(index, &receiver, 16) > 0.0, "light {index} of {seed}");
                }
            }
        }
    }

    /// A light of irradiance E, chosen with the chance p, estimates the irradiance of all lights as
    /// E/p. The mean square of this estimate is Σ E²/p. Its variance is much smaller with the
    /// tree's chances than with chances by power.
    #[test]
    fn the_tree_beats_a_choice_by_power() {
        let mut ratios = Vec::new();
        for seed in 0..10 {
            let lights = lights(500, 100 + seed);
            let tree = LightTree::new(&lights).unwrap();
            let power = |light: &Emitter| {
                light.strength
                    * if light.normal_angle > 0.0 {
                        4.0
                    } else if light.two_sided {
                        2.0
                    } else {
                        1.0
                    }
            };
            let total: f32 = lights.iter().map(power).sum();
            for receiver in receivers() {
                // returns the relative variance of the estimate, computed from the chances of all
                // lights
                let moments = |chance: &dyn Fn(usize) -> f32| {
                    let (mut mean, mut square) = (0.0, 0.0);
                    for (index, light) in lights.iter().enumerate() {
                        let e = irradiance(light, &receiver);
                        if e > 0.0 {
                            mean += e;
                            square += e * e / chance(index);
                        }
                    }
                    square / (mean * mean) - 1.0
                };
                let by_tree = moments(&|index| tree.chance(index, &receiver, 0));
                let by_power = moments(&|index| power(&lights[index]) / total);
                println!("variance by tree {by_tree:.3}, by power {by_power:.3}");
                ratios.push(by_power / by_tree);
            }
        }
        let geometric = (ratios.iter().map(|ratio| ratio.ln()).sum::<f32>() / ratios.len() as f32).exp();
        println!("variance ratio {geometric}");
        assert!(geometric > 2.0, "{geometric}");
    }

    /// With n stratified numbers each light is chosen exactly n times its chance, since the rounded
    /// chances are multiples of 1/n. Without rounding, a light might be chosen once more or once
    /// less.
    #[test]
    fn a_few_lights_get_whole_parts() {
        for parts in [16u32, 64] {
            for seed in 0..20 {
                let lights = lights(4, 40 + seed);
                let tree = LightTree::new(&lights).unwrap();
                for receiver in receivers() {
                    let mut stream = Stream::new(seed);
                    let mut counts = [0u32; 4];
                    for part in 0..parts {
                        let u = (f64::from(part) + f64::from(stream.next_f32())) / f64::from(parts);
                        if let Some((light, _, _)) = tree.sample(&receiver, u, parts) {
                            counts[light] += 1;
                        }
                    }
                    for (light, &count) in counts.iter().enumerate() {
                        let expected = tree.chance(light, &receiver, parts) * parts as f32;
                        let exact = tree.chance(light, &receiver, 0) * parts as f32;
                        // Counts are exact only if all chances are whole parts. A light that is too
                        // weak for a whole part keeps its small chance, and the chances of other
                        // lights are smaller by this chance. So the counts of other lights may
                        // differ.
                        let least = (0..4).map(|other| tree.chance(other, &receiver, parts) * parts as f32);
                        let whole = least.into_iter().all(|share| (share - share.round()).abs() < 1e-3);
                        assert!(!whole || (expected - count as f32).abs() < 1e-3, "{count} of {expected}");
                        assert!((expected - exact).abs() < 2.0, "{expected} for {exact}");
                    }
                }
            }
        }
    }

    #[test]
    fn coincident_lights_make_a_tree() {
        let same = vec![lights(1, 3)[0]; 1000];
        let tree = LightTree::new(&same).unwrap();
        let receiver = receivers()[0];
        for light in [0, 500, 999] {
            assert!((tree.chance(light, &receiver, 0) * 1000.0 - 1.0).abs() < 0.05);
        }
        assert!(LightTree::new(&[]).is_none());
        // positions in a geometric sequence give the deepest tree that buckets make
        let mut line: Vec<Emitter> = (0..100).map(|k| lights(1, 4)[0].moved(Vec3::X * 0.5f32.powi(k))).collect();
        line.reverse();
        let tree = LightTree::new(&line).unwrap();
        let sum: f32 = (0..100).map(|light| tree.chance(light, &Receiver { normal: None, ..receiver }, 64)).sum();
        assert!((sum - 1.0).abs() < 1e-3, "{sum}");
    }

    impl Emitter {
        fn moved(self, by: Vec3) -> Self {
            Self { min: self.min + by, max: self.max + by, ..self }
        }
    }
}
