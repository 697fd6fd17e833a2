//! Textures of the scenes. "It tiles" means that a picture repeats without a visible border. The
//! comment of each function states the picture's content and, if fixed, its scale.

use std::f64::consts::{FRAC_PI_2, TAU};

use crate::bitmap_font::{columns, is_set};
use crate::paint::{Picture, Rgba, fractal_noise, hash, mix, noise, paint, paint_normals, rgb, ruled, shade, wave};

/// Number of checks along each side of [`checkerboard`].
pub(crate) const CHECKS_PER_TILE: u32 = 8;

/// Returns a checkerboard of two stones with grain. Every check has inlaid lines and a small star.
/// It tiles.
pub(crate) fn checkerboard() -> Picture {
    let (ivory, slate) = (rgb(228, 218, 196), rgb(58, 74, 88));
    paint(1024, 1024, 3, |u, v| {
        let (x, y) = (u * f64::from(CHECKS_PER_TILE), v * f64::from(CHECKS_PER_TILE));
        let light = (x.floor() + y.floor()) % 2.0 == 0.0;
        let (base, inlay) = if light { (ivory, slate) } else { (slate, ivory) };
        let (across, along) = (x.fract() - 0.5, y.fract() - 0.5);
        let from_middle = across.abs().max(along.abs());
        let diamond = across.abs() + along.abs();
        if from_middle > 0.488 {
            return shade(slate, 0.55); // the joint between two checks
        }
        if (0.392..0.41).contains(&from_middle) || (0.13..0.15).contains(&diamond) || diamond < 0.05 {
            return mix(base, inlay, 0.75);
        }
        let vein = (fractal_noise(u, v, 8, 5, if light { 11 } else { 23 }) - 0.5).abs();
        let clouds = fractal_noise(u, v, 16, 4, 37);
        let stone = shade(base, 0.88 + 0.24 * clouds);
        mix(shade(stone, if light { 0.8 } else { 1.45 }), stone, (vein * 22.0).min(1.0))
    })
}

/// Returns wallpaper: stripes with a woven thread, and a small flower at each point of a lattice.
/// It tiles.
pub(crate) fn wallpaper() -> Picture {
    let (ground, stripe, flower) = (rgb(96, 128, 132), rgb(116, 147, 146), rgb(205, 205, 178));
    paint(1024, 1024, 3, |u, v| {
        let (x, y) = (u * 16.0, v * 16.0);
        let column = x.floor();
        let base = if column % 2.0 == 0.0 { ground } else { stripe };
        let weave = 1.0 + 0.05 * wave(u * 128.0) * wave(v * 128.0 + 0.25 * wave(u * 64.0));
        let cloth = shade(base, weave * (0.94 + 0.12 * noise(u, v, 256, 256, 5)));
        if ruled(x, 1.0, 0.03) {
            return mix(cloth, flower, 0.7);
        }
        // every second column of flowers is moved by half a step
        let (cx, cy) = (x.fract() - 0.5, (y + 0.5 * (column % 2.0)).fract() - 0.5);
        let (radius, angle) = (cx.hypot(cy), cy.atan2(cx));
        let petals = 0.30 * (0.45 + 0.55 * (2.5 * angle + FRAC_PI_2).sin().abs());
        let on_flower = radius < petals && !(0.05..0.085).contains(&radius);
        if on_flower { mix(cloth, flower, 0.8) } else { cloth }
    })
}

/// Lines on the card of text, at most 37 characters.
const CARD_TEXT: [&str; 8] = [
    "A STACK OF CLEAR PANELS CAN SHOW",
    "MORE THAN A PICTURE. EACH RAY MEETS",
    "EVERY PANEL ONCE, AND WHAT COMES OUT",
    "IS THE PRODUCT OF WHAT EACH ONE LETS",
    "THROUGH. CHANGE THE PATTERNS FASTER",
    "THAN THE EYE CAN FOLLOW, AND THE",
    "MEAN OF THE FRAMES IS A SUM OF SUCH",
    "PRODUCTS: A TENSOR OF LOW RANK.",
];

/// Returns a printed card with the proportions 3 : 2. A dot of its small letters is 3 pixels wide;
/// the card has 768 columns.
pub(crate) fn text_card() -> Picture {
    let (paper, ink, red) = (rgb(240, 235, 220), rgb(34, 34, 48), rgb(176, 42, 36));
    paint(768, 512, 1, |u, v| {
        let (x, y) = ((u * 768.0).floor(), (v * 512.0).floor());
        let border = x.min(y).min(767.0 - x).min(511.0 - y);
        if (12.0..16.0).contains(&border) {
            return red;
        }
        let on_text = |text: &str, left: f64, top: f64, dot: f64| {
            let (column, row) = ((x - left) / dot, (y - top) / dot);
            column >= 0.0 && row >= 0.0 && is_set(text, column as usize, row as usize)
        };
        if on_text("LIGHT FIELDS", 54.0, 44.0, 9.0) {
            return red;
        }
        let line = ((y - 136.0) / 32.0).floor();
        if (0.0..CARD_TEXT.len() as f64).contains(&line)
            && on_text(CARD_TEXT[line as usize], 54.0, 136.0 + 32.0 * line, 3.0)
        {
            return ink;
        }
        // a row of colour patches, and below it a row of bars that become finer to the right
        if (54.0..714.0).contains(&x) && (404.0..436.0).contains(&y) {
            let patches = [rgb(200, 40, 40), rgb(225, 150, 40), rgb(70, 150, 60), rgb(40, 130, 170), rgb(60, 60, 150)];
            return patches[((x - 54.0) / 132.0) as usize];
        }
        if (54.0..714.0).contains(&x) && (444.0..480.0).contains(&y) {
            let period = [16.0, 12.0, 8.0, 6.0, 4.0][((x - 54.0) / 132.0) as usize];
            return if (x - 54.0).rem_euclid(period) < 0.5 * period { ink } else { paper };
        }
        paper
    })
}

