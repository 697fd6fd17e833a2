//! The exploded view: the layers pulled apart, the backlight behind them, and rays of one slope through them.
//!
//! The rays meet each layer where they do in the real stack, x + d_n s; only the distances along z are drawn larger.

use lumistack_display::{Backlight, Display, FieldGeometry};

/// How far the outermost layers are pulled apart at a spread of 1, in widths of the field.
const SPREAD: f64 = 0.9;
/// Distance of the camera from the stack's middle, in widths of the field.
const CAMERA: f64 = 3.2;
/// Share of the canvas that the stack may fill.
const FILL: f64 = 0.96;
/// Half the width of a ray, in shares of the canvas' height.
const RAY_HALF_WIDTH: f64 = 0.0011;
/// Rays along x and along y.
const RAYS: [usize; 2] = [4, 3];

/// What is drawn, rear to front as the camera sees it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Item {
    pub(crate) kind: Kind,
    /// Triangles: clip coordinates x, y, z, w and the place (u right, v down) on the layer.
    pub(crate) corners: Vec<[f32; 6]>,
}

/// See [`Item`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Backlight,
    Layer(usize),
    Rays,
}

/// Where the camera stands and how the stack is drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    /// Turn of the stack about the vertical axis.
    pub(crate) yaw_rad: f64,
    /// Turn about the horizontal axis.
    pub(crate) pitch_rad: f64,
    /// 0: true distances, 1: pulled apart.
    pub(crate) spread: f64,
    /// Width over height of the canvas.
    pub(crate) aspect: f64,
}

/// The whole view.
pub(crate) fn scene(display: &Display, geometry: &FieldGeometry, slope: [f64; 2], look: Look) -> Vec<Item> {
    let [width, height] = geometry.size_mm();
    let count = display.layers.len();
    // planes rear to front: the backlight, the layers, and where the rays end
    let gap = width * SPREAD * look.spread / (count.max(2) - 1) as f64;
    let middle = (count as f64 - 1.0) / 2.0;
    let true_d = |plane: usize| match plane {
        0 => match &display.backlight {
            Backlight::Lenslets(backlight) => backlight.d_mm,
            Backlight::Uniform => {
                let first = display.layers[0].d_mm;
                first - if count > 1 { display.layers[1].d_mm - first } else { 0.1 * width }
            }
        },
        n if n <= count => display.layers[n - 1].d_mm,
        _ => display.layers[count - 1].d_mm + 0.25 * width,
    };
    let drawn_z = |plane: usize| (1.0 - look.spread) * true_d(plane) + gap * (plane as f64 - 1.0 - middle);
    let size = |plane: usize| match plane {
        0 => match &display.backlight {
            Backlight::Lenslets(b) => ([b.lenslets[0], b.lenslets[1]].map(|n| n as f64 * b.pitch_mm), b.offset_mm),
            Backlight::Uniform => ([width, height], [0.0; 2]),
        },
        n => {
            let layer = &display.layers[n - 1];
            (layer.resolution.map(|n| n as f64 * layer.pitch_mm), layer.offset_mm)
        }
    };
    let corner_at = |plane: usize, u: f64, v: f64| {
        let ([w, h], [x, y]) = size(plane);
        [x + w * (u - 0.5), y + h * (0.5 - v), drawn_z(plane)]
    };
    let ray_at = |place: [usize; 2], plane: usize| {
        let along = |axis: usize, size: f64| ((place[axis] as f64 + 0.5) / RAYS[axis] as f64 - 0.5) * 0.8 * size;
        let point = [along(0, width), along(1, height)];
        let d_mm = true_d(plane);
        let [x, y] = [0, 1].map(|i| point[i] + d_mm * geometry.grid.projection.slope(slope[i], point[i]));
        [x, y, drawn_z(plane)]
    };
    let places = || (0..RAYS[0] * RAYS[1]).map(|i| [i % RAYS[0], i / RAYS[0]]);
    let corners = (0..=count)
        .flat_map(|plane| [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|[u, v]| corner_at(plane, u, v)));
    let points: Vec<[f64; 3]> = corners.chain(places().map(|place| ray_at(place, count + 1))).collect();
    let camera = Camera::new(width, height, look, &points);
    let mut items = Vec::new();
    for plane in 0..=count {
        let corner = |u: f64, v: f64| {
            let [cx, cy, cz, cw] = camera.clip(corner_at(plane, u, v));
            [cx as f32, cy as f32, cz as f32, cw as f32, u as f32, v as f32]
        };
        let corners =
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]].map(|[u, v]| corner(u, v));
        let kind = if plane == 0 { Kind::Backlight } else { Kind::Layer(plane - 1) };
        items.push(Item { kind, corners: corners.to_vec() });
        let mut rays = Vec::new();
        for place in places() {
            let at = |plane: usize| camera.clip(ray_at(place, plane));
            ribbon(&mut rays, at(plane), at(plane + 1), look.aspect);
        }
        items.push(Item { kind: Kind::Rays, corners: rays });
    }
    if camera.from_behind {
        items.reverse();
    }
    items
}

