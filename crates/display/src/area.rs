//! Computes the intersections of the rays of one view with the display, over the whole area of
//! every field pixel.
//!
//! Layers consist of squares of constant value. So along an axis, two rays read different values
//! only if the edge of a layer pixel, a lenslet or a bin lies between them. Each axis of a field
//! pixel is cut at all these edges. All rays between two cuts read the same values. So one ray
//! represents the part of the pixel between two cuts, with the part's width as its weight. The
//! intersections are separable, so the pixel's area is divided into products of a part along x and
//! a part along y. The weighted mean over these products is the exact mean over the area.

use crate::raymap::{Axis, AxisRay};
use crate::{Backlight, Display, FieldGeometry, RayMap, Sampling};

/// Parts of a pixel that are narrower than this fraction of the pixel are left out. Such parts come
/// from rounding, if a layer's edge coincides with the pixel's border.
const SLIVER: f64 = 1e-9;

/// The intersections of the rays of one view with the display, with one ray for every part of a
/// pixel.
#[derive(Clone, Debug)]
pub struct AreaMap {
    /// The intersections of one ray per part. The map's columns are the parts `x`, and its rows are
    /// the parts `y`.
    pub map: RayMap,
    /// Parts along x: the first parts of all pixels, then the second parts, and so on. So
    /// neighbouring parts in the list read neighbouring pixels of a layer.
    pub x: Vec<Part>,
    /// Parts along y: all parts of the top pixel, then all parts of the next pixel, and so on.
    pub y: Vec<Part>,
}

/// A part of a field pixel along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Index of the field column or row that has this part.
    pub pixel: u32,
    /// The part's fraction of the pixel's width, above 0. The fractions of a pixel add up to 1.
    pub share: f64,
}

impl AreaMap {
    /// Cuts the field pixels at all edges that the rays of `view` = [view_y, view_x] cross.
    pub fn new(display: &Display, geometry: &FieldGeometry, view: [usize; 2]) -> Self {
        let (rays_x, x) = phase_by_phase(cut_axis(display, geometry, Axis::X, view[1]));
        let (rays_y, y) = cut_axis(display, geometry, Axis::Y, view[0]).into_iter().flatten().unzip();
        let rays_y: Vec<AxisRay> = rays_y;
        let map = RayMap::of_rays(display, Sampling::Nearest, [(&rays_x, rays_x.len()), (&rays_y, rays_y.len())]);
        Self { map, x, y }
    }
}

/// Returns the parts of every field pixel along an axis, in the order of array indices, each with
/// its ray.
fn cut_axis(display: &Display, geometry: &FieldGeometry, axis: Axis, view: usize) -> Vec<Vec<(AxisRay, Part)>> {
    let half_mm = 0.5 * geometry.pitch_mm * if axis == Axis::X { 1.0 } else { -1.0 };
    let mut cuts = Vec::new();
    let pixel = |pixel: usize| {
        let centre = axis.centre_mm(geometry, pixel);
        let ray = |t: f64| axis.ray(geometry, view, centre + (2.0 * t - 1.0) * half_mm);
        cuts.clear();
        // A ray's position on a layer is linear in t, which runs over the field pixel from 0 to 1.
        let (first, last) = (ray(0.0), ray(1.0));
        for layer in &display.layers {
            let edge = |ray| axis.pixel(layer, ray) + 0.5;
            cut_at_whole_numbers(&mut cuts, [edge(&first), edge(&last)], layer.resolution[axis.index()]);
        }
        if let Backlight::Lenslets(lenslets) = &display.backlight {
            let count = lenslets.lenslets[axis.index()];
            cut_at_whole_numbers(&mut cuts, [&first, &last].map(|ray| axis.lenslet(lenslets, ray)), count);
            // Bins may repeat on both sides of their range, at most once per lenslet. So the edges
            // of bins are whole numbers from −`reach` to `reach`. Shift positions by `reach`, since
            // cuts are made at numbers from 0.
            let bins = [&first, &last].map(|ray| axis.bin(lenslets, ray));
            let reach = lenslets.views[axis.index()].saturating_mul(count + 1);
            cut_at_whole_numbers(&mut cuts, bins.map(|bin| bin + reach as f64), reach.saturating_mul(2));
        }
        cuts.push(1.0);
        let mut parts = Vec::with_capacity(cuts.len());
        let mut from = 0.0;
        for &to in cuts.iter().filter(|&&to| to <= 1.0 - SLIVER || to == 1.0) {
            if to - from > SLIVER {
                let share = to - from;
                parts.push((ray(from + 0.5 * share), Part { pixel: pixel as u32, share }));
                from = to;
            }
        }
        parts
    };
    (0..axis.count(geometry)).map(pixel).collect()
}

/// Adds a cut at each whole number from 0 to `count` between `place[0]` and `place[1]`. A cut is
/// the fraction of the distance from `place[0]` to `place[1]` at which the number lies. `cuts`
/// stays sorted.
fn cut_at_whole_numbers(cuts: &mut Vec<f64>, place: [f64; 2], count: usize) {
    let [low, high] = [place[0].min(place[1]), place[0].max(place[1])];
    let first = low.ceil().max(0.0);
    let last = high.floor().min(count as f64);
    if !(first <= last && high > low) {
        return;
    }
    for edge in first as u64..=last as u64 {
        let t = (edge as f64 - place[0]) / (place[1] - place[0]);
        if t > 0.0 && t < 1.0 {
            // Insert the cut in order: cuts are few, and the library's sort would add much code to
            // the browser's module.
            let at = cuts.iter().take_while(|cut| **cut < t).count();
            cuts.insert(at, t);
        }
    }
}

/// Orders the parts of all pixels: the first part of each pixel, then the second part of each
/// pixel, and so on.
fn phase_by_phase(pixels: Vec<Vec<(AxisRay, Part)>>) -> (Vec<AxisRay>, Vec<Part>) {
    let most = pixels.iter().map(Vec::len).max().unwrap_or(0);
    (0..most).flat_map(|phase| pixels.iter().filter_map(move |parts| parts.get(phase).copied())).unzip()
}