/// Returns a beach ball as an equirectangular picture: twelve stripes along meridians, and thin
/// lines along parallels.
pub(crate) fn striped_ball() -> Picture {
    let (white, red, blue) = (rgb(236, 232, 224), rgb(190, 50, 40), rgb(40, 80, 150));
    paint(512, 256, 3, |u, v| {
        if ruled(v, 0.125, 0.008) {
            return shade(blue, 0.8);
        }
        match (u * 12.0).floor() as i64 % 4 {
            0 => red,
            2 => blue,
            _ => white,
        }
    })
}

/// Returns brushed metal as glTF stores it: roughness in green, metalness in blue; it tiles.
pub(crate) fn brushed_metal() -> Picture {
    paint(256, 256, 1, |u, v| {
        let streaks = 0.7 * noise(u, v, 4, 128, 3) + 0.3 * noise(u, v, 8, 256, 4);
        [0.0, 0.16 + 0.12 * streaks, 1.0, 1.0]
    })
}

/// Returns graph paper, one tile = 40 mm: lines every 2 mm, heavier every 10 mm.
pub(crate) fn graph_paper(paper: Rgba, line: Rgba) -> Picture {
    paint(256, 256, 4, |u, v| {
        let (x, y) = (40.0 * u, 40.0 * v);
        if ruled(x, 10.0, 0.35) || ruled(y, 10.0, 0.35) {
            line
        } else if ruled(x, 2.0, 0.2) || ruled(y, 2.0, 0.2) {
            mix(paper, line, 0.35)
        } else {
            paper
        }
    })
}

/// Returns two resolution charts side by side: a Siemens star (left) and groups of line pairs
/// (right).
pub(crate) fn resolution_charts() -> Picture {
    let (white, black) = (rgb(242, 242, 242), rgb(14, 14, 14));
    let ink = |on: bool| if on { black } else { white };
    paint(1024, 512, 4, |u, v| {
        let right_half = u >= 0.5;
        let (x, y) = ((2.0 * u).fract(), v);
        if x.min(y).min(1.0 - x).min(1.0 - y) < 0.012 {
            return black;
        }
        if !right_half {
            let (radius, angle) = ((x - 0.5).hypot(y - 0.5), (y - 0.5).atan2(x - 0.5));
            let ring = (0.445..0.455).contains(&radius);
            // with this small offset no border of a sector lies on a diagonal of pixels
            let sector = (36.0 * (angle / TAU + 1.001)).fract() < 0.5;
            return ink(ring || (radius < 0.43 && radius > 0.01 && sector));
        }
        // The right chart has 4 x 4 fields. Its columns have vertical line pairs, horizontal line
        // pairs, checks and slanted line pairs. Each row is finer than the row above it.
        let (column, row) = ((x * 4.0).floor(), (y * 4.0).floor());
        let (a, b) = ((x * 4.0).fract(), (y * 4.0).fract());
        if a.min(b).min(1.0 - a).min(1.0 - b) < 0.1 {
            return white;
        }
        let pairs = [4.0, 6.0, 10.0, 16.0][row as usize];
        let on = |t: f64| (t * pairs + 1e-3).rem_euclid(1.0) < 0.5;
        ink(match column as usize {
            0 => on(a),
            1 => on(b),
            2 => on(a) != on(b),
            _ => on(a + 0.4 * b),
        })
    })
}

/// Returns the height of the glazed tiles of [`tile_colors`] and [`tile_normals`], in an arbitrary
/// unit. The picture has 2 x 2 bevelled tiles, each with a raised ripple around its middle.
fn tile_height(u: f64, v: f64) -> f64 {
    let (across, along) = ((2.0 * u).rem_euclid(1.0) - 0.5, (2.0 * v).rem_euclid(1.0) - 0.5);
    let edge = (0.5 - across.abs().max(along.abs())) / 0.05;
    let bevel = edge.clamp(0.0, 1.0);
    let radius = across.hypot(along);
    let ripple = if radius < 0.36 { 0.22 * (1.0 - wave(radius / 0.12)) } else { 0.0 };
    bevel * bevel * (3.0 - 2.0 * bevel) + ripple
}

/// Returns the normal map of the glazed tiles.
pub(crate) fn tile_normals() -> Picture {
    paint_normals(512, 0.012, tile_height)
}