/// Two triangles of constant width on the canvas.
fn ribbon(corners: &mut Vec<[f32; 6]>, from: [f64; 4], to: [f64; 4], aspect: f64) {
    let seen = |p: [f64; 4]| [p[0] / p[3] * aspect, p[1] / p[3]];
    let (a, b) = (seen(from), seen(to));
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length = dx.hypot(dy).max(1e-9);
    let side = [-dy / length * 2.0 * RAY_HALF_WIDTH / aspect, dx / length * 2.0 * RAY_HALF_WIDTH];
    let corner = |p: [f64; 4], sign: f64| {
        [
            (p[0] / p[3] + sign * side[0]) as f32,
            (p[1] / p[3] + sign * side[1]) as f32,
            (p[2] / p[3]) as f32,
            1.0,
            0.0,
            0.0,
        ]
    };
    let [a0, a1, b0, b1] = [corner(from, -1.0), corner(from, 1.0), corner(to, -1.0), corner(to, 1.0)];
    corners.extend([a0, a1, b0, b0, a1, b1]);
}

/// A pinhole on the z axis that looks at the turned stack.
struct Camera {
    yaw: [f64; 2],
    pitch: [f64; 2],
    distance: f64,
    zoom: [f64; 2],
    from_behind: bool,
}

impl Camera {
    /// Far enough for every point of the stack to stay on the canvas, however it is turned about the vertical axis.
    fn new(width: f64, height: f64, look: Look, points: &[[f64; 3]]) -> Self {
        let distance = CAMERA * width.max(height);
        let (pitch_sin, pitch_cos) = look.pitch_rad.sin_cos();
        // tangents of the largest angles under which points are seen
        let (mut across, mut upward) = (1e-6f64, 1e-6f64);
        for [x, y, z] in points {
            let around = x.hypot(*z).min(0.8 * distance);
            let middle = distance - y.abs() * pitch_sin.abs();
            let nearest = (middle - around * pitch_cos.abs()).max(0.1 * distance);
            // on its way around the axis a point is seen furthest aside where the line of sight touches its circle
            let touched = (middle.powi(2) - (around * pitch_cos).powi(2)).max((0.1 * distance).powi(2)).sqrt();
            across = across.max(around / touched);
            upward = upward.max((y.abs() * pitch_cos.abs() + around * pitch_sin.abs()) / nearest);
        }
        let zoom = FILL * (1.0 / upward).min(look.aspect / across);
        Self {
            yaw: [look.yaw_rad.sin(), look.yaw_rad.cos()],
            pitch: [pitch_sin, pitch_cos],
            distance,
            zoom: [zoom / look.aspect, zoom],
            from_behind: look.yaw_rad.cos() * pitch_cos < 0.0,
        }
    }

