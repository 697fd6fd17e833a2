//! Lighting: the studio light for scenes without light, and environment maps.

use std::sync::Arc;

use glam::{Quat, Vec3};
use lumistack_core::{NoProgress, Task};
use lumistack_display::{FieldGeometry, Projection, ViewGrid};
use lumistack_pathtracer::Settings;
use lumistack_scene::{AlphaMode, Environment, Image, Lamp, Material, Pixels, Scene, SceneParts, Window};

use crate::edit::edited;
use crate::error::ShotError;
use crate::job::LightJob;
use crate::place::side;
use crate::renderer::SceneRenderer;
use crate::surround;
use crate::tone_mapping::automatic_tone_mapping;

/// Numbers of columns and rows of the studio map. Small numbers suffice, since the map is smooth.
const STUDIO: [usize; 2] = [128, 64];
/// Numbers of columns and rows of the picture that measures whether lamps light a scene.
const PROBE: [usize; 2] = [96, 60];
/// Number of paths per pixel of the picture that measures whether lamps light a scene.
const PROBE_SAMPLES: u32 = 16;
/// Surfaces whose value after exposure and tone curve is below this are regarded as unlit.
const DARK: f64 = 0.02;
/// Smallest fraction of the visible surfaces that the scene's own light must light, if only glowing
/// objects give light.
const LIT_BY_GLOW: f64 = 0.5;
/// Smallest fraction of the visible surfaces that the scene's own light must light, if the scene
/// has light sources. The scene's author may want a spot in a dark room.
const LIT_BY_LAMPS: f64 = 0.05;
/// Radiance of the background behind a scene in studio light: a dark neutral ground.
const GROUND: f32 = 0.035;

