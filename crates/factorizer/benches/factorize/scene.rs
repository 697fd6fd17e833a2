//! A light field in closed form, the same on every machine. It resembles a rendering of a small
//! scene, so timings and PSNR are meaningful.
//!
//! Units are millimetres of display space, for a display 473.76 mm wide. A wall stands at z = −170.
//! A checkerboard slopes down from the wall to the viewer, through the display plane to z = 100.
//! Three balls (plastic, brushed metal, mirror) are partly sunk into the checkerboard, and their
//! highlights move with the view. Thin posts stand in front.
//!
//! A ray is (x, y, 0) + z (s_x, s_y, 1), and the viewer sees the hit with the largest z. The code
//! calls no transcendental functions, since their last bits differ between machines.

use lumistack_display::{Display, DisplayError, LightField};
use rayon::prelude::*;

type Vector = [f64; 3];

/// Positions of the samples within a pixel, along each axis, in pixels from its centre.
const SAMPLES: [f64; 3] = [-1.0 / 3.0, 0.0, 1.0 / 3.0];

/// z of the wall behind the scene.
const WALL_Z: f64 = -170.0;
/// The checkerboard: z = BOARD_SLOPE · (BOARD_Y − y), between the wall and BOARD_FRONT.
const BOARD_SLOPE: f64 = 1.6;
const BOARD_Y: f64 = -60.0;
const BOARD_FRONT: f64 = 100.0;
const BOARD_HALF_WIDTH: f64 = 215.0;
const SQUARE: f64 = 27.0;

struct Ball {
    centre: Vector,
    radius: f64,
    colour: Vector,
    /// Fraction of the reflected surroundings in the colour, 0..1.
    mirror: f64,
    /// Strength of the ball's highlight.
    shine: f64,
}

const BALLS: [Ball; 3] = [
    Ball { centre: [-105.0, 5.0, -20.0], radius: 72.0, colour: [0.80, 0.52, 0.16], mirror: 0.25, shine: 0.5 },
    Ball { centre: [45.0, -45.0, 35.0], radius: 44.0, colour: [0.70, 0.08, 0.06], mirror: 0.05, shine: 0.8 },
    Ball { centre: [140.0, 30.0, -80.0], radius: 62.0, colour: [0.10, 0.12, 0.14], mirror: 0.75, shine: 0.3 },
];

/// x, z and radius of the posts, which stand upright.
const POSTS: [[f64; 3]; 5] =
    [[-200.0, 60.0, 2.5], [-150.0, 75.0, 1.5], [-20.0, 90.0, 2.0], [95.0, 80.0, 1.5], [190.0, 65.0, 3.0]];
const POST_COLOUR: Vector = [0.30, 0.42, 0.55];

/// Direction to the light, unit length.
const LIGHT: Vector = [-0.48, 0.64, 0.6];
/// Ambient light.
const AMBIENT: f64 = 0.25;

/// Renders the views of a display, rounded to half floats as in files of light fields.
pub fn light_field(display: &Display) -> Result<LightField, DisplayError> {
    let geometry = display.geometry()?;
    let mut field = LightField::black(geometry.clone())?;
    let [_, view_cols] = geometry.grid.views();
    let row_len = 3 * geometry.cols;
    field.radiance_mut().data_mut().par_chunks_mut(row_len).enumerate().for_each(|(index, row)| {
        let (view, r) = (index / geometry.rows, index % geometry.rows);
        let view = [view / view_cols, view % view_cols];
        for (c, pixel) in row.chunks_exact_mut(3).enumerate() {
            let mut sum = [0.0; 3];
            for down in SAMPLES {
                for right in SAMPLES {
                    let x = geometry.x_mm(c) + right * geometry.pitch_mm;
                    let y = geometry.y_mm(r) + down * geometry.pitch_mm;
                    let slope = geometry.grid.slope_at(view, [x, y]);
                    let colour = seen([x, y, 0.0], [slope[0], slope[1], 1.0]);
                    sum.iter_mut().zip(colour).for_each(|(sum, colour)| *sum += colour);
                }
            }
            for (value, sum) in pixel.iter_mut().zip(sum) {
                *value = round_to_half((sum / (SAMPLES.len() * SAMPLES.len()) as f64).min(1.0) as f32);
            }
        }
    });
    Ok(field)
}

/// Rounds to the nearest half float, for values in the normal range of half floats; every colour
/// here exceeds 0.005.
fn round_to_half(value: f32) -> f32 {
    const DROPPED: u32 = 13;
    let bits = value.to_bits();
    let nearest_even = (1 << (DROPPED - 1)) - 1 + (bits >> DROPPED & 1);
    f32::from_bits((bits + nearest_even) & !((1 << DROPPED) - 1))
}

