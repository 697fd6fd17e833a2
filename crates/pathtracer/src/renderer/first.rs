//! Means over the first surfaces of a pixel's rays.

use glam::{DVec3, Quat, Vec3};
use lumistack_scene::Window;

use super::sums::LightSums;
use crate::geometry::RenderSpace;
use crate::surface::{First, divisor};

/// Number of values per pixel of the guides.
pub(crate) const FEATURES: usize = 11;
/// Number of values per pixel of a view whose diffuse and other light are separate.
pub(super) const PARTS: usize = 17;
/// Number of values per pixel if some rays end at the first surface: the values of [`PARTS`], then
/// the diffuse and the glossy reflectance over the paths alone.
pub(super) const MORE_PARTS: usize = PARTS + 6;
/// Index of the smallest α of a pixel's rays among the pixel's values.
pub(super) const ALPHA: usize = PARTS - 1;
/// Number of values of [`FirstSums::apart`]: the values of [`MORE_PARTS`], then the light that the
/// rays themselves see. Here the values of [`MORE_PARTS`] do not include this light.
pub(super) const APART: usize = MORE_PARTS + 3;

/// Converts points and directions of render space to depths and directions of display space.
pub(super) struct DisplayAxes {
    display_from_scene: Quat,
    /// For a point of render space, along · point + offset is z in display space, in millimetres.
    along: DVec3,
    offset: f64,
}

impl DisplayAxes {
    pub(super) fn new(window: &Window, space: RenderSpace) -> Self {
        let map = &window.scene_from_display;
        let along = map.rotation * DVec3::Z / map.scale;
        Self {
            display_from_scene: map.rotation.inverse().as_quat(),
            along: along / space.scale,
            offset: (space.centre - map.translation).dot(along),
        }
    }

    /// Returns z in display space of a point in render space, millimetres.
    fn z_mm(&self, point: Vec3) -> f32 {
        (point.as_dvec3().dot(self.along) + self.offset) as f32
    }
}

/// Sums over the first surfaces of a pixel's rays. Normals are in render space until
/// [`turned`](Self::turned) converts them to display space.
#[derive(Default)]
pub(super) struct FirstSums {
    /// Number of all rays; `paths` of them continue as paths, and `hits` of them hit a surface.
    rays: u32,
    paths: u32,
    hits: u32,
    z_mm: f32,
    /// Sum of the geometric normals.
    normal: Vec3,
    /// Sum of the reflectances of the diffuse lobe.
    reflectance: Vec3,
    /// Sum of the reflectances of the lobes that depend on the viewer's direction.
    glossy: Vec3,
    /// 1 minus the smallest α of the rays' [`Gloss`](crate::surface::Gloss).
    sharpness: f32,
    /// This sum and the next three are the sums of the guides' values.
    albedo: Vec3,
    shading: Vec3,
    gloss: f32,
    alpha: f32,
    /// For the ray nearest to the pixel's centre: the squared distance from the centre, and the
    /// depth of its hit, `None` for a miss.
    nearest: Option<(f32, Option<f32>)>,
    /// Light that is scattered alike to all viewers, over the samples that are finite.
    diffuse: Vec3,
    /// Light that the first surfaces emit, or that rays past all surfaces see.
    seen: Vec3,
    /// The sum `seen` over the rays that continue as paths.
    path_seen: Vec3,
    /// The sum `reflectance` over the rays that continue as paths. Without such rays, it is the
    /// mean over all rays if the pixel has light of its group, see [`lend`](Self::lend). The same
    /// holds for `path_glossy`.
    path_reflectance: Vec3,
    /// The sum `glossy` over the rays that continue as paths.
    path_glossy: Vec3,
}

impl FirstSums {
    /// Adds the first surface of a ray. `place` is the ray's position, in pixels from the pixel's
    /// centre.
    #[inline]
    pub(super) fn add(&mut self, first: &First, place: [f32; 2], axes: &DisplayAxes) {
        let z_mm = first.is_there.then(|| axes.z_mm(first.position));
        let distance = place[0] * place[0] + place[1] * place[1];
        if self.nearest.is_none_or(|(nearest, _)| distance < nearest) {
            self.nearest = Some((distance, z_mm));
        }
        self.rays += 1;
        self.seen += first.seen;
        if first.is_path {
            self.paths += 1;
            self.path_seen += first.seen;
            self.path_reflectance += first.reflectance;
            self.path_glossy += first.gloss.reflectance;
        }
        // α = 0 marks light that other views do not share, such as light that a ray itself sees
        let alpha = if first.seen == Vec3::ZERO { first.gloss.alpha } else { 0.0 };
        self.sharpness = self.sharpness.max(1.0 - alpha);
        let Some(z_mm) = z_mm else { return };
        self.hits += 1;
        self.z_mm += z_mm;
        self.normal += first.normal;
        self.reflectance += first.reflectance;
        self.glossy += first.gloss.reflectance;
        self.albedo += first.guide.albedo;
        self.shading += first.guide.normal;
        self.gloss += first.guide.gloss;
        self.alpha += first.guide.alpha;
    }

