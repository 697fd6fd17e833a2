//! Crops captures to a box or a sphere.

use glam::Vec3;
use lumistack_core::Task;
use lumistack_scene::{Scene, SceneParts};
use lumistack_shot::edited;

use crate::error::PipelineError;
use crate::job::PoseJob;

/// Removes the splats whose centres are outside `pose.crop_box` or `pose.crop_sphere`.
///
/// # Errors
/// If no splat is left, or the task is cancelled.
pub(crate) fn cropped(scene: Scene, pose: &PoseJob, task: Task<'_>) -> Result<Scene, PipelineError> {
    let corners = pose.crop_box.map(|corners| corners.map(vector)).map(|[a, b]| [a.min(b), a.max(b)]);
    let sphere = pose.crop_sphere.map(|[x, y, z, radius]| (vector([x, y, z]), radius as f32));
    if corners.is_none() && sphere.is_none() {
        return Ok(scene);
    }
    let count: usize = scene.placed_clouds.iter().map(|placed| scene.clouds[placed.cloud].len()).sum();
    let inside = |at: Vec3| {
        corners.is_none_or(|[low, high]| at.cmpge(low).all() && at.cmple(high).all())
            && sphere.is_none_or(|(centre, radius)| at.distance(centre) <= radius)
    };
    edited(scene, task, |parts| {
        crop(parts, inside);
        if parts.placed_clouds.is_empty() {
            let key = if corners.is_some() { "pose.crop_box" } else { "pose.crop_sphere" };
            let found = if count == 0 {
                "a scene without splats".into()
            } else {
                format!("a crop without splats (number of splats in the scene: {count})")
            };
            return Err(PipelineError::job(key, "a crop that contains splats of the scene", found));
        }
        Ok(())
    })
}

/// Crops the clouds. If a cloud is used in several places, different splats may remain in each
/// place. So every place gets a cloud of its own.
fn crop(parts: &mut SceneParts, inside: impl Fn(Vec3) -> bool) {
    let clouds = std::mem::take(&mut parts.clouds);
    for mut placed in std::mem::take(&mut parts.placed_clouds) {
        let mut cloud = clouds[placed.cloud].clone();
        cloud.retain(|at| inside(placed.scene_from_cloud.transform_point3(at)));
        if !cloud.is_empty() {
            placed.cloud = parts.clouds.len();
            parts.clouds.push(cloud);
            parts.placed_clouds.push(placed);
        }
    }
}

fn vector(values: [f64; 3]) -> Vec3 {
    Vec3::from_array(values.map(|value| value as f32))
}

#[cfg(test)]
mod tests {
    use glam::Affine3A;
    use lumistack_core::{Cancel, Collector};
    use lumistack_scene::{Cloud, PlacedCloud};

    use super::*;

    /// Returns a scene of four splats in a row along x. They are placed twice: at the origin, and
    /// ten units above.
    fn scene() -> Scene {
        let mut cloud = Cloud::default();
        for x in 0..4 {
            cloud.positions.push(Vec3::new(x as f32, 0.0, 0.0));
            cloud.rotations.push(glam::Quat::IDENTITY);
            cloud.scales.push(Vec3::splat(0.1));
            cloud.opacities.push(1.0);
            cloud.harmonics.extend([x as f32; 3]);
        }
        let placed = |y| PlacedCloud { cloud: 0, scene_from_cloud: Affine3A::from_translation(Vec3::new(0.0, y, 0.0)) };
        let placed_clouds = vec![placed(0.0), placed(10.0)];
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let parts = SceneParts { clouds: vec![cloud], placed_clouds, ..SceneParts::default() };
        parts.validate(Task::quiet(&warnings, &cancel)).unwrap()
    }

    /// Returns the sorted positions of the remaining splats, or the error.
    fn left(pose: &PoseJob) -> Result<Vec<[f32; 2]>, String> {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let scene = cropped(scene(), pose, Task::quiet(&warnings, &cancel)).map_err(|error| error.to_string())?;
        let mut places: Vec<[f32; 2]> = scene.splat_positions().map(|at| [at.x, at.y]).collect();
        places.sort_by(|a, b| a.partial_cmp(b).unwrap());
        Ok(places)
    }

    #[test]
    fn each_placement_is_cropped_where_it_stands() {
        assert_eq!(left(&PoseJob::default()).unwrap().len(), 8);
        // The two corners of the box may be in any order.
        let crop_box = Some([[2.5, 11.0, 1.0], [0.5, 9.0, -1.0]]);
        assert_eq!(left(&PoseJob { crop_box, ..PoseJob::default() }).unwrap(), [[1.0, 10.0], [2.0, 10.0]]);
        let crop_sphere = Some([0.0, 0.0, 0.0, 2.0]);
        let sphere = PoseJob { crop_sphere, ..PoseJob::default() };
        assert_eq!(left(&sphere).unwrap(), [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]);
        let both = PoseJob { crop_box: Some([[1.5, -1.0, -1.0], [9.0, 1.0, 1.0]]), ..sphere };
        assert_eq!(left(&both).unwrap(), [[2.0, 0.0]]);
    }

    #[test]
    fn a_crop_without_splats_is_an_error() {
        let crop_sphere = Some([0.0, 5.0, 0.0, 1.0]);
        let error = left(&PoseJob { crop_sphere, ..PoseJob::default() }).unwrap_err();
        let expected = "pose.crop_sphere: expected a crop that contains splats of the scene, found a crop without splats (number of splats in the scene: 8)";
        assert!(error.contains(expected), "{error}");
    }
}
