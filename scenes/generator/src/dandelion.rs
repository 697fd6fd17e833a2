//! A dandelion clock of Gaussian splats. Its hairs are transparent, thinner than a pixel, and at
//! every depth of the head. A mesh file of the same size could not represent such hairs.
//!
//! One unit is a decimetre, and y points up. The head's centre is the origin, and the flower's
//! front faces +z. By spherical harmonics of degree 1, colours change with the direction of view,
//! as sheen does.

use glam::{Quat, Vec3};
use lumistack_splats::Cloud;
use lumistack_splats::write;

use crate::{GeneratorError, SceneFile};

/// Number of seeds on the head.
const SEEDS: usize = 190;
/// Number of hairs of each seed.
const HAIRS: usize = 13;
/// Distance from the head's centre to the feet of the hairs, decimetres.
const HEAD: f32 = 0.52;
/// Length of the hairs, decimetres.
const HAIR: f32 = 0.2;
/// The golden angle, radians.
const TURN: f32 = 2.399_963;

/// Returns the files of the scene.
pub(crate) fn build() -> Result<Vec<SceneFile>, GeneratorError> {
    let file = "dandelion.spz";
    let bytes = write::spz(&cloud()).map_err(|source| GeneratorError::Write { path: file.into(), source })?;
    Ok(vec![(file.to_owned(), bytes)])
}

fn cloud() -> Cloud {
    let mut cloud = Cloud { degree: 1, ..Cloud::default() };
    for i in 0..SEEDS {
        seed(&mut cloud, on_sphere(i, SEEDS), i);
    }
    // add the base of the head, on which the seeds sit
    for i in 0..60 {
        let normal = on_sphere(i, 60);
        disc(&mut cloud, 0.09 * normal, normal, 0.022, [0.42, 0.47, 0.27], 0.95);
    }
    stalk(&mut cloud);
    for leaf in 0..7 {
        blade(&mut cloud, leaf as f32 * TURN, 0.8 + 0.13 * (leaf % 4) as f32);
    }
    cloud
}

/// Returns direction i of `count` directions that are evenly spread over the sphere.
fn on_sphere(i: usize, count: usize) -> Vec3 {
    let y = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
    let (sin, cos) = (TURN * i as f32).sin_cos();
    Vec3::new((1.0 - y * y).sqrt() * cos, y, (1.0 - y * y).sqrt() * sin)
}

/// Adds a seed: a brown grain, a thread that leads outwards from it, and a parachute of hairs at
/// the thread's end.
fn seed(cloud: &mut Cloud, out: Vec3, number: usize) {
    needle(cloud, 0.12 * out, 0.17 * out, 0.009, [0.36, 0.24, 0.14], 0.95);
    for part in 0..4 {
        let [from, to] = [part, part + 1].map(|i| 0.17 + (HEAD - 0.17) * i as f32 / 4.0);
        needle(cloud, from * out, to * out, 0.0025, [0.62, 0.64, 0.58], 0.6);
    }
    let side = out.any_orthonormal_vector();
    for hair in 0..HAIRS {
        let turn = std::f32::consts::TAU * (hair as f32 + 0.37 * number as f32) / HAIRS as f32;
        let around = Quat::from_axis_angle(out, turn) * side;
        let tip = HEAD * out + HAIR * (0.62 * out + 0.78 * around);
        let middle = HEAD * out + HAIR * (0.25 * out + 0.42 * around);
        needle(cloud, HEAD * out, middle, 0.003, [0.88, 0.89, 0.92], 0.55);
        needle(cloud, middle, tip, 0.0022, [0.95, 0.95, 0.97], 0.42);
    }
}

/// Adds the hollow stalk, which is slightly bent.
fn stalk(cloud: &mut Cloud) {
    let at = |t: f32| Vec3::new(0.22 * t * t, -0.06 - 1.75 * t, 0.1 * t);
    for ring in 0..70 {
        let [from, to] = [ring, ring + 1].map(|i| at(i as f32 / 70.0));
        let along = (to - from).normalize();
        let side = along.any_orthonormal_vector();
        for spoke in 0..8 {
            let normal = Quat::from_axis_angle(along, std::f32::consts::TAU * spoke as f32 / 8.0) * side;
            let green = 0.42 + 0.12 * normal.x - 0.05 * ring as f32 / 70.0;
            disc(cloud, 0.5 * (from + to) + 0.035 * normal, normal, 0.017, [0.6 * green + 0.06, green, 0.2], 0.96);
        }
    }
}

/// Adds a leaf with a jagged edge, which lies on the ground.
fn blade(cloud: &mut Cloud, turn: f32, length: f32) {
    let foot = Vec3::new(0.22, -1.79, 0.1);
    let along = Quat::from_rotation_y(turn) * Vec3::X;
    let across = along.cross(Vec3::Y);
    for i in 0..46 {
        let t = (i as f32 + 0.5) / 46.0;
        let jagged = 0.75 + 0.25 * (14.0 * t).sin();
        let half = 0.16 * length * (3.0 * t * (1.0 - t)).max(0.0).sqrt() * jagged;
        let lift = 0.32 * length * (1.6 * t).sin() * (1.0 - 0.55 * t);
        for j in -3..=3i32 {
            let s = j as f32 / 3.0;
            let at = foot + length * t * along + half * s * across + (lift + 0.05 * s * s) * Vec3::Y;
            let normal = (Vec3::Y - 0.25 * s * across + 0.3 * (2.0 * t - 1.0) * along).normalize();
            let shade = 0.3 + 0.16 * (1.0 - s.abs()) + 0.08 * t;
            disc(cloud, at, normal, 0.013 + 0.5 * half / 3.0, [0.55 * shade, shade, 0.35 * shade], 0.9);
        }
    }
}

/// Adds a long splat from one point to another.
fn needle(cloud: &mut Cloud, from: Vec3, to: Vec3, thickness: f32, rgb: [f32; 3], opacity: f32) {
    let along = to - from;
    let rotation = Quat::from_rotation_arc(Vec3::X, along.normalize());
    splat(cloud, 0.5 * (from + to), rotation, Vec3::new(0.36 * along.length(), thickness, thickness), rgb, opacity);
    // a needle is brighter if it is seen from above or from the front, as if the light came from
    // these sides
    sheen(cloud, 0.06, -0.1);
}

/// Adds a flat round splat.
fn disc(cloud: &mut Cloud, at: Vec3, normal: Vec3, size: f32, rgb: [f32; 3], opacity: f32) {
    let lit = 0.72 + 0.28 * normal.y;
    splat(
        cloud,
        at,
        Quat::from_rotation_arc(Vec3::Z, normal),
        Vec3::new(size, size, 0.15 * size),
        rgb.map(|c| lit * c),
        opacity,
    );
    sheen(cloud, 0.03, 0.04);
}

fn splat(cloud: &mut Cloud, at: Vec3, rotation: Quat, scale: Vec3, rgb: [f32; 3], opacity: f32) {
    cloud.positions.push(at);
    cloud.rotations.push(rotation.normalize());
    cloud.scales.push(scale);
    cloud.opacities.push(opacity);
    cloud.harmonics.extend(rgb.map(|value| (value - 0.5) / 0.282_094_8));
}

/// Makes the last splat's colour depend on the direction of view. `height` and `depth` are the
/// coefficients of the harmonics along y and z.
fn sheen(cloud: &mut Cloud, height: f32, depth: f32) {
    let orders = [height, depth, 0.0];
    cloud.harmonics.extend(orders.iter().flat_map(|value| [*value; 3]));
}
