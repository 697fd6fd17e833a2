//! Clouds of 3D Gaussians ("splats"), in which captures of the real world are stored.
//!
//! ```text
//! G(x) = exp(−½ (x − μ)ᵀ Σ⁻¹ (x − μ)),   Σ = M R diag(s²) Rᵀ Mᵀ
//! μ, R, s: position, rotation and standard deviations of a splat
//! M: the linear part of scene_from_cloud; c_lm, Y_lm: coefficients and spherical harmonics
//! colour = max(0, ½ + Σ_lm c_lm Y_lm(direction from the viewer to μ))
//! ```
//!
//! Source: Kerbl et al., *3D Gaussian Splatting for Real-Time Radiance Field Rendering*, SIGGRAPH
//! 2023, as KHR_gaussian_splatting states it.

use glam::{Affine3A, Quat, Vec3};
use lumistack_core::Task;

use crate::{Bounds, SceneError};

/// The highest degree of spherical harmonics that a cloud may have.
pub const MAX_DEGREE: usize = 3;

/// Splats in the cloud's own space. All arrays list the splats in the same order. The validator may
/// change the order of the splats.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Place in the file ("/meshes/3/primitives/0"), for messages.
    pub place: String,
    /// Centres μ of the splats.
    pub positions: Vec<Vec3>,
    /// Rotations from a splat's axes to the cloud's; the validator makes them unit quaternions.
    pub rotations: Vec<Quat>,
    /// Standard deviations of each splat along its own axes, ≥ 0.
    pub scales: Vec<Vec3>,
    /// Opacity of each splat at its centre, 0..1.
    pub opacities: Vec<f32>,
    /// Degree of the harmonics, 0..=[`MAX_DEGREE`].
    pub degree: usize,
    /// Coefficients c_lm, `[splat][coefficient][rgb]`, in the cloud's axes. There are (degree + 1)²
    /// coefficients, in the order of degree l, then of order m.
    pub harmonics: Vec<f32>,
    /// Colour space of the harmonics. Splats are also blended in this space, or in sRGB if the
    /// clouds of a scene have different spaces.
    pub encoding: Encoding,
}

/// The space of a cloud's colours. Both spaces are display-referred and have the primaries of
/// BT.709; 1 is white.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// sRGB code values, in which captures are trained.
    #[default]
    Srgb,
    /// Linear light.
    Linear,
}

/// A cloud placed in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedCloud {
    /// Index into [`SceneParts::clouds`](crate::SceneParts::clouds).
    pub cloud: usize,
    /// Placement of the cloud: any invertible affine map.
    pub scene_from_cloud: Affine3A,
}

/// A cloud of more splats than this is sorted by position, since renderers read neighbouring splats
/// together.
const UNSORTED: usize = 1 << 13;
/// Quantiles of the positions on each axis, between which the bulk of a cloud lies.
const BULK: [f64; 2] = [0.02, 0.98];
/// A splat is a floater if its distance from the bulk exceeds this fraction of the bulk's size.
/// Floaters do not extend the bounds.
const REACH: f32 = 0.5;
/// A splat of smaller opacity than this does not extend the bounds, unless all splats near the bulk
/// are so faint.
const LEAST_OPACITY: f32 = 0.1;

impl Cloud {
    /// Returns the number of splats.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns true if there are no splats.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Returns the number of coefficients per splat and channel.
    pub fn coefficients(&self) -> usize {
        (self.degree + 1).pow(2)
    }

    /// Returns the size of the cloud's arrays in bytes.
    pub fn bytes(&self) -> usize {
        self.len() * (size_of::<Vec3>() * 2 + size_of::<Quat>() + size_of::<f32>() * (1 + 3 * self.coefficients()))
    }

    /// Keeps the splats whose centres satisfy `wanted`.
    pub fn retain(&mut self, wanted: impl Fn(Vec3) -> bool) {
        let kept: Vec<bool> = self.positions.iter().map(|at| wanted(*at)).collect();
        self.keep(&kept);
    }

