//! Fewer paths where pixels see the same smooth surface.
//!
//! Views that share light ([`SharedLight`](crate::denoise::SharedLight)) average the paths of
//! hundreds of views on a smooth surface. So most of the noise that remains is elsewhere: at edges,
//! in sharp reflections and in glass. Here rays are divided into groups. A group has the rays of
//! four neighbouring pixels, or of one pixel with many paths. If all rays of a group hit one smooth
//! surface, a quarter of its paths continue. The other rays end at the surface. Their pixels get
//! the reflectance, normal and depth of their own rays.
//!
//! A pixel that loses its only path takes E and H (see `denoise/shared.rs`) from the paths of its
//! group (`FirstSums::lend`). E and H do not include texture. So shadows are blurred over at most a
//! pixel, textures are not. Chance decides in every view which pixel of the group keeps its path.
//! A regular pattern would be worse. A point that moves by a pixel from view to view would then
//! have a path in all views or in none.
//!
//! Results with 13 × 13 views of 420 × 262 pixels. In groups that see one surface, the given
//! fraction of the paths continues. Views with one path per pixel also have a further ray per
//! pixel:
//!
//! | scene | paths | fraction | CPU seconds of rendering | score in the viewing zone |
//! |---|---|---|---|---|
//! | still-life | 1 | 1 | 33 | 26.12 dB |
//! | | 1 | 1/4 | 24 | 26.06 dB |
//! | | 2 | 1 | 52 | 26.30 dB |
//! | | 2 | 1/4 | 36 | 26.30 dB |
//! | | 4 | 1 | 100 | 26.49 dB |
//! | | 4 | 1/4 | 60 | 26.49 dB |
//! | FlightHelmet | 12 | 1 | 56 | 38.65 dB |
//! | | 12 | 1/4 | 54 | 38.54 dB |
//!
//! In FlightHelmet, only a fifth of the groups see one surface. Points are compared before textures
//! are read: if textures were read first, FlightHelmet took 5 % longer. With [`LEAST_ALPHA`] 0.04
//! instead of 0.1, still-life with 4 paths took 56 instead of 60 seconds, but lost 0.02 dB, and
//! FlightHelmet lost 0.05 dB. Larger limits on the angle between normals saved no time.

use std::ops::Range;

use glam::Vec3;

use crate::bvh::BEAM;
use crate::math::all_ones;
use crate::settings::FEWER;
use crate::surface::{First, divisor};

/// Number of neighbouring pixels of a group.
const PIXELS: usize = 4;
/// Smallest α of a lobe whose light a group shares.
const LEAST_ALPHA: f32 = 0.1;
/// Largest angle between the shading normals of a group with a glossy lobe, divided by α. The angle
/// is in radians.
const GLOSSY_TURN: f32 = 0.5;
/// Largest angle in radians between the normals of a group, both geometric and shading normals.
const MOST_TURN: f32 = 0.3;
/// Smallest reflectance at normal incidence of a group's lobes that depend on the viewer's
/// direction, as a fraction of the largest one. Near grazing angles, their light is not in
/// proportion to this reflectance. The same limit holds for diffuse reflectances that are too small
/// to divide by.
const LEAST_RATIO: f32 = 0.25;

/// The groups of a beam.
#[derive(Clone, Copy)]
pub(crate) struct SparsePaths {
    /// Number of rays of a group.
    rays: usize,
    /// The bit of each ray that continues as a path even if its group sees one surface.
    kept: u32,
}

/// Returns the number of pixels that a beam should have if it has room for `most` pixels. The
/// pixels form whole groups if the beam has room for a group.
pub(crate) fn whole_groups(most: usize) -> usize {
    if most >= PIXELS { most / PIXELS * PIXELS } else { most }
}

/// Returns the number of pixels of a group, for pixels with these numbers of rays and paths.
pub(crate) fn pixels_of_group(rays: usize, paths: usize) -> usize {
    if paths < FEWER as usize && PIXELS * rays <= BEAM { PIXELS } else { 1 }
}

impl SparsePaths {
    /// Makes the groups of a beam with pixels at the places [row, col]. Each pixel has `rays` rays,
    /// of which the first `paths` may continue as paths. `seeds` has a random number for each
    /// pixel.
    pub(crate) fn new(places: &[[usize; 2]], seeds: &[u64], rays: usize, paths: usize) -> Self {
        let pixels = pixels_of_group(rays, paths);
        let mut kept = 0;
        for (group, (places, seeds)) in places.chunks_exact(pixels).zip(seeds.chunks_exact(pixels)).enumerate() {
            let first = group * pixels * rays;
            if pixels == 1 {
                // the first samples of a pixel are stratified
                kept |= all_ones(paths.div_ceil(FEWER as usize)) << first;
                continue;
            }
            // at the picture's lower and right edges, four pixels may be no square
            let [row, col] = places[0];
            if places != [[row, col], [row, col + 1], [row + 1, col], [row + 1, col + 1]] {
                kept |= all_ones(pixels * rays) << first;
                continue;
            }
            // as many pixels keep one path as a pixel has paths; the first two are on a diagonal
            let start = (seeds[0] >> 40) as usize % PIXELS;
            for pixel in [start, start ^ 3, start ^ 1, start ^ 2].into_iter().take(paths) {
                kept |= 1 << (first + pixel * rays);
            }
        }
        Self { rays: pixels * rays, kept }
    }