/// Measures whether a scene's own lamps light its visible surfaces. If not, returns the reason why
/// the scene gets the studio light too. For example, a glowing engine does not light a hangar, and
/// lamps may shine past the visible region.
///
/// # Errors
/// When the scene cannot be rendered, or when cancelled.
pub(crate) fn probe(scene: &Arc<Scene>, task: Task<'_>) -> Result<Option<&'static str>, ShotError> {
    if scene.environment.is_some() {
        return Ok(None);
    }
    // Replace opaque materials by clay, which keeps their emission. So scenes that differ only in
    // the reflectance of opaque surfaces get the same result.
    let scene = &Arc::new(edited::<ShotError>((**scene).clone(), task, |parts| {
        parts.materials.iter_mut().for_each(to_clay);
        Ok(())
    })?);
    // Render a small picture of the scene, from its first camera or else from the best side.
    let [cols, rows] = PROBE;
    let grid = ViewGrid::single(Projection::Oblique, [0.0; 2]);
    let geometry = FieldGeometry { rows, cols, pitch_mm: 1.0, grid };
    let size_mm = geometry.size_mm();
    let quiet = Task { progress: &NoProgress, ..task };
    let renderer = SceneRenderer::new(scene.clone(), quiet)?;
    let seen_by = |camera| Window::from_camera(camera, scene.seen_bounds(), size_mm).ok();
    let window = match scene.cameras.first().and_then(seen_by) {
        Some(window) => window,
        None => side::framed(scene, side::choose(&renderer, scene, size_mm, quiet)?, size_mm)
            .map_err(|source| ShotError::Window { name: scene.name.clone(), source })?,
    };
    let settings = Settings { samples: PROBE_SAMPLES, ..Settings::default() };
    let tracer = &renderer.tracer;
    let radiance = tracer.render_view(&window, &geometry, [0, 0], &settings, quiet)?;
    let mask = tracer.hit_mask(&window, &geometry, [0, 0], quiet)?;
    let brightest = radiance.data().chunks_exact(3).map(|rgb| rgb[0].max(rgb[1]).max(rgb[2]));
    let rays: Vec<(f32, bool)> = brightest.zip(mask.data().iter().map(|&hit| hit > 0.5)).collect();
    let (exposure, curve) = automatic_tone_mapping(scene, &rays);
    let is_lit = |value: f32| curve.apply([(f64::from(value) * exposure) as f32; 3])[1] >= DARK as f32;
    let surfaces = rays.iter().filter(|(_, surface)| *surface);
    let count = surfaces.clone().count() as f64;
    // Count the pixels whose surfaces are lit after automatic exposure.
    let lit = surfaces.filter(|(value, _)| is_lit(*value)).count() as f64;
    let has_lamps = !scene.lights.is_empty() || scene.materials.iter().any(|material| material.lamp != Lamp::No);
    let message = if has_lamps {
        (lit < LIT_BY_LAMPS * count).then_some(
            "the scene's own lamps leave almost all visible surfaces dark, so the studio light is added; `light.automatic = false` prevents the studio light",
        )
    } else {
        (lit < LIT_BY_GLOW * count).then_some(
            "the scene's glowing surfaces leave most visible surfaces dark, so the studio light is added; `light.automatic = false` prevents the studio light",
        )
    };
    Ok(message)
}

/// Reflectance of the clay that replaces the materials while their light is measured.
const CLAY: f32 = 0.5;

/// Turns an opaque surface into clay that keeps its emission. Unlit surfaces, and surfaces that
/// transmit light or have another alpha mode, stay as they are.
fn to_clay(material: &mut Material) {
    if material.unlit || material.transmission > 0.0 || material.alpha_mode != AlphaMode::Opaque {
        return;
    }
    *material = Material {
        name: std::mem::take(&mut material.name),
        base_color: Vec3::splat(CLAY).extend(1.0),
        metallic: 0.0,
        roughness: 1.0,
        specular: 0.0,
        emission: material.emission,
        emission_texture: material.emission_texture,
        double_sided: material.double_sided,
        lamp: material.lamp,
        ..Material::default()
    };
}

/// Adds the built-in studio light: a soft grey surround that darkens downwards, with two lamps. The
/// key light is large, and above to the left in front of the scene. The fill light, to the right,
/// is weaker. Radiance outside the lamps is at most about 1. Instead of the surround, the viewer
/// sees a dark ground behind the scene.
pub fn add_studio_light(parts: &mut SceneParts) {
    let [width, height] = STUDIO;
    let mut texels = Vec::with_capacity(width * height);
    let key = Vec3::new(-0.6, 0.75, 0.7).normalize();
    let fill = Vec3::new(0.9, 0.25, 0.5).normalize();
    for row in 0..height {
        let elevation = std::f32::consts::FRAC_PI_2 - (row as f32 + 0.5) / height as f32 * std::f32::consts::PI;
        for col in 0..width {
            // the centre column shows −z, and columns to the right of it turn towards +x
            let azimuth = ((col as f32 + 0.5) / width as f32 - 0.5) * std::f32::consts::TAU;
            let direction =
                Vec3::new(elevation.cos() * azimuth.sin(), elevation.sin(), -elevation.cos() * azimuth.cos());
            let surround = 0.30 + 0.25 * direction.y;
            let lobe = |axis: Vec3, sharpness: f32| (sharpness * (direction.dot(axis) - 1.0)).exp();
            let radiance = Vec3::splat(surround)
                + Vec3::new(1.0, 0.96, 0.9) * 9.0 * lobe(key, 18.0)
                + Vec3::new(0.85, 0.93, 1.0) * 1.6 * lobe(fill, 10.0);
            texels.push(radiance.to_array());
        }
    }
    let image = Image { name: "studio light".into(), width, height, pixels: Pixels::RgbF32(texels) };
    set_environment(parts, image, Vec3::ONE, Quat::IDENTITY);
    parts.backdrop = Some(Vec3::splat(GROUND));
}

/// Sets an image as the scene's environment.
pub fn set_environment(parts: &mut SceneParts, image: Image, strength: Vec3, scene_from_environment: Quat) {
    parts.images.push(image);
    parts.environment = Some(Environment { image: parts.images.len() - 1, strength, scene_from_environment });
}

/// Lights a scene as a job says. `environment` is true if the scene's environment came from the
/// job, at the job's strength: from the file that `light.environment` names, or from splats.
/// Returns the scene, and true if the studio light was added.
///
/// # Errors
/// When the scene cannot be rendered, or when cancelled.
pub fn lit(
    mut scene: Scene,
    environment: bool,
    job: &LightJob,
    task: Task<'_>,
) -> Result<(Arc<Scene>, bool), ShotError> {
    // If the environment comes from the scene's own file, apply the job's factor to it.
    if !environment
        && let Some(strength) = scene.environment.map(|environment| environment.strength)
        && job.environment_strength != 1.0
    {
        scene = edited::<ShotError>(scene, task, |parts| {
            if let Some(environment) = &mut parts.environment {
                environment.strength = strength * job.environment_strength;
            }
            Ok(())
        })?;
    }
    // Make light sources with a surface visible or invisible, as the job says.
    if let Some(visible) = job.visible {
        let wanted = if visible { Lamp::Seen } else { Lamp::Unseen };
        if scene.materials.iter().any(|material| material.lamp != Lamp::No && material.lamp != wanted) {
            scene = edited::<ShotError>(scene, task, |parts| {
                let lamps = parts.materials.iter_mut().filter(|material| material.lamp != Lamp::No);
                lamps.for_each(|material| material.lamp = wanted);
                Ok(())
            })?;
        }
    }
    let has_environment = scene.environment.is_some();
    if has_environment {
        scene = surround::turned(scene, job, task)?;
    }
    // Add studio light if the scene has no light, or if its light leaves too many surfaces dark.
    // Splats bring their own light, so a scene of splats alone gets none.
    let automatic = job.automatic && !scene.instances.is_empty();
    let mut studio = automatic && !scene.is_lit();
    let mut scene = Arc::new(scene);
    if automatic
        && !studio
        && let Some(message) = probe(&scene, task)?
    {
        task.warn(&scene.name, message);
        studio = true;
    }
    if studio {
        let lit = edited::<ShotError>(Arc::unwrap_or_clone(scene), task, |parts| {
            add_studio_light(parts);
            if let Some(environment) = &mut parts.environment {
                environment.strength = Vec3::splat(job.environment_strength);
            }
            Ok(())
        })?;
        scene = Arc::new(surround::turned(lit, job, task)?);
    } else if !has_environment {
        surround::warn_of_unused(&scene, job, task);
    }
    Ok((scene, studio))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Vec4};
    use lumistack_core::{Cancel, Collector};
    use lumistack_scene::{Instance, Mesh};

    /// Returns a scene of a floor below a glowing panel, seen from above.
    fn room(floor: Material) -> Arc<Scene> {
        let square = |height: f32, half: f32, material: usize| Mesh {
            place: format!("/{material}"),
            positions: [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, z)| Vec3::new(half * x, height, half * z))
                .to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material,
            ..Mesh::default()
        };
        let lamp = Material { emission: Vec3::splat(5.0), double_sided: true, ..Material::default() };
        let placed = |mesh: usize| Instance { mesh, scene_from_mesh: Affine3A::from_rotation_x(0.5) };
        let parts = SceneParts {
            name: "room".into(),
            meshes: vec![square(0.0, 2.0, 0), square(2.0, 0.7, 1)],
            instances: vec![placed(0), placed(1)],
            materials: vec![Material { double_sided: true, ..floor }, lamp],
            ..SceneParts::default()
        };
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        Arc::new(parts.validate(Task::quiet(&warnings, &cancel)).unwrap())
    }

    #[test]
    fn lamps_are_judged_by_their_light_and_not_by_the_materials_that_it_falls_on() {
        let (warnings, cancel) = (Collector::default(), Cancel::default());
        let task = Task::quiet(&warnings, &cancel);
        let grey = |value: f32| Material { base_color: Vec4::new(value, value, value, 1.0), ..Material::default() };
        for floor in [
            grey(0.8),
            Material { metallic: 0.0, roughness: 0.9, ..grey(0.004) },
            Material { metallic: 1.0, roughness: 0.0, ..grey(1.0) },
        ] {
            assert!(probe(&room(floor.clone()), task).unwrap().is_none(), "{floor:?}");
        }
    }
}