    fn keep(&mut self, kept: &[bool]) {
        fn chosen<T: Copy>(values: &mut Vec<T>, size: usize, kept: &[bool]) {
            let mut next = 0;
            for i in (0..kept.len()).filter(|i| kept[*i]) {
                values.copy_within(i * size..(i + 1) * size, next * size);
                next += 1;
            }
            values.truncate(next * size);
        }
        let values = 3 * self.coefficients();
        chosen(&mut self.positions, 1, kept);
        chosen(&mut self.rotations, 1, kept);
        chosen(&mut self.scales, 1, kept);
        chosen(&mut self.opacities, 1, kept);
        chosen(&mut self.harmonics, values, kept);
    }

    /// Returns the reason why a splat is not a Gaussian; `None` if it is one.
    fn fault(&self, i: usize) -> Option<&'static str> {
        let (scale, rotation, values) = (self.scales[i], self.rotations[i], 3 * self.coefficients());
        if !self.positions[i].is_finite() {
            Some("a position that is not finite")
        } else if !(scale.is_finite() && scale.min_element() >= 0.0) {
            Some("a scale that is negative or not finite")
        } else if !(rotation.is_finite() && rotation.length_squared().is_normal()) {
            Some("a rotation without direction")
        } else if !(0.0..=1.0).contains(&self.opacities[i]) {
            Some("an opacity outside 0..1")
        } else if !self.harmonics[i * values..(i + 1) * values].iter().all(|value| value.is_finite()) {
            Some("a colour that is not finite")
        } else {
            None
        }
    }

    /// Checks lengths, normalizes rotations, and sorts a large cloud by position. Drops splats that
    /// are not Gaussians, which files of some trainers contain.
    pub(crate) fn check(&mut self, task: Task<'_>) -> Result<(), SceneError> {
        if self.degree > MAX_DEGREE {
            let expected = format!("a degree of harmonics up to {MAX_DEGREE}");
            return Err(SceneError::new(&self.place, expected, self.degree.to_string()));
        }
        // check that every list has an entry per splat
        let count = self.len();
        let lengths = [
            ("rotations", self.rotations.len(), count),
            ("scales", self.scales.len(), count),
            ("opacities", self.opacities.len(), count),
            ("harmonics", self.harmonics.len(), 3 * self.coefficients() * count),
        ];
        if let Some((name, found, expected)) = lengths.into_iter().find(|(_, found, expected)| found != expected) {
            let expected = format!("a list `{name}` of length {expected}");
            return Err(SceneError::new(&self.place, expected, found.to_string()));
        }
        // leave out splats that are not Gaussians, with one warning for all
        let mut first_fault = None;
        let kept: Vec<bool> = (0..count)
            .map(|i| {
                let fault = self.fault(i);
                if let Some(fault) = fault {
                    first_fault.get_or_insert((i, fault));
                }
                fault.is_none()
            })
            .collect();
        if let Some((i, fault)) = first_fault {
            self.keep(&kept);
            let dropped = count - self.len();
            let message = format!("splats left out: {dropped} of {count}; splat {i}, the first of them, has {fault}");
            task.warn(&self.place, message);
        }
        self.rotations.iter_mut().for_each(|rotation| *rotation = rotation.normalize());
        // sort the splats of a large cloud, so that splats close in space are close in memory
        if self.len() > UNSORTED {
            self.sort_by_place();
        }
        Ok(())
    }

    /// Sorts splats along Morton's curve through the cloud, so that neighbours in space follow one
    /// another.
    fn sort_by_place(&mut self) {
        let mut bounds = Bounds::EMPTY;
        self.positions.iter().for_each(|at| bounds.include(*at));
        let steps = (1u32 << 21) as f32 / bounds.size().max_element().max(f32::MIN_POSITIVE);
        // insert two zeros between neighbouring bits of a number
        let spread = |value: f32| {
            let mut bits = u64::from((value * steps) as u32).min((1 << 21) - 1);
            for (shift, mask) in [
                (32, 0x1f_0000_0000_ffff),
                (16, 0x1f_0000_ff00_00ff),
                (8, 0x100f_00f0_0f00_f00f),
                (4, 0x10c3_0c30_c30c_30c3),
                (2, 0x1249_2492_4924_9249),
            ] {
                bits = (bits | bits << shift) & mask;
            }
            bits
        };
        // compute the Morton code of a position
        let key = |at: Vec3| {
            let [x, y, z] = (at - bounds.min).to_array();
            spread(x) | spread(y) << 1 | spread(z) << 2
        };
        let mut order: Vec<(u64, u32)> = self.positions.iter().zip(0..).map(|(at, i)| (key(*at), i)).collect();
        order.sort_unstable();
        fn turned<T: Copy>(values: &mut Vec<T>, size: usize, order: &[(u64, u32)]) {
            let of_one = |i: u32| &values[i as usize * size..(i as usize + 1) * size];
            *values = order.iter().flat_map(|(_, i)| of_one(*i)).copied().collect();
        }
        let values = 3 * self.coefficients();
        turned(&mut self.positions, 1, &order);
        turned(&mut self.rotations, 1, &order);
        turned(&mut self.scales, 1, &order);
        turned(&mut self.opacities, 1, &order);
        turned(&mut self.harmonics, values, &order);
    }

    /// Returns the bounds of the placed cloud without its floaters and its faint splats. On every
    /// axis, the bounds hold the bulk of the cloud's splats, and the splats near the bulk. To find
    /// the bulk, splats are weighted by opacity × area.
    pub(crate) fn seen_bounds(&self, scene_from_cloud: Affine3A) -> Bounds {
        let points: Vec<Vec3> = self.positions.iter().map(|p| scene_from_cloud.transform_point3(*p)).collect();
        // Compute the area that each splat covers. The largest tenth of the splats are sky and
        // haze, so their areas are limited to the smallest area of this tenth.
        let mut areas: Vec<f32> = self.scales.iter().map(|s| (s.x * s.y).max(s.y * s.z).max(s.z * s.x)).collect();
        let mut sorted = areas.clone();
        sorted.sort_by(f32::total_cmp);
        let Some(&most) = sorted.get(sorted.len() * 9 / 10) else { return Bounds::EMPTY };
        areas.iter_mut().zip(&self.opacities).for_each(|(area, opacity)| *area = area.min(most) * opacity);
        // Find the bulk on each axis, and surround it by a fence. Only splats inside the fence
        // extend the bounds.
        let all: f64 = areas.iter().map(|area| f64::from(*area)).sum();
        let mut fence = Bounds { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY };
        if all > 0.0 {
            let mut order: Vec<u32> = (0..points.len() as u32).collect();
            for axis in 0..3 {
                order.sort_by(|a, b| points[*a as usize][axis].total_cmp(&points[*b as usize][axis]));
                let quantile = |share: f64| {
                    let mut sum = 0.0;
                    let at = order.iter().find(|i| {
                        sum += f64::from(areas[**i as usize]);
                        sum >= share * all
                    });
                    points[*at.unwrap_or(&order[order.len() - 1]) as usize][axis]
                };
                let [low, high] = BULK.map(quantile);
                fence.min[axis] = low - REACH * (high - low);
                fence.max[axis] = high + REACH * (high - low);
            }
        }
        let mut bounds = Bounds::EMPTY;
        for (point, opacity) in points.iter().zip(&self.opacities) {
            if *opacity >= LEAST_OPACITY && fence.contains(*point) {
                bounds.include(*point);
            }
        }
        if bounds.is_empty() {
            // all splats near the bulk are faint, so use them in spite of their opacity
            points.iter().filter(|point| fence.contains(**point)).for_each(|point| bounds.include(*point));
        }
        bounds
    }
}

