//! Light fields in closed form: cards that move in front of a display.

use std::sync::Arc;

use lumistack_display::{Display, FieldGeometry, LightField, Weights};

use crate::Target;

/// Kinds of moving content.
#[derive(Clone, Copy, Debug)]
pub(super) enum Content {
    /// A card of waves at the depth of the front layer.
    Waves,
    /// A card of patches of random grey behind the stack.
    Patches,
    /// A round card in front of a card of patches.
    Two,
}

pub(super) const CONTENTS: [Content; 3] = [Content::Waves, Content::Patches, Content::Two];

/// Returns a display of three layers 12 mm apart, with 80 × 50 pixels of 1 mm.
pub(super) fn display() -> Display {
    Display { brightness: 0.3, ..Display::uniform([80, 50], 1.0, [5, 3], [20.0, 12.0], &[-12.0, 0.0, 12.0], 4) }
}

/// Returns the display of [`display`] with twice the columns, so that moving content enters a
/// smaller fraction of the display.
pub(super) fn wide() -> Display {
    Display { brightness: 0.3, ..Display::uniform([160, 50], 1.0, [5, 3], [20.0, 12.0], &[-12.0, 0.0, 12.0], 4) }
}

/// Returns a random grey in 0..1 for a patch of a card.
fn patch(x: f64, y: f64) -> f64 {
    let mut bits = (x.floor() as i64 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (y.floor() as i64 as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    bits = (bits ^ (bits >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((bits ^ (bits >> 32)) & 0xffff) as f64 / 65535.0
}

/// Returns the grey that a ray sees. The ray goes through (x, y) on z = 0 along a slope, and the
/// content is moved to the right.
fn grey(content: Content, [x, y]: [f64; 2], [sx, sy]: [f64; 2], moved_mm: f64) -> f64 {
    let on = |d: f64| [x + d * sx - moved_mm, y + d * sy];
    let waves = |[x, y]: [f64; 2]| 0.5 + 0.2 * (0.7 * x + 0.1 * y).sin() * (0.5 * y).cos() + 0.2 * (0.11 * x).sin();
    let patches = |[x, y]: [f64; 2]| 0.15 + 0.7 * patch(x / 4.0, y / 4.0);
    match content {
        Content::Waves => waves(on(12.0)),
        Content::Patches => patches(on(-20.0)),
        Content::Two => {
            let [cx, cy] = on(15.0);
            if (cx + 10.0).hypot(cy) < 12.0 { waves([cx, cy]) } else { patches(on(-10.0)) }
        }
    }
}

/// Returns the first view of a geometry, for content that has not moved: `[row][col][rgb]`.
pub(super) fn view(content: Content, geometry: &FieldGeometry) -> Vec<f32> {
    picture(content, geometry, [0, 0], 0.0)
}

fn picture(content: Content, geometry: &FieldGeometry, view: [usize; 2], moved_mm: f64) -> Vec<f32> {
    let pixels = (0..geometry.rows).flat_map(|row| (0..geometry.cols).map(move |col| [row, col]));
    // a pixel is the mean over its area, by 3 × 3 rays
    let side = [-1.0, 0.0, 1.0].map(|step| step * geometry.pitch_mm / 3.0);
    let pixel = |[row, col]: [usize; 2]| {
        let rays = side.iter().flat_map(|&dy| side.iter().map(move |&dx| [dx, dy]));
        let sum: f64 = rays
            .map(|[dx, dy]| {
                let at = [geometry.x_mm(col) + dx, geometry.y_mm(row) + dy];
                grey(content, at, geometry.grid.slope_at(view, at), moved_mm)
            })
            .sum();
        [(sum / 9.0) as f32; 3]
    };
    pixels.flat_map(pixel).collect()
}

/// Returns a target of content that is moved to the right.
pub(super) fn target(display: &Display, content: Content, moved_mm: f64, number: u64) -> Arc<Target> {
    let mut field = LightField::black(display.geometry().unwrap()).unwrap();
    let geometry = field.geometry().clone();
    for view in geometry.grid.iter() {
        field.view_mut(view).copy_from_slice(&picture(content, &geometry, view, moved_mm));
    }
    let display = Arc::new(display.clone());
    Arc::new(Target { display, field, weights: Weights::Uniform, content: number, passes: 1 })
}