    /// Adds light that is scattered alike to all viewers.
    #[inline]
    pub(super) fn add_diffuse(&mut self, diffuse: Vec3) {
        self.diffuse += diffuse;
    }

    /// Gives the light of the paths of a group of pixels to those pixels that have no path. Each
    /// pixel has its [`LightSums`], over its own paths. If a pixel has no path, all rays of the
    /// group hit one surface, which emits no light; see
    /// [`SparsePaths`](crate::sparse::SparsePaths). If the light of any path is not finite, pixels
    /// without a path stay without one. Other views then give them light.
    pub(super) fn lend(group: &mut [(Self, LightSums)]) {
        let is_finite = group.iter().all(|(_, light)| light.not_finite == 0);
        if !is_finite || group.iter().all(|(first, _)| first.paths > 0) {
            return;
        }
        // E and H of the group (see `denoise/shared.rs`): its light divided by its reflectances, so
        // that textures have no effect
        let sum = |of: fn(&Self, &LightSums) -> Vec3| group.iter().map(|(first, light)| of(first, light)).sum::<Vec3>();
        let paths = group.iter().map(|(first, _)| first.paths).sum::<u32>() as f32;
        let diffuse = sum(|first, _| first.diffuse) / divisor(sum(|first, _| first.path_reflectance) / paths);
        let other =
            sum(|first, light| light.sum() - first.diffuse) / divisor(sum(|first, _| first.path_glossy) / paths);
        let (diffuse, other) = (diffuse / paths, other / paths);
        for (first, light) in group.iter_mut().filter(|(first, _)| first.paths == 0) {
            let share = 1.0 / first.rays as f32;
            first.paths = 1;
            first.path_reflectance = share * first.reflectance;
            first.path_glossy = share * first.glossy;
            first.diffuse = diffuse * divisor(first.path_reflectance);
            light.add(first.diffuse + other * divisor(first.path_glossy));
        }
    }

    /// Returns the sums with normals in display space.
    pub(super) fn turned(mut self, axes: &DisplayAxes) -> Self {
        self.normal = axes.display_from_scene * self.normal;
        self.shading = axes.display_from_scene * self.shading;
        self
    }

    /// Returns the guides of a pixel.
    pub(super) fn features(&self) -> [f32; FEATURES] {
        let share = 1.0 / self.hits.max(1) as f32;
        let [r, g, b] = (share * self.albedo).to_array();
        let [x, y, z] = (share * self.shading).to_array();
        let central = self.nearest.and_then(|(_, z_mm)| z_mm).unwrap_or(f32::NAN);
        let covered = self.hits as f32 / self.rays as f32;
        [covered, r, g, b, x, y, z, share * self.z_mm, share * self.gloss, share * self.alpha, central]
    }

    /// Returns the values of a pixel with its diffuse and other light separate. `mean` is the mean
    /// light of the paths, of which `finite` have finite light.
    pub(super) fn split(&self, mean: Vec3, finite: u32) -> [f32; PARTS] {
        // light is a mean over the finite paths, reflectance over all rays, normal and depth over
        // the rays with a surface
        let diffuse = self.diffuse / finite.max(1) as f32;
        let share = 1.0 / self.hits.max(1) as f32;
        let mut values = [0.0; PARTS];
        values[..3].copy_from_slice(&diffuse.to_array());
        values[3..6].copy_from_slice(&(mean - diffuse).to_array());
        values[6..9].copy_from_slice(&(self.reflectance / self.rays as f32).to_array());
        values[9..12].copy_from_slice(&(share * self.normal).to_array());
        values[12] = share * self.z_mm;
        values[13..16].copy_from_slice(&(self.glossy / self.rays as f32).to_array());
        values[ALPHA] = 1.0 - self.sharpness;
        values
    }

    /// Returns the values of [`split`](Self::split), then the diffuse and the glossy reflectance
    /// over the paths alone, then the light that all rays themselves see. The values of `split`
    /// lack this last light.
    pub(super) fn apart(&self, mean: Vec3, finite: u32) -> [f32; APART] {
        let of_paths = 1.0 / self.paths.max(1) as f32;
        let mut values = [0.0; APART];
        values[..PARTS].copy_from_slice(&self.split(mean - of_paths * self.path_seen, finite));
        values[PARTS..PARTS + 3].copy_from_slice(&(of_paths * self.path_reflectance).to_array());
        values[PARTS + 3..MORE_PARTS].copy_from_slice(&(of_paths * self.path_glossy).to_array());
        values[MORE_PARTS..].copy_from_slice(&(self.seen / self.rays as f32).to_array());
        values
    }
}