#[cfg(test)]
mod tests {
    use lumistack_core::{Cancel, Collector};

    use super::*;
    use crate::{Scene, SceneParts};

    fn cloud(xs: &[f32]) -> Cloud {
        let count = xs.len();
        Cloud {
            place: "/a".into(),
            positions: xs.iter().map(|x| Vec3::new(*x, 0.0, 0.0)).collect(),
            rotations: vec![Quat::from_xyzw(0.0, 0.0, 0.0, 2.0); count],
            scales: vec![Vec3::ONE; count],
            opacities: vec![1.0; count],
            harmonics: vec![0.0; 3 * count],
            ..Cloud::default()
        }
    }

    /// Validates a scene with a cloud that each of `maps` places once. Returns the scene and its
    /// warnings.
    fn validated(cloud: Cloud, maps: &[Affine3A]) -> (Result<Scene, SceneError>, Vec<String>) {
        let placed_clouds = maps.iter().map(|map| PlacedCloud { cloud: 0, scene_from_cloud: *map }).collect();
        let parts = SceneParts { name: "a".into(), clouds: vec![cloud], placed_clouds, ..SceneParts::default() };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let scene = parts.validate(Task::quiet(&warnings, &cancel));
        (scene, warnings.take().iter().map(ToString::to_string).collect())
    }