/// Returns the colours of the glazed tiles: two glazes with brush marks, a painted ring and dark
/// joints. The picture repeats without seams.
pub(crate) fn tile_colors() -> Picture {
    let (cream, teal, joint) = (rgb(214, 206, 186), rgb(74, 126, 128), rgb(70, 66, 62));
    paint(512, 512, 3, |u, v| {
        let (x, y) = (2.0 * u, 2.0 * v);
        let (across, along) = (x.fract() - 0.5, y.fract() - 0.5);
        if across.abs().max(along.abs()) > 0.475 {
            return joint;
        }
        let light = (x.floor() + y.floor()) % 2.0 == 0.0;
        let (base, mark) = if light { (cream, teal) } else { (teal, cream) };
        let radius = across.hypot(along);
        let angle = along.atan2(across);
        let glaze = shade(base, 0.9 + 0.2 * fractal_noise(u, v, 32, 3, 71));
        let ring = (0.375..0.39).contains(&radius) || (0.405..0.412).contains(&radius);
        let ticks = (0.42..0.45).contains(&radius) && ((48.0 * (angle / TAU + 1.003)).fract() < 0.4);
        if ring || ticks { mix(glaze, mark, 0.8) } else { glaze }
    })
}

/// Returns a screen of leaves on a lattice, for the alpha mode MASK. Alpha is 1 on leaves and bars,
/// and 0 between them. It tiles.
pub(crate) fn leaf_screen() -> Picture {
    let (leaf, vein, bar) = (rgb(64, 110, 48), rgb(138, 168, 84), rgb(92, 70, 44));
    paint(256, 256, 4, |u, v| {
        let (x, y) = (2.0 * u, 2.0 * v);
        let (across, along) = (x.fract() - 0.5, y.fract() - 0.5);
        if across.abs() > 0.465 || along.abs() > 0.465 {
            return bar;
        }
        // leaves lean to alternating sides
        let lean = if (x.floor() + y.floor()) % 2.0 == 0.0 { 1.0 } else { -1.0 };
        let (s, t) = ((across + lean * along) / 2f64.sqrt(), (along - lean * across) / 2f64.sqrt());
        let half_width = 0.17 * (1.0 - (t / 0.5).powi(2)).max(0.0);
        if s.abs() > half_width {
            return [leaf[0], leaf[1], leaf[2], 0.0];
        }
        let on_vein = s.abs() < 0.018 || ruled(t - 0.7 * s.abs(), 0.11, 0.012);
        if on_vein { vein } else { leaf }
    })
}

/// Returns stained glass, for the alpha mode BLEND: coloured panes with different alpha, separated
/// by lead lines.
pub(crate) fn stained_glass() -> Picture {
    let lead = rgb(24, 24, 26);
    let panes = [rgb(200, 40, 50), rgb(240, 180, 30), rgb(30, 120, 200), rgb(40, 160, 90)];
    paint(256, 384, 4, |u, v| {
        let (x, y) = (4.0 * u, 6.0 * v);
        let (p, q) = (x + y, x - y);
        let frame = u.min(1.0 - u) < 0.03 || v.min(1.0 - v) < 0.02;
        if frame || ruled(p, 2.0, 0.07) || ruled(q, 2.0, 0.07) {
            return lead;
        }
        let (i, j) = ((p / 2.0).floor() as i64 + 64, (q / 2.0).floor() as i64 + 64);
        let choice = (hash(i as u32, j as u32, 9) * 3.999) as usize;
        let mut pane = panes[choice];
        pane[3] = 0.45 + 0.15 * hash(i as u32, j as u32, 10);
        pane
    })
}

/// Returns the print on both sides of the paper ribbon: staves with notes, and a fine line along
/// the edges.
pub(crate) fn sheet_music() -> Picture {
    let (paper, ink) = (rgb(238, 230, 208), rgb(30, 28, 34));
    paint(1024, 256, 2, |u, v| {
        let (x, y) = (u * 1024.0, v * 256.0);
        if (6.0..9.0).contains(&y) || (247.0..250.0).contains(&y) {
            return ink;
        }
        let title = "PRELUDE IN FIVE VIEWS";
        let (column, row) = ((x - 40.0) / 4.0, (y - 20.0) / 4.0);
        if column >= 0.0
            && row >= 0.0
            && (column as usize) < columns(title)
            && is_set(title, column as usize, row as usize)
        {
            return ink;
        }
        // draw two staves of five lines; the lines are 12 pixels apart
        for (stave, top) in [(0u32, 90.0), (1, 178.0)] {
            let line = y - top;
            if (-1.0..49.0).contains(&line) && ruled(line, 12.0, 1.0) {
                return ink;
            }
            let beat = (x / 32.0).floor();
            let height = 6.0 * (hash(beat as u32, stave, 21) * 8.0).floor();
            let (dx, dy) = (x - 32.0 * beat - 14.0, line - height);
            let head = (dx / 7.5).powi(2) + (dy / 5.5).powi(2) < 1.0;
            let stem = (5.0..7.5).contains(&dx) && (-34.0..0.0).contains(&dy);
            if head || stem {
                return ink;
            }
        }
        paper
    })
}