    fn clip(&self, [x, y, z]: [f64; 3]) -> [f64; 4] {
        let (x, z) = (x * self.yaw[1] + z * self.yaw[0], z * self.yaw[1] - x * self.yaw[0]);
        let (y, z) = (y * self.pitch[1] - z * self.pitch[0], z * self.pitch[1] + y * self.pitch[0]);
        let depth = (self.distance - z).max(0.05 * self.distance);
        [x * self.zoom[0], y * self.zoom[1], 0.0, depth]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> (Display, FieldGeometry) {
        let display = Display::uniform([40, 25], 1.0, [3, 3], [20.0, 20.0], &[-10.0, 0.0, 10.0], 1);
        let geometry = display.geometry().unwrap();
        (display, geometry)
    }

    fn middle(item: &Item) -> [f32; 2] {
        let seen = |i: usize| item.corners.iter().map(move |c| c[i] / c[3]);
        let mid = |i: usize| 0.5 * (seen(i).fold(f32::MAX, f32::min) + seen(i).fold(f32::MIN, f32::max));
        [mid(0), mid(1)]
    }

    #[test]
    fn everything_is_drawn_from_rear_to_front_and_inside_the_canvas() {
        let (display, geometry) = sample();
        let looks = [(0.0, 0.0), (0.6, -0.3), (-0.9, 0.4), (-0.62, 0.34), (1.3, 1.0), (-1.5, -1.2)];
        for (yaw_rad, pitch_rad) in looks {
            for (aspect, spread) in [(0.5, 1.0), (1.0, 0.3), (1.45, 0.6), (1.7, 1.0), (2.5, 0.0)] {
                let items = scene(&display, &geometry, [0.1, 0.0], Look { yaw_rad, pitch_rad, spread, aspect });
                let kinds: Vec<Kind> = items.iter().map(|item| item.kind).filter(|kind| *kind != Kind::Rays).collect();
                assert_eq!(kinds, [Kind::Backlight, Kind::Layer(0), Kind::Layer(1), Kind::Layer(2)]);
                for c in items.iter().flat_map(|item| &item.corners) {
                    assert!(c[0].abs() < c[3] && c[1].abs() < c[3], "{yaw_rad} {pitch_rad} {aspect}: {c:?}");
                }
            }
        }
        let behind = Look { yaw_rad: 3.0, pitch_rad: 0.0, spread: 1.0, aspect: 1.0 };
        assert_eq!(scene(&display, &geometry, [0.0; 2], behind).last().unwrap().kind, Kind::Backlight);
    }

    /// A stack that is turned to the right shows its front layer further right than its rear one, and from straight ahead all are centred.
    #[test]
    fn turning_moves_front_and_rear_apart() {
        let (display, geometry) = sample();
        let look = Look { yaw_rad: 0.0, pitch_rad: 0.0, spread: 1.0, aspect: 1.0 };
        let layers = |look: Look| {
            let items = scene(&display, &geometry, [0.0; 2], look);
            [0, 2].map(|n| middle(items.iter().find(|item| item.kind == Kind::Layer(n)).unwrap()))
        };
        assert!(layers(look).iter().flatten().all(|v| v.abs() < 1e-6));
        let [rear, front] = layers(Look { yaw_rad: 0.5, ..look });
        assert!(front[0] > 0.05 && rear[0] < -0.05, "{rear:?} {front:?}");
        let [rear, front] = layers(Look { pitch_rad: 0.5, ..look });
        assert!(front[1] < -0.05 && rear[1] > 0.05, "{rear:?} {front:?}");
    }

    /// Rays of slope 0 are seen end on from straight ahead without spread; steep ones lean towards the side of the slope.
    #[test]
    fn rays_lean_as_their_slope_says() {
        let (display, geometry) = sample();
        let look = Look { yaw_rad: 0.0, pitch_rad: 0.0, spread: 0.0, aspect: 1.0 };
        let last = |slope: [f64; 2]| {
            let items = scene(&display, &geometry, slope, look);
            middle(items.iter().rfind(|item| item.kind == Kind::Rays).unwrap())
        };
        let straight = last([0.0; 2]);
        assert!(last([0.3, 0.0])[0] > straight[0] + 0.05 && last([0.0, 0.3])[1] > straight[1] + 0.05);
    }
}