    #[test]
    fn what_is_no_gaussian_is_left_out_and_told_once() {
        let mut broken = cloud(&[0.0, 1.0, f32::NAN, 3.0, 4.0, 5.0, 6.0]);
        broken.scales[3].y = -1.0;
        broken.rotations[4] = Quat::from_xyzw(0.0, 0.0, 0.0, 0.0);
        broken.opacities[5] = 1.5;
        broken.harmonics[3 * 6 + 1] = f32::INFINITY;
        let (scene, warnings) = validated(broken, &[Affine3A::IDENTITY]);
        let scene = scene.unwrap();
        assert_eq!((scene.splat_count(), scene.bounds().max.x), (2, 1.0));
        assert_eq!(scene.clouds[0].rotations, [Quat::IDENTITY; 2]);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("splats left out: 5 of 7; splat 2, the first of them, has"), "{warnings:?}");
        let (none, _) = validated(cloud(&[f32::NAN]), &[Affine3A::IDENTITY]);
        assert!(none.unwrap_err().to_string().contains("at least one splat that is a Gaussian"));
        let short = Cloud { opacities: vec![], ..cloud(&[0.0]) };
        assert!(validated(short, &[]).0.unwrap_err().to_string().contains("`opacities` of length 1"));
        let high = Cloud { degree: 4, ..cloud(&[0.0]) };
        assert!(validated(high, &[]).0.unwrap_err().to_string().contains("harmonics up to 3"));
    }

    #[test]
    fn copies_without_extent_are_left_out_and_too_many_are_refused() {
        let flat = Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0));
        let (scene, warnings) = validated(cloud(&[0.0]), &[flat, Affine3A::from_translation(Vec3::X)]);
        assert_eq!(scene.unwrap().placed_clouds.len(), 1);
        assert!(warnings[0].contains("a scale of zero"), "{warnings:?}");
        let lost = Affine3A::from_translation(Vec3::splat(f32::NAN));
        assert!(validated(cloud(&[0.0]), &[lost]).0.unwrap_err().to_string().contains("a finite transform"));
        let many = vec![Affine3A::IDENTITY; 1 << 18];
        let error = validated(cloud(&[0.0; 1 << 10]), &many).0.unwrap_err().to_string();
        assert!(error.contains("at most 134217728 placed splats"), "{error}");
    }

    #[test]
    fn floaters_do_not_widen_the_bounds() {
        let mut xs: Vec<f32> = (0..100).map(|i| i as f32 / 100.0).collect();
        xs.push(50.0);
        let (scene, _) = validated(cloud(&xs), &[Affine3A::IDENTITY]);
        let bounds = scene.unwrap().bounds();
        assert!(bounds.max.x < 1.0 && bounds.min.x == 0.0, "{bounds:?}");
    }
}