    /// Returns the rays of every group, for a beam with this number of rays.
    pub(crate) fn groups(self, rays: usize) -> impl Iterator<Item = Range<usize>> {
        (0..rays / self.rays).map(move |group| group * self.rays..(group + 1) * self.rays)
    }

    /// Returns `paths`, the bits of the rays that continue as paths, without the bits of the paths
    /// that end if `group` sees one surface.
    pub(crate) fn fewer(self, paths: u32, group: Range<usize>) -> u32 {
        paths & (self.kept | !(all_ones(group.len()) << group.start))
    }
}

/// Returns true if the hits of rays are on one plane. `points` yields the position and the
/// geometric normal of every hit, and `None` for a miss. `width` is the width of a ray's footprint.
pub(crate) fn are_on_a_plane(mut points: impl Iterator<Item = Option<(Vec3, Vec3)>>, width: f32) -> bool {
    let Some(Some((position, normal))) = points.next() else { return false };
    points.all(|point| {
        point.is_some_and(|(other, turned)| {
            normal.dot(other - position).abs() <= width && normal.distance_squared(turned) <= MOST_TURN * MOST_TURN
        })
    })
}

/// Returns true if rays whose hits are on a plane can share the light of their surface.
pub(crate) fn is_one_surface(first: &[First]) -> bool {
    let Some((own, others)) = first.split_first() else { return false };
    let are_alike = others.iter().all(|other| {
        let is_glossy = other.gloss.reflectance != Vec3::ZERO;
        let turn = if is_glossy { MOST_TURN.min(GLOSSY_TURN * other.gloss.alpha) } else { MOST_TURN };
        can_share(other) && own.guide.normal.distance_squared(other.guide.normal) <= turn * turn
    });
    // the smallest and the largest value of each channel
    let range = |of: fn(&First) -> Vec3| {
        first.iter().map(of).fold((Vec3::MAX, Vec3::ZERO), |(least, most), x| (least.min(x), most.max(x)))
    };
    let is_even = |(least, most): (Vec3, Vec3)| least.cmpge(LEAST_RATIO * most);
    let diffuse = range(|first| first.reflectance);
    let divides = diffuse.0.cmpeq(divisor(diffuse.0)) | is_even(diffuse);
    can_share(own) && are_alike && divides.all() && is_even(range(|first| first.gloss.reflectance)).all()
}

fn can_share(first: &First) -> bool {
    first.seen == Vec3::ZERO && first.gloss.alpha >= LEAST_ALPHA
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A group that sees one surface keeps a quarter of its paths, but at least one. A group of
    /// pixels keeps at most one path per pixel.
    #[test]
    fn a_quarter_of_the_paths_is_kept() {
        let seeds = |pixels: usize| (0..pixels as u64).map(|pixel| pixel << 40).collect::<Vec<u64>>();
        // pixels in the order of a tile
        let places = |pixels: usize| (0..pixels).map(|i| [i / 2 % 2, i / 4 * 2 + i % 2]).collect::<Vec<_>>();
        for (pixels, rays, paths, kept) in [
            (16, 1, 1, 4),
            (8, 2, 1, 2),
            (8, 2, 2, 4),
            (4, 3, 3, 3),
            (4, 4, 4, 4),
            (2, 6, 6, 4),
            (1, 16, 12, 3),
            (1, 16, 1, 1),
        ] {
            let sparse = SparsePaths::new(&places(pixels), &seeds(pixels), rays, paths);
            let all = (0..pixels).fold(0, |all, pixel| all | all_ones(paths) << (pixel * rays));
            let groups: Vec<_> = sparse.groups(pixels * rays).collect();
            let left = groups.iter().fold(all, |left, group| sparse.fewer(left, group.clone()));
            assert_eq!((left.count_ones(), left & !all), (kept, 0), "{pixels} pixels, {rays} rays, {paths} paths");
            for group in groups {
                // only the paths of this group end
                let bits = all_ones(group.len()) << group.start;
                let left = sparse.fewer(all, group);
                assert_eq!(left & !bits, all & !bits);
                assert_ne!(left & bits, 0);
            }
        }
        // the pixel with the path is random
        let starts: Vec<u32> = (0..4).map(|seed| SparsePaths::new(&places(4), &[seed << 40; 4], 2, 1).kept).collect();
        assert_eq!(starts, [0b1, 0b100, 0b1_0000, 0b100_0000]);
        // a group has whole pixels
        assert_eq!([whole_groups(16), whole_groups(5), whole_groups(3)], [16, 4, 3]);
        assert_eq!(SparsePaths::new(&places(3), &seeds(3), 1, 1).kept, 0);
        // four pixels in a row are no group
        let row = [[0, 0], [0, 1], [0, 2], [0, 3]];
        assert_eq!(SparsePaths::new(&row, &seeds(4), 1, 1).kept, 0b1111);
    }
}