/// Returns the colour of the surface that the viewer sees along a ray.
fn seen(origin: Vector, direction: Vector) -> Vector {
    let mut z = WALL_Z;
    let mut colour = wall(along(origin, direction, z));
    if let Some(hit) = board(origin, direction) {
        z = hit;
        colour = board_colour(along(origin, direction, z));
    }
    for ball in &BALLS {
        if let Some(hit) = sphere(origin, direction, ball.centre, ball.radius).filter(|hit| *hit > z) {
            z = hit;
            colour = ball_colour(ball, along(origin, direction, z), direction);
        }
    }
    for [x, post_z, radius] in POSTS {
        if let Some(hit) = post(origin, direction, x, post_z, radius).filter(|hit| *hit > z) {
            z = hit;
            let at = along(origin, direction, z);
            let normal = [(at[0] - x) / radius, 0.0, (at[2] - post_z) / radius];
            colour = POST_COLOUR.map(|value| value * lit(normal));
        }
    }
    colour
}

/// Returns the colour of the wall, which has soft vertical stripes and is brighter to the top.
fn wall([x, y, _]: Vector) -> Vector {
    let stripe = wave(x / 36.0);
    let height = ((y + 190.0) / 400.0).clamp(0.0, 1.0);
    [0.10 + 0.18 * height + 0.10 * stripe, 0.14 + 0.24 * height + 0.08 * stripe, 0.22 + 0.40 * height]
}

/// Returns z at which a ray hits the checkerboard; `None` if the ray misses it.
fn board(origin: Vector, direction: Vector) -> Option<f64> {
    let z = BOARD_SLOPE * (BOARD_Y - origin[1]) / (1.0 + BOARD_SLOPE * direction[1]);
    let x = along(origin, direction, z)[0];
    (WALL_Z < z && z < BOARD_FRONT && x.abs() < BOARD_HALF_WIDTH).then_some(z)
}

/// Returns the colour of the checkerboard, which is darker under the balls.
fn board_colour(at: Vector) -> Vector {
    let even = ((at[0] / SQUARE).floor() + (at[2] / SQUARE).floor()).rem_euclid(2.0) < 1.0;
    let shade: f64 = BALLS
        .iter()
        .map(|ball| {
            let distance = ((at[0] - ball.centre[0]).powi(2) + (at[2] - ball.centre[2]).powi(2)) / ball.radius.powi(2);
            1.0 - 0.6 / (1.0 + 3.0 * distance * distance)
        })
        .product();
    let colour = if even { [0.78, 0.74, 0.66] } else { [0.09, 0.11, 0.10] };
    colour.map(|value| value * shade)
}

/// Returns z at which the viewer sees a sphere along a ray; `None` if the ray misses it.
fn sphere(origin: Vector, direction: Vector, centre: Vector, radius: f64) -> Option<f64> {
    let from = sub(origin, centre);
    let (a, b, c) = (dot(direction, direction), dot(from, direction), dot(from, from) - radius * radius);
    let discriminant = b * b - a * c;
    (discriminant > 0.0).then(|| (-b + discriminant.sqrt()) / a)
}

/// Returns z at which the viewer sees an upright cylinder along a ray; `None` if the ray misses it.
fn post(origin: Vector, direction: Vector, x: f64, z: f64, radius: f64) -> Option<f64> {
    sphere([origin[0], 0.0, 0.0], [direction[0], 0.0, 1.0], [x, 0.0, z], radius)
}

fn ball_colour(ball: &Ball, at: Vector, direction: Vector) -> Vector {
    let normal = sub(at, ball.centre).map(|value| value / ball.radius);
    let length = dot(direction, direction).sqrt();
    let to_viewer = direction.map(|value| value / length);
    let mirrored = sub(normal.map(|value| value * 2.0 * dot(normal, to_viewer)), to_viewer);
    let highlight = dot(mirrored, LIGHT).max(0.0).powi(24);
    let around = surroundings(mirrored);
    std::array::from_fn(|i| {
        let diffuse = ball.colour[i] * lit(normal) * (1.0 - ball.mirror);
        0.01 + diffuse + ball.mirror * around[i] + ball.shine * highlight
    })
}

/// Returns the colour of the surroundings that a mirror reflects: sky above, squares below. The
/// squares fade towards the horizon, where no pixel resolves them.
fn surroundings([x, y, z]: Vector) -> Vector {
    if y >= 0.0 {
        return [0.36 + 0.19 * y, 0.36 + 0.34 * y, 0.34 + 0.56 * y];
    }
    let even = ((x / y).floor() + (z / y).floor()).rem_euclid(2.0) < 1.0;
    let contrast = if even { 0.7 } else { -0.7 } * (y * y / (y * y + 0.06));
    [0.36, 0.36, 0.34].map(|value| value * (1.0 + contrast))
}

/// Returns the ambient and diffuse light on a surface.
fn lit(normal: Vector) -> f64 {
    AMBIENT + (1.0 - AMBIENT) * dot(normal, LIGHT).max(0.0)
}

/// Returns the value, at a phase, of a wave of period 1 from 0 to 1 and back. The wave has a smooth
/// top and bottom.
fn wave(phase: f64) -> f64 {
    let t = 1.0 - (2.0 * (phase - phase.floor()) - 1.0).abs();
    t * t * (3.0 - 2.0 * t)
}

fn along(origin: Vector, direction: Vector, z: f64) -> Vector {
    std::array::from_fn(|i| origin[i] + z * direction[i])
}

fn sub(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
